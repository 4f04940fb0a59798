"""What to say of a syntax error: what was found, what was expected, and the likely mend."""

from __future__ import annotations

from typing import Any

from menid_plan.language.grammar import lexer
from menid_plan.language.syntax import Token
from menid_plan.language.tokens import TokenStream, shown
from menid_plan.source import Diagnostic, Span

_FORMULA = frozenset("NAME NOT EXISTS FORALL COUNT TRUE FALSE LPAR".split())
_EXPRESSION = frozenset("NAME NUMBER MINUS LPAR".split())
_NAMES = {"NAME": "a name", "NAME_COLON": "a name and `:`", "NUMBER": "a number", "$END": "the end"}
_OPERATORS = frozenset("AND OR IMPLIES PLUS MINUS STAR SLASH".split())


def explain(error: Any, piece: list[Token], stream: TokenStream) -> Diagnostic:
    """The diagnostic for Lark's error in a piece of a text."""
    found, previous, following = _place(error, piece, stream)
    expected = set(error.accepts or error.expected)
    reserved = found is not None and found.value[0].isalpha() and found.type not in _NAMES
    message = f"expected {_list(expected)}"
    if previous is not None:
        message += f" after `{shown(previous.value)}`"
    if found is None:
        message += ", but the text ends"
        last = stream.tokens[-1]
        span = Span(stream.source, last.end, last.end)
    else:
        message += f", found `{shown(found.value)}`"
        span = Span(stream.source, found.start, found.end)
    code = "M101"
    if (
        reserved
        and found is not None
        and expected & {"NAME", "NAME_COLON"}
        and _as_name(found, following)
    ):
        code = "M102"
        message = f"`{found.value}` is a reserved word and can't be a name"
    return Diagnostic(
        "error", code, message, span, _hint(found, previous, following, expected, piece)
    )


def _place(
    error: Any, piece: list[Token], stream: TokenStream
) -> tuple[Token | None, Token | None, Token | None]:
    """The offending token, the one before it and the one after; None where there is none."""
    token = error.token
    tokens = stream.tokens
    if isinstance(token, Token) and token.start < token.end:
        index = token.index
        found: Token | None = token
    else:  # the piece ended too early: what comes next in the whole text is in the way
        real = [t for t in piece if t.start < t.end]
        index = real[-1].index + 1
        found = tokens[index] if index < len(tokens) else None
    previous = tokens[index - 1] if index > 0 else None
    following = tokens[index + 1] if index + 1 < len(tokens) else None
    return found, previous, following


def _as_name(found: Token, following: Token | None) -> bool:
    """Whether a reserved word seems meant as a name: something follows it that follows names."""
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
    if len(words) == 1:
        return words[0]
    return f"{', '.join(words[:-1])} or {words[-1]}"


_SIGNS = {
    "LPAR": "(", "RPAR": ")", "LBRACE": "{", "RBRACE": "}", "COLON": ":", "COMMA": ",",
    "EQUAL": "=", "VBAR": "|", "LESSTHAN": "<", "MORETHAN": ">", "MINUS": "-", "PLUS": "+",
    "STAR": "*", "SLASH": "/", "DEAD_END": "dead-end",
}  # fmt: skip


def _name(terminal: str) -> str:
    if terminal in _NAMES:
        return _NAMES[terminal]
    if terminal in _SIGNS:
        return f"`{_SIGNS[terminal]}`"
    if terminal.startswith("__ANON"):
        return f"`{lexer().text_of(terminal)}`"
    return f"`{terminal.lower()}`"


def _hint(
    found: Token | None,
    previous: Token | None,
    following: Token | None,
    expected: set[str],
    piece: list[Token],
) -> str | None:
    if found is None:
        return None
    value = found.value
    in_row = piece[0].type == "NAME_COLON"
    if in_row and found.type in _OPERATORS and previous is not None:
        if found.type == "MINUS" and previous.value == ":":
            return "a probability can't be negative; an expression stands in parentheses: (1 - p)"
        return f"an expression in a row stands in parentheses: ({previous.value} {value} ...)"
    if in_row and found.type == "NUMBER" and previous is not None and previous.value == "(":
        return "a name followed by `(` is an atom; put the param in parentheses too: (p) (1 - p)"
    if value == "=" and previous is not None and previous.value == "=":
        return "`=` compares two objects"
    if "COLON" in expected or (
        "NAME_COLON" in expected and previous is not None and previous.type == "NAME"
    ):
        return "a variable is declared with its type: x: TYPE"
    if found.type == "WHEN" and "OUTCOMES" in expected:
        return "a rule has one `when`, after its references; join conditions with `and`"
    if found.type == "THE" and "OUTCOMES" in expected:
        return "references come before `when`"
    if "EQUAL" in expected and value == ":":
        return "write `=` here"
    if (
        previous is not None
        and previous.type == "NAME"
        and "COMMA" in expected
        and found.type == "NAME"
    ):
        return "names are separated by commas"
    if found.type == "NOT" and previous is not None and previous.value == "(":
        return None
    del following
    return None
