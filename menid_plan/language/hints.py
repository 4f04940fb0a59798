"""The likely mend of a syntax error, from the tokens about it and what could have stood there."""

from __future__ import annotations

from collections.abc import Iterable

from menid_plan.language.grammar import lexer
from menid_plan.language.pieces import DECLARATION_STARTS
from menid_plan.language.syntax import Token

# What may follow a name that is declared with a type to come: a comma, or the dots of a range.
_IN_DECLARED_NAMES = frozenset([",", ".."])
_OPERATORS = frozenset("PLUS MINUS STAR SLASH".split())
_CONNECTIVES = frozenset("AND OR IMPLIES".split())

# Two signs that other languages join, or write the other way round.
_SLIPS = {
    "==": "`=` compares two objects",
    "=>": "write `>=` for at least, `implies` between formulas",
    "=<": "write `<=`",
    "->": "write `implies`",
    "//": "comments start with `#`",
    "/*": "comments start with `#`",
    "--": "comments start with `#`",
    "forall": "write `forall`",
}


def hint_for(
    found: Token | None,
    previous: Token | None,
    following: Token | None,
    expected: set[str],
    piece: list[Token],
) -> str | None:
    """The likely mend, if the tokens about the error suggest one."""
    if lacks_type(found, previous, expected):
        return _untyped(previous, piece)
    if found is None:
        return None
    before = previous.value if previous is not None else ""
    after = following.value if following is not None else ""
    for slip in (f"{before}{found.value}", f"{found.value}{after}"):
        if slip in _SLIPS and before != "/":
            return _SLIPS[slip]
    if piece[0].type == "NAME_COLON":
        hint = _in_row(found, before, expected)
    elif piece[0].type in ("ACTION", "RULE"):
        hint = _in_action(found, before, expected)
    else:
        hint = _in_declaration(found, before, expected, piece)
    return hint or _anywhere(found, before, previous, expected, piece)


def lacks_type(found: Token | None, previous: Token | None, expected: set[str]) -> bool:
    """Whether a variable or object is named and its type left out."""
    if previous is None or previous.type != "NAME" or not _texts(expected) <= _IN_DECLARED_NAMES:
        return False
    return found is None or found.type != "NAME_COLON"


def _untyped(previous: Token | None, piece: list[Token]) -> str:
    name = previous.value if previous is not None else "x"
    if piece[0].type in ("OBJECT", "CONSTANT"):
        return f"an object is declared with its type, `{name}: TYPE`; commas separate several"
    return f"a variable is declared with its type: `{name}: TYPE`"


def _in_row(found: Token, before: str, expected: set[str]) -> str | None:
    if found.type == "MINUS" and "NOTHING" not in expected:
        return "what was seen, and what is likely, is not negative"
    if found.type == "MINUS" and before == ":":
        return "a probability is not negative; an expression stands in parentheses: (1 - p)"
    if found.type in _CONNECTIVES:
        return "effects are separated by commas; a condition belongs in `if CONDITION { ... }`"
    if found.type == "PLUS" and before == "reward":
        return "no sign before a positive number"
    if found.type in _OPERATORS:
        return f"an expression in a row stands in parentheses: ({before} {found.value} ...)"
    if found.type == "NUMBER" and before == "(":
        return "a name before `(` is an atom; put a param in parentheses too: (p) (1 - p)"
    if found.type == "NAME" and "PLUS" in expected:
        return "the reward comes last in its row"
    return None


def _in_action(found: Token, before: str, expected: set[str]) -> str | None:
    if found.type == "COST":
        return "`cost` stands before the action's `{`"
    if found.type == "PER" and "OUTCOMES" not in expected:
        return "`per` stands behind the rule's name: `rule NAME per x {`"
    if found.type == "WHERE" and expected & {"WHEN", "OUTCOMES"}:
        return "a condition of the rule starts with `when`"
    if before == "otherwise":
        return "`otherwise` stands alone: it covers where no other rule does"
    if found.type == "WHEN" and "OUTCOMES" in expected:
        return "a rule has one `when`, after its references; join conditions with `and`"
    if found.type == "THE" and "OUTCOMES" in expected:
        return "references come before `when`"
    if found.value == "," and "LBRACE" in expected:
        return "environments are separated by spaces"
    return None


def _in_declaration(
    found: Token, before: str, expected: set[str], piece: list[Token]
) -> str | None:
    kind = piece[0].type
    if found.index == 0 and found.value == "(":
        return "this looks like PDDL, which MENID is not"
    if found.type == "NOT" and (kind == "INIT" or found.index == 0):
        return "list what holds; what is not listed does not hold"
    if found.type == "AND" and "COMMA" in expected:
        return "atoms are separated by commas"
    if found.type == "NAME_COLON" and kind == "PREDICATE":
        return "a predicate lists the types of its arguments alone: p(object)"
    if found.type == "NAME" and kind == "PREDICATE" and "LPAR" in expected:
        return f"the types of its arguments stand in parentheses: {before}({found.value})"
    if found.type == "NAME_COLON" and kind == "TYPE":
        return "a supertype stands behind `<`: type a < b"
    if found.type == "NAME_COLON" and kind in ("DERIVED", "PARAM"):
        return "write `=`, not `:`"
    if found.type == "NAME" and kind == "ENVIRONMENT":
        return f"write `{found.value} : target` or `{found.value} : test`"
    if found.type == "IF" and "WHEN" in expected:
        return "write `when`"
    if found.value == "," and kind in ("DISCOUNT", "PARAM") and before.isdigit():
        return "a decimal number has a point: 0.95"
    if found.value == "}" and expected == {"$END"}:
        return "perhaps one `}` too many"
    return None


def _anywhere(
    found: Token, before: str, previous: Token | None, expected: set[str], piece: list[Token]
) -> str | None:
    named = previous is not None and previous.type.startswith("NAME")
    if found.type == "NAME_COLON" and found.value in lexer().reserved_words:
        return f"`{found.value}` takes no colon"
    if found.value == ":" and "EQUAL" in expected:
        return "write `=` here"
    if found.value == "|" and "OR" in expected:
        return "write `or`"
    if found.value == "," and "AND" in expected:
        return "join conditions with `and`"
    if found.type == "NAME" and "WHERE" in expected:
        return "write `where` before the condition"
    hint = _similar_keyword(found, expected, piece)
    if hint is not None:
        return hint
    if found.type == "NAME" and named and {"LPAR", "AND"} <= expected:
        return f"arguments stand in parentheses: {before}({found.value})"
    if found.type == "NAME" and named and "LPAR" in expected:
        return "the quantified formula stands in parentheses"
    if found.type.startswith("NAME") and named and "COMMA" in expected:
        return "names are separated by commas"
    if found.value == "}" and expected == {"$END"}:
        return "perhaps one `}` too many"
    return None


def _similar_keyword(found: Token, expected: set[str], piece: list[Token]) -> str | None:
    """The word that a name looks like, among those that could stand here."""
    if not found.type.startswith("NAME"):
        return None
    words = [text for text in _texts(expected) if text[0].isalpha()]
    if "$END" in expected or found is piece[0]:
        words += _texts(DECLARATION_STARTS)
    meant = similar(found.value, words, 0.6)
    return f"did you mean `{meant}`?" if meant else None


def similar(word: str, candidates: Iterable[str], cutoff: float) -> str | None:
    """The candidate that a word looks like, if one does."""
    from difflib import get_close_matches

    if len(word) > 40:
        return None
    matches = get_close_matches(word.lower(), list(candidates), n=1, cutoff=cutoff)
    return matches[0] if matches else None


def _texts(terminals: Iterable[str]) -> set[str]:
    return {lexer().text_of(terminal) for terminal in terminals}
