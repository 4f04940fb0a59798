"""`menid doctor`: which planners of others are there."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click


@click.command("doctor")
@click.option(
    "--planners", "path", metavar="FILE.toml",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Where planners are declared; by default the user's own file.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def command(path: Path | None, as_json: bool) -> None:
    """Say which planners are found, where they were sought, and how to get those that are missing."""
    from menid_plan.planners.known import declarations, report

    found = report(path)
    if as_json:
        click.echo(json.dumps([asdict(each) for each in found], indent=2))
        return
    for each in found:
        click.echo(f"{each.name}: {'found' if each.there else 'missing'}: {each.told}")
    if path is None and not declarations().is_file():
        click.echo(f"planners of your own can be declared in {declarations()}")
