"""What the commands share: printing diagnostics, reading DOMAIN and PROBLEM, writing results."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

import click

from menid_plan.errors import InputError
from menid_plan.language.files import Document, check_files
from menid_plan.model.domain import Domain, Problem
from menid_plan.source import Diagnostic, render

_COLOURS: dict[str, dict[str, Any]] = {
    "place": {"bold": True},
    "error": {"fg": "red", "bold": True},
    "warning": {"fg": "yellow", "bold": True},
    "caret": {"fg": "red"},
    "hint": {"fg": "cyan"},
}

_Command = TypeVar("_Command", bound=Callable[..., Any])

existing_file = click.Path(exists=True, dir_okay=False, allow_dash=True, path_type=str)


def json_option(function: _Command) -> _Command:
    """The option --json."""
    return click.option("--json", "as_json", is_flag=True, help="Print JSON.")(function)


def output_option(function: _Command) -> _Command:
    """The option -o."""
    path = click.Path(dir_okay=False, path_type=Path)
    option = click.option("-o", "--output", type=path, help="Write there, not to standard output.")
    return option(function)


def report_diagnostics(diagnostics: Iterable[Diagnostic], *, err: bool = False) -> None:
    """Print diagnostics with their excerpts, in colour on a terminal."""
    for diagnostic in diagnostics:
        text = render(diagnostic, lambda part, role: click.style(part, **_COLOURS[role]))
        click.echo(text, err=err)


def load_domain(paths: Iterable[str]) -> Document:
    """The domain, and the problem if there is one, of one file or two.

    Raises InputError if there is an error in them, click.UsageError if they hold no domain.
    """
    results = check_files(list(paths))
    diagnostics = [d for result in results for d in result.diagnostics]
    if any(d.is_error for d in diagnostics):
        raise InputError(diagnostics)
    report_diagnostics(diagnostics, err=True)
    domains = [r.domain for r in results if r.domain is not None]
    problems = [r.problem for r in results if r.problem is not None]
    if len(domains) > 1 or len(problems) > 1:
        raise click.UsageError("the files hold more than one domain or problem")
    if not domains:
        raise click.UsageError("the files hold no domain; give DOMAIN and then PROBLEM")
    return Document(domains[0], problems[0] if problems else None)


def load_both(paths: Iterable[str]) -> tuple[Domain, Problem]:
    """The domain and the problem of one file or two; see `load_domain`."""
    document = load_domain(paths)
    if document.problem is None:
        raise click.UsageError("the files hold no problem; give DOMAIN and then PROBLEM")
    assert document.domain is not None
    return document.domain, document.problem
