"""What to say of a syntax error: what was found, what was expected, and the likely mend."""

from __future__ import annotations

from typing import Any

from menid_plan.language.grammar import accepted, lexer
from menid_plan.language.syntax import Token
from menid_plan.language.tokens import TokenStream, shown
from menid_plan.source import Diagnostic, Span

_FORMULA = frozenset("NAME NOT EXISTS FORALL COUNT TRUE FALSE LPAR".split())
_EXPRESSION = frozenset("NAME NUMBER MINUS LPAR".split())
_NAMES = {"NAME": "a name", "NAME_COLON": "a name and `:`", "NUMBER": "a number", "$END": "the end"}
_ITEM = frozenset("NAME NUMBER LPAR COMMA FORALL IF NOT NOTHING".split())
# What may follow a name that is declared with a type to come: a comma, or the dots of a range.
_IN_DECLARED_NAMES = frozenset([",", ".."])
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
    if _lacks_type(found, previous, expected):
        wanted = "`:` and a type"
    message = f"expected {wanted}{after}{tail}"
    hint = _hint(found, previous, expected, piece)
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


def _texts(expected: set[str]) -> set[str]:
    return {lexer().text_of(terminal) for terminal in expected}


def _name(terminal: str) -> str:
    return _NAMES.get(terminal) or f"`{lexer().text_of(terminal)}`"


def _lacks_type(found: Token | None, previous: Token | None, expected: set[str]) -> bool:
    """Whether a variable or object is named and its type left out."""
    if previous is None or previous.type != "NAME" or not _texts(expected) <= _IN_DECLARED_NAMES:
        return False
    return found is None or not found.type.startswith("NAME")


def _hint(
    found: Token | None, previous: Token | None, expected: set[str], piece: list[Token]
) -> str | None:
    """The likely mend, if the tokens about the error suggest one."""
    if _lacks_type(found, previous, expected):
        return "a variable or object is declared with its type: x: TYPE"
    if found is None:
        return None
    before = previous.value if previous is not None else ""
    if piece[0].type == "NAME_COLON":
        hint = _hint_in_row(found, before, expected)
        if hint is not None:
            return hint
    if before and (hint := _SLIPS.get(f"{before}{found.value}")) is not None:
        return hint
    after_name = previous is not None and previous.type.startswith("NAME")
    for applies, hint in (
        (found.index == 0 and found.value == "(", "this looks like PDDL, which MENID is not"),
        (found.type == "NAME_COLON" and found.value in lexer().reserved_words,
         f"`{found.value}` takes no colon"),
        (found.type == "NAME_COLON" and piece[0].type == "PREDICATE",
         "a predicate lists the types of its arguments alone: p(object)"),
        (found.type == "NAME_COLON" and before in ("derived", "param"), "write `=`, not `:`"),
        (found.value == ":" and "EQUAL" in expected, "write `=` here"),
        (before == "otherwise", "`otherwise` stands alone: it covers where no other rule does"),
        (found.type == "WHEN" and "OUTCOMES" in expected,
         "a rule has one `when`, after its references; join conditions with `and`"),
        (found.type == "THE" and "OUTCOMES" in expected, "references come before `when`"),
        (found.type == "NOT" and piece[0].type == "INIT", "what `init` does not list does not hold"),
        (found.type == "AND" and piece[0].type == "INIT", "atoms are separated by commas"),
        (found.type == "IF" and "WHEN" in expected, "write `when`"),
        (found.value == "," and "AND" in expected, "join conditions with `and`"),
        (found.value == "," and piece[0].type != "INIT" and "LBRACE" in expected,
         "environments are separated by spaces"),
        (found.value == "}" and expected == {"$END"}, "perhaps one `}` too many"),
        (after_name and found.type.startswith("NAME") and "COMMA" in expected,
         "names are separated by commas"),
        (after_name and found.type == "NAME" and "LPAR" in expected and "AND" in expected,
         f"arguments stand in parentheses: {before}({found.value})"),
    ):  # fmt: skip
        if applies:
            return hint
    return _similar_keyword(found, expected)


# Two signs that other languages join, or write the other way round.
_SLIPS = {
    "==": "`=` compares two objects",
    "=>": "write `>=` for at least, `implies` between formulas",
    "=<": "write `<=`",
    "->": "write `implies`",
}


def _hint_in_row(found: Token, before: str, expected: set[str]) -> str | None:
    if found.type == "MINUS" and "NOTHING" not in expected:
        return "what was seen, and what is likely, is not negative"
    if found.type == "MINUS" and before == ":":
        return "a probability is not negative; an expression stands in parentheses: (1 - p)"
    if found.type in ("AND", "OR", "IMPLIES"):
        return "effects are separated by commas; a condition belongs in `if CONDITION { ... }`"
    if found.type in _OPERATORS:
        return f"an expression in a row stands in parentheses: ({before} {found.value} ...)"
    if found.type == "NUMBER" and before == "(":
        return "a name before `(` is an atom; put a param in parentheses too: (p) (1 - p)"
    return None


def _similar_keyword(found: Token, expected: set[str]) -> str | None:
    """The expected word that a name looks like."""
    if not found.type.startswith("NAME"):
        return None
    from difflib import get_close_matches

    words = [text for text in _texts(expected) if text[0].isalpha()]
    matches = get_close_matches(found.value.lower(), words, n=1, cutoff=0.75)
    return f"did you mean `{matches[0]}`?" if matches else None
