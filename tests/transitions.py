"""What two models of one problem do, state by state, to be compared."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from pathlib import Path

import pytest

from conftest import ROOT
from menid_plan.exchange.flat import Flat
from menid_plan.grounding.state import SINK, GroundAction, NextState, State
from menid_plan.language.files import check_files
from menid_plan.model.domain import Domain, Problem
from menid_plan.model.formulas import GroundAtom
from menid_plan.planning import Task

PROBLEMS = sorted(
    path for path in (ROOT / "domains").glob("*/*.menid") if path.name != "domain.menid"
)


def documents(path: Path) -> tuple[Domain, Problem]:
    results = check_files([str(path.with_name("domain.menid")), str(path)])
    domain = next(r.domain for r in results if r.domain is not None)
    problem = next(r.problem for r in results if r.problem is not None)
    return domain, problem


@dataclass
class Transitions:
    """For each state and action: the reward, and the probability of each state after it."""

    initial: Hashable
    states: set[Hashable]
    goals: set[Hashable]
    rows: dict[tuple[Hashable, GroundAction], tuple[float, dict[Hashable, float]]]


def transitions(
    task: Task,
    state_of: Callable[[NextState], Hashable] = lambda state: state,
    action_of: Callable[[GroundAction], GroundAction] = lambda action: action,
) -> Transitions:
    """The transitions of a task that was built, its states and actions called otherwise."""
    structure, mdp = task.structure, task.mdp
    names = [state_of(structure.state(number)) for number in range(mdp.states)]
    rows: dict[tuple[Hashable, GroundAction], tuple[float, dict[Hashable, float]]] = {}
    for state in range(mdp.states):
        for row in range(int(mdp.state_row[state]), int(mdp.state_row[state + 1])):
            span = slice(int(mdp.row_transition[row]), int(mdp.row_transition[row + 1]))
            after: dict[Hashable, float] = {}
            chances = mdp.row_probabilities(row).tolist()
            for number, chance in zip(mdp.next_state[span].tolist(), chances, strict=True):
                if chance > 0:
                    after[names[number]] = after.get(names[number], 0.0) + chance
            key = (names[state], action_of(structure.action(row)))
            assert key not in rows, f"two rows of {key}"
            rows[key] = (float(mdp.row_reward[row]), after)
    goals = {names[number] for number in range(mdp.states) if mdp.goal[number]}
    return Transitions(names[mdp.initial], set(names), goals, rows)


def of_flat(task: Task, flat: Flat) -> Transitions:
    """The transitions of a flat problem in terms of the one that it was made from."""
    parameters = {a.name: [v.name for v in a.parameters] for a in flat.domain.actions}

    def state_of(state: NextState) -> NextState:
        assert state is not SINK
        return SINK if flat.sunk and GroundAtom(flat.sunk) in state else state

    def action_of(action: GroundAction) -> GroundAction:
        objects = dict(zip(parameters[action.action], action.arguments, strict=True))
        return flat.calls[action.action].bound(objects)

    return transitions(task, state_of, action_of)


def assert_same(one: Transitions, other: Transitions, chance: float, reward: float) -> None:
    """Demand the same states, and the same transitions up to some differences of the numbers."""
    assert one.initial == other.initial
    assert one.states == other.states
    assert one.goals == other.goals
    assert one.rows.keys() == other.rows.keys()
    for key, (paid, after) in one.rows.items():
        paid_too, after_too = other.rows[key]
        assert paid == pytest.approx(paid_too, rel=1e-9, abs=reward), key
        assert after.keys() == after_too.keys(), key
        for state, probability in after.items():
            assert probability == pytest.approx(after_too[state], abs=chance), key


__all__ = ["PROBLEMS", "State", "Transitions", "assert_same", "documents", "of_flat", "transitions"]
