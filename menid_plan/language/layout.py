"""The canonical layout of a text: only white space changes, every token and comment stays.

The tokens are cut into lines (a declaration, a rule's part, a row, a closing brace), and each line is
printed with its comments where they stood: those that end a source line still end a line, those on a
line of their own still stand on one, before the same token. The rows of a table are aligned.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from menid_plan.language.grammar import lexer
from menid_plan.language.parse import declarations
from menid_plan.language.syntax import Token
from menid_plan.language.tokens import Comment, TokenStream
from menid_plan.source import SourceFile

WIDTH = 88
_INDENT = "  "
_CONTINUATION = "    "
_RULE_PARTS = frozenset("OTHERWISE THE WHEN OUTCOMES PROBABILITIES OBSERVED RULE".split())
_TABLES = frozenset("OUTCOMES PROBABILITIES OBSERVED".split())
_OPERANDS = frozenset("NAME NUMBER".split())
_BREAK_BEFORE = frozenset("and or implies".split())


def layout(text: str) -> str:
    """The text in canonical layout. It must be free of syntax errors."""
    stream = lexer().split(SourceFile("", text))
    return _Printer(stream).run()


@dataclass(slots=True)
class _Line:
    """Tokens that stand on one line, if it is not too long."""

    tokens: list[Token]
    level: int
    blank: bool = False  # a blank line is forced before it
    table: _Table | None = None  # the table of which it is a row


@dataclass(slots=True)
class _Table:
    """An outcome table or block: how many columns it has, and its rows."""

    columns: int
    has_head: bool
    right: bool  # counts are aligned to the right
    rows: list[_Line] = field(default_factory=list)


def _lines(tokens: list[Token]) -> Iterator[_Line]:
    previous = ""
    for piece in declarations(tokens):
        kind = piece[0].type
        forced = previous in ("DOMAIN", "PROBLEM", "ACTION") or kind in ("ACTION", "PROBLEM")
        lines = _lines_of(piece)
        lines[0].blank = forced and previous != ""
        yield from lines
        previous = kind


def _lines_of(piece: list[Token]) -> list[_Line]:
    """The lines of one declaration."""
    stack: list[str] = []  # what each open brace belongs to; "" where it stays inside a line
    lines: list[_Line] = []
    table: _Table | None = None
    condition = False  # inside a row, between `if` or `forall` and its brace
    fresh = True
    for token in piece:
        inside = stack[-1] if stack else None
        if token.value == "}" and inside:
            stack.pop()
            lines.append(_Line([token], len(stack)))
            table, fresh = None, True
            continue
        starts_row = inside == "TABLE" and token.type == "NAME_COLON" and not condition
        starts_part = inside in ("RULE", "ACTION") and token.type in _RULE_PARTS
        if fresh or starts_row or starts_part:
            lines.append(_Line([], len(stack)))
            fresh = condition = False
            if starts_row and table is not None:
                lines[-1].table = table
                table.rows.append(lines[-1])
        line = lines[-1]
        line.tokens.append(token)
        if inside == "TABLE" and token.value in ("if", "forall"):
            condition = True
        if token.value == "{":
            kind = _brace_kind(line, inside)
            stack.append(kind)
            if kind:
                fresh = True
                table = _table(line) if kind == "TABLE" else table
        elif token.value == "}":
            stack.pop()
            condition = False
    return lines


def _brace_kind(line: _Line, inside: str | None) -> str:
    first = line.tokens[0].type
    if inside == "TABLE" or inside == "":
        return ""
    return "TABLE" if first in _TABLES else first


def _table(line: _Line) -> _Table:
    names = 0
    for token in line.tokens[1:]:
        if token.type != "NAME":
            break
        names += 1
    return _Table(names or 1, names > 0, line.tokens[0].type == "OBSERVED")


class _Printer:
    def __init__(self, stream: TokenStream) -> None:
        self.text = stream.source.text
        self.tokens = stream.tokens
        self.before: dict[int, list[Comment]] = {}
        for comment in stream.comments:
            self.before.setdefault(comment.before, []).append(comment)
        self.out: list[str] = []
        self.after_opening = True  # nothing, or an opening brace, stands just before

    def run(self) -> str:
        lines = list(_lines(self.tokens))
        colons = _environment_colons(lines)
        for line in lines:
            self._leading_comments(line)
            cells = self._cells(line)
            if cells is not None:
                self.out.append(cells)
            else:
                self._flow(line, colons.get(line.tokens[0].index))
            self.after_opening = line.tokens[-1].value == "{"
        self._comments_at_end()
        return "\n".join(self.out) + ("\n" if self.out else "")

    # ------------------------------------------------------------------ comments between lines

    def _leading_comments(self, line: _Line) -> None:
        first = line.tokens[0]
        comments = self.before.get(first.index, [])
        own = self._trailing(comments)
        indent = _INDENT * (line.level + (first.value == "}"))
        forced = line.blank
        for comment in own:
            self._blank(forced or comment.blank_before)
            forced = False
            self.out.append(indent + comment.text)
            self.after_opening = False
        if first.value != "}":
            self._blank(forced or (bool(self.out) and self._blank_above(first)))

    def _trailing(self, comments: list[Comment]) -> list[Comment]:
        """Put a comment that ends a source line behind what was printed; the others come back."""
        if comments and not comments[0].own_line:
            self.out[-1] += f"  {comments[0].text}"
            return comments[1:]
        return comments

    def _blank(self, wanted: bool) -> None:
        if wanted and not self.after_opening and self.out and self.out[-1]:
            self.out.append("")

    def _blank_above(self, token: Token) -> bool:
        line_start = self.text.rfind("\n", 0, token.start)
        gap_start = self.text.rfind("\n", 0, max(line_start, 0)) + 1
        return line_start >= 0 and not self.text[gap_start : token.start].strip()

    def _comments_at_end(self) -> None:
        for comment in self._trailing(self.before.get(len(self.tokens), [])):
            self._blank(comment.blank_before)
            self.out.append(comment.text)
            self.after_opening = False

    def _has_inner_comments(self, tokens: list[Token]) -> bool:
        return any(token.index in self.before for token in tokens[1:])

    # ----------------------------------------------------------------------------- aligned rows

    def _cells(self, line: _Line) -> str | None:
        """A row in the columns of its table; None if it is no row or can't be aligned."""
        table = line.table
        if table is None or self._has_inner_comments(line.tokens):
            return None
        rows = [
            _split_row(row, table) for row in table.rows if not self._has_inner_comments(row.tokens)
        ]
        mine = _split_row(line, table)
        name_width = max(len(row.name) for row in rows)
        count = max(len(row.cells) for row in rows)
        widths = [max((len(r.cells[i]) for r in rows if i < len(r.cells)), default=0) for i in range(count)]
        text = mine.name.ljust(name_width)
        for i, width in enumerate(widths):
            cell = mine.cells[i] if i < len(mine.cells) else ""
            text += " " + (cell.rjust(width) if table.right else cell.ljust(width))
        start = len(_INDENT * line.level + text) + 2
        room = WIDTH - start - max((len(row.reward) + 2 for row in rows if row.reward), default=0)
        effects_width = max((len(r.effects) for r in rows if len(r.effects) <= room), default=0)
        if mine.effects or mine.reward:
            gap = "  " if widths else " "
            text += gap + (mine.effects.ljust(effects_width) if mine.reward else mine.effects)
        if mine.reward:
            text += ("  " if effects_width or mine.effects else "") + mine.reward
        text = _INDENT * line.level + text.rstrip()
        return text if len(text) <= WIDTH else None

    # ------------------------------------------------------------------------------ other lines

    def _flow(self, line: _Line, pad: int | None) -> None:
        """A line that is broken where it is too long, and after comments inside it."""
        indent = _INDENT * line.level
        more = indent + _CONTINUATION
        pieces = _pieces(line)
        current, start = indent, True
        for tokens, text in pieces:
            comments = self.before.get(tokens[0].index, []) if tokens[0] is not line.tokens[0] else []
            if comments:
                self.out.append(current)
                for comment in self._trailing(comments):
                    self.out.append(more + comment.text)
                current, start = more, True
            glued = text if start or text[:1] != " " else text
            if not start and len(current) + len(text.rstrip()) > WIDTH and _may_break(tokens[0], self.tokens):
                self.out.append(current.rstrip())
                current, start = more, True
            current += glued.lstrip() if start else glued
            if pad is not None and tokens[0].type == "NAME_COLON":
                current += " " * pad
            start = False
        self.out.append(current.rstrip())


def _environment_colons(lines: list[_Line]) -> dict[int, int]:
    """By the index of its first token, how much to pad the name of each environment."""
    pads: dict[int, int] = {}
    run: list[_Line] = []

    def settle() -> None:
        widest = max((len(line.tokens[1].value) for line in run), default=0)
        for line in run:
            pads[line.tokens[0].index] = widest - len(line.tokens[1].value)
        run.clear()

    for line in lines:
        if line.tokens[0].type == "ENVIRONMENT":
            run.append(line)
        else:
            settle()
    settle()
    return pads


def _pieces(line: _Line) -> list[tuple[list[Token], str]]:
    """Each token of a line with the text that it adds, the space before it included."""
    pieces = []
    previous: Token | None = None
    earlier: Token | None = None
    depth = 0
    for token in line.tokens:
        glue = previous is None or _glued(earlier, previous, token, line, depth)
        pieces.append(([token], ("" if glue else " ") + token.value))
        if token.value == "(":
            depth += 1
        elif token.value == ")":
            depth -= 1
        # Whether a sign is unary shows in what stands before it.
        earlier, previous = previous, token
    return pieces


def _glued(
    earlier: Token | None, previous: Token, token: Token, line: _Line, depth: int
) -> bool:
    """Whether no space stands between two tokens."""
    before, value = previous.value, token.value
    if value in (")", ",", "..") or before in ("(", ".."):
        return True
    if value == ":":
        return line.tokens[0].type != "ENVIRONMENT"
    if value == "(":
        is_type = earlier is not None and earlier.value in (":", "|")
        return previous.type == "NAME" and not is_type
    if "/" in (value, before) and depth == 0 and _in_cells(line):
        return True
    if before == "-":
        operand = earlier is not None and (earlier.type in _OPERANDS or earlier.value == ")")
        return not operand
    return False


def _in_cells(line: _Line) -> bool:
    return line.table is not None and not any(t.type == "REWARD" for t in line.tokens)


def _may_break(token: Token, tokens: list[Token]) -> bool:
    previous = tokens[token.index - 1]
    return token.value in _BREAK_BEFORE or previous.value == "," or token.type == "REWARD"


@dataclass(slots=True)
class _Row:
    name: str
    cells: list[str]
    effects: str
    reward: str


def _split_row(line: _Line, table: _Table) -> _Row:
    """The texts of a row's parts."""
    pieces = _pieces(line)[2:]
    name = f"{line.tokens[0].value}:"
    reward_at = next((i for i, (ts, _) in enumerate(pieces) if ts[0].type == "REWARD"), len(pieces))
    reward = "".join(text for _, text in pieces[reward_at:]).strip()
    items = pieces[:reward_at]
    cells: list[str] = []
    at = 0
    while at < len(items) and (len(cells) < table.columns):
        end = _cell_end(items, at, table, line)
        if end == at:
            break
        cells.append("".join(text for _, text in items[at:end]).strip())
        at = end
    effects = "".join(text for _, text in items[at:]).strip()
    return _Row(name, cells, effects, reward)


def _cell_end(
    items: list[tuple[list[Token], str]], at: int, table: _Table, line: _Line
) -> int:
    """The index after the cell that starts at ``at``; ``at`` if what starts there is no cell."""
    token = items[at][0][0]
    following = items[at + 1][0][0] if at + 1 < len(items) else None
    if token.type == "NUMBER":
        fraction = following is not None and following.value == "/"
        return at + 3 if fraction else at + 1
    if token.value == "(":
        depth = 0
        for i in range(at, len(items)):
            value = items[i][0][0].value
            depth += (value == "(") - (value == ")")
            if depth == 0:
                return i + 1
    if token.type == "NAME" and (following is None or following.value != "("):
        # Without a head the one column may be missing; then the name is an effect.
        is_cell = table.has_head or line.tokens[0].value == "noise" or (
            following is not None and following.value != ","
        )
        return at + 1 if is_cell else at
    return at
