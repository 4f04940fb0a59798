"""Random small processes: the solvers against brute force over all policies in exact fractions."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from importlib.util import find_spec

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from menid_plan.mdp.model import MDP
from menid_plan.solving import Solution, UnsupportedError
from menid_solvers.policy_iteration import PolicyIteration
from menid_solvers.storm import Storm
from menid_solvers.value_iteration import ValueIteration
from solver_reference import (
    INF,
    ONE,
    Process,
    UndefinedError,
    best,
    best_goal_then_reward,
    build,
    choices,
    value_of,
)

REWARDS = ([0, 1, 2], [0, -1, -2], [0], [0, 0, -1, 1, -2, 2, -3])


@st.composite
def processes(draw: st.DrawFn) -> tuple[Process, list[int]]:
    """Up to five states with up to three rows; entries of probability 0, and repeated ones."""
    n = draw(st.integers(1, 5))
    rewards = draw(st.sampled_from(REWARDS))
    weights = st.lists(st.sampled_from([0, 1, 1, 2, 3]), min_size=1, max_size=3).filter(any)
    process: Process = []
    for _ in range(n):
        rows = []
        for _ in range(draw(st.sampled_from([0, 1, 1, 2, 2, 3]))):
            weight = draw(weights)
            entries = [(Fraction(w, sum(weight)), draw(st.integers(0, n - 1))) for w in weight]
            rows.append((Fraction(draw(st.sampled_from(rewards))), entries))
        process.append(rows)
    return process, draw(st.lists(st.integers(0, n - 1), max_size=2, unique=True))


def encloses(solution: Solution, state: int, value: float) -> bool:
    lower, upper = solution.lower[state], solution.upper[state]
    room = 1e-12 * abs(value) if abs(value) < INF else 0.0
    return bool(lower <= value + room and upper >= value - room)


OBJECTIVES = [
    ("reward", ONE),
    ("reward", Fraction(1, 2)),
    ("reward", Fraction(0)),
    ("goal-probability", ONE),
    ("steps", ONE),
]


@pytest.mark.parametrize(("objective", "discount"), OBJECTIVES)
@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.filter_too_much])
@given(processes())
def test_value_iteration_is_right(
    objective: str, discount: Fraction, drawn: tuple[Process, list[int]]
) -> None:
    process, goal = drawn
    mdp = build(process, goal, discount=float(discount))
    try:
        expected = best(process, goal, objective, discount)
    except UndefinedError:
        assume(False)
    solution = ValueIteration().solve(mdp, objective)  # type: ignore[arg-type]
    assert solution.status in ("solved", "unbounded", "infeasible"), solution.message
    assert (solution.status == "unbounded") == (objective == "reward" and expected[0] == INF)
    assert (solution.status == "infeasible") == (objective == "steps" and expected[0] == INF)
    attained = value_of(process, goal, choices(mdp, solution.policy), objective, discount)
    for s, value in enumerate(expected):
        assert encloses(solution, s, float(value))
        if abs(value) == INF:
            assert solution.lower[s] == solution.upper[s]
        else:
            assert solution.upper[s] - solution.lower[s] <= 1e-6
            assert abs(float(attained[s]) - float(value)) <= 1e-6
    for iterations in (1, 2, 5):
        early = ValueIteration(max_iterations=iterations).solve(mdp, objective)  # type: ignore[arg-type]
        assert all(encloses(early, s, float(value)) for s, value in enumerate(expected))
    again = ValueIteration().solve(mdp, objective)  # type: ignore[arg-type]
    for name in ("lower", "upper", "policy"):
        assert np.array_equal(getattr(again, name), getattr(solution, name))
    guess = np.linspace(-3, 3, mdp.states)
    warm = ValueIteration().solve(mdp, objective, start=guess)  # type: ignore[arg-type]
    assert warm.status == solution.status
    assert all(encloses(warm, s, float(value)) for s, value in enumerate(expected))


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.filter_too_much])
@given(processes())
def test_goal_then_reward_is_right(drawn: tuple[Process, list[int]]) -> None:
    process, goal = drawn
    assume(goal)
    mdp = build(process, goal)
    try:
        chance, expected = best_goal_then_reward(process, goal)
    except UndefinedError:
        assume(False)
    solution = ValueIteration().solve(mdp, "goal-then-reward")
    assert solution.goal_probability is not None
    reached = value_of(process, goal, choices(mdp, solution.policy), "goal-probability", ONE)
    for s, value in enumerate(expected):
        assert encloses(solution, s, float(value))
        assert solution.upper[s] - solution.lower[s] <= 1e-6
        assert abs(reached[s] - chance[s]) < 1e-8
        assert abs(solution.goal_probability[s] - chance[s]) < 1e-6


@pytest.mark.parametrize("objective", ["reward", "goal-probability", "goal-then-reward", "steps"])
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.filter_too_much])
@given(processes(), st.sampled_from([1.0, 0.9]))
def test_policy_iteration_agrees(
    objective: str, drawn: tuple[Process, list[int]], discount: float
) -> None:
    compare(PolicyIteration(), *drawn, objective, discount, None)


@pytest.mark.skipif(find_spec("stormpy") is None, reason="stormpy is not installed")
@pytest.mark.parametrize("objective", ["reward", "goal-probability", "goal-then-reward", "steps"])
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.filter_too_much])
@given(processes(), st.sampled_from([1.0, 0.9]), st.sampled_from([None, 0, 1, 4]))
def test_storm_agrees(
    objective: str, drawn: tuple[Process, list[int]], discount: float, horizon: int | None
) -> None:
    compare(Storm(), *drawn, objective, discount, horizon)


def compare(
    solver: PolicyIteration | Storm,
    process: Process,
    goal: list[int],
    objective: str,
    discount: float,
    horizon: int | None,
) -> None:
    """The bounds of two solvers overlap at the initial state, and they end alike."""
    mdp = build(process, goal, discount=discount, horizon=horizon)
    try:
        other = solver.solve(mdp, objective)  # type: ignore[arg-type]
    except UnsupportedError:
        assume(False)
    ours = ValueIteration().solve(mdp, objective)  # type: ignore[arg-type]
    if ours.status == "limit":
        assert "cancel" in ours.message or "apart" in ours.message
        return
    assert ours.status == other.status
    if np.isinf(ours.value):
        assert ours.value == other.value
    else:
        assert ours.lower[0] <= other.upper[0] + 1e-9
        assert ours.upper[0] >= other.lower[0] - 1e-9


def rolled_out(process: Process, goal: list[int], objective: str, horizon: int) -> list[Fraction]:
    """The best value of a finite horizon in fractions, by the recursion itself."""
    n = len(process)
    value = [Fraction(int(objective == "goal-probability" and s in goal)) for s in range(n)]
    for _ in range(horizon):
        value = [
            max(
                (objective == "reward") * reward + sum(p * value[t] for p, t in entries)
                for reward, entries in process[s]
            )
            if process[s] and s not in goal
            else value[s]
            for s in range(n)
        ]
    return value


@pytest.mark.parametrize("objective", ["reward", "goal-probability"])
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.filter_too_much])
@given(processes(), st.integers(0, 6))
def test_horizons(objective: str, drawn: tuple[Process, list[int]], horizon: int) -> None:
    process, goal = drawn
    mdp = build(process, goal, horizon=horizon)
    solution = ValueIteration().solve(mdp, objective)  # type: ignore[arg-type]
    expected = rolled_out(process, goal, objective, horizon)
    assert solution.status == "solved"
    assert all(encloses(solution, s, float(v)) for s, v in enumerate(expected))
    assert attained(mdp, solution, objective) == pytest.approx([float(v) for v in expected])
    for iterations in (0, 1, 2, 5):
        early = ValueIteration(max_iterations=iterations).solve(mdp, objective)  # type: ignore[arg-type]
        assert all(encloses(early, s, float(v)) for s, v in enumerate(expected))


def attained(mdp: MDP, solution: Solution, objective: str) -> list[float]:
    """What the policy by steps is worth, step by step."""
    assert mdp.horizon is not None
    value = mdp.goal * float(objective == "goal-probability")
    for left in range(1, mdp.horizon + 1):
        assert solution.steps is not None
        after = value.copy()
        for s in range(mdp.states):
            row = solution.steps.row(s, left)
            assert row == solution.steps.rows(left)[s]
            if row >= 0:
                part = slice(mdp.row_transition[row], mdp.row_transition[row + 1])
                after[s] = mdp.probability[part] @ value[mdp.next_state[part]]
                after[s] += mdp.row_reward[row] * (objective == "reward")
        value = after
    return list(value)


def test_replacing_keeps_the_arrays() -> None:
    mdp = build([[(1, [(1, 0)])]])
    assert replace(mdp, discount=0.5).next_state is mdp.next_state
