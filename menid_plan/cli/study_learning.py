"""`menid study learning`: accumulated reward with simulations and without, as CSV, JSON and PNG."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from menid_plan.cli.common import (
    distinct_outputs,
    existing_file,
    json_option,
    load_both,
    print_table,
)
from menid_plan.cli.studying import jobs_option, penalties_option, seed_option
from menid_plan.cli.tasks import tell_written
from menid_plan.files import replace_file
from menid_plan.interrupts import tidied_up

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from menid_plan.studies.learning import Interval, LearningStudy, Panel


@click.command("learning")
@click.option(
    "-o", "--output", "folder", required=True, metavar="DIR",
    type=click.Path(file_okay=False, path_type=Path),
    help="The folder for learning.json, learning-runs.jsonl, and a CSV and PNG file for each panel.",
)  # fmt: skip
@click.option(
    "--target", type=click.Choice(("fine", "robot", "both")), default="both", show_default=True,
    help="Which environment is the target.",
)  # fmt: skip
@penalties_option
@click.option(
    "--runs", type=click.IntRange(1, 100_000), default=5, show_default=True, metavar="N",
    help="How many runs of each learner; for verdicts 30.",
)  # fmt: skip
@click.option(
    "--hours", type=click.FloatRange(0, 1000, min_open=True), default=1.0, show_default=True,
    help="How long a run takes on the virtual clock.",
)  # fmt: skip
@click.option(
    "--test-time", type=click.FloatRange(0, min_open=True), default=20.0, show_default=True,
    metavar="T", help="Seconds for which an action is tested.",
)  # fmt: skip
@click.option(
    "--m", type=click.FloatRange(0), default=10.0, show_default=True,
    help="The weight m of decreasing-m.",
)  # fmt: skip
@click.option(
    "--bank", type=existing_file, metavar="STORE",
    help="The experiences that stand for the environments; by default those of the project.",
)  # fmt: skip
@click.option(
    "--live", is_flag=True, help="Execute in the PyBullet scenes: slow, and needs menid-plan[hdd]."
)
@jobs_option
@seed_option
@json_option
def command(
    folder: Path, target: str, penalties: tuple[float, ...], bank: str | None, live: bool, jobs: int,
    as_json: bool, **options: Any,
) -> None:  # fmt: skip
    """Compare learning with tests in simulations and without, on the hard drive.

    The protocol is that of the paper. What was interrupted, or is to have more runs, goes on where it
    was.
    """
    from menid_plan import charts
    from menid_plan.environments.runfile import read_run_file
    from menid_plan.resources import folder as shipped
    from menid_plan.studies.learning import LearningStudy

    charts.require()
    drive = shipped("domains") / "hdd"
    if live:
        from menid_plan.environments.hdd.extra import require

        if bank is not None:
            raise click.UsageError("--bank: with --live, nothing is taken from a bank")
        require()
    domain, problem = load_both([str(drive / f"{name}.menid") for name in ("domain", "drive")])
    studies: dict[str, tuple[Any, ...]] = {
        "fine": ("simulation",), "robot": ("robot",), "both": ("simulation", "robot"),
    }  # fmt: skip
    study = LearningStudy(
        domain, problem, Path(bank or drive / "bank.sqlite"),
        read_run_file(drive / "robot.toml") if live else None,
        studies[target], penalties, **options,
    )  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    runs = folder / "learning-runs.jsonl"
    distinct_outputs([bank] if bank else [], runs)

    def told(done: int, wanted: int) -> None:
        click.echo(f"{done} of {wanted} runs", err=True)

    with tidied_up():
        panels = study.execute(runs, jobs, told)
    written = [runs, folder / "learning.json"]
    text = json.dumps(study.as_json(panels), indent=2)
    replace_file(written[1], (text + "\n").encode())
    for panel in panels:
        written += [folder / f"{panel.name}.csv", folder / f"{panel.name}.png"]
        replace_file(written[-2], study.as_csv(panel).encode())
        replace_file(written[-1], study.as_png(panel))
    if as_json:
        click.echo(text)
        return
    _show(study, panels)
    tell_written(written, err=False)


def _show(study: LearningStudy, panels: Sequence[Panel]) -> None:
    """Tables for each panel: means with half the width of their 95 % intervals, and differences."""
    from menid_plan.studies.learning import SETTINGS, Interval

    for panel in panels:
        click.echo(f"target {SETTINGS[panel.study].target}, penalty {panel.penalty:g}")
        measures = panel.measures(study.hours)
        _print("mean of a run", {
            name: {key: Interval.of(values) for key, values in found.items()}
            for name, found in measures.items()
        })  # fmt: skip
        _print("more than without", panel.differences(study.hours))
        click.echo()


def _print(head: str, columns: Mapping[str, Mapping[str, Interval]]) -> None:
    rows = (
        (key, [_text(found[key]) for found in columns.values()])
        for key in next(iter(columns.values()))
    )
    print_table(head, list(columns), rows, first=22, others=16)


def _text(found: Interval) -> str:
    half = "" if math.isnan(found.half) else f" ± {found.half:.3g}"
    return f"{found.mean:.4g}{half}"
