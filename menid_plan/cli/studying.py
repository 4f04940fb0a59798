"""Options that several studies have."""

from __future__ import annotations

import math
import os

import click


def _penalties(
    _ctx: click.Context, _parameter: click.Parameter, text: str
) -> tuple[float, ...]:  # fmt: skip
    """What --penalties lists; click.UsageError if that makes no sense."""
    try:
        found = tuple(dict.fromkeys(float(each) for each in text.split(",")))
    except ValueError:
        raise click.UsageError(f"--penalties: `{text}` is no list of numbers") from None
    if not all(0 <= each < math.inf for each in found):
        raise click.UsageError(f"--penalties: `{text}`: they must be finite, and not below 0")
    return found


penalties_option = click.option(
    "--penalties", default="0,5,10", show_default=True, metavar="C,...", callback=_penalties,
    help="What a failure costs, where a success brings in 1.",
)  # fmt: skip
jobs_option = click.option(
    "--jobs", type=click.IntRange(1), default=os.cpu_count() or 1, metavar="J",
    help="How many runs at once; as many as there are cores if left out.",
)  # fmt: skip
seed_option = click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, metavar="S",
    help="The same seed gives the same files.",
)  # fmt: skip
