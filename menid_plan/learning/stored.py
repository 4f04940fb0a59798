"""What a store of experiences teaches: its counts, merged as the run that made it has them merged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from menid_plan.errors import MenidError
from menid_plan.experience.reading import StoreReader
from menid_plan.experience.rows import damaged
from menid_plan.learning.counts import Evidence
from menid_plan.learning.estimators import Estimator, estimator
from menid_plan.model.domain import Domain


def stored_evidence(
    store: StoreReader,
    domain: Domain | None = None,
    name: str | None = None,
    m: float | None = None,
    prior_weight: float | None = None,
) -> Evidence:
    """The evidence of a store, the target first, in a domain that suits it (None: its own).

    ``name``, ``m`` and ``prior_weight`` are the estimator's; None stands for those of the run, so that
    what comes is what the run learned. Raises ValueError or UnknownEstimatorError for a given estimator
    that there is not, StoreInputError for settings that no run writes.
    """
    settings = store.settings
    # A run may give environments other roles than the domain does.
    domain = domain or store.domain
    environments = tuple(
        replace(e, role="target" if store.roles.get(e.name) == "target" else "test")
        for e in domain.all_environments
    )
    domain = replace(domain, environments=environments)
    learn = _setting(store, settings, "learn", {})
    used = _setting(store, learn, "estimator", "decreasing-m")
    options = _setting(store, learn, "estimator_options", {}) if name in (None, used) else {}
    weight = prior_weight
    if weight is None:
        weight = float(_setting(store, learn, "prior_weight", 0.0))
    taken = _setting(store, settings, "environments", dict(store.roles))
    names = [each for each in in_order(store.roles) if each in taken]
    params = _setting(store, settings, "params", {})
    for param, value in params.items():
        if param not in {p.name for p in domain.params} or not isinstance(value, int | float):
            raise _bad_settings(store, f"params.{param}")
    try:
        made = estimator_with(name or used, m, options)
    except (ValueError, MenidError) as error:
        if name is not None or m is not None:
            raise
        raise _bad_settings(store, "learn", str(error)) from error
    evidence = Evidence(domain, store.problem, names, made, weight, params)
    for (environment, key), weights in store.counts().items():
        if environment not in evidence.environments:
            raise _bad_settings(store, "environments", f"it lacks `{environment}`")
        evidence.add(environment, key, weights)
    return evidence


def estimator_with(name: str, m: float | None, options: Mapping[str, Any]) -> Estimator:
    """An estimator with some options, and ``m`` among them if it is given; see `estimator`."""
    return estimator(name, **{**options, **({} if m is None else {"m": m})})


def in_order(roles: Mapping[str, str]) -> list[str]:
    """The environments, the target first."""
    return sorted(roles, key=lambda each: roles[each] != "target")


def _setting(store: StoreReader, table: Mapping[str, Any], key: str, default: Any) -> Any:
    """A setting that a store keeps, which must be such as a run would have there."""
    value = table.get(key, default)
    kind = (int, float) if isinstance(default, float) else type(default)
    if not isinstance(value, kind) or isinstance(value, bool):
        raise _bad_settings(store, key)
    return value


def _bad_settings(store: StoreReader, key: str, why: str = "") -> MenidError:
    return damaged(
        store.path, f"in its settings `{key}` is not what a run writes" + (why and f": {why}")
    )
