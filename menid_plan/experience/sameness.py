"""Whether two domains, or two problems, are the same, and if not, where they differ first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

from menid_plan.model.domain import Domain, Problem


def difference(own: Domain | Problem, given: Domain | Problem) -> str:
    """What differs first, in words, comments and layout aside; empty if nothing does."""
    own, given = without_comments(own), without_comments(given)
    if own == given:
        return ""
    if isinstance(own, Domain) and isinstance(given, Domain):
        return _first(_all_of(own), _all_of(given)) or "the order of the declarations is another"
    assert isinstance(own, Problem)
    assert isinstance(given, Problem)
    return _first(_task(own), _task(given)) or "the order of the declarations is another"


def difference_for_experiences(own: Domain, given: Domain) -> str:
    """What differs first of all that gives an experience its meaning; empty if nothing does.

    That are the types, predicates, actions, rules and the effects of outcomes. Probabilities, counts,
    rewards, costs, the values of params and the roles of environments are not looked at, and there may
    be more environments.
    """
    ours, theirs = _meaning(without_comments(own)), _meaning(without_comments(given))
    for name in [e.name for e in own.all_environments]:
        ours[f"environment `{name}`"] = ""
    for name in [e.name for e in given.all_environments]:
        if f"environment `{name}`" in ours:
            theirs[f"environment `{name}`"] = ""
    return _first(ours, theirs)


def without_comments(value: Any) -> Any:
    """A domain, a problem or a part of one, less its comments."""
    if type(value) is tuple:
        return tuple(map(without_comments, value))
    if not is_dataclass(value) or not hasattr(value, "doc"):
        return value
    parts: dict[str, Any] = {
        f.name: without_comments(getattr(value, f.name)) for f in fields(value)
    }
    return replace(value, **{**parts, "doc": ""})  # type: ignore[type-var]


def _first(ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> str:
    for name, value in ours.items():
        if name not in theirs:
            return f"{name} is in the store's only"
        if theirs[name] != value:
            return f"{name} differs"
    return next((f"{name} is not in the store's" for name in theirs if name not in ours), "")


def _named(kind: str, values: tuple[Any, ...]) -> dict[str, Any]:
    return {f"{kind} `{value.name}`": value for value in values}


def _all_of(domain: Domain) -> dict[str, Any]:
    """All that a domain declares, each under the words for it."""
    return {
        "the name": domain.name,
        **_named("type", domain.types),
        **_named("constant", domain.constants),
        **_named("param", domain.params),
        **_named("environment", domain.environments),
        **_named("predicate", domain.predicates),
        **_named("derived predicate", domain.derived),
        "a reward of states": domain.rewards,
        **{f"action `{a.name}`": (a.parameters, a.cost) for a in domain.actions},
        **{f"rule `{a.name}.{r.name}`": r for a in domain.actions for r in a.rules},
    }


def _meaning(domain: Domain) -> dict[str, Any]:
    """The same of what gives experiences their meaning."""
    return {
        "the name": domain.name,
        **_named("type", domain.types),
        **_named("constant", domain.constants),
        **dict.fromkeys(_named("param", domain.params)),
        **_named("predicate", domain.predicates),
        **_named("derived predicate", domain.derived),
        **{f"action `{a.name}`": a.parameters for a in domain.actions},
        **{
            f"rule `{a.name}.{r.name}`": (
                r.per, r.references, r.condition, r.otherwise,
                [(outcome.name, outcome.effects) for outcome in r.outcomes],
            )
            for a in domain.actions
            for r in a.rules
        },
    }  # fmt: skip


def _task(problem: Problem) -> dict[str, Any]:
    return {
        "the name": problem.name,
        "the name of the domain": problem.domain,
        **_named("param", problem.params),
        **_named("object", problem.objects),
        **{f"`{atom}` in `init`": "" for atom in problem.init},
        "the goal": (problem.goal, problem.goal_reward),
        "the horizon": problem.horizon,
        "the discount": problem.discount,
        "the reward of dead ends": problem.dead_end_reward,
    }
