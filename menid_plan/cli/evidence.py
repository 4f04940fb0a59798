"""What was observed, from a store of experiences or from a domain, for the commands that use it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from menid_plan.learning.counts import Evidence
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
    from menid_plan.learning.stored import estimator_with, in_order, stored_evidence
    from menid_plan.model.domain import Problem

    try:
        if store is None:
            roles = {e.name: str(e.role) for e in domain.all_environments}
            made = estimator_with(name or "decreasing-m", m, {})
            problem = Problem("none", domain.name)
            return Evidence(domain, problem, in_order(roles), made, prior_weight or 0.0), roles
        with Store.read(store) as opened_store:
            opened_store.must_suit(domain)
            domain = _as_the_run_began(domain, opened_store.domain, domain_file)
            evidence = stored_evidence(opened_store, domain, name, m, prior_weight)
            return evidence, dict(opened_store.roles)
    except ValueError as error:
        raise click.UsageError(str(error)) from error


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
