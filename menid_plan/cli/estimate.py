"""`menid estimate`: what counts say of each rule, and how sure that is."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
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
from menid_plan.cli.experiences import files_of, store_in
from menid_plan.errors import MenidError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from rich.console import Console
    from rich.table import Table

    from menid_plan.experience.record import DistributionKey
    from menid_plan.learning.counts import Evidence
    from menid_plan.learning.estimators import Estimator
    from menid_plan.model.domain import Domain
    from menid_plan.model.rules import Rule


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
    evidence, roles = _evidence(domain_file, store, name, m, prior_weight)
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


def _evidence(
    domain_file: str,
    store: Path | None,
    name: str | None,
    m: float | None,
    prior_weight: float | None,
) -> tuple[Evidence, dict[str, str]]:
    """The evidence of a domain and a store, and the roles of the environments."""
    from menid_plan.experience.store import Store
    from menid_plan.learning.counts import Evidence
    from menid_plan.model.domain import Problem

    domain = next((r.domain for r in checked([domain_file]) if r.domain is not None), None)
    if domain is None:
        raise click.UsageError(f"`{domain_file}` holds no domain")
    if store is None:
        roles = {e.name: str(e.role) for e in domain.all_environments}
        made = _estimator(name or "decreasing-m", m, {})
        problem = Problem("none", domain.name)
        return Evidence(domain, problem, _in_order(roles), made, prior_weight or 0.0), roles
    with Store.read(store) as opened_store:
        roles = dict(opened_store.roles)
        opened_store.must_suit(domain)
        domain = _as_the_run_began(domain, opened_store.domain, domain_file)
        # A run may give environments other roles than the domain does.
        environments = tuple(
            replace(e, role="target" if roles.get(e.name) == "target" else "test")
            for e in domain.all_environments
        )
        domain = replace(domain, environments=environments)
        # By default everything is as in the run, so that what comes is its learned.menid.
        settings = opened_store.settings
        learn = _setting(store, settings, "learn", {})
        used = _setting(store, learn, "estimator", "decreasing-m")
        options = _setting(store, learn, "estimator_options", {}) if name in (None, used) else {}
        weight = prior_weight
        if weight is None:
            weight = float(_setting(store, learn, "prior_weight", 0.0))
        taken = _setting(store, settings, "environments", roles)
        names = [each for each in _in_order(roles) if each in taken]
        params = _setting(store, settings, "params", {})
        for param, value in params.items():
            if param not in {p.name for p in domain.params} or not isinstance(value, int | float):
                raise _bad_settings(store, f"params.{param}")
        try:
            made = _estimator(name or used, m, options)
        except (click.UsageError, MenidError) as error:
            if name is not None or m is not None:
                raise
            why = error.message if isinstance(error, click.UsageError) else str(error)
            raise _bad_settings(store, "learn", why) from error
        evidence = Evidence(domain, opened_store.problem, names, made, weight, params)
        for (environment, key), weights in opened_store.counts().items():
            if environment not in evidence.environments:
                raise _bad_settings(store, "environments", f"it lacks `{environment}`")
            evidence.add(environment, key, weights)
    return evidence, roles


def _as_the_run_began(domain: Domain, own: Domain, domain_file: str) -> Domain:
    """The domain, with the rules of the store's where it has counts that the run did not begin with.

    Such counts come from the store itself, in a domain with what was learned, and the probabilities
    with them; to count them again would make everything seem twice as sure.
    """
    from menid_plan.experience.sameness import without_comments

    rules = {(a.name, r.name): r for a in own.actions for r in a.rules}
    learned: list[str] = []

    def began(action: str, rule: Rule) -> Rule:
        there = rules[action, rule.name]
        if not rule.observed or without_comments(rule.observed) == without_comments(there.observed):
            return rule
        learned.append(f"{action}.{rule.name}")
        return there

    actions = tuple(
        replace(a, rules=tuple(began(a.name, rule) for rule in a.rules)) for a in domain.actions
    )
    if learned:
        more = f" and {len(learned) - 1} more" if len(learned) > 1 else ""
        click.echo(
            f"menid: `{domain_file}` has counts of rule `{learned[0]}`{more} that the run did not "
            "begin with; the store's alone are used, so that nothing is counted twice",
            err=True,
        )
    return replace(domain, actions=actions)


def _setting(store: Path, table: Mapping[str, Any], key: str, default: Any) -> Any:
    """A setting that a store keeps, which must be such as a run would have there."""
    value = table.get(key, default)
    kind = (int, float) if isinstance(default, float) else type(default)
    if not isinstance(value, kind) or isinstance(value, bool):
        raise _bad_settings(store, key)
    return value


def _bad_settings(store: Path, key: str, why: str = "") -> MenidError:
    from menid_plan.experience.rows import damaged

    return damaged(
        store, f"in its settings `{key}` is not what a run writes" + (why and f": {why}")
    )


def _in_order(roles: Mapping[str, str]) -> list[str]:
    """The environments, the target first."""
    return sorted(roles, key=lambda each: roles[each] != "target")


def _estimator(name: str, m: float | None, options: Mapping[str, Any]) -> Estimator:
    from menid_plan.learning.estimators import estimator

    given = {**options, **({} if m is None else {"m": m})}
    try:
        return estimator(name, **given)
    except ValueError as error:
        raise click.UsageError(str(error)) from error


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
