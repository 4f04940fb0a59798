"""From a text to its lists and words, with what is wrong in its form."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any, TypeAlias

from lark import Lark, Token, Transformer
from lark.exceptions import UnexpectedCharacters, UnexpectedInput, UnexpectedToken

from menid_plan import resources
from menid_plan.source import Diagnostic, SourceFile, Span

# Lists in lists.
MAX_DEPTH = 100


@dataclass(frozen=True, slots=True)
class Word:
    """A name, variable (``?x``), number, keyword (``:init``) or sign, in small letters."""

    text: str
    kind: str
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class List:
    """What stands between two parentheses. ``depth`` counts the lists in lists, itself too."""

    items: tuple[Node, ...]
    start: int
    end: int
    depth: int

    @property
    def head(self) -> str:
        """The word that it starts with; empty if there is none."""
        first = self.items[0] if self.items else None
        return first.text if isinstance(first, Word) else ""


Node: TypeAlias = Word | List


class _Nodes(Transformer[Token, "tuple[List, ...]"]):
    """Makes nodes of what Lark has parsed, from the inside out."""

    def word(self, children: Sequence[Token]) -> Word:
        """A word."""
        (token,) = children
        assert token.start_pos is not None
        return Word(token.lower(), token.type, token.start_pos, token.start_pos + len(token))

    def list(self, children: Sequence[Any]) -> List:
        """A list, between its two parentheses."""
        first, *items, last = children
        depth = 1 + max((item.depth for item in items if isinstance(item, List)), default=0)
        return List(tuple(items), first.start_pos, last.start_pos + 1, depth)

    def start(self, children: Sequence[Any]) -> tuple[List, ...]:
        """The lists of a text."""
        return tuple(children)


@cache
def _lark() -> Lark:
    text = (resources.folder("grammar") / "ppddl.lark").read_text(encoding="utf-8")
    return Lark(text, parser="lalr", transformer=_Nodes(), keep_all_tokens=True)


def parse(source: SourceFile) -> tuple[tuple[List, ...], list[Diagnostic]]:
    """The lists of a text; none if a diagnostic says why its form is wrong."""
    try:
        # mypy: a parser with a transformer gives what the transformer makes
        lists: tuple[List, ...] = _lark().parse(source.text)  # type: ignore[assignment]
    except UnexpectedInput as error:
        return (), [_syntax_error(source, error)]
    exponent = next(_exponents(lists), None)
    if exponent is not None:
        span = Span(source, exponent[0].start, exponent[1].end)
        message = f"`{exponent[0].text}{exponent[1].text}` is no number"
        hint = "numbers are decimals without exponent, or fractions"
        return (), [Diagnostic("error", "P205", message, span, hint)]
    for each in lists:
        if each.depth > MAX_DEPTH:
            span = Span(source, each.start, each.start + 1)
            message = f"lists are nested more than {MAX_DEPTH} deep"
            return (), [Diagnostic("error", "P003", message, span)]
    return lists, []


def _exponents(lists: Sequence[List]) -> Iterator[tuple[Word, Word]]:
    """Where a number runs into a name, or a sign into a number."""
    waiting = list(lists)
    while waiting:
        items = waiting.pop().items
        waiting += [item for item in items if isinstance(item, List)]
        for left, right in pairwise(items):
            if not (isinstance(left, Word) and isinstance(right, Word)) or left.end != right.start:
                continue
            if left.kind == "NUMBER" or (left.text == "-" and right.kind == "NUMBER"):
                yield left, right


def _syntax_error(source: SourceFile, error: UnexpectedInput) -> Diagnostic:
    text = source.text
    at = min(error.pos_in_stream or 0, max(len(text) - 1, 0))
    if isinstance(error, UnexpectedCharacters):
        span = Span(source, at, at + 1)
        shown = text[at] if text[at].isprintable() else f"U+{ord(text[at]):04X}"
        return Diagnostic("error", "P001", f"the character `{shown}` has no meaning in PPDDL", span)
    if isinstance(error, UnexpectedToken) and error.token.type != "$END":
        span = Span(source, at, at + len(error.token))
        if str(error.token) == ")":
            return Diagnostic("error", "P002", "there is one `)` too many", span)
        message = f"expected `(define ...)`, found `{error.token}`"
        return Diagnostic("error", "P002", message, span)
    opened = _unclosed(text)
    span = Span(source, opened, opened + 1)
    return Diagnostic("error", "P002", "this `(` is never closed", span)


def _unclosed(text: str) -> int:
    """Where the list begins that is most likely not closed: the last one at the start of a line."""
    plain = re.sub(r";[^\n]*", lambda found: " " * len(found[0]), text)
    stack: list[int] = []
    for found in re.finditer(r"[()]", plain):
        if found[0] == "(":
            stack.append(found.start())
        elif stack:
            stack.pop()
    return stack[-1] if stack else 0
