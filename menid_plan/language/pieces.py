"""Cuts the tokens of a text at the words that start a declaration, a rule or a row."""

from __future__ import annotations

from collections.abc import Iterator

from menid_plan.language.syntax import Token

DOMAIN_STARTS = frozenset("TYPE CONSTANT PARAM ENVIRONMENT PREDICATE DERIVED REWARD ACTION".split())
PROBLEM_STARTS = frozenset("PARAM OBJECT INIT GOAL HORIZON DISCOUNT DEAD_END".split())
HEADERS = frozenset(["DOMAIN", "PROBLEM"])
DECLARATION_STARTS = DOMAIN_STARTS | PROBLEM_STARTS | HEADERS

# These words may also stand inside a declaration; they start one only outside all brackets.
_AMBIGUOUS = frozenset(["REWARD", "OBJECT", "DEAD_END"])
# After these a name follows.
_NAMING = frozenset("DOMAIN PROBLEM TYPE PARAM PREDICATE DERIVED ACTION".split())
_TABLES = {"OUTCOMES": "row", "PROBABILITIES": "block_row", "OBSERVED": "block_row"}


def declarations(
    tokens: list[Token], strays: frozenset[int] = frozenset()
) -> Iterator[list[Token]]:
    """Cut the tokens before each word that starts a declaration, and behind each whole action.

    ``strays`` are the indices of further tokens to cut before: words that look like such a word.
    """
    piece: list[Token] = []
    depth = 0
    for token in tokens:
        starts = token.type in DECLARATION_STARTS and _starts_declaration(token, piece, depth)
        whole = bool(piece) and depth == 0 and piece[0].type == "ACTION" and piece[-1].value == "}"
        if starts or whole or (token.index in strays and depth == 0):
            if piece:
                yield piece
            piece, depth = [], 0
        if token.value in ("(", "{"):
            depth += 1
        elif token.value in (")", "}"):
            depth = max(0, depth - 1)
        piece.append(token)
    if piece:
        yield piece


def _starts_declaration(token: Token, piece: list[Token], depth: int) -> bool:
    if len(piece) == 1 and piece[0].type in _NAMING:
        return False  # a reserved word in the place of a name
    if piece and piece[-1].type == "RULE":
        return False
    if token.type not in _AMBIGUOUS:
        return True
    if depth > 0:
        return False
    if token.type == "OBJECT":
        return not piece or piece[-1].value not in (":", "<", "|", ",")
    if token.type == "REWARD" and piece and piece[0].type in ("GOAL", "DEAD_END"):
        return any(t.type == "REWARD" for t in piece)
    return True


def rows(rule: list[Token]) -> Iterator[tuple[str, list[Token]]]:
    """The parts of a rule: each row with its start symbol, what is between them with ``""``."""
    table, depth = "", 0
    part: list[Token] = []
    kind = ""
    condition = False  # between `if` or `forall` and its brace, where variables are declared
    for token in rule:
        if token.type in _TABLES:
            table, depth = _TABLES[token.type], 0
        inside = bool(table) and depth == 1 and not condition
        if token.value in ("if", "forall") and kind:
            condition = True
        elif token.value == "{":
            condition = False
        if inside and (token.type == "NAME_COLON" or token.value == "}"):
            if part:
                yield kind, part
            part, kind = [], table if token.type == "NAME_COLON" else ""
            if token.value == "}":
                table = ""
        if token.value == "{":
            depth += 1
        elif token.value == "}":
            depth -= 1
        part.append(token)
    if part:
        yield kind, part


def without_context(rule: list[Token]) -> list[Token]:
    """A rule without what stands between its head and its outcomes."""
    begin = next((i for i, t in enumerate(rule) if t.value == "{"), len(rule) - 1) + 1
    end = next((i for i, t in enumerate(rule) if t.type == "OUTCOMES"), begin)
    return rule[:begin] + rule[end:]


def balanced(rule: list[Token]) -> list[Token]:
    """A rule without the brace that closes its action."""
    rest = len(rule)
    while rest and rule[rest - 1].value == "}":
        rest -= 1
    depth = 0
    for i, token in enumerate(rule):
        if token.value == "{":
            depth += 1
        elif token.value == "}":
            depth -= 1
            if depth == 0 and i >= rest:
                return rule[: i + 1]
    return rule


def closed(piece: list[Token], column: dict[int, int]) -> tuple[list[Token], list[Token]]:
    """A piece that opens more braces than it closes, with those that lack, and the open ones.

    A word that can't stand inside an open brace shows that it should have been closed; so does a
    closing brace that starts a line further left than the line of the one it would close.
    ``column`` has, by a token's index, the indentation of its line; for the first token of each line
    -1 less that.
    """
    mended: list[Token] = []
    found: list[Token] = []
    stack: list[Token] = []

    def close() -> None:
        found.append(stack.pop())
        mended.append(sign("RBRACE", "}", mended[-1]))

    for token in piece:
        deepest = {"RULE": 1, "OUTCOMES": 2, "PROBABILITIES": 2, "OBSERVED": 2}.get(token.type)
        while deepest is not None and len(stack) > deepest:
            close()
        if token.value == "{":
            stack.append(token)
        elif token.value == "}" and stack:
            indent = column[token.index]
            while indent < 0 and len(stack) > 1 and _indent(column[stack[-1].index]) > -indent - 1:
                close()
            stack.pop()
        mended.append(token)
    while stack:
        close()
    return mended, found


def sign(type_: str, value: str, near: Token) -> Token:
    """A token that does not stand in the text, behind one that does."""
    return Token(type_, value, near.end, near.end, near.index)


def _indent(column: int) -> int:
    return -column - 1 if column < 0 else column


def is_open(piece: list[Token]) -> bool:
    """Whether more braces are opened than closed."""
    values = [token.value for token in piece]
    return values.count("{") > values.count("}")
