"""What the commands share: printing diagnostics, reading DOMAIN and PROBLEM, writing results."""

from __future__ import annotations

import io
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO, TypeVar

import click

from menid_plan.errors import InputError
from menid_plan.files import replace_file as replace_file
from menid_plan.files import resolved
from menid_plan.language.check import CheckResult
from menid_plan.language.files import check_files
from menid_plan.model.domain import Domain, Problem
from menid_plan.source import Diagnostic, render

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from menid_plan.environments.registry import EnvironmentSpec
    from menid_plan.environments.runfile import Bound

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


def _settings(
    _context: click.Context, _parameter: click.Parameter, values: tuple[str, ...]
) -> dict[str, float]:
    found = {}
    for text in values:
        name, _, number = text.partition("=")
        if name.strip() in found:
            raise click.BadParameter(f"`{name.strip()}` is set twice")
        try:
            found[name.strip()] = float(number)
        except ValueError:
            raise click.BadParameter(f"`{text}` is not of the form NAME=NUMBER") from None
    return found


def setting_option(function: _Command) -> _Command:
    """The option --set, any number of times; the command gets ``settings``."""
    option = click.option(
        "--set", "settings", multiple=True, metavar="NAME=NUMBER", callback=_settings,
        help="Set a param of the domain anew; may be given more than once.",
    )  # fmt: skip
    return option(function)


def environment_of(bound: Bound, run_file: str, name: str | None) -> EnvironmentSpec:
    """The environment of that name among those of a run file; None: the target."""
    found = {spec.name: spec for spec in bound.environments}
    if name is None:
        return bound.target
    if name not in found:
        raise click.UsageError(f"{run_file} has no environment `{name}`; it has {', '.join(found)}")
    return found[name]


def distinct_outputs(inputs: Iterable[str], *outputs: Path | None) -> None:
    """Refuse to write over what is read, or twice to one file, or where there is no folder."""
    taken = {resolved(Path(name)): f"`{name}` is an input" for name in inputs if name != "-"}
    for output in outputs:
        if output is None:
            continue
        place = resolved(output)
        if place in taken:
            raise click.UsageError(f"cannot write `{output}`: {taken[place]}")
        if not place.parent.is_dir():
            raise click.UsageError(f"cannot write `{output}`: there is no folder `{output.parent}`")
        taken[place] = f"`{output}` is to be written already"


def installed(requirement: str) -> bool:
    """Whether a package is there, of whatever version (``stormpy>=2``)."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        version(re.split(r"[<>=!~ ]", requirement, maxsplit=1)[0])
    except PackageNotFoundError:
        return False
    return True


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


def checked(paths: Iterable[str]) -> list[CheckResult]:
    """What is in the files; warnings go to standard error.

    Raises InputError if there is an error in them, click.UsageError if they hold two domains or two
    problems.
    """
    results = check_files(list(paths), together=True)
    diagnostics = [d for result in results for d in result.diagnostics]
    if any(d.is_error for d in diagnostics):
        raise InputError(diagnostics)
    report_diagnostics(diagnostics, err=True)
    for kind, count in (
        ("domain", sum(r.domain is not None for r in results)),
        ("problem", sum(r.problem is not None for r in results)),
    ):
        if count > 1:
            raise click.UsageError(f"the files hold {count} {kind}s; give one")
    return results


def load_both(paths: Iterable[str]) -> tuple[Domain, Problem]:
    """The problem in the files and its domain, which may be found beside it; see `checked`."""
    for result in checked(paths):
        if result.problem is not None and result.known is not None:
            return result.known.domain, result.problem
    raise click.UsageError("the files hold no problem; give DOMAIN PROBLEM")


@contextmanager
def print_plain(console: Console, stream: TextIO) -> Iterator[None]:
    """Print what the console gets without the spaces that pad columns at the ends of lines."""
    with console.capture() as capture:
        yield
    for line in capture.get().splitlines():
        stream.write(line.rstrip() + "\n")


def table(console: Console, gap: int = 1) -> Table:
    """A table with a line under its head on a terminal, and white space alone elsewhere.

    ``gap`` is the number of spaces between two columns.
    """
    from rich import box
    from rich.table import Table

    style = box.SIMPLE_HEAD if console.is_terminal else None
    return Table(box=style, padding=(0, gap, 0, 0), pad_edge=False)


def print_table(
    head: str,
    columns: Sequence[str],
    rows: Iterable[tuple[str, Sequence[str]]],
    first: int = 0,
    others: int = 0,
    gap: int = 2,
) -> None:
    """Print rows of texts, each with its name; ``first`` and ``others`` are least widths."""
    from rich.console import Console

    console = Console(file=sys.stdout, highlight=False, markup=False)
    shown = table(console, gap)
    shown.add_column(head, no_wrap=True, min_width=first)
    for name in columns:
        shown.add_column(name, justify="right", no_wrap=True, min_width=others)
    for name, cells in rows:
        shown.add_row(name, *cells)
    with print_plain(console, sys.stdout):
        console.print(shown)


@contextmanager
def opened(output: Path | None) -> Iterator[TextIO]:
    """The stream for results: a file, or standard output. A file appears only when it is whole."""
    if output is None:
        yield sys.stdout or io.StringIO()  # it is None where the caller closed it
        return
    buffer = io.StringIO()
    yield buffer
    replace_file(output, buffer.getvalue().encode("utf-8"))
