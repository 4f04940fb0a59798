"""Policies as values: what to do in every state that a policy reaches from the initial one.

`menid_plan.policy_file` writes and reads them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from menid_plan.errors import LimitError, MenidError
from menid_plan.grounding.semantics import Noise
from menid_plan.grounding.state import GroundAction, State
from menid_plan.mdp.distance import spans
from menid_plan.mdp.explore import Structure
from menid_plan.mdp.model import MDP, Ints
from menid_plan.simulation import Chooser, Simulator
from menid_plan.solving import Objective, Solution, Status


class PolicyError(MenidError):
    """A policy file is wrong, or is for another problem."""

    exit_code = 3


@dataclass(frozen=True, slots=True)
class Entry:
    """What to do in a state, given without the atoms that always hold.

    ``left`` are the least and the most steps left for which it is; None: for any number.
    """

    state: State
    action: GroundAction
    left: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True)
class Policy:
    """A policy, and for what it was made: everything that a policy file says.

    ``value`` is that of the initial state by the objective, NaN if it is not known.
    """

    domain: str
    problem: str
    environment: str
    params: Mapping[str, float] = field(hash=False)
    noise: Noise
    objective: Objective
    status: Status
    value: float
    lower: float
    upper: float
    horizon: int | None
    always: State
    entries: tuple[Entry, ...]
    _by_state: dict[State, list[Entry]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def action(self, state: State, left: int | None = None) -> GroundAction | None:
        """What to do in a state (with all its basic atoms); None if the policy does not say.

        ``left`` is the number of steps left, which a policy for a horizon must be told.
        """
        if not self._by_state:
            for entry in self.entries:
                self._by_state.setdefault(entry.state, []).append(entry)
        if not self.always <= state:
            return None
        for entry in self._by_state.get(state - self.always, ()):
            if entry.left is None:
                return entry.action
            if left is None:
                raise ValueError("this policy depends on the number of steps left")
            if entry.left[0] <= left <= entry.left[1]:
                return entry.action
        return None


@dataclass(frozen=True, slots=True, eq=False)
class Decisions:
    """The decisions of a policy that can be come to, by state; arrays of one length.

    ``state`` (int64), ``row`` (int64), and the ``least`` and ``most`` (int64) steps left; without a
    horizon both are 0.
    """

    state: Ints
    row: Ints
    least: Ints
    most: Ints


def decisions(mdp: MDP, solution: Solution) -> Decisions:
    """The decisions that a solution comes to from the initial state.

    Raises LimitError if the solver kept no policy for each number of steps left.
    """
    if solution.steps is None:
        if mdp.horizon and solution.status == "solved":
            reason = solution.message or "the solver gives none for the steps of a horizon"
            raise LimitError(f"there is no policy to write: {reason}")
        state = _closure(mdp, np.array([mdp.initial]), solution.policy)
        row = solution.policy[state].astype(np.int64)
        bound = mdp.horizon or 0
        return Decisions(
            state, row, np.full(len(row), min(1, bound)), np.full(len(row), bound)
        )  # fmt: skip
    return _stepwise(mdp, solution)


def _ended(mdp: MDP, states: Ints) -> Any:
    return mdp.goal[states] | (mdp.state_row[states] == mdp.state_row[states + 1])


def _successors(mdp: MDP, rows: Ints) -> Ints:
    """The states (int64, sorted) to which some rows may lead, less those where an episode ends."""
    entries = spans(mdp.row_transition, rows)
    widths = mdp.row_transition[rows + 1] - mdp.row_transition[rows]
    happens = mdp.kind_probability[entries + np.repeat(mdp.to_probability(rows), widths)] > 0.0
    found = np.unique(mdp.next_state[entries[happens]]).astype(np.int64)
    return np.asarray(found[~_ended(mdp, found)], np.int64)


def _closure(mdp: MDP, start: Ints, policy: Any) -> Ints:
    """The states with a row (int64, sorted) that are reached from some by a policy (int32[n])."""
    seen = np.zeros(mdp.states, np.bool_)
    front = start[~_ended(mdp, start)]
    while len(front):
        front = front[policy[front] >= 0]
        seen[front] = True
        front = _successors(mdp, policy[front].astype(np.int64))
        front = front[~seen[front]]
    return np.flatnonzero(seen)


def _stepwise(mdp: MDP, solution: Solution) -> Decisions:
    """Decisions by the steps left: a run for as long as a state's row stays the same."""
    steps = solution.steps
    assert steps is not None
    row = np.full(mdp.states, -1, np.int64)
    most = np.zeros(mdp.states, np.int64)
    least = np.zeros(mdp.states, np.int64)
    closed: list[tuple[Ints, Ints, Ints, Ints]] = []
    at = np.array([mdp.initial])
    at = at[~_ended(mdp, at)]
    for left in _numbers_left(steps.horizon, len(steps.offsets)):
        policy = steps.rows(left)
        if left > len(steps.offsets):
            # One row for each state from here down to the lines: where it is when does not matter.
            at = _closure(mdp, at, policy)
            row[at], most[at], least[at] = policy[at], left, len(steps.offsets)
            continue
        at = at[policy[at] >= 0]
        changed = at[row[at] != policy[at]]
        old = changed[row[changed] >= 0]
        closed.append((old, row[old], least[old], most[old]))
        row[changed], most[changed] = policy[changed], left
        least[at] = left
        at = _successors(mdp, row[at])
    rest = np.flatnonzero(row >= 0)
    closed.append((rest, row[rest], least[rest], most[rest]))
    state, rows, low, high = (np.concatenate(column) for column in zip(*closed, strict=True))
    order = np.lexsort((-high, state))
    return Decisions(state[order], rows[order], low[order], high[order])


def _numbers_left(horizon: int, lines: int) -> Iterator[int]:
    """The horizon if it is above the lines of a policy, and then these downwards."""
    if horizon > lines:
        yield horizon
    yield from range(min(horizon, lines), 0, -1)


def policy_of(
    structure: Structure,
    mdp: MDP,
    solution: Solution,
    environment: str,
    params: Mapping[str, float],
    noise: Noise,
) -> Policy:
    """The policy of a solution: the states that it reaches, in the order of their numbers."""
    problem = structure.problem
    found = decisions(mdp, solution)
    columns = (found.state, found.row, found.least, found.most)
    entries = []
    last, state = -1, frozenset[Any]()
    for number, row, least, most in zip(*(c.tolist() for c in columns), strict=True):
        if number != last:
            last, state = number, problem.unpack(structure.words[number]) - problem.always
        left = None if mdp.horizon is None else (least, most)
        entries.append(Entry(state, structure.action(int(row)), left))
    low, high = float(solution.lower[solution.initial]), float(solution.upper[solution.initial])
    return Policy(
        problem.domain.name, problem.problem.name, environment, dict(params), noise,
        solution.objective, solution.status, known_value(solution), low, high, mdp.horizon,
        problem.always, tuple(entries),
    )  # fmt: skip


def known_value(solution: Solution) -> float:
    """The value of the initial state; NaN while a bound is infinite and the other is not the same."""
    low, high = float(solution.lower[solution.initial]), float(solution.upper[solution.initial])
    return solution.value if low == high or math.isfinite(high - low) else math.nan


def file_chooser(policy: Policy, simulator: Simulator, name: str) -> Chooser:
    """Choose in a simulation as a policy says, which is looked up where episodes come.

    ``name`` is what messages call it. Raises PolicyError where an action does not apply, or where the
    policy says nothing.
    """
    return _Lookup(policy, simulator, name)


class _Lookup:
    """A policy's entries on the numbers of a structure: first by state, then by steps left."""

    def __init__(self, policy: Policy, simulator: Simulator, name: str) -> None:
        self.simulator = simulator
        self.name = name
        structure = simulator.structure
        problem, mdp = structure.problem, simulator.mdp
        self._actions = {action: number for number, action in enumerate(problem.actions)}
        self._entries: dict[bytes, list[tuple[int, Entry]]] = {}
        for number, entry in enumerate(policy.entries, start=1):
            words = problem.pack(entry.state | policy.always)
            if words is not None:  # else it cannot be reached
                self._entries.setdefault(words.tobytes(), []).append((number, entry))
        # Of a state: -2 not looked up yet, -1 nothing, else the place of its first range.
        self._first = np.full(mdp.states, -2, np.int64)
        self._count = np.zeros(mdp.states, np.int64)
        self._ranges = np.zeros((0, 3), np.int64)  # least, most, row

    def __call__(self, states: Ints, left: int | None) -> Ints:
        new = np.unique(states[self._first[states] == -2])
        if len(new):
            self._look_up(new)
        rows = np.full(len(states), -1, np.int64)
        place, ends = self._first[states], self._first[states] + self._count[states]
        open_ = np.flatnonzero(place >= 0)
        while len(open_):
            least, most, row = self._ranges[place[open_]].T
            fits = (
                np.ones(len(open_), np.bool_) if left is None else (least <= left) & (left <= most)
            )
            rows[open_[fits]] = row[fits]
            open_ = open_[~fits]
            place[open_] += 1
            open_ = open_[place[open_] < ends[open_]]
        silent = np.flatnonzero(rows < 0)
        if len(silent):
            number = int(states[silent[0]])
            raise PolicyError(self.simulator.silence(number, left, f"`{self.name}`"))
        return rows

    def _look_up(self, states: Ints) -> None:
        structure, mdp = self.simulator.structure, self.simulator.mdp
        found = []
        place = len(self._ranges)
        for state in states.tolist():
            known = self._entries.get(structure.words[state].tobytes(), [])
            self._first[state] = place if known else -1
            self._count[state] = len(known)
            for number, entry in known:
                begin, end = mdp.state_row[state], mdp.state_row[state + 1]
                action = self._actions.get(entry.action, -1)
                row = np.flatnonzero(mdp.kind_action[mdp.row_kind[begin:end]] == action)
                if len(row) == 0:
                    raise PolicyError(
                        f"`{self.name}`: entry {number}: `{entry.action}` does not apply in its state"
                    )
                least, most = entry.left or (0, np.iinfo(np.int64).max)
                found.append((least, most, int(begin + row[0])))
                place += 1
        self._ranges = np.concatenate((self._ranges, np.array(found, np.int64).reshape(-1, 3)))
