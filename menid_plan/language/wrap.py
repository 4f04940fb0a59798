"""One line of tokens: which stand together without a space, and where a long line is broken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from menid_plan.language.syntax import Token

WIDTH = 88

_OPERANDS = frozenset("NAME NUMBER".split())
# Breaks outside brackets come first; among those of one depth, the lower number.
_REWARD, _COMMA, _WHERE, _IMPLIES, _OR, _AND = range(6)
_VARIABLES = 1000
_CONNECTIVES = {
    "where": _WHERE, "when": _WHERE, "implies": _IMPLIES, "or": _OR, "and": _AND,
}  # fmt: skip
_DECLARES = frozenset("the forall exists count per".split())


@dataclass(frozen=True, slots=True)
class Piece:
    """A token and the text it adds to its line, the space before it included.

    ``rank`` is that of a break before it: the lower, the sooner a long line is broken there; None
    where it never is.
    """

    token: Token
    text: str
    rank: int | None


def pieces(tokens: Sequence[Token], *, in_cells: bool = False) -> list[Piece]:
    """The pieces of a line; ``in_cells`` says that the line is a row, where `1/3` is one cell."""
    found: list[Piece] = []
    depth = 0
    declaring = False
    before: Token | None = None
    earlier: Token | None = None
    for token in tokens:
        value = token.value
        if token.type == "REWARD":
            in_cells = False
        glued = before is None or _glued(earlier, before, token, tokens[0], in_cells and not depth)
        rank: int | None = None
        if value in _CONNECTIVES and not (value == "when" and before is None):
            rank = 10 * depth + _CONNECTIVES[value]
        elif token.type == "REWARD" and before is not None:
            rank = _REWARD
        elif before is not None and before.value == ",":
            rank = 10 * depth + (_VARIABLES if declaring else _COMMA)
        found.append(Piece(token, ("" if glued else " ") + value, rank))
        if value in ("(", "{"):
            depth += 1
        elif value in (")", "}"):
            depth -= 1
        declaring = value in _DECLARES or (declaring and value not in ("where", "(", "when"))
        earlier, before = before, token
    return found


def _glued(
    earlier: Token | None, before: Token, token: Token, first: Token, in_cells: bool
) -> bool:
    """Whether no space stands between a token and the one before it."""
    value = token.value
    if value in (")", ",", "..") or before.value in ("(", ".."):
        return True
    if value == ":":
        return first.type != "ENVIRONMENT"
    if value == "(":
        # `p(x)` and `action a(x)`, but `exists x: t (...)`.
        is_type = earlier is not None and earlier.value in (":", "|")
        return before.type == "NAME" and not is_type
    if in_cells and "/" in (value, before.value):
        return True
    if before.value == "-":
        has_left = earlier is not None and (earlier.type in _OPERANDS or earlier.value == ")")
        return not has_left
    return False


def text_of(line: Sequence[Piece]) -> str:
    """A line in one piece."""
    return "".join(piece.text for piece in line).strip()


def wrap(line: Sequence[Piece], first: str, more: str) -> list[str]:
    """Lines no longer than WIDTH if that can be; they start with ``first``, later with ``more``.

    A line is broken at places of the lowest rank that it has; what is still too long, at the next.
    """
    lines = [first]
    _fill(list(line), lines, more, fresh=True)
    return [text.rstrip() for text in lines]


def _fill(line: list[Piece], lines: list[str], more: str, *, fresh: bool) -> None:
    """Add pieces to the last of the lines, starting new ones where they must."""
    text = "".join(piece.text for piece in line)
    ranks = {piece.rank for piece in line[1:] if piece.rank is not None}
    room = WIDTH - len(lines[-1])
    if len(text.lstrip() if fresh else text) <= room or not ranks:
        lines[-1] += text.lstrip() if fresh else text
        return
    rank = min(ranks)
    chunks: list[list[Piece]] = [[]]
    for piece in line:
        if piece.rank == rank and chunks[-1]:
            chunks.append([])
        chunks[-1].append(piece)
    for chunk in chunks:
        length = sum(len(piece.text) for piece in chunk)
        if chunk is not chunks[0] and len(lines[-1]) + length > WIDTH:
            lines.append(more)
            fresh = True
        _fill(chunk, lines, more, fresh=fresh)
        fresh = False
