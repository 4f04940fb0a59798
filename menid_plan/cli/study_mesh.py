"""`menid study mesh`: what the quality of meshes does to times and outcomes, as CSV, JSON and PNG."""

from __future__ import annotations

import json
import math
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from menid_plan.cli.common import (
    distinct_outputs,
    existing_file,
    json_option,
    load_both,
    print_plain,
    table,
)
from menid_plan.cli.tasks import tell_written
from menid_plan.files import replace_file

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from menid_plan.studies.mesh import Curve, Progress


@click.command("mesh")
@click.argument("files", nargs=-1, type=existing_file, metavar="[DOMAIN PROBLEM]")
@click.option(
    "-o", "--output", "folder", required=True, metavar="DIR",
    type=click.Path(file_okay=False, path_type=Path),
    help="The folder for mesh-runs.csv, mesh.csv, mesh.json and mesh.png.",
)  # fmt: skip
@click.option(
    "--actions", metavar="NAME,...",
    help="Which actions, with commas between them; all if left out.",
)  # fmt: skip
@click.option(
    "--qualities", type=click.IntRange(2, 1000), default=4, show_default=True, metavar="N",
    help="How many, evenly spaced from .00103 to .01; in the paper 36.",
)  # fmt: skip
@click.option(
    "--repetitions", type=click.IntRange(1), default=2, show_default=True, metavar="R",
    help="How often each action is executed at each place and quality; in the paper 5.",
)  # fmt: skip
@click.option(
    "--jobs", type=click.IntRange(1), default=os.cpu_count() or 1, metavar="J",
    help="How many executions run at once; as many as there are cores if left out.",
)  # fmt: skip
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, metavar="S",
    help="The same seed gives the same outcomes.",
)  # fmt: skip
@json_option
def command(
    files: tuple[str, ...],
    folder: Path,
    actions: str | None,
    qualities: int,
    repetitions: int,
    jobs: int,
    seed: int,
    as_json: bool,
) -> None:
    """Execute actions on hard drives with ever finer meshes; compare times and outcomes.

    Without DOMAIN PROBLEM, on the drive that comes with the project. What was interrupted, or is
    to have more qualities or repetitions, goes on where it was.
    """
    from menid_plan import charts
    from menid_plan.environments.hdd.extra import require
    from menid_plan.resources import folder as shipped
    from menid_plan.studies.mesh import MeshStudy

    require()
    charts.require()
    drive = shipped("domains") / "hdd"
    domain, problem = load_both(files or [str(drive / f"{n}.menid") for n in ("domain", "drive")])
    declared = tuple(action.name for action in domain.actions)
    chosen = declared if actions is None else tuple(dict.fromkeys(_names(actions)))
    for name in chosen:
        if name not in declared:
            raise click.UsageError(
                f"--actions: domain `{domain.name}` has no action `{name}`; it has"
                f" {', '.join(declared)}"
            )
    study = MeshStudy(domain, problem, chosen, qualities, repetitions, seed)
    there = {call.action for call in study.calls}
    for name in chosen:
        if name not in there:
            raise click.UsageError(
                f"no `{name}` applies in the initial state of problem `{problem.name}`: name the"
                " others with --actions"
            )
    folder.mkdir(parents=True, exist_ok=True)
    outputs = {name: folder / f"mesh{name}" for name in ("-runs.csv", ".csv", ".json", ".png")}
    distinct_outputs(files, *outputs.values())

    def told(now: Progress) -> None:
        failures = f", {now.failed} failed" if now.failed else ""
        click.echo(f"{now.done} of {now.wanted} executions{failures}", err=True)

    results = study.run(
        outputs["-runs.csv"], jobs, told, lambda failure: click.echo(str(failure), err=True)
    )
    curves = study.curves(results)
    text = json.dumps(study.as_json(curves, results), indent=2)
    replace_file(outputs[".csv"], study.as_csv(curves).encode())
    replace_file(outputs[".json"], (text + "\n").encode())
    replace_file(outputs[".png"], study.as_png(curves))
    failed = sum(bool(result.failure) for result in results.values())
    if failed:
        click.echo(
            f"{failed} of {len(results)} executions failed each time and are left out;"
            " the same command tries them again",
            err=True,
        )
    if as_json:
        click.echo(text)
        return
    _show(curves)
    tell_written(outputs.values(), err=False)


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",")]


def _show(curves: Sequence[Curve]) -> None:
    """A row for each action and quality, then how far repetitions differ at the highest."""
    from rich.console import Console

    console = Console(file=sys.stdout, highlight=False, markup=False)
    shown = table(console, gap=2)
    for name in ("action", "quality", "runs", "seconds", "quartiles", "error", "other seeds"):
        shown.add_column(name, justify="left" if name == "action" else "right", no_wrap=True)
    for curve in curves:
        rows = zip(
            curve.qualities, curve.runs, curve.seconds, curve.error, curve.others, strict=True
        )
        for quality, runs, (_, low, median, high), error, others in rows:
            shown.add_row(
                curve.action, f"{quality:g}", str(runs), _number(median, 2),
                f"{_number(low, 2)} to {_number(high, 2)}", _mean(error), _mean(others),
            )  # fmt: skip
    with print_plain(console, sys.stdout):
        console.print(shown)
    for curve in curves:
        if not math.isnan(curve.floor[0]):
            click.echo(f"{curve.action}: two seeds at the best mesh differ by {_mean(curve.floor)}")


def _mean(found: Iterable[float]) -> str:
    """A mean and its standard error."""
    mean, error = found
    return _number(mean, 3) + ("" if math.isnan(error) else f" ± {error:.3f}")


def _number(value: float, digits: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{digits}f}"
