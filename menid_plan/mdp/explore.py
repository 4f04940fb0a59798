"""The reachable states of a ground problem, and the MDP over them.

The *structure* (states, rows, where each outcome leads) is built once; the probabilities are filled in
from any array with one number for each slot, as often as they change.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from menid_plan.grounding.ground import GroundProblem, ground
from menid_plan.grounding.semantics import Noise
from menid_plan.grounding.state import SINK, GroundAction, NextState
from menid_plan.mdp import kernel
from menid_plan.mdp.model import MDP, Bools, Floats, Ints, SmallInts
from menid_plan.mdp.search import Progress, Search, of_length
from menid_plan.memory import demand
from menid_plan.model.domain import Domain, Problem

MAX_STATES = 50_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Structure:
    """Reachable states and where each outcome leads; shapes as in `menid_plan.mdp.model`.

    ``words`` (uint64[n, W]) are the packed states; a row's kind (``row_rule``, int32[r]) is its
    ground rule, and ``kind_slot`` (int32[q]) the slots of a kind's probabilities. ``sink`` is the
    number of the sink, -1 if no step falls into it; it is the last state, its words are 0 and mean
    nothing.
    """

    problem: GroundProblem
    words: NDArray[np.uint64]
    state_row: Ints
    row_rule: SmallInts
    row_transition: SmallInts
    next_state: SmallInts
    kind_first: Ints
    kind_slot: SmallInts
    goal: Bools
    state_reward: Floats
    sink: int
    seconds: float

    @property
    def states(self) -> int:
        """How many states were reached, the sink included."""
        return len(self.state_row) - 1

    @property
    def dead_end(self) -> Bools:
        """Where nothing applies and no goal holds, and the sink."""
        found: Bools = (np.diff(self.state_row) == 0) & ~self.goal
        return found

    def slot(self, transitions: Ints) -> SmallInts:
        """The slots of transitions (int64, any shape), by their numbers."""
        rows = np.searchsorted(self.row_transition, transitions, side="right") - 1
        first = self.kind_first[self.row_rule[rows]] - self.row_transition[rows]
        slots: SmallInts = self.kind_slot[first + transitions]
        return slots

    def action(self, row: int) -> GroundAction:
        """The ground action of a row."""
        return self.problem.actions[int(self.problem.tables.rule_action[self.row_rule[row]])]

    def state(self, number: int) -> NextState:
        """A state by its number, as a set of atoms."""
        return SINK if number == self.sink else self.problem.unpack(self.words[number])

    def fill(self, probabilities: Floats) -> MDP:
        """The MDP with these probabilities (float64, one for each slot; they are not checked)."""
        problem = self.problem
        arrival = np.where(self.goal, problem.goal_reward, 0.0)
        arrival[self.dead_end] += problem.dead_end_reward
        rows = len(self.row_rule)
        demand(8.0 * rows, f"what {rows} rows pay")
        row_reward = np.empty(rows)
        action = problem.tables.rule_action
        probability = np.asarray(probabilities, np.float64)[self.kind_slot]
        graph = (
            self.state_row, self.row_transition, self.next_state, self.row_rule, self.kind_first,
            probability,
        )  # fmt: skip
        kernel.pay(
            *graph, problem.slot_reward[self.kind_slot], problem.action_cost[action], arrival,
            self.state_reward, row_reward,
        )  # fmt: skip
        task = problem.problem
        return MDP(
            self.state_row, self.row_rule, row_reward, self.row_transition, self.next_state,
            self.kind_first, probability, action, self.goal, 0,
            1.0 if task.discount is None else task.discount, task.horizon, task.goal is not None,
        )  # fmt: skip


def explore(
    problem: GroundProblem,
    happens: NDArray[np.uint8] | None = None,
    *,
    noise: Noise = "stay",
    max_states: int = MAX_STATES,
    progress: Progress | None = None,
) -> Structure:
    """Every state that can be reached from the initial one, breadth first.

    ``happens`` (uint8, one for each slot) says which outcomes to follow: 0 never, 1 yes, 2 nobody
    knows, which is an error where its rule covers; by default all are followed. Raises MeaningError
    where two rules cover or probabilities are missing, LimitError past ``max_states``.
    """
    start = time.perf_counter()
    if happens is None:
        happens = np.ones(problem.slots, np.uint8)
    search = Search(problem, happens, noise == "sink", max_states)
    search.run(progress)
    return _structure(search, time.perf_counter() - start)


def warm() -> None:
    """Load the compiled search, so that it is not part of what the first problem takes."""
    explore(ground(Domain("none"), Problem("none", "none")))


def _structure(search: Search, seconds: float) -> Structure:
    states, rows, transitions = search.found, search.rows, search.transitions
    next_state = search.next_state[:transitions]
    falls = next_state == kernel.SINK_STATE
    sink = states if falls.any() else -1
    next_state[falls] = states
    total = states + (sink >= 0)
    state_row = of_length(search.state_row, total + 1)
    state_row[states:] = rows
    words, goal = of_length(search.words, total), of_length(search.goal, total)
    reward = of_length(search.reward, total)
    words[states:], goal[states:], reward[states:] = 0, False, 0.0
    tables = search.problem.tables
    outcome_first = tables.rule[:, 1].astype(np.int64)
    before = np.repeat(tables.rule[:-1, 2] - outcome_first[:-1], np.diff(outcome_first))
    slots = (before + np.arange(tables.outcomes)).astype(np.int32)
    follows = search.follow[slots] != kernel.NEVER
    kind_first = np.concatenate(([0], np.cumsum(follows)))[outcome_first]
    return Structure(
        search.problem, words, state_row, search.row_rule[:rows],
        search.row_transition[: rows + 1], next_state, kind_first, slots[follows],
        goal, reward, sink, seconds,
    )  # fmt: skip
