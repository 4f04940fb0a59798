"""Finite horizons: backward induction, exact up to rounding (Bellman 1957).

value[k + 1][s] = max over rows r of s: reward[r] + discount * sum of p * value[k][next].
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from menid_plan.mdp.model import MDP, Bools, Floats
from menid_plan.solving import Objective, Solution, StepPolicy
from menid_solvers.bounds import ROUNDING, Limits
from menid_solvers.graph import lowest_rows
from menid_solvers.horizon_kernels import step_back


def solve_horizon(
    mdp: MDP, rows: Bools, objective: Objective, epsilon: float, limits: Limits, policy_bytes: int
) -> Solution:
    """The best value of ``mdp.horizon`` steps by the given rows (bool[r]), and a policy by steps.

    Stops early where one more step changes nothing. The policy of every number of steps is kept if
    that takes at most policy_bytes, else only that of the first step.
    """
    horizon = mdp.horizon
    assert horizon is not None
    n = mdp.states
    goal = mdp.goal.astype(np.float64)
    sign = -1.0 if objective == "steps" else 1.0
    discount = 1.0 if objective in ("steps", "goal-probability") else mdp.discount
    reward = mdp.row_reward
    value = np.zeros(n)
    if objective == "steps":
        reward = np.full(mdp.rows, -1.0)
        value = np.where(mdp.goal, 0.0, -np.inf)
    elif objective == "goal-probability":
        reward, value = np.zeros(mdp.rows), goal.copy()
    most_rows = int(np.max(np.diff(mdp.state_row), initial=0))
    kind = next(t for t in (np.uint8, np.uint16, np.uint32) if most_rows < np.iinfo(t).max)
    none = np.iinfo(kind).max
    keep = True
    kept: list[np.ndarray] = []
    reached, best_reached = goal.copy(), goal.copy()
    policy = np.full(n, -1, np.int32)
    longest = int(np.max(np.diff(mdp.row_transition), initial=0))
    size = float(np.max(np.abs(reward[rows]), initial=0.0))
    error = once = 0.0
    done = 0
    settled = False
    try:
        while done < horizon and not settled and not limits.reached:
            after = (np.empty(n), np.empty(n), np.empty(n))
            settled = step_back(
                *mdp.graph, rows, reward, discount, objective == "goal-then-reward", value, reached,
                best_reached, *after, policy,
            )  # fmt: skip
            value, reached, best_reached = after
            done += 1
            limits.iterations += 1
            largest = float(np.max(np.abs(value[np.isfinite(value)]), initial=0.0))
            once = ROUNDING * (longest + 4) * (largest + size)
            error = error * discount + once
            keep = done * n * kind().itemsize <= policy_bytes
            if not keep:
                kept.clear()
            else:
                offset = np.where(policy < 0, none, policy - mdp.state_row[:-1])
                kept.append(offset.astype(kind))
            if limits.progress is not None:
                limits.progress(limits.iterations, -np.inf, np.inf)
    except KeyboardInterrupt:
        limits.interrupted = True
    complete = done == horizon or settled
    if settled and done < horizon:
        # Each step that was spared may have changed the values by less than what is rounded off.
        left = float(horizon - done)
        if discount < 1.0:
            left = min(left, 1.0 / (1.0 - discount))
        if error + once * left > 0.25 * epsilon:  # it is seldom worth the search
            left = min(left, _longest_run(mdp, rows, done + 1000))
        error += once * left
    lower, upper = _bounds(value, reward[rows], discount, error, 0 if complete else horizon - done)
    if objective == "goal-probability":
        # What is reached within fewer steps is reached; 0 stays exact.
        lower, upper = np.clip(lower, 0.0, 1.0), np.clip(upper, 0.0, 1.0)
        if complete:
            upper[value == 0.0] = 0.0
    if objective == "steps":
        lower, upper = -upper, -lower
        if not complete:
            lower, upper = np.where(mdp.goal, 0.0, 1.0), np.where(mdp.goal, 0.0, np.inf)
    if objective == "goal-then-reward" and not complete:
        lower, upper = np.full(n, -np.inf), np.full(n, np.inf)
    policy[~rows_of_states(mdp, rows)] = -1
    stepwise = None
    if keep and complete and kept:
        stepwise = StepPolicy(mdp.state_row, np.stack(kept[::-1]), horizon)
    solution = Solution(
        status="solved",
        objective=objective,
        initial=mdp.initial,
        lower=lower,
        upper=upper,
        policy=policy,
        iterations=limits.iterations,
        seconds=limits.seconds,
        goal_probability=reached if mdp.has_goal else None,
        steps=stepwise,
    )
    first = mdp.initial
    if not complete:
        return replace(solution, status="limit", message=limits.reason)
    if objective == "steps" and sign * value[first] == np.inf:
        message = f"no policy surely reaches the goal within {horizon} steps"
        return replace(solution, status="infeasible", message=message)
    if upper[first] - lower[first] > epsilon:
        return replace(solution, status="limit", message="double precision cannot do better")
    if not keep:
        message = (
            "the policy is that of the first step; those of the others would take too much room"
        )
        return replace(solution, message=message)
    return solution


def _longest_run(mdp: MDP, rows: Bools, most: int) -> float:
    """The largest expected number of steps until nothing goes on; inf if so many do not tell."""
    value, zero = np.zeros(mdp.states), np.zeros(mdp.states)
    policy = np.empty(mdp.states, np.int32)
    ones = np.ones(mdp.rows)
    for _ in range(most):
        after = np.empty(mdp.states)
        settled = step_back(
            *mdp.graph, rows, ones, 1.0,
            False, value, zero, zero, after, np.empty(mdp.states), np.empty(mdp.states), policy,
        )  # fmt: skip
        if settled:
            return float(value.max(initial=0.0)) + 1.0
        value = after
    return np.inf


def rows_of_states(mdp: MDP, rows: Bools) -> Bools:
    """Which states (bool[n]) have a row that counts."""
    return np.asarray(lowest_rows(mdp, rows) >= 0)


def _bounds(
    value: Floats, rewards: Floats, discount: float, error: float, left: int
) -> tuple[Floats, Floats]:
    """Bounds from the values of the last steps, with so many first steps not looked at."""
    if left == 0:
        with np.errstate(invalid="ignore"):
            exact = np.isinf(value)
        return np.where(exact, value, value - error), np.where(exact, value, value + error)
    paid = left if discount == 1.0 else (1.0 - discount**left) / (1.0 - discount)
    least = min(0.0, float(np.min(rewards, initial=0.0)) * paid)
    most = max(0.0, float(np.max(rewards, initial=0.0)) * paid)
    down = least + min(0.0, float(value.min())) - error
    up = most + max(0.0, float(value.max())) + error
    return np.full(len(value), down), np.full(len(value), up)
