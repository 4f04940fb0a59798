"""The canonical layout of a text: only white space changes, every token and comment stays.

The tokens are cut into lines (a declaration, a rule's part, a row, a closing brace), and each line is
printed with its comments where they stood: those that end a source line still end a line, those on a
line of their own still stand on one, before the same token. The rows of a table are aligned.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from menid_plan.language.grammar import lexer
from menid_plan.language.pieces import declarations
from menid_plan.language.syntax import Token
from menid_plan.language.table import Table
from menid_plan.language.tokens import Comment, TokenStream
from menid_plan.language.wrap import pieces, wrap
from menid_plan.source import SourceFile

_INDENT = "  "
_CONTINUATION = "    "
_RULE_PARTS = frozenset("OTHERWISE THE WHEN OUTCOMES PROBABILITIES OBSERVED RULE".split())
_TABLES = frozenset("OUTCOMES PROBABILITIES OBSERVED".split())


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
    table: Table | None = None  # the table of which it is a row


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
    table: Table | None = None
    condition = False  # inside a row, between `if` or `forall` and its brace
    fresh = True
    for token in piece:
        inside = stack[-1] if stack else ""
        if token.value == "}" and inside:
            stack.pop()
            lines.append(_Line([token], len(stack)))
            fresh = True
            continue
        starts_row = inside == "TABLE" and token.type == "NAME_COLON" and not condition
        starts_part = inside in ("RULE", "ACTION") and token.type in _RULE_PARTS
        if fresh or starts_row or starts_part:
            lines.append(_Line([], len(stack)))
            fresh = condition = False
            if starts_row and table is not None:
                lines[-1].table = table
                table.rows.append(lines[-1].tokens)
        lines[-1].tokens.append(token)
        if inside == "TABLE" and token.value in ("if", "forall"):
            condition = True
        if token.value == "{":
            kind = _brace_kind(lines[-1].tokens[0], inside)
            stack.append(kind)
            fresh = bool(kind)
            if kind == "TABLE":
                table = Table.of_head(lines[-1].tokens)
        elif token.value == "}":
            stack.pop()
            condition = False
    return lines


def _brace_kind(first: Token, inside: str) -> str:
    """What an opening brace belongs to: ACTION, RULE, TABLE, or "" inside a row."""
    if inside == "TABLE":
        return ""
    return "TABLE" if first.type in _TABLES else first.type


class _Printer:
    def __init__(self, stream: TokenStream) -> None:
        self.text = stream.source.text
        self.tokens = stream.tokens
        self.before: dict[int, list[Comment]] = {}
        for comment in stream.comments:
            self.before.setdefault(comment.before, []).append(comment)
        self.out: list[str] = []
        self.after_opening = True  # nothing, or an opening brace, stands just before
        self.rows: dict[int, list[str]] = {}  # by the index of a row's first token: its lines

    def run(self) -> str:
        lines = list(_lines(self.tokens))
        pads = _environment_pads(lines)
        for line in lines:
            self._leading_comments(line)
            aligned = self._aligned(line) if line.table is not None else None
            if aligned is not None:
                self.out.extend(aligned)
            else:
                self._flow(line, pads.get(line.tokens[0].index, 0))
            self.after_opening = line.tokens[-1].value == "{"
        self._comments_at_end()
        return "\n".join(self.out) + ("\n" if self.out else "")

    # ------------------------------------------------------------------ comments between lines

    def _leading_comments(self, line: _Line) -> None:
        first = line.tokens[0]
        own = self._trailing(self.before.get(first.index, []))
        indent = _INDENT * (line.level + (first.value == "}"))
        forced = line.blank
        for comment in own:
            self._blank(forced or comment.blank_before)
            forced = False
            self.out.append(indent + comment.text)
            self.after_opening = False
        if first.value != "}":
            self._blank(forced or self._blank_above(first))

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

    # --------------------------------------------------------------------------- rows and lines

    def _aligned(self, line: _Line) -> list[str] | None:
        """The lines of a row in the columns of its table; None if comments stand inside it."""
        first = line.tokens[0].index
        if line.table is not None and first not in self.rows and line.tokens is line.table.rows[0]:
            rows = [row for row in line.table.rows if not self._has_comments_inside(row)]
            indent = _INDENT * line.level
            texts = line.table.aligned(rows, indent, indent + _CONTINUATION)
            self.rows.update((row[0].index, text) for row, text in zip(rows, texts, strict=True))
        return self.rows.get(first)

    def _has_comments_inside(self, tokens: Sequence[Token]) -> bool:
        return any(token.index in self.before for token in tokens[1:])

    def _flow(self, line: _Line, pad: int) -> None:
        """A line that is broken where it is too long, and at the comments inside it."""
        indent = _INDENT * line.level
        start, more = indent, indent + _CONTINUATION
        found = pieces(line.tokens, in_cells=line.table is not None)
        if pad:
            found[1] = replace(found[1], text=found[1].text + " " * pad)
        begin = 0
        for end in range(1, len(found) + 1):
            comments = self.before.get(found[end].token.index, []) if end < len(found) else []
            if not comments and end < len(found):
                continue
            self.out.extend(wrap(found[begin:end], start, more))
            begin, start = end, more
            self.out.extend(more + comment.text for comment in self._trailing(comments))


def _environment_pads(lines: list[_Line]) -> dict[int, int]:
    """By the index of its first token: what to pad the name of each environment with."""
    pads: dict[int, int] = {}
    run: list[list[Token]] = []
    for tokens in [*(line.tokens for line in lines), []]:
        if tokens and tokens[0].type == "ENVIRONMENT":
            run.append(tokens)
            continue
        widest = max((len(t[1].value) for t in run), default=0)
        pads.update((t[0].index, widest - len(t[1].value)) for t in run)
        run.clear()
    return pads
