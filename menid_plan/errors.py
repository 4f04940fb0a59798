"""The exceptions of the project, as one tree.

::

    MenidError                 anything below; `exit_code` is what the command line ends with
    ├── InputError         3   a text has errors: carries the diagnostics
    ├── MeaningError       3   a domain means nothing in some state (two rules cover it, ...)
    └── LimitError         6   an input is larger than a stated limit

Errors in a user's text are values (`menid_plan.source.Diagnostic`) until a caller asks for a result
that cannot be had; only then are they raised.
"""

from __future__ import annotations

from collections.abc import Sequence

from menid_plan.source import Diagnostic, render


class MenidError(Exception):
    """Any failure that the project reports on purpose."""

    exit_code = 5


class InputError(MenidError):
    """A text cannot be used; ``diagnostics`` tells all that is wrong with it."""

    exit_code = 3

    def __init__(self, diagnostics: Sequence[Diagnostic]) -> None:
        super().__init__(diagnostics)
        self.diagnostics = tuple(diagnostics)

    def __str__(self) -> str:
        return "\n".join(render(d) for d in self.diagnostics)


class MeaningError(MenidError):
    """A domain and problem that are well formed give no meaning to what was asked."""

    exit_code = 3


class LimitError(MenidError):
    """Something is larger than a limit that the message names."""

    exit_code = 6


class MissingDependencyError(MenidError):
    """Something needs a package that is not installed; the message says how to have it."""

    exit_code = 5
