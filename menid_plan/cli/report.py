"""`menid report`: a page about learning runs."""

from __future__ import annotations

from pathlib import Path

import click

from menid_plan.cli.common import distinct_outputs, replace_file
from menid_plan.cli.experiences import files_of
from menid_plan.cli.tasks import tell_written


@click.command("report")
@click.argument(
    "folders", nargs=-1, required=True, metavar="RUNDIR...",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
)  # fmt: skip
@click.option(
    "-o", "--output", required=True, type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE.html", help="The page; one that is there already is replaced.",
)  # fmt: skip
def command(folders: tuple[Path, ...], output: Path) -> None:
    """Write a page about learning runs: curves, what was learned, the best policy, settings.

    RUNDIR is a folder that `menid learn -o` has written; several are compared. The page is one file,
    which loads nothing else, and the same runs give the same page. A film best.gif in the folder of a
    run is shown.
    """
    if output.suffix.lower() not in (".html", ".htm"):
        raise click.UsageError(f"-o: {output}: the file's ending must be .html")
    distinct_outputs(_inputs(folders), output)
    if len({folder.resolve() for folder in folders}) < len(folders):
        raise click.UsageError("a run is given twice")
    from menid_plan.report.page import page, require
    from menid_plan.report.run import read_run

    require()
    runs = [read_run(folder) for folder in folders]
    for run in runs:
        for note in run.notes:
            click.echo(f"menid: `{run.folder}`: {note}", err=True)
    replace_file(output, page(runs).encode("utf-8", "replace"))
    tell_written([output], err=False)


def _inputs(folders: tuple[Path, ...]) -> list[str]:
    """The files that are read, or that a run keeps there."""
    from menid_plan.learning.run import CURVE, EVENTS, LEARNED, SETTINGS, STORE
    from menid_plan.report.run import FILM

    names = (CURVE, EVENTS, FILM, LEARNED, SETTINGS)
    return [
        name
        for folder in folders
        for name in (*files_of(folder / STORE), *(str(folder / each) for each in names))
    ]
