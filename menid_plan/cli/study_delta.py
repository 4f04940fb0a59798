"""`menid study delta`: the delta bound against the true error, as CSV, JSON and PNG files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from menid_plan.cli.common import json_option
from menid_plan.cli.studying import seed_option
from menid_plan.files import replace_file

if TYPE_CHECKING:
    from menid_plan.learning.confidence import Method


@click.command("delta")
@click.option(
    "-o", "--output", "folder", required=True, metavar="DIR",
    type=click.Path(file_okay=False, path_type=Path),
    help="The folder for delta.csv, delta.json and delta.png.",
)  # fmt: skip
@seed_option
@click.option(
    "--samples-up-to", "largest", type=click.IntRange(1), default=1000, show_default=True,
    metavar="N", help="How large the samples grow.",
)  # fmt: skip
@click.option(
    "--runs", type=click.IntRange(1), default=50, show_default=True, metavar="R",
    help="Over how many samplings the share of exceeded bounds is taken.",
)  # fmt: skip
@click.option(
    "--method", type=click.Choice(("monte-carlo", "exact")), default="monte-carlo",
    show_default=True, help="How the bounds are found; see `menid delta`.",
)  # fmt: skip
@json_option
def command(
    folder: Path, seed: int, largest: int, runs: int, method: Method, as_json: bool
) -> None:
    """Draw ever larger samples; compare their true error with the bounds for it.

    One distribution is skewed, one uniform. The figure has one sampling; how often bounds are exceeded
    is counted in many.
    """
    from menid_plan.studies.delta import DeltaStudy

    study = DeltaStudy(seed=seed, largest=largest, runs=runs, method=method)
    curves = study.run()
    folder.mkdir(parents=True, exist_ok=True)
    result = study.as_json(curves)
    text = json.dumps(result, indent=2)
    replace_file(folder / "delta.csv", study.as_csv(curves).encode())
    replace_file(folder / "delta.json", (text + "\n").encode())
    replace_file(folder / "delta.png", study.as_png(curves))
    if as_json:
        click.echo(text)
        return
    for curve in curves:
        shown = ", ".join(f"{p:g}" for p in curve.truth)
        click.echo(f"{curve.name} distribution ({shown})")
        for epsilon in study.epsilons:
            click.echo(
                f"  the bound for epsilon {epsilon:g} is exceeded in"
                f" {curve.exceeded[epsilon]:.2%} of {curve.compared} samples of {runs} runs"
            )
    for name in ("delta.csv", "delta.json", "delta.png"):
        click.echo(f"wrote {folder / name}")
