"""`menid estimate`: what counts say of each rule, and how sure that is."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from menid_plan.cli.common import (
    checked,
    distinct_outputs,
    existing_file,
    json_option,
    opened,
    print_plain,
    table,
)
from menid_plan.cli.evidence import evidence_of
from menid_plan.cli.experiences import files_of, store_in
from menid_plan.cli.tasks import tell_written

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from menid_plan.experience.record import DistributionKey
    from menid_plan.learning.counts import Evidence


def _number(
    _context: click.Context, parameter: click.Parameter, value: float | None
) -> float | None:
    """A number that can be computed with: nan is in no range, and click lets it pass."""
    if value is None:
        return None
    if not math.isfinite(value):
        raise click.BadParameter(f"{value:g} is not a finite number")
    if parameter.name != "epsilon":
        from menid_plan.learning.mixtures import MOST

        if value > MOST:
            raise click.BadParameter(f"{value:g} is too large; it may be at most {MOST:g}")
    return value


@click.command("estimate")
@click.argument("domain_file", type=existing_file, metavar="DOMAIN")
@click.argument("store", required=False, type=click.Path(exists=True, path_type=Path))
@click.option("--estimator", "name", metavar="NAME",
              help="How counts of several environments are merged: as in the run, else "
              "decreasing-m.")  # fmt: skip
@click.option("--m", type=click.FloatRange(0), callback=_number,
              help="The weight m of decreasing-m.")  # fmt: skip
@click.option("--prior-weight", type=click.FloatRange(0), callback=_number,
              help="How many executions the domain's own probabilities are worth: as in the run, "
              "else 0.")  # fmt: skip
@click.option("--epsilon", type=click.FloatRange(0, 1, min_open=True, max_open=True),
              default=0.05, show_default=True, callback=_number,
              help="The probability that an error is larger than its bound.")  # fmt: skip
@click.option("--compare", is_flag=True, help="Show the estimates of all estimators.")
@click.option("-o", "--output", type=click.Path(dir_okay=False, path_type=Path),
              help="Write the domain there, with the estimates and the counts.")  # fmt: skip
@json_option
def command(
    domain_file: str,
    store: Path | None,
    name: str | None,
    m: float | None,
    prior_weight: float | None,
    epsilon: float,
    compare: bool,
    output: Path | None,
    as_json: bool,
) -> None:
    """Tell what counts say of each rule: those of a store, or of the `observed` blocks of the domain.

    STORE is the file of a run, or its folder. The counts of a store are added to those that the domain
    had when the run began.
    """
    store = None if store is None else store_in(store)
    distinct_outputs([domain_file, *(files_of(store) if store else ())], output)
    domain = next((r.domain for r in checked([domain_file]) if r.domain is not None), None)
    if domain is None:
        raise click.UsageError(f"`{domain_file}` holds no domain")
    evidence, roles = evidence_of(domain, domain_file, store, name, m, prior_weight)
    keys = [key for key in evidence.keys if evidence.counts(key).any()]
    try:
        rules = [_described(evidence, key, epsilon) for key in keys]
        if compare:
            for each, key in zip(rules, keys, strict=True):
                each["estimators"] = _compared(evidence, key)
    except ValueError as error:  # as many tests have data as an estimator can't weigh up
        raise click.UsageError(str(error)) from error
    if output is not None:
        from menid_plan.language.write import write
        from menid_plan.learning.counts import learned_domain

        with opened(output) as stream:
            stream.write(write(learned_domain(evidence, roles)))
        if str(output) != "-":
            tell_written([output], err=True)
    seen = {(key.action, key.rule) for key in keys}
    unseen = [
        f"{action.name}.{rule.name}"
        for action in evidence.domain.actions
        for rule in action.rules
        if (action.name, rule.name) not in seen
    ]
    if as_json:
        environments = list(evidence.environments)
        found = {"environments": environments, "rules": rules, "unseen": unseen}
        click.echo(json.dumps(found, indent=2))
        return
    _show(evidence, rules)
    if unseen:
        click.echo(f"never seen: {', '.join(unseen)}")


def _described(evidence: Evidence, key: DistributionKey, epsilon: float) -> dict[str, Any]:
    """All that is known of a distribution, for JSON."""
    from menid_plan.learning.confidence import delta
    from menid_plan.learning.counts import agreement

    counts = evidence.counts(key)
    rows = dict(zip(evidence.environments, counts, strict=True))
    target = counts[0]
    return {
        "action": key.action,
        "rule": key.rule,
        "for": list(key.values),
        "outcomes": [outcome.name for outcome in evidence.rule(key).outcomes],
        "counts": {name: row.tolist() for name, row in rows.items()},
        "delta": {name: delta(row, epsilon) for name, row in rows.items()},
        "agreement": {
            name: agreement(target, row)
            for name, row in rows.items()
            if name != evidence.environments[0]
        },
        "estimate": evidence.answer(key).tolist(),
    }


def _compared(evidence: Evidence, key: DistributionKey) -> dict[str, list[float]]:
    from menid_plan.learning.estimators import ESTIMATORS

    return {
        name: kind().posterior(evidence.counts(key)).estimate().tolist()
        for name, kind in ESTIMATORS.items()
    }


def _show(evidence: Evidence, rules: list[dict[str, Any]]) -> None:
    """A table for each rule: outcomes by environments, then how sure they are."""
    from rich.console import Console

    console = Console(highlight=False, markup=False)
    for each in rules:
        per = f" for {', '.join(each['for'])}" if each["for"] else ""
        click.echo(f"{each['action']}.{each['rule']}{per}")
        grid = table(console)
        grid.add_column("")
        for name in (*evidence.environments, "estimate"):
            grid.add_column(name, justify="right")
        for i, outcome in enumerate(each["outcomes"]):
            cells = [f"{each['counts'][name][i]:g}" for name in evidence.environments]
            cells.append(f"{each['estimate'][i]:.4f}")
            grid.add_row(outcome, *cells)
        grid.add_row("delta", *(f"{each['delta'][name]:.4f}" for name in evidence.environments))
        grid.add_row("agrees", "", *(f"{p:.2f}" for p in each["agreement"].values()))
        with print_plain(console, sys.stdout):
            console.print(grid)
            if "estimators" in each:
                console.print(_comparison(console, each))
        click.echo()


def _comparison(console: Console, each: dict[str, Any]) -> Table:
    """The estimates of all estimators, a line for each."""
    grid = table(console)
    for name in ("", *each["outcomes"]):
        grid.add_column(name, justify="right" if name else "left")
    for name, found in each["estimators"].items():
        grid.add_row(name, *(f"{p:.4f}" for p in found))
    return grid
