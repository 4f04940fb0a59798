"""`menid hdd mesh`: a part at a quality, and what was checked of it."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from menid_plan.cli.common import distinct_outputs, json_option, print_plain, table
from menid_plan.files import replace_file

if TYPE_CHECKING:
    from menid_plan.environments.hdd.mesh import Check

_ENDINGS = ("obj", "stl", "ply")


@click.command("mesh")
@click.option(
    "--part", type=click.Choice(("board", "bay")), default="board", show_default=True,
    help="Which part.",
)  # fmt: skip
@click.option(
    "--quality", type=float, required=True, metavar="Q",
    help="The share of the vertices of a dense scan that is kept, 0.001 to 0.1.",
)  # fmt: skip
@click.option(
    "--scan", type=click.Path(exists=True, dir_okay=False, path_type=Path), metavar="FILE",
    help="A scan of your own (STL, OBJ, PLY; in mm) instead of the designed part.",
)  # fmt: skip
@click.option(
    "--other-scan", type=click.Path(exists=True, dir_okay=False, path_type=Path), metavar="FILE",
    help="With --report: a scan of the other part, for the tests of contact.",
)  # fmt: skip
@click.option(
    "-o", "--output", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE",
    help="Where to write it: .obj, .stl or .ply, in mm.",
)  # fmt: skip
@click.option(
    "--report", is_flag=True,
    help="Print the checks, those of contact with the other part among them.",
)  # fmt: skip
@json_option
@click.pass_context
def command(
    ctx: click.Context,
    part: str,
    quality: float,
    scan: Path | None,
    other_scan: Path | None,
    output: Path | None,
    report: bool,
    as_json: bool,
) -> None:
    """Write a part of the hard drive at a quality, or print what was checked of it.

    A report (--json: as JSON) ends with 1 if the part is not fit for contact. What is not within the
    tolerances by itself is not written.
    """
    report = report or as_json
    kind = output.suffix.lower().removeprefix(".") if output else ""
    if output is None and not report:
        raise click.UsageError("say where to write it (-o), or --report for the checks")
    if output is not None and kind not in _ENDINGS:
        raise click.UsageError(f"{output}: the file's ending must be .obj, .stl or .ply")
    if other_scan is not None and not report:
        raise click.UsageError("--other-scan is for the tests of contact: give --report as well")
    distinct_outputs([str(path) for path in (scan, other_scan) if path is not None], output)

    from menid_plan.environments.hdd.extra import require

    require()
    from menid_plan.environments.hdd.meshes import Source, part_mesh, tried_mesh, wanted_vertices
    from menid_plan.environments.hdd.scans import MeshError, exported

    try:
        wanted_vertices(part, quality)
    except MeshError as error:
        raise click.UsageError(str(error)) from error
    found = (tried_mesh if report else part_mesh)(Source(part, scan), quality)
    faults = found.report.faults
    if output is not None and not faults:
        replace_file(output, exported(found.mesh, kind))
        click.echo(f"wrote {output}", err=True)
    if not report:
        return
    checks, fit = found.report.checks, None
    if not faults:
        from menid_plan.environments.hdd.scene import Physics
        from menid_plan.environments.hdd.validity import validity

        other = {"board": "bay", "bay": "board"}[part]
        pair = {part: found.mesh, other: part_mesh(Source(other, other_scan), quality).mesh}
        fit = validity(pair["board"], pair["bay"], Physics())
        checks, faults = (*checks, *fit.checks), fit.faults
    if as_json:
        shown = {"mesh": asdict(found.report), "contact": asdict(fit) if fit else None}
        click.echo(json.dumps({**shown, "faults": faults}, indent=2))
    else:
        origin = scan or "the designed one"
        click.echo(
            f"{part} at quality {quality:g}, of {origin} with {found.report.full_vertices} vertices"
        )
        _show(checks)
        if fit is None:
            click.echo("contact was not tested, and nothing is written")
    if faults:
        ctx.exit(1)


def _show(checks: Iterable[Check]) -> None:
    """A table of the checks, then what is wrong in words."""
    from rich.console import Console

    console = Console(file=sys.stdout, highlight=False, markup=False)
    shown = table(console, gap=2)
    for name in ("", "found", "wanted", ""):
        shown.add_column(name)
    faults = []
    for check in checks:
        shown.add_row(check.name, check.found, check.wanted, "fault" if check.fault else "ok")
        if check.fault:
            faults.append(check.fault)
    with print_plain(console, sys.stdout):
        console.print(shown)
    for fault in faults:
        click.echo(f"fault: {fault}")
