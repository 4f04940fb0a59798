"""Collects what the checker finds, with suggestions for names that look like a declared one."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Any

from menid_plan.language.syntax import Token, extent
from menid_plan.language.tokens import shown
from menid_plan.source import Diagnostic, SourceFile, Span

# Looking for a similar name among many takes long; after this many comparisons no more is suggested.
_SUGGESTION_WORK = 200_000


def counted(number: int, noun: str, plural: str = "") -> str:
    """A number and its noun: ``1 rule``, ``2 rules``, ``no rules``."""
    many = plural or f"{noun}s"
    return f"{number or 'no'} {noun if number == 1 else many}"


class Report:
    """The diagnostics of one text."""

    def __init__(self, source: SourceFile, lost_names: Collection[str] = ()) -> None:
        self.source = source
        self.diagnostics: list[Diagnostic] = []
        self._lost = lost_names
        self._work = _SUGGESTION_WORK

    def span(self, first: Any, last: Any = None) -> Span:
        """From the start of a token or node to the end of another, by default the same."""
        start, end = extent(first)
        return Span(self.source, start, end if last is None else extent(last)[1])

    @property
    def knows_errors(self) -> bool:
        """Whether anything is wrong so far, in what could be read or in what could not."""
        return bool(self._lost) or any(d.is_error for d in self.diagnostics)

    @property
    def start(self) -> Span:
        """The first character of the text."""
        return Span(self.source, 0, min(1, len(self.source.text)))

    def error(self, code: str, message: str, node: Any, hint: str | None = None) -> None:
        """Record an error at a node, token, list of these, or span."""
        self._add("error", code, message, node, hint)

    def warning(self, code: str, message: str, node: Any, hint: str | None = None) -> None:
        """Record a warning at a node, token, list of these, or span."""
        self._add("warning", code, message, node, hint)

    def _add(self, severity: Any, code: str, message: str, node: Any, hint: str | None) -> None:
        span = node if isinstance(node, Span) else self.span(node)
        self.diagnostics.append(Diagnostic(severity, code, message, span, hint))

    def unknown(
        self,
        code: str,
        kind: str,
        token: Token,
        candidates: Iterable[str],
        hint: str | None = None,
    ) -> None:
        """Record that a name is not declared, unless the lost part of the text may declare it."""
        name = token.value
        if name in self._lost:
            return
        message = f"unknown {kind} `{shown(name)}`"
        # Listing very many names for each of very many errors takes too long as well.
        names = list(candidates) if self._work >= 0 else []
        close = None if hint else self.similar(name, names)
        if close:
            message += f"; did you mean `{close}`?"
            hint = f"write `{close}`, or declare `{shown(name)}`"
        elif hint is None and 0 < len(names) <= 8:
            hint = f"declared: {', '.join(f'`{n}`' for n in names)}"
        elif hint is None and not names and self._work >= 0:
            hint = f"no {kind} is declared"
        self.error(code, message, token, hint)

    def similar(self, name: str, candidates: list[str]) -> str | None:
        """The candidate that looks most like a name, if one does."""
        self._work -= len(candidates)
        if self._work < 0 or not 2 < len(name) < 100:
            return None
        from difflib import get_close_matches

        matches = get_close_matches(name, candidates, n=1, cutoff=0.6)
        if matches:
            return matches[0]
        folded = {c.casefold().replace("_", "-"): c for c in candidates}
        return folded.get(name.casefold().replace("_", "-"))

    def duplicate(self, kind: str, token: Token, first: Token | None) -> None:
        """Record that a name is declared a second time."""
        where = ""
        if first is not None:
            where = f"; first in line {self.source.position(first.start)[0]}"
        self.error("M201", f"{kind} `{shown(token.value)}` is declared twice{where}", token)
