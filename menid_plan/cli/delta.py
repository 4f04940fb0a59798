"""`menid delta`: how far an empirical distribution may be off, from counts."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

import click

from menid_plan.cli.common import json_option

if TYPE_CHECKING:
    from menid_plan.learning.confidence import Method

_METHODS = ("exact", "monte-carlo", "bonferroni")


def _counts(
    ctx: click.Context, _parameter: click.Parameter, values: tuple[str, ...]
) -> tuple[float, ...]:
    """The counts, each of them finite and not below 0."""
    found = []
    for text in values:
        if text.startswith("--"):  # a minus sign alone may be that of a number
            raise click.NoSuchOption(text, ctx=ctx)
        try:
            number = float(text)
        except ValueError:
            raise click.BadParameter(f"`{text}` is not a number") from None
        if not math.isfinite(number):
            raise click.BadParameter(f"`{text}` is no count: it must be finite")
        if number < 0.0:
            raise click.BadParameter(f"`{text}` is no count: it must not be below 0")
        found.append(number)
    if len(found) < 2:
        raise click.UsageError("give at least two counts, one for each outcome", ctx)
    return tuple(found)


def _share(_context: click.Context, _parameter: click.Parameter, value: float) -> float:
    if not 0.0 < value < 1.0:
        raise click.BadParameter(f"{value:g} does not lie between 0 and 1")
    return value


@click.command("delta", context_settings={"ignore_unknown_options": True})
@click.argument("counts", nargs=-1, required=True, callback=_counts, metavar="COUNT COUNT...")
@click.option(
    "--epsilon", type=float, default=0.05, show_default=True, callback=_share, metavar="E",
    help="The probability with which the error may be larger.",
)  # fmt: skip
@click.option(
    "--method", type=click.Choice(_METHODS), default="exact", show_default=True,
    help="All digits; drawn at random (Algorithm 2 of the paper); or a simple upper bound.",
)  # fmt: skip
@click.option(
    "--samples", type=click.IntRange(1), default=10_000, show_default=True, metavar="N",
    help="How many distributions monte-carlo draws.",
)  # fmt: skip
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, metavar="S",
    help="Where monte-carlo starts; the same seed gives the same answer.",
)  # fmt: skip
@json_option
@click.pass_context
def command(
    ctx: click.Context,
    /,
    counts: tuple[float, ...],
    epsilon: float,
    method: Method,
    samples: int,
    seed: int,
    as_json: bool,
) -> None:
    """Tell how far the distribution seen in counts may be from the true one.

    Give how often each outcome was seen. The error of each outcome's frequency is at most the number
    printed, with probability 1 - epsilon.
    """
    if method != "monte-carlo":
        for name in ("samples", "seed"):
            if ctx.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE:
                raise click.UsageError(
                    f"--{name} goes with --method monte-carlo only; {method} draws nothing"
                )
    import numpy as np

    from menid_plan.learning.confidence import delta

    try:
        found = delta(counts, epsilon, method, samples, np.random.default_rng(seed))
    except ValueError as error:
        raise click.UsageError(str(error)) from None
    if not as_json:
        click.echo(f"{found:.6g}")
        return
    result: dict[str, Any] = {
        "delta": found,
        "counts": list(counts),
        "epsilon": epsilon,
        "method": method,
    }
    if method == "monte-carlo":
        result |= {"samples": samples, "seed": seed}
    click.echo(json.dumps(result, indent=2))
