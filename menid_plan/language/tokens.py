"""From characters to tokens and comments, by the terminals of a grammar.

Lark's own lexer gives up at the first bad character and drops comments; the formatter needs the
comments, the checker all errors, and both need the list of tokens again, so the lexing is done here,
with the regular expressions that the grammar states.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from menid_plan.language.syntax import MAX_NESTING, Token
from menid_plan.source import Diagnostic, SourceFile, Span

BAD = "BAD"

MAX_NAME = 255

# Past this many bad characters, numbers and names the rest of a text is not looked at.
MAX_LEXICAL_ERRORS = 100


class Terminal(NamedTuple):
    """A terminal of a grammar: a word or sign (``is_fixed``), or a regular expression."""

    name: str
    is_fixed: bool
    pattern: str
    priority: int


@dataclass(frozen=True, slots=True)
class Comment:
    """A comment, from its ``#`` to the end of the line, and the token that it precedes."""

    start: int
    end: int
    before: int  # index of the next token
    own_line: bool  # nothing but white space stands before it on its line
    blank_before: bool  # a blank line stands directly above it (only told of own-line comments)
    text: str


@dataclass(frozen=True, slots=True)
class TokenStream:
    """All tokens of a text (bad ones included, of type BAD), its comments, and what is wrong."""

    source: SourceFile
    tokens: list[Token]
    comments: list[Comment]
    diagnostics: list[Diagnostic]


class Lexer:
    """Splits texts by the terminals of a grammar."""

    def __init__(self, terminals: Iterable[Terminal]) -> None:
        words: dict[str, str] = {}
        signs: dict[str, str] = {}
        patterns: list[Terminal] = []
        for terminal in terminals:
            if not terminal.is_fixed:
                patterns.append(terminal)
            elif terminal.pattern[0].isalpha():
                words[terminal.pattern] = terminal.name
            else:
                signs[terminal.pattern] = terminal.name
        patterns.sort(key=lambda t: (-t.priority, -len(t.pattern)))
        longest_first = sorted(signs, key=len, reverse=True)
        self.reserved_words = frozenset(words)
        self._words = words
        self._signs = signs
        self._pattern = re.compile(
            "|".join(
                [f"(?P<{t.name}>{t.pattern})" for t in patterns]
                + [f"(?P<SIGN>{'|'.join(map(re.escape, longest_first))})"]
                + [f"(?P<{BAD}>[0-9][0-9A-Za-z_.]*|.)"]
            ),
            re.DOTALL,
        )

    def text_of(self, terminal: str) -> str:
        """The word or sign that a terminal stands for; its own name if it stands for many."""
        for table in (self._words, self._signs):
            for text, name in table.items():
                if name == terminal:
                    return text
        return terminal

    def split(self, source: SourceFile) -> TokenStream:
        """The tokens and comments of a text. Takes time linear in its length."""
        text, words, signs = source.text, self._words, self._signs
        tokens: list[Token] = []
        comments: list[Comment] = []
        diagnostics: list[Diagnostic] = []
        add = tokens.append
        for match in self._pattern.finditer(text):
            if len(diagnostics) > MAX_LEXICAL_ERRORS:
                message = f"more than {MAX_LEXICAL_ERRORS} such errors: the rest is not read"
                span = Span(source, match.start(), match.end())
                diagnostics.append(Diagnostic("error", "M106", message, span))
                break
            kind = match.lastgroup
            if kind == "WHITE":
                continue
            value = match.group()
            if kind == "NAME":
                kind = words.get(value, kind)
                if len(value) > MAX_NAME:
                    kind = _too_long(source, match.start(), match.end(), diagnostics)
            elif kind == "SIGN":
                kind = signs[value]
            elif kind == "COMMENT":
                comments.append(_comment(text, match.start(), match.end(), len(tokens)))
                continue
            elif kind == "NUMBER" and float(value) == math.inf:
                diagnostics.append(_too_large(source, match.start(), match.end()))
                kind = BAD
            elif kind == BAD:
                _note_bad(source, match.start(), match.end(), diagnostics)
            elif kind == "NAME_COLON" and len(value) > MAX_NAME:
                kind = _too_long(source, match.start(), match.end(), diagnostics)
            add(Token(kind or BAD, value, match.start(), match.end(), len(tokens)))
        diagnostics.extend(_nested_too_deep(source, tokens))
        return TokenStream(source, tokens, comments, diagnostics)


def _comment(text: str, start: int, end: int, before: int) -> Comment:
    line_start = text.rfind("\n", 0, start) + 1
    own_line = not text[line_start:start].strip()
    blank_before = False
    if own_line and line_start > 0:
        previous_start = text.rfind("\n", 0, line_start - 1) + 1
        blank_before = not text[previous_start : line_start - 1].strip()
    return Comment(start, end, before, own_line, blank_before, text[start:end].rstrip())


_SUGGESTIONS = {
    "&": "write `and`",
    "!": "write `not`, or `!=` between two objects",
    ";": "declarations end by themselves; comments start with `#`",
    "?": "variables are plain names",
    "'": "names stand without quotes",
    '"': "names stand without quotes",
    "[": "MENID uses `(` and `{`",
    "]": "MENID uses `)` and `}`",
    ".": "a number has digits on both sides of its point: 0.5",
    "%": "write a probability as a number from 0 to 1",
}


def _note_bad(source: SourceFile, start: int, end: int, diagnostics: list[Diagnostic]) -> None:
    value = source.text[start:end]
    if value[0] in "0123456789":
        diagnostics.append(
            Diagnostic(
                "error",
                "M004",
                f"`{shown(value)}` is neither a number nor a name",
                Span(source, start, end),
                "a number looks like 12, 0.5 or 1e-3; a name starts with a letter",
            )
        )
        return
    last = diagnostics[-1] if diagnostics else None
    if last and last.code == "M003" and last.span.end == start:
        # One message for a run of bad characters, whatever it holds.
        diagnostics[-1] = Diagnostic(
            "error", "M003", "these characters have no meaning here",
            Span(source, last.span.start, end), last.hint,
        )  # fmt: skip
        return
    named = f"`{value}`" if value.isprintable() else f"the character U+{ord(value):04X}"
    diagnostics.append(
        Diagnostic(
            "error",
            "M003",
            f"{named} has no meaning here",
            Span(source, start, end),
            _suggestion(source, start, value),
        )
    )


def _suggestion(source: SourceFile, start: int, value: str) -> str | None:
    if value == "." and source.text[max(0, start - 2) : start] == "..":
        return "a range has two points: n1..n9"
    if value.isalpha():
        return "names are made of the letters a to z and A to Z, digits, `_` and inner hyphens"
    return _SUGGESTIONS.get(value)


def shown(value: str) -> str:
    """A piece of a user's text, short enough for a message."""
    return value if len(value) <= 40 else value[:37] + "..."


def _too_long(source: SourceFile, start: int, end: int, diagnostics: list[Diagnostic]) -> str:
    message = f"a name of {end - start} characters: the limit is {MAX_NAME}"
    diagnostics.append(Diagnostic("error", "M007", message, Span(source, start, end)))
    return BAD


def _too_large(source: SourceFile, start: int, end: int) -> Diagnostic:
    return Diagnostic("error", "M006", "this number is too large", Span(source, start, end))


def _nested_too_deep(source: SourceFile, tokens: list[Token]) -> list[Diagnostic]:
    """One diagnostic at the first bracket that is nested too deep, which becomes a bad token."""
    depth = 0
    for token in tokens:
        value = token.value
        if value in ("(", "{"):
            depth += 1
            if depth > MAX_NESTING:
                token.type = BAD
                return [nesting_diagnostic(Span(source, token.start, token.end))]
        elif value in (")", "}"):
            depth = max(0, depth - 1)
    return []


def nesting_diagnostic(span: Span) -> Diagnostic:
    """What is said of a text that is nested too deep."""
    return Diagnostic(
        "error",
        "M005",
        f"nested too deep: the limit is {MAX_NESTING} levels",
        span,
        "give a part a name of its own with `derived`",
    )
