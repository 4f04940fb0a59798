"""The parser that Lark makes of ``grammar/menid.lark``, its table kept between runs.

With the reader of PPDDL this is the only module that imports Lark.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any, cast

from lark import Lark, logger
from lark.exceptions import UnexpectedInput
from lark.lexer import Lexer as LarkLexer
from lark.parsers.lalr_analysis import Shift
from platformdirs import user_cache_path

from menid_plan import resources
from menid_plan.language import syntax
from menid_plan.language.builder import Builder
from menid_plan.language.tokens import Lexer, Terminal

SYNTAX_ERRORS = (UnexpectedInput, syntax.NestingError)

# What a text, or a part of one, may be parsed as.
_STARTS = "file domain problem declaration action rule row block_row atoms atom".split()


class GivenTokens(LarkLexer):
    """Hands on the tokens that the parser is given in place of a text."""

    def __init__(self, conf: Any) -> None:
        del conf

    def lex(self, tokens: Any) -> Iterator[Any]:  # type: ignore[override]
        """The tokens themselves."""
        return iter(tokens)


def parse_tokens(tokens: list[syntax.Token], start: str) -> Any:
    """The node that the tokens make, by the grammar's rule ``start``; raises SYNTAX_ERRORS."""
    with _without_collection():
        return _lark().parse(cast("Any", tokens), start=start)


def accepted(error: UnexpectedInput) -> set[str]:
    """The terminals that could have stood where Lark found the error; ``$END`` for the end.

    Lark offers the same as ``error.accepts``, but copies all that has been parsed for each try.
    """
    state = error.interactive_parser.parser_state
    conf = state.parse_conf
    choices = {*conf.states[state.state_stack[-1]], "$END"}
    return {t for t in choices if t.isupper() and _shifts(t, list(state.state_stack), conf)}


def _shifts(terminal: str, stack: list[Any], conf: Any) -> bool:
    """Whether a terminal is shifted at last, after the reductions that it calls for."""
    while True:
        if terminal == "$END" and stack[-1] == conf.end_state:
            return True
        entry = conf.states[stack[-1]].get(terminal)
        if entry is None:
            return False
        action, rule = entry
        if action is Shift:
            return True
        if rule.expansion:
            del stack[-len(rule.expansion) :]
        stack.append(conf.states[stack[-1]][rule.origin.name][1])


@cache
def lexer() -> Lexer:
    """The lexer of the MENID grammar."""
    return Lexer(
        Terminal(t.name, t.pattern.type == "str", t.pattern.value, t.priority)
        for t in _lark().terminals
    )


@cache
def _lark() -> Lark:
    # Lark logs a cache file that it can't use and then does without; users need not know.
    logger.disabled = True
    return Lark(
        (resources.folder("grammar") / "menid.lark").read_text(encoding="utf-8"),
        parser="lalr",
        lexer=GivenTokens,
        start=_STARTS,
        transformer=Builder(),
        cache=_cache_file(),
    )


def _cache_file() -> str | bool:
    """Where the parse table is kept between runs; False where no folder can be written."""
    try:
        folder = user_cache_path("menid-plan")
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # no home is known, or nothing can be written there
        return False
    return str(folder / "menid.parser")


@contextmanager
def _without_collection() -> Iterator[None]:
    """Switch the cycle collector off: a tree is all live, and scanning a big one costs a third."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
