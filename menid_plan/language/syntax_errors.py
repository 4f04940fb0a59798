"""What to say of a syntax error: what was found, what was expected, and the likely mend."""

from __future__ import annotations

from typing import Any

from menid_plan.language.grammar import accepted, lexer
from menid_plan.language.hints import hint_for, lacks_type
from menid_plan.language.syntax import Token
from menid_plan.language.tokens import TokenStream, shown
from menid_plan.source import Diagnostic, Span

_FORMULA = frozenset("NAME NOT EXISTS FORALL COUNT TRUE FALSE LPAR".split())
_EXPRESSION = frozenset("NAME NUMBER MINUS LPAR".split())
_NAMES = {"NAME": "a name", "NAME_COLON": "a name and `:`", "NUMBER": "a number", "$END": "the end"}
_ITEM = frozenset("NAME NUMBER LPAR COMMA FORALL IF NOT NOTHING".split())
_NAME_OR_TYPE = frozenset(["NAME", "NAME_COLON", "OBJECT"])
_OPERATORS = frozenset("AND OR IMPLIES PLUS MINUS STAR SLASH".split())


def explain(error: Any, piece: list[Token], stream: TokenStream) -> Diagnostic:
    """The diagnostic for Lark's error in a piece of a text."""
    index = _index(error, piece)
    found = stream.tokens[index] if index < len(stream.tokens) else None
    previous = stream.tokens[index - 1] if index > 0 else None
    following = stream.tokens[index + 1] if index + 1 < len(stream.tokens) else None
    expected = accepted(error)
    if found is not None and found.index <= piece[-1].index:
        span = Span(stream.source, found.start, found.end)
        if expected & {"NAME", "NAME_COLON"} and _as_name(found, following, expected):
            message = f"`{found.value}` is a reserved word and can't be a name"
            return Diagnostic("error", "M102", message, span)
        tail = f", found `{shown(found.value)}`"
    else:  # the piece ends too early: what is missing belongs behind its last token
        end = stream.tokens[index - 1].end
        span = Span(stream.source, end, end)
        place = "the text" if found is None else "the declaration"
        tail = f", but {place} ends"
    after = f" after `{shown(previous.value)}`" if previous is not None else ""
    wanted = _list(expected)
    if expected == {"$END"}:
        wanted = {"RULE": "`rule` or `}`"}.get(piece[0].type, "the next declaration")
    if lacks_type(found, previous, expected):
        wanted = "`:` and a type"
    message = f"expected {wanted}{after}{tail}"
    hint = hint_for(found, previous, following, expected, piece)
    return Diagnostic("error", "M101", message, span, hint)


def _index(error: Any, piece: list[Token]) -> int:
    """The index of the token that is wrong; past the piece if it ends too early."""
    token = error.token
    if isinstance(token, Token) and token.start < token.end:
        return token.index
    return next(t.index for t in reversed(piece) if t.start < t.end) + 1


def _as_name(found: Token, following: Token | None, expected: set[str]) -> bool:
    """Whether a token is a reserved word and seems meant as a name, by what follows it."""
    if found.type in _NAMES or not found.value[0].isalpha():
        return False
    if not expected - _NAME_OR_TYPE and found.type != "NOT":
        return True  # nothing but a name could stand here
    if found.type in ("NOT", "EXISTS", "FORALL", "COUNT", "TRUE", "FALSE", "NOTHING"):
        return False
    return following is None or following.value in (
        "(",
        ")",
        ",",
        ":",
        "=",
        "{",
        "|",
        "<",
        "for",
        "..",
    )


def _list(expected: set[str]) -> str:
    rest = set(expected)
    words = []
    if rest >= _ITEM:
        rest -= _ITEM
        words.append("a probability or an effect")
    if rest >= _FORMULA:
        rest -= _FORMULA
        words.append("a formula")
    if rest >= _EXPRESSION:
        rest -= _EXPRESSION
        words.append("an expression")
    if {"TYPE", "ACTION"} <= rest or {"INIT", "GOAL"} <= rest:
        declarations = {
            "TYPE", "CONSTANT", "PARAM", "ENVIRONMENT", "PREDICATE", "DERIVED", "REWARD", "ACTION",
            "OBJECT", "INIT", "GOAL", "HORIZON", "DISCOUNT", "DEAD_END",
        }  # fmt: skip
        rest -= declarations
        words.append("a declaration")
    if rest - {"$END"} or ("$END" in rest and words):
        rest.discard("$END")
    operators = rest & _OPERATORS
    if len(rest) - len(operators) >= 1 and len(operators) > 1:
        rest -= operators
        words.append("an operator")
    words.extend(sorted((_name(terminal) for terminal in rest), key=lambda w: (w[0] == "`", w)))
    return " or ".join(part for part in (", ".join(words[:-1]), words[-1]) if part)


def _name(terminal: str) -> str:
    return _NAMES.get(terminal) or f"`{lexer().text_of(terminal)}`"
