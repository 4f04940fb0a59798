"""Source texts, spans within them, and the diagnostics that point at them."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

Severity = Literal["error", "warning"]

_EXCERPT_WIDTH = 100


@dataclass(frozen=True, slots=True, eq=False)
class SourceFile:
    """A text and the name to call it by in messages. Lines end with a line feed alone.

    Two files are the same only if they are the same object: spans of different readings never mix.
    """

    name: str
    text: str = field(repr=False)
    _line_starts: list[int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        starts = [0]
        position = self.text.find("\n")
        while position >= 0:
            starts.append(position + 1)
            position = self.text.find("\n", position + 1)
        object.__setattr__(self, "_line_starts", starts)

    def position(self, offset: int) -> tuple[int, int]:
        """Line and column of a character offset, both counted from 1."""
        line = bisect_right(self._line_starts, offset)
        return line, offset - self._line_starts[line - 1] + 1

    def line_text(self, line: int) -> str:
        """The text of a line (counted from 1), without its line end."""
        start = self._line_starts[line - 1]
        end = self.text.find("\n", start)
        return self.text[start:] if end < 0 else self.text[start:end]


class Span(NamedTuple):
    """The characters ``start <= offset < end`` of a source file."""

    file: SourceFile
    start: int
    end: int

    @property
    def line(self) -> int:
        """The line on which the span starts, from 1."""
        return self.file.position(self.start)[0]

    @property
    def column(self) -> int:
        """The column at which the span starts, from 1."""
        return self.file.position(self.start)[1]

    @property
    def end_line(self) -> int:
        """The line of the first character after the span, from 1."""
        return self.file.position(self.end)[0]

    @property
    def end_column(self) -> int:
        """The column of the first character after the span, from 1."""
        return self.file.position(self.end)[1]

    def __str__(self) -> str:
        return f"{self.file.name}:{self.line}:{self.column}"


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """One thing found in a text: what is wrong, where, and, where one can be had, the mend."""

    severity: Severity
    code: str
    message: str
    span: Span
    hint: str | None = None

    @property
    def is_error(self) -> bool:
        """Whether the text can't be used because of this."""
        return self.severity == "error"

    def as_json(self) -> dict[str, object]:
        """The diagnostic as ``menid check --json`` prints it."""
        span = self.span
        return {
            "file": span.file.name,
            "line": span.line,
            "column": span.column,
            "end_line": span.end_line,
            "end_column": span.end_column,
            "severity": self.severity,
            "code": self.code,
            "message": self.message,
            "hint": self.hint,
        }


def in_order(diagnostics: Iterable[Diagnostic]) -> list[Diagnostic]:
    """Diagnostics by file (in order of appearance) and place, each once."""
    files: dict[int, int] = {}
    unique = dict.fromkeys(diagnostics)
    for diagnostic in unique:
        files.setdefault(id(diagnostic.span.file), len(files))
    return sorted(unique, key=lambda d: (files[id(d.span.file)], d.span.start, d.span.end, d.code))


def render(diagnostic: Diagnostic, style: Callable[[str, str], str] | None = None) -> str:
    """A diagnostic as text: one headline, the line with a caret under the span, the hint.

    ``style(text, role)`` may colour a part; roles are ``place``, ``error``, ``warning``, ``caret``
    and ``hint``.
    """
    paint = style or (lambda text, _role: text)
    span = diagnostic.span
    headline = (
        f"{paint(f'{span}:', 'place')} "
        f"{paint(f'{diagnostic.severity}[{diagnostic.code}]', diagnostic.severity)}: "
        f"{diagnostic.message}"
    )
    lines = [headline, *_excerpt(span, paint)]
    if diagnostic.hint:
        lines.append(f"    {paint('hint:', 'hint')} {diagnostic.hint}")
    return "\n".join(lines)


def _excerpt(span: Span, paint: Callable[[str, str], str]) -> list[str]:
    line, column = span.file.position(span.start)
    text = span.file.line_text(line)
    start = column - 1
    end = len(text) if span.end_line > line else min(span.end_column - 1, len(text))
    end = max(end, start + 1)
    left = max(0, start - _EXCERPT_WIDTH // 2) if len(text) > _EXCERPT_WIDTH else 0
    shown = text[left : left + _EXCERPT_WIDTH]
    before, after = "…" if left else "", "…" if left + _EXCERPT_WIDTH < len(text) else ""
    # A tab stays a tab in the line of the caret, so that the two lines stay aligned.
    indent = "".join("\t" if c == "\t" else " " for c in before + text[left:start])
    caret = "^" * max(1, min(end, left + _EXCERPT_WIDTH) - start)
    printable = "".join(
        c if c.isprintable() or c == "\t" else "\N{REPLACEMENT CHARACTER}" for c in shown
    )
    gutter = f"{line:>5} | "
    return [
        f"{gutter}{before}{printable}{after}",
        f"{' ' * 5} | {indent}{paint(caret, 'caret')}",
    ]
