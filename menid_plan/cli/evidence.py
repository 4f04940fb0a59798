"""What was observed, from a store of experiences or from a domain, for the commands that use it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from menid_plan.errors import MenidError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from menid_plan.learning.counts import Evidence
    from menid_plan.learning.estimators import Estimator
    from menid_plan.model.domain import Domain
    from menid_plan.model.rules import Rule


def evidence_of(
    domain: Domain,
    domain_file: str,
    store: Path | None,
    name: str | None,
    m: float | None,
    prior_weight: float | None,
) -> tuple[Evidence, dict[str, str]]:
    """The evidence of a domain and a store (None: its own counts), and the environments' roles.

    ``name``, ``m`` and ``prior_weight`` are the estimator's; None stands for those of the run.
    """
    from menid_plan.experience.store import Store
    from menid_plan.learning.counts import Evidence
    from menid_plan.model.domain import Problem

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
