"""Stopping early, being interrupted, large and slow problems, progress, policies of horizons."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from menid_plan.mdp.model import MDP
from menid_plan.solving import StepPolicy
from menid_solvers import bounds
from menid_solvers.policy_iteration import PolicyIteration
from menid_solvers.value_iteration import ValueIteration
from solver_reference import build, walk


def grid(side: int, seed: int, *, pits: float = 0.0, discount: float = 1.0) -> MDP:
    """A slippery grid with a goal in the far corner; some cells are pits, where an episode ends."""
    rng = np.random.default_rng(seed)
    pit = rng.random(side * side) < pits
    pit[[0, -1]] = False
    moves = ((0, 1), (1, 0), (0, -1), (-1, 0))
    process = []
    for cell in range(side * side):
        y, x = divmod(cell, side)
        ahead = [
            min(max(y + dy, 0), side - 1) * side + min(max(x + dx, 0), side - 1) for dy, dx in moves
        ]
        rows = []
        for a in range(4):
            slip = 0.05 + 0.05 * rng.random()
            entries = [(1 - 3 * slip if a == b else slip, ahead[b]) for b in range(4)]
            rows.append((-1.0, entries))
        process.append([] if pit[cell] or cell == side * side - 1 else rows)
    return build(process, [side * side - 1], discount=discount)


@pytest.mark.parametrize("iterations", [1, 2, 5, 50])
@pytest.mark.parametrize("objective", ["reward", "goal-probability", "goal-then-reward", "steps"])
@pytest.mark.parametrize("both_ends", [False, True])
def test_bounds_are_true_when_stopped(both_ends: bool, objective: str, iterations: int) -> None:
    n = 301
    mdp = walk(n, both_ends=both_ends)
    solution = ValueIteration(max_iterations=iterations).solve(mdp, objective)  # type: ignore[arg-type]
    s = np.arange(n)
    duration = s * (n - 1 - s) if both_ends else (n - 1) * n - s * (s + 1)
    value = {
        "reward": -duration,
        "goal-then-reward": -duration,
        "goal-probability": s / (n - 1) if both_ends else np.ones(n),
        "steps": np.where(s == n - 1, 0, np.inf) if both_ends else duration,
    }[objective]
    if both_ends and objective == "goal-then-reward":
        value = value.astype(float)
        value[0] = 0
    assert np.all(solution.lower <= value + 1e-9)
    assert np.all(solution.upper >= value - 1e-9)
    if solution.status == "limit":
        assert "iterations" in solution.message


@pytest.mark.parametrize("iterations", [1, 2, 5, 20])
def test_discounted_bounds_narrow(iterations: int) -> None:
    mdp = replace(walk(301), discount=0.9)
    solution = ValueIteration(max_iterations=iterations).solve(mdp, "reward")
    exact = PolicyIteration().solve(mdp, "reward")
    assert solution.status == "limit"
    assert np.all(solution.lower <= exact.upper)
    assert np.all(solution.upper >= exact.lower)
    width = solution.upper[mdp.initial] - solution.lower[mdp.initial]
    assert width <= 10.001
    if iterations == 20:
        assert width < 5.0


def test_chance_from_below_is_shown_when_stopped() -> None:
    mdp = grid(12, 1, pits=0.05)
    exact = PolicyIteration().solve(mdp, "goal-probability")
    early = ValueIteration(max_iterations=8).solve(mdp, "goal-probability")
    assert early.status == "limit"
    assert np.all(early.lower <= exact.upper)
    assert np.all(early.upper >= exact.lower)
    assert early.lower[0] > 0.1


@pytest.mark.parametrize("objective", ["reward", "goal-probability", "goal-then-reward", "steps"])
@pytest.mark.parametrize("discount", [1.0, 0.95])
@pytest.mark.parametrize("pits", [0.0, 0.03])
@pytest.mark.parametrize("epsilon", [1e-2, 1e-6, 1e-9])
def test_slippery_grid(objective: str, discount: float, pits: float, epsilon: float) -> None:
    mdp = grid(20, 4, pits=pits, discount=discount)
    if objective == "goal-then-reward" and (discount < 1.0 or pits):
        pytest.skip("policy-iteration has no answer, or other ties in probability")
    solution = ValueIteration(epsilon=epsilon).solve(mdp, objective)  # type: ignore[arg-type]
    exact = PolicyIteration().solve(mdp, objective)  # type: ignore[arg-type]
    assert solution.status == exact.status
    finite = np.isfinite(exact.lower)
    assert np.array_equal(finite, np.isfinite(solution.lower))
    assert np.all(solution.lower[finite] <= exact.upper[finite] + 1e-10)
    assert np.all(solution.upper[finite] >= exact.lower[finite] - 1e-10)
    assert np.all(solution.upper[finite] - solution.lower[finite] <= epsilon)


def test_slow_walk_is_quick() -> None:
    n = 1001
    solution = ValueIteration().solve(walk(n, both_ends=True), "goal-probability")
    assert solution.status == "solved"
    assert solution.iterations < 1000  # sweeps alone would take a million
    assert np.all(np.abs(solution.lower - np.arange(n) / (n - 1)) <= 1e-6)


def test_time_limit_and_progress() -> None:
    seen = []
    mdp = grid(60, 2, pits=0.01)
    solution = ValueIteration(max_seconds=0.0).solve(mdp, "goal-probability")
    assert solution.status == "limit"
    assert "seconds" in solution.message
    assert (solution.lower[0], solution.upper[0]) == (0.0, 1.0)
    done = ValueIteration().solve(mdp, "goal-probability", progress=lambda *told: seen.append(told))
    assert done.status == "solved"
    assert seen
    assert seen[-1] == (done.iterations, done.lower[0], done.upper[0])


@pytest.mark.parametrize("horizon", [None, 10**6])
def test_interrupt_ends_with_true_bounds(
    monkeypatch: pytest.MonkeyPatch, horizon: int | None
) -> None:
    monkeypatch.setattr(bounds, "WORK", 1e4)
    calls = []

    def progress(iterations: int, lower: float, upper: float) -> None:
        calls.append(iterations)
        if len(calls) == 3:
            raise KeyboardInterrupt

    mdp = replace(grid(30, 2, pits=0.02), horizon=horizon)
    exact = PolicyIteration().solve(replace(mdp, horizon=None), "goal-probability")
    solution = ValueIteration().solve(mdp, "goal-probability", progress=progress)
    assert (solution.status, solution.message) == ("limit", "interrupted")
    assert np.all(solution.lower <= exact.upper)
    assert np.all(solution.upper >= exact.lower)
    rows = solution.policy
    assert np.all((rows >= mdp.state_row[:-1]) | (rows == -1))
    assert np.all(rows < mdp.state_row[1:])


def test_policies_of_a_horizon_are_small() -> None:
    mdp = replace(walk(50), horizon=30)
    solution = ValueIteration().solve(mdp, "reward")
    assert isinstance(solution.steps, StepPolicy)
    assert solution.steps.offsets.dtype == np.uint8
    assert solution.steps.offsets.shape == (30, 50)
    assert solution.steps.row(25, 0) == -1
    small = ValueIteration(policy_bytes=100).solve(mdp, "reward")
    assert (small.status, small.steps) == ("solved", None)
    assert "room" in small.message
    assert np.array_equal(small.policy, solution.policy)


def test_a_horizon_beyond_the_end_costs_nothing() -> None:
    mdp = build([[(1, [(1, 1)])], [(2, [(1, 2)])], []], [2], horizon=10**12)
    solution = ValueIteration().solve(mdp, "reward")
    assert (solution.status, solution.value, solution.iterations) == ("solved", 3, 3)
    assert solution.steps is not None
    assert solution.steps.row(0, 10**12) == 0
    assert solution.steps.row(1, 1) == 1


def test_many_blocks_share_the_precision() -> None:
    # 300 slow pairs in a row, each left by chance: the gap at the start is the sum of theirs.
    n = 300
    process = []
    for k in range(n):
        process.append([(-1.0, [(0.9, 2 * k + 1), (0.1, 2 * k + 2)])])
        process.append([(-1.0, [(0.9, 2 * k), (0.1, 2 * k + 2)])])
    solution = ValueIteration().solve(build([*process, []], [2 * n]), "reward")
    assert solution.status == "solved"
    assert solution.lower[0] <= -10 * n <= solution.upper[0]
    assert solution.upper[0] - solution.lower[0] <= 1e-6


def test_staying_that_costs_next_to_nothing() -> None:
    # A loop that costs 1e-9 a step, beside a way out that costs 1: leaving is forced.
    mdp = build([[(-1e-9, [(1, 1)]), (-1, [(1, 2)])], [(-1e-9, [(1, 0)])], []], [2])
    for objective in ("reward", "goal-then-reward"):
        solution = ValueIteration().solve(mdp, objective)  # type: ignore[arg-type]
        assert solution.status == "solved"
        assert solution.value == pytest.approx(-1)
        assert solution.policy.tolist() == [1, 2, -1]
