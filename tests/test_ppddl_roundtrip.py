"""One model: a problem, and its PPDDL read back, have the same transitions, state by state."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, assume, given, settings

import menid_plan
from menid_plan.errors import LimitError, MeaningError
from menid_plan.exchange.flat import NotExpressibleError
from menid_plan.exchange.grounded import grounded
from menid_plan.exchange.lifted import lifted
from menid_plan.exchange.ppddl import Written, ppddl
from menid_plan.exchange.ppddl_states import ppddl_states
from menid_plan.grounding.semantics import Noise
from menid_plan.grounding.state import SINK, GroundAction, NextState
from menid_plan.language.write import write
from menid_plan.model.domain import Domain, Problem
from menid_plan.model.expressions import evaluate
from menid_plan.model.formulas import GroundAtom
from menid_plan.planning import Task
from menid_plan.ppddl.menid import menid
from menid_plan.ppddl.read import read
from menid_plan.ppddl.tables import TooLargeError
from menid_plan.source import SourceFile
from strategies import domains_with_problems
from transitions import PROBLEMS, Transitions, assert_same, documents, transitions

FORMS = ("lifted", "grounded", "states")
# The blocks' `above` is recursive, and what is paid for a dead end no action can know.
CANNOT = {("blocks", "lifted"), ("rescue", "lifted"), ("rescue", "grounded")}
# For which there are too many states to be compared, or to be written one by one.
LARGE = ("plant", "house", "long-bench", "triangle-3", "tidy-up", "tower")


def written(task: Task, form: str) -> Written:
    if form == "states":
        return ppddl_states(task.domain, task.problem, task.structure, task.mdp)
    make = lifted if form == "lifted" else grounded
    return ppddl(make(task.domain, task.problem, task.environment, task.params, task.noise))


def read_back(problem: Problem, texts: Written) -> Transitions:
    """The transitions of what was written, by the names that it had before."""
    found = read(
        [SourceFile("domain.pddl", texts.domain), SourceFile("problem.pddl", texts.problem)]
    )
    assert not found.diagnostics, [d.message for d in found.diagnostics]
    assert found.domain is not None
    assert found.problem is not None
    domain, made, called = menid(found.domain, found.problem)
    domain_again = menid_plan.parse(write(domain)).domain
    again = menid_plan.parse(write(made), domain_again).problem
    assert domain_again is not None
    assert again is not None
    task = Task(
        domain_again, replace(again, discount=problem.discount, horizon=problem.horizon),
        max_states=20_000,
    )  # fmt: skip
    task.build()
    old = {new.lower(): name for name, new in texts.predicates.items()}
    predicates = {
        after.name: old.get(before.name, before.name)
        for before, after in zip(found.domain.predicates, domain.predicates, strict=True)
    }
    names = {called[new.lower()]: name for name, new in texts.objects.items()}
    actions = {
        after.name: texts.calls[before.name]
        for before, after in zip(found.domain.actions, domain.actions, strict=True)
    }

    def state_of(state: NextState) -> NextState:
        assert state is not SINK
        if texts.sunk and any(predicates[atom.predicate] == texts.sunk for atom in state):
            return SINK
        return frozenset(
            GroundAtom(predicates[p], tuple(names[name] for name in arguments))
            for p, arguments in state
        )

    def action_of(action: GroundAction) -> GroundAction:
        parameters, call = actions[action.action]
        return call.bound(
            dict(zip(parameters, (names[each] for each in action.arguments), strict=True))
        )

    return transitions(task, state_of, action_of)


def compare(domain: Domain, problem: Problem, form: str, noise: Noise, limit: int = 20_000) -> None:
    task = Task(domain, problem, noise=noise, max_states=limit)
    task.build()
    # Chances are rounded to six decimals, and rewards to as many as fit.
    assert_same(transitions(task), read_back(problem, written(task, form)), 2e-6, 2e-5)


@pytest.mark.parametrize("noise", ["stay", "sink"])
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    "path", [p for p in PROBLEMS if p.stem not in LARGE], ids=lambda p: f"{p.parent.name}/{p.stem}"
)
def test_shipped_problems(path: Path, form: str, noise: Noise) -> None:
    domain, problem = documents(path)
    if path.stem == "lake" and form != "lifted":
        pytest.skip("it has too many states")
    if (path.parent.name, form) in CANNOT:
        with pytest.raises(NotExpressibleError, match=r"\.menid:\d+:\d+: .*(recursive|dead ends)"):
            compare(domain, problem, form, noise)
        return
    compare(domain, problem, form, noise)


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(domains_with_problems())
def test_generated_problems(both: tuple[Domain, Problem]) -> None:
    domain, problem = both
    task = Task(domain, problem, max_states=60)
    try:
        task.build()
        rewards = [abs(float(r)) for r in task.mdp.row_reward]
        assume(max(rewards, default=0) < 50)
        assume(
            problem.goal_reward is None
            or abs(evaluate(problem.goal_reward, task.structure.problem.params)) < 50
        )
    except (MeaningError, LimitError):
        assume(False)
    for form in FORMS:
        try:
            texts = written(task, form)
            again = read_back(problem, texts)
        except (NotExpressibleError, MeaningError, LimitError, TooLargeError):
            continue
        assert_same(transitions(task), again, 2e-6, 1e-3)
