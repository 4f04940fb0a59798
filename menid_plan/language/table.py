"""The rows of an outcome table or block, aligned in columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from menid_plan.language.syntax import Token
from menid_plan.language.wrap import WIDTH, Piece, pieces, text_of, wrap


@dataclass(slots=True)
class Row:
    """A row cut into its parts."""

    name: str
    cells: list[str]
    effects: list[Piece]
    reward: list[Piece]


@dataclass(slots=True)
class Table:
    """What is known of a table from its head, and the tokens of each row.

    ``has_head`` tells whether the head names environments; without, there is at most one column.
    """

    columns: int
    has_head: bool
    right: bool  # counts stand to the right of their column, probabilities to the left
    rows: list[list[Token]] = field(default_factory=list)

    @staticmethod
    def of_head(tokens: Sequence[Token]) -> Table:
        """The table that starts with these tokens: its word, and its environments."""
        names = 0
        while tokens[1 + names].type == "NAME":
            names += 1
        return Table(names or 1, names > 0, tokens[0].type == "OBSERVED")

    def aligned(self, rows: Sequence[Sequence[Token]], indent: str, more: str) -> list[list[str]]:
        """For each row, its lines; all but the longest stand on one line, in common columns."""
        split = [self._split(tokens) for tokens in rows]
        name_width = max((len(row.name) for row in split), default=0)
        count = max((len(row.cells) for row in split), default=0)
        widths = [max(len(r.cells[i]) for r in split if i < len(r.cells)) for i in range(count)]
        start = len(indent) + name_width + sum(width + 1 for width in widths) + 2
        rewards = max((len(text_of(row.reward)) + 2 for row in split if row.reward), default=0)
        room = WIDTH - start - rewards
        effects = [len(text_of(row.effects)) for row in split]
        effects_width = max((width for width in effects if width <= room), default=0)
        lines = []
        for row in split:
            head = indent + row.name.ljust(name_width)
            for width, cell in zip(widths, row.cells, strict=False):
                head += " " + (cell.rjust(width) if self.right else cell.ljust(width))
            head += "  " if row.cells else " "
            effect = text_of(row.effects)
            if len(effect) <= room:
                tail = (
                    f"{effect.ljust(effects_width)}  {text_of(row.reward)}"
                    if row.reward
                    else effect
                )
                lines.append([(head + tail).rstrip()])
            else:
                lines.append(_wrapped(head, [*row.effects, *row.reward], more))
        return lines

    def _split(self, tokens: Sequence[Token]) -> Row:
        line = pieces(tokens, in_cells=True)
        items = line[2:]
        reward = next((i for i, p in enumerate(items) if p.token.type == "REWARD"), len(items))
        cells: list[str] = []
        at = 0
        while len(cells) < self.columns and (end := self._cell_end(items[:reward], at, line)) > at:
            cells.append(text_of(items[at:end]))
            at = end
        return Row(f"{tokens[0].value}:", cells, items[at:reward], items[reward:])

    def _cell_end(self, items: Sequence[Piece], at: int, line: Sequence[Piece]) -> int:
        """The index after the cell that starts at ``at``; ``at`` if what starts there is no cell."""
        if at >= len(items):
            return at
        token = items[at].token
        following = items[at + 1].token.value if at + 1 < len(items) else ""
        if token.type == "NUMBER":
            return at + 3 if following == "/" else at + 1
        if token.value == "(":
            depth = 0
            for i in range(at, len(items)):
                depth += (items[i].token.value == "(") - (items[i].token.value == ")")
                if depth == 0:
                    return i + 1
        if token.type == "NAME" and following != "(":
            # Without a head there may be no column; then the name is an effect, and a comma, a
            # reward or the end of the row follows it, unless the row is that of noise.
            sure = self.has_head or line[0].token.value == "noise"
            return at + 1 if sure or following not in ("", ",") else at
        return at


def _wrapped(head: str, rest: list[Piece], more: str) -> list[str]:
    """A long row: the effects start behind the cells if the first of them has room there."""
    end = next(
        (i for i, p in enumerate(rest) if i and p.rank is not None and p.rank < 2), len(rest)
    )
    if len(head) + len(text_of(rest[:end])) <= WIDTH:
        return wrap(rest, head, more)
    return [head.rstrip(), *wrap(rest, more, more)]
