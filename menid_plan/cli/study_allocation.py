"""`menid study allocation`: where to act, by several learners, as CSV, JSON and PNG."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from menid_plan.cli.common import json_option, load_both, print_table
from menid_plan.cli.studying import jobs_option, penalties_option, seed_option
from menid_plan.cli.tasks import tell_written
from menid_plan.files import replace_file
from menid_plan.interrupts import tidied_up


@click.command("allocation")
@click.option(
    "-o", "--output", "folder", required=True, metavar="DIR",
    type=click.Path(file_okay=False, path_type=Path),
    help="The folder for allocation.json, a CSV and three PNG files, and allocation-runs.jsonl.",
)  # fmt: skip
@click.option(
    "--bandits", type=click.IntRange(2, 100_000), default=300, show_default=True, metavar="N",
    help="How many runs of each learner with random actions.",
)  # fmt: skip
@click.option(
    "--runs", type=click.IntRange(2, 100_000), default=30, show_default=True, metavar="N",
    help="How many runs of each learner on the hard drive and where there are several steps.",
)  # fmt: skip
@click.option(
    "--hours", type=click.FloatRange(0, 1000, min_open=True), default=1.0, show_default=True,
    help="How long such a run takes on the virtual clock; with random actions it is an hour.",
)  # fmt: skip
@penalties_option
@jobs_option
@seed_option
@json_option
def command(
    folder: Path, penalties: tuple[float, ...], jobs: int, as_json: bool, **options: Any
) -> None:
    """Compare ways to choose between tests and executions.

    With random actions and simulators that are right or lie, on the hard drive, and in two domains
    with several steps. What was interrupted, or is to have more runs, goes on where it was.
    """
    from menid_plan import charts
    from menid_plan.resources import folder as shipped
    from menid_plan.studies.allocation import AllocationStudy, plain
    from menid_plan.studies.allocation_tables import curves_png, rewards_csv, tables

    charts.require()
    domains = shipped("domains")
    models = {
        name: load_both([str(domains / place / f"{each}.menid") for each in ("domain", problem)])
        for name, place, problem in (
            ("drive", "hdd", "drive"), ("assembly", "assembly", "peg"), ("stones", "stones", "river"),
        )
    }  # fmt: skip
    bank = domains / "hdd" / "bank.sqlite"
    study = AllocationStudy(models, bank, penalties, **options)
    folder.mkdir(parents=True, exist_ok=True)
    runs = folder / "allocation-runs.jsonl"

    def told(done: int, wanted: int) -> None:
        if done % 10 == 0 or done == wanted:
            click.echo(f"{done} of {wanted} pieces", err=True)

    with tidied_up():
        cases = study.execute(runs, jobs, told)
    settings = {
        "penalties": study.penalties, "bandits": study.bandits, "runs": study.runs,
        "hours": study.hours, "seed": study.seed,
    }  # fmt: skip
    text = json.dumps({"settings": settings, "cases": [plain(case) for case in cases]}, indent=2)
    files = {
        "allocation.json": (text + "\n").encode(),
        "rewards.csv": rewards_csv(cases).encode(),
    }
    for group in dict.fromkeys(case.group for case in cases):
        files[f"{group.replace(' ', '-')}.png"] = curves_png(cases, group)
    for name, data in files.items():
        replace_file(folder / name, data)
    if as_json:
        click.echo(text)
        return
    for shown in tables(cases):
        click.echo(shown.title)
        print_table(shown.head, shown.columns, shown.rows, first=11, gap=1)
        click.echo()
    tell_written([runs, *(folder / name for name in files)], err=False)
