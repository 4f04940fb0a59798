"""A flat problem does what the problem does that it was made from, lifted or grounded."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, assume, given, settings

import menid_plan.exchange.grounded
import menid_plan.exchange.lifted
from menid_plan.errors import LimitError, MeaningError
from menid_plan.exchange.flat import Flat, NotExpressibleError
from menid_plan.exchange.grounded import grounded
from menid_plan.exchange.lifted import lifted
from menid_plan.grounding.semantics import Noise
from menid_plan.model.domain import Domain, Problem
from menid_plan.planning import Task
from strategies import domains_with_problems
from transitions import PROBLEMS, assert_same, documents, of_flat, transitions

SMALL = [
    path for path in PROBLEMS if path.stem not in ("plant", "house", "long-bench", "triangle-3")
]


def assert_flat(domain: Domain) -> None:
    assert not domain.derived
    assert not domain.params
    for action in domain.actions:
        assert len(action.rules) == 1
        assert not action.rules[0].references
        assert not action.rules[0].otherwise


def compare(domain: Domain, problem: Problem, flat: Flat, noise: Noise, limit: int) -> None:
    assert_flat(flat.domain)
    task = Task(domain, problem, noise=noise, max_states=limit)
    task.build()
    other = Task(flat.domain, flat.problem)
    other.build()
    assert_same(transitions(task), of_flat(other, flat), 1e-12, 1e-9)


@pytest.mark.parametrize("noise", ["stay", "sink"])
@pytest.mark.parametrize("path", SMALL, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_shipped_problems(path: Path, noise: Noise) -> None:
    domain, problem = documents(path)
    made = 0
    for make in (lifted, grounded):
        try:
            flat = make(domain, problem, noise=noise)
        except NotExpressibleError:
            continue  # the blocks' `above` is recursive
        made += 1
        if path.stem not in ("tower", "lake"):
            compare(domain, problem, flat, noise, 10_000)
    assert made or path.parent.name == "blocks"


def test_rules_that_keep_their_own_numbers() -> None:
    domain, problem = documents(next(p for p in PROBLEMS if p.stem == "drive"))
    flat = lifted(domain, problem, split=False)
    assert len(flat.domain.actions) == 6
    compare(domain, problem, flat, "stay", 100)


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give up early on formulas that grow large: to compare those takes minutes."""
    monkeypatch.setattr(menid_plan.exchange.lifted, "MAX_SIZE", 300)
    monkeypatch.setattr(menid_plan.exchange.lifted, "MAX_COUNTED", 4)
    monkeypatch.setattr(menid_plan.exchange.grounded, "MAX_SIZE", 20_000)
    monkeypatch.setattr(menid_plan.exchange.grounded, "MAX_FORMULA", 5_000)


@pytest.mark.usefixtures("brief")
@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(domains_with_problems())
def test_generated_problems(documents: tuple[Domain, Problem]) -> None:
    domain, problem = documents
    task = Task(domain, problem, max_states=300)
    try:
        task.build()
    except (MeaningError, LimitError):
        assume(False)
    for make in (lifted, grounded):
        try:
            flat = make(domain, problem)
            compare(domain, problem, flat, "stay", 300)
        except (NotExpressibleError, MeaningError, LimitError):
            continue  # too large, or without numbers for what is never reached
