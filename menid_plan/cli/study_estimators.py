"""`menid study estimators`: errors of all estimators and rewards by them, as CSV, JSON and PNG."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

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


@click.command("estimators")
@click.option(
    "-o", "--output", "folder", required=True, metavar="DIR",
    type=click.Path(file_okay=False, path_type=Path),
    help="The folder for estimators.json, two CSV and three PNG files, and estimators-runs.jsonl.",
)  # fmt: skip
@click.option(
    "--runs", type=click.IntRange(1, 100_000), default=10, show_default=True, metavar="N",
    help="How many runs of each estimator on the hard drive; for verdicts 30.",
)  # fmt: skip
@click.option(
    "--hours", type=click.FloatRange(0, 1000, min_open=True), default=1.0, show_default=True,
    help="How long such a run takes on the virtual clock.",
)  # fmt: skip
@click.option(
    "--random-runs", type=click.IntRange(1, 100_000), default=200, show_default=True, metavar="N",
    help="How many runs of each estimator with random actions.",
)  # fmt: skip
@click.option(
    "--repetitions", type=click.IntRange(1, 1_000_000), default=4000, show_default=True, metavar="N",
    help="How many truths of each kind of random rule.",
)  # fmt: skip
@penalties_option
@click.option(
    "--bank", type=existing_file, metavar="STORE",
    help="Experiences that stand for the hard drive; by default those of the project.",
)  # fmt: skip
@jobs_option
@seed_option
@json_option
def command(
    folder: Path,
    penalties: tuple[float, ...],
    bank: str | None,
    jobs: int,
    as_json: bool,
    **options: Any,
) -> None:
    """Compare the estimators: their errors, and the reward that is earned by them.

    On random rules and actions, and on the hard drive. What was interrupted, or is to have more runs,
    goes on where it was.
    """
    from menid_plan import charts
    from menid_plan.resources import folder as shipped
    from menid_plan.studies.estimator_tables import errors_png, rewards_png, tables
    from menid_plan.studies.estimators import DRIVE, RANDOM, EstimatorStudy

    charts.require()
    drive = shipped("domains") / "hdd"
    domain, problem = load_both([str(drive / f"{name}.menid") for name in ("domain", "drive")])
    study = EstimatorStudy(
        domain, problem, Path(bank or drive / "bank.sqlite"), penalties, **options
    )
    folder.mkdir(parents=True, exist_ok=True)
    runs = folder / "estimators-runs.jsonl"
    distinct_outputs([bank] if bank else [], runs)

    def told(done: int, wanted: int) -> None:
        if done % 10 == 0 or done == wanted:
            click.echo(f"{done} of {wanted} pieces", err=True)

    with tidied_up():
        found = study.execute(runs, jobs, told)
    text = json.dumps(study.as_json(found), indent=2)
    files = {
        "estimators.json": (text + "\n").encode(),
        "errors.csv": study.errors_csv(found).encode(),
        "rewards.csv": study.rewards_csv(found).encode(),
        "errors.png": errors_png(found),
        "rewards-random.png": rewards_png(found, RANDOM),
        "rewards-drive.png": rewards_png(found, DRIVE),
    }
    for name, data in files.items():
        replace_file(folder / name, data)
    if as_json:
        click.echo(text)
        return
    for shown in tables(found):
        click.echo(shown.title)
        print_table(shown.head, shown.columns, shown.rows, first=14, gap=1)
        click.echo()
    tell_written([runs, *(folder / name for name in files)], err=False)
