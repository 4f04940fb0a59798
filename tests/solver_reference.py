"""Small Markov decision processes, and their answers by brute force in exact fractions.

A process is written as a list over states of lists of rows ``(reward, [(probability, next), ...])``.
Every deterministic policy is evaluated exactly; the best is what the solvers are compared with.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import TypeAlias

import numpy as np

from menid_plan.mdp.model import MDP

Row: TypeAlias = "tuple[Fraction, list[tuple[Fraction, int]]]"
Process: TypeAlias = "list[list[Row]]"
Choice: TypeAlias = "Sequence[int | None]"
INF = float("inf")
ONE = Fraction(1)


class UndefinedError(Exception):
    """A policy whose total has no limit, or is the difference of two infinite sums."""


def build(
    process: Sequence[Sequence[tuple[float | Fraction, Sequence[tuple[float | Fraction, int]]]]],
    goal: Sequence[int] = (),
    *,
    initial: int = 0,
    discount: float = 1.0,
    horizon: int | None = None,
) -> MDP:
    """The arrays of a process."""
    rows = [row for state in process for row in state]
    goals = np.zeros(len(process), np.bool_)
    goals[list(goal)] = True
    return MDP.of_rows(
        state_row=np.cumsum([0, *(len(state) for state in process)]).astype(np.int64),
        row_action=np.array([a for state in process for a in range(len(state))], np.int32),
        row_reward=np.array([float(reward) for reward, _ in rows], np.float64),
        row_transition=np.cumsum([0, *(len(entries) for _, entries in rows)]).astype(np.int32),
        next_state=np.array([t for _, entries in rows for _, t in entries], np.int32),
        probability=np.array([float(p) for _, entries in rows for p, _ in entries], np.float64),
        goal=goals,
        initial=initial,
        discount=discount,
        horizon=horizon,
        has_goal=bool(goal),
    )


def walk(n: int, *, both_ends: bool = False, reward: float = -1.0) -> MDP:
    """A fair walk over n states in a row from the middle; the goal is the last one.

    The first one throws back, or, with both_ends, ends the walk without the goal.
    """
    process = [[(reward, [(0.5, max(s - 1, 0)), (0.5, s + 1)])] for s in range(n - 1)]
    if both_ends:
        process[0] = []
    return build([*process, []], [n - 1], initial=n // 2)


def gauss(matrix: list[list[Fraction]], right: list[Fraction]) -> list[Fraction]:
    """The solution of a linear system, exactly."""
    n = len(right)
    m = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    for i in range(n):
        pivot = next(j for j in range(i, n) if m[j][i] != 0)
        m[i], m[pivot] = m[pivot], m[i]
        m[i] = [x / m[i][i] for x in m[i]]
        for j in range(n):
            if j != i and m[j][i] != 0:
                m[j] = [x - m[j][i] * y for x, y in zip(m[j], m[i], strict=True)]
    return [m[i][n] for i in range(n)]


class Chain:
    """A process under one policy."""

    def __init__(self, process: Process, goal: Sequence[int], policy: Choice) -> None:
        n = len(process)
        self.n = n
        self.goal = set(goal)
        self.ended = {s for s in range(n) if s in self.goal or policy[s] is None}
        self.p: list[dict[int, Fraction]] = [{} for _ in range(n)]
        self.reward = [Fraction(0)] * n
        for s in set(range(n)) - self.ended:
            choice = policy[s]
            assert choice is not None
            self.reward[s], entries = process[s][choice]
            for p, t in entries:
                if p:
                    self.p[s][t] = self.p[s].get(t, Fraction(0)) + p
        self.reach = [self._reach(s) for s in range(n)]
        self.recurrent = [all(s in self.reach[t] for t in self.reach[s]) for s in range(n)]

    def _reach(self, s: int) -> set[int]:
        seen, stack = {s}, [s]
        while stack:
            for t in self.p[stack.pop()]:
                if t not in seen:
                    seen.add(t)
                    stack.append(t)
        return seen

    def _solve(self, unknown: list[int], constant: list[Fraction], known: dict[int, Fraction]):
        place = {s: i for i, s in enumerate(unknown)}
        matrix = [[Fraction(int(i == j)) for j in range(len(unknown))] for i in range(len(unknown))]
        for s in unknown:
            for t, p in self.p[s].items():
                if t in place:
                    matrix[place[s]][place[t]] -= p
                else:
                    constant[place[s]] += p * known.get(t, Fraction(0))
        return gauss(matrix, constant)

    def chance(self) -> list[Fraction]:
        """The probability of the goal."""
        unknown = [s for s in range(self.n) if self.reach[s] & self.goal and s not in self.goal]
        found = self._solve(unknown, [Fraction(0)] * len(unknown), dict.fromkeys(self.goal, ONE))
        values = dict(zip(unknown, found, strict=True)) | dict.fromkeys(self.goal, ONE)
        return [values.get(s, Fraction(0)) for s in range(self.n)]

    def discounted(self, discount: Fraction) -> list[Fraction]:
        """The discounted value."""
        matrix = [
            [
                Fraction(int(s == t)) - discount * self.p[s].get(t, Fraction(0))
                for t in range(self.n)
            ]
            for s in range(self.n)
        ]
        return gauss(matrix, list(self.reward))

    def _gain(self, members: list[int]) -> Fraction:
        m = len(members)
        matrix = [
            [self.p[t].get(s, Fraction(0)) - Fraction(int(s == t)) for t in members]
            for s in members
        ]
        matrix[-1] = [ONE] * m
        often = gauss(matrix, [Fraction(0)] * (m - 1) + [ONE])
        return sum((f * self.reward[s] for f, s in zip(often, members, strict=True)), Fraction(0))

    def total(self) -> list[Fraction | float]:
        """The value without discount."""
        endless: dict[int, float] = {}
        for s in range(self.n):
            members = sorted(self.reach[s])
            if self.recurrent[s] and any(self.reward[t] for t in members):
                gain = self._gain(members)
                if gain == 0:
                    raise UndefinedError
                endless[s] = INF if gain > 0 else -INF
        values: list[Fraction | float] = [Fraction(0)] * self.n
        unknown = []
        for s in range(self.n):
            ends = {endless[t] for t in self.reach[s] if t in endless}
            if len(ends) == 2:
                raise UndefinedError
            if ends:
                values[s] = ends.pop()
            elif not self.recurrent[s]:
                unknown.append(s)
        found = self._solve(unknown, [self.reward[s] for s in unknown], {})
        for s, value in zip(unknown, found, strict=True):
            values[s] = value
        return values

    def steps(self) -> list[Fraction | float]:
        """The expected number of steps to the goal, inf unless it is reached surely."""
        chance = self.chance()
        self.reward = [Fraction(int(s not in self.ended)) for s in range(self.n)]
        totals = self.total()
        return [totals[s] if chance[s] == 1 else INF for s in range(self.n)]


def value_of(
    process: Process, goal: Sequence[int], policy: Choice, objective: str, discount: Fraction
) -> Sequence[Fraction | float]:
    """What a policy is worth for an objective (not goal-then-reward)."""
    chain = Chain(process, goal, policy)
    if objective == "goal-probability":
        return chain.chance()
    if objective == "steps":
        return chain.steps()
    return chain.discounted(discount) if discount < 1 else chain.total()


def policies(process: Process, goal: Sequence[int]) -> Iterator[tuple[int | None, ...]]:
    """Every deterministic policy."""
    return itertools.product(
        *([None] if s in goal or not rows else range(len(rows)) for s, rows in enumerate(process))
    )


def best(
    process: Process, goal: Sequence[int], objective: str, discount: Fraction = ONE
) -> list[Fraction | float]:
    """The best value of every state; UndefinedError if some policy has none."""
    found = [value_of(process, goal, p, objective, discount) for p in policies(process, goal)]
    pick = min if objective == "steps" else max
    return [pick(values[s] for values in found) for s in range(len(process))]


def best_goal_then_reward(
    process: Process, goal: Sequence[int]
) -> tuple[list[Fraction], list[Fraction | float]]:
    """The highest probability and then the highest reward; UndefinedError if that is not finite."""
    chance = [Fraction(p) for p in best(process, goal, "goal-probability")]
    kept: Process = [
        [
            row
            for row in rows
            if chance[s] > 0 and sum(p * chance[t] for p, t in row[1]) == chance[s]
        ]
        for s, rows in enumerate(process)
    ]
    values: list[Fraction | float] = [-INF] * len(process)
    for policy in policies(kept, goal):
        chain = Chain(kept, goal, policy)
        reached = chain.chance()
        totals = chain.total()
        if INF in totals:
            raise UndefinedError
        for s in range(len(process)):
            if reached[s] == chance[s]:
                values[s] = max(values[s], totals[s])
    return chance, values


def choices(mdp: MDP, policy: Sequence[int]) -> list[int | None]:
    """A solver's policy as choices of a process."""
    return [None if row < 0 else int(row - mdp.state_row[s]) for s, row in enumerate(policy)]
