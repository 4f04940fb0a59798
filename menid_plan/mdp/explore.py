"""The reachable states of a ground problem, and the MDP over them.

The *structure* (states, rows, where each outcome leads) is built once; the probabilities are filled in
from any array with one number for each slot, as often as they change.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from menid_plan.errors import LimitError, MeaningError
from menid_plan.grounding.ground import GroundProblem, ground
from menid_plan.grounding.semantics import Noise
from menid_plan.grounding.state import SINK, NextState, binding_text, state_text
from menid_plan.mdp import kernel
from menid_plan.mdp.model import MDP, Bools, Floats, Ints, SmallInts
from menid_plan.memory import demand
from menid_plan.model.domain import Domain, Problem

MAX_STATES = 50_000_000
_BATCH = 100_000

Progress = Callable[[int, int, int], None]
"""Called now and then with the states found, those expanded, and the transitions."""


@dataclass(frozen=True, slots=True, eq=False)
class Structure:
    """Reachable states and where each outcome leads; shapes as in `menid_plan.mdp.model`.

    ``words`` (uint64[n, W]) are the packed states, ``row_rule`` (int32[r]) the ground rule of each
    row and ``row_action`` (int32[r]) its ground action, ``slot`` (int32[t]) the slot of each
    transition's probability. ``sink`` is the number of the sink, -1 if no step falls into it; it is
    the last state, its words are 0 and mean nothing.
    """

    problem: GroundProblem
    words: NDArray[np.uint64]
    state_row: Ints
    row_rule: SmallInts
    row_action: SmallInts
    row_transition: Ints
    next_state: SmallInts
    slot: SmallInts
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

    def state(self, number: int) -> NextState:
        """A state by its number, as a set of atoms."""
        return SINK if number == self.sink else self.problem.unpack(self.words[number])

    def fill(self, probabilities: Floats) -> MDP:
        """The MDP with these probabilities (float64, one for each slot; they are not checked)."""
        problem = self.problem
        arrival = np.where(self.goal, problem.goal_reward, 0.0)
        arrival[self.dead_end] += problem.dead_end_reward
        transitions, rows = len(self.next_state), len(self.row_rule)
        demand(8.0 * (transitions + rows), f"the probabilities of {transitions} transitions")
        chances, row_reward = np.empty(transitions), np.empty(rows)
        kernel.fill(
            self.state_row, self.row_transition, self.next_state, self.slot,
            np.ascontiguousarray(probabilities), problem.slot_reward, arrival, self.state_reward,
            problem.action_cost, self.row_action, chances, row_reward,
        )  # fmt: skip
        task = problem.problem
        return MDP(
            self.state_row, self.row_action, row_reward, self.row_transition, self.next_state,
            chances, self.goal, 0, 1.0 if task.discount is None else task.discount, task.horizon,
            task.goal is not None,
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
    search = _Search(problem, happens, noise == "sink", max_states)
    search.run(progress)
    return search.structure(time.perf_counter() - start)


def warm() -> None:
    """Load the compiled search, so that it is not part of what the first problem takes."""
    explore(ground(Domain("none"), Problem("none", "none")))


class _Search:
    """The arrays of a search, which grow as it goes on."""

    def __init__(
        self, problem: GroundProblem, happens: NDArray[np.uint8], to_sink: bool, max_states: int
    ) -> None:
        self.problem = problem
        self.happens = happens
        self.to_sink = to_sink
        self.max_states = max_states
        words = problem.tables.words
        size = 1024
        tables = problem.tables
        self.most = max(len(tables.outcome_slot), len(tables.rule_action), 1)  # of one state
        self.counts = np.array([0, 1, 0, 0], np.int64)
        self.table = np.full(4 * size, -1, np.int32)
        self.words = np.zeros((size, words), np.uint64)
        self.words[0] = problem.initial
        self.state_row = np.zeros(size + 1, np.int64)
        self.goal = np.zeros(size, np.bool_)
        self.reward = np.zeros(size, np.float64)
        self.row_rule = np.zeros(size, np.int32)
        self.row_transition = np.zeros(size + 1, np.int64)
        self.next_state = np.zeros(4 * size, np.int32)
        self.slot = np.zeros(4 * size, np.int32)
        self.clash = np.zeros(3, np.int64)
        self.room = [
            np.zeros(size, np.uint64) for size in (problem.tables.extended_words, *[words] * 3)
        ]
        kernel.rehash(self.table, self.words, 1)

    def run(self, progress: Progress | None) -> None:
        while True:
            reason = self._call()
            if reason == kernel.DONE:
                return
            if reason == kernel.CONFLICT:
                raise self._conflict()
            if reason == kernel.UNKNOWN:
                raise self._unknown()
            if reason == kernel.LIMIT:
                raise LimitError(
                    f"more than {self.max_states} states can be reached, the limit; {self._so_far}"
                )
            if reason == kernel.STATES_FULL:
                self._grow("words", "goal", "state_row", "reward")
            elif reason == kernel.TABLE_FULL:
                size = 2 * len(self.table)
                self.table = np.empty(0, np.int32)
                demand(4.0 * size, self._so_far)
                self.table = np.full(size, -1, np.int32)
                kernel.rehash(self.table, self.words, int(self.counts[1]))
            elif reason == kernel.ROWS_FULL:
                self._grow("row_rule", "row_transition")
            elif reason == kernel.TRANSITIONS_FULL:
                self._grow("next_state", "slot")
            elif progress is not None:
                progress(int(self.counts[1]), int(self.counts[0]), int(self.counts[3]))

    @property
    def _so_far(self) -> str:
        done, found, _, transitions = self.counts.tolist()
        return (
            f"so far {found} states were found, {done} of them expanded, "
            f"with {transitions} transitions"
        )

    def _grow(self, *names: str) -> None:
        """Make arrays longer by half, if there is memory for them all."""
        arrays = [getattr(self, name) for name in names]
        demand(1.5 * sum(array.nbytes for array in arrays), self._so_far)
        for name, array in zip(names, arrays, strict=True):
            setattr(self, name, _of_length(array, len(array) + max(len(array) // 2, self.most)))

    def _call(self) -> int:
        t = self.problem.tables
        return kernel.explore(
            t.words, t.entry_word, t.entry_mask, t.entry_value, t.op_kind,
            t.op_number, t.op_entries, t.op_word, t.op_bit, t.segment_ops, t.segment_loops,
            t.rule_entries, t.rule_outcomes, t.rule_action, t.outcome_slot, t.outcome_noise,
            t.outcome_delete, t.outcome_add,
            t.outcome_effects, t.effect_entries, t.effect_changes, t.change_word, t.change_delete,
            t.change_add, t.reward_entries, t.reward_value, t.goal_entries,
            self.happens, self.to_sink, self.max_states,
            self.counts, self.table, self.words, self.state_row, self.goal, self.reward,
            self.row_rule, self.row_transition, self.next_state, self.slot, _BATCH, self.clash,
            *self.room,
        )  # fmt: skip

    def _rule_text(self, number: int) -> str:
        rule = self.problem.rules[number]
        binding = f" ({binding_text(rule.binding)})" if rule.binding else ""
        return f"`{rule.rule.name}`{binding}"

    def _state_text(self) -> str:
        return state_text(self.problem.unpack(self.words[int(self.clash[0])]))

    def _conflict(self) -> MeaningError:
        first, second = int(self.clash[1]), int(self.clash[2])
        action = self.problem.rules[first].action
        return MeaningError(
            f"`{action}` is covered by rules {self._rule_text(first)} and "
            f"{self._rule_text(second)} in the state {self._state_text()}"
        )

    def _unknown(self) -> MeaningError:
        number = int(self.clash[1])
        distribution = self.problem.distributions[self.problem.rule_distribution[number]]
        return MeaningError(
            f"rule {distribution} has no probabilities, and covers the state {self._state_text()}"
        )

    def structure(self, seconds: float) -> Structure:
        _, states, rows, transitions = (int(count) for count in self.counts)
        next_state = self.next_state[:transitions]
        falls = next_state == kernel.SINK_STATE
        sink = states if falls.any() else -1
        next_state[falls] = states
        total = states + (sink >= 0)
        state_row = _of_length(self.state_row, total + 1)
        state_row[states:] = rows
        row_rule = self.row_rule[:rows]
        return Structure(
            self.problem, _of_length(self.words, total), state_row, row_rule,
            self.problem.tables.rule_action[row_rule], self.row_transition[: rows + 1], next_state,
            self.slot[:transitions], _of_length(self.goal, total), _of_length(self.reward, total),
            sink, seconds,
        )  # fmt: skip


def _of_length(array: Any, length: int) -> Any:
    """The beginning of an array, or a longer one that begins like it, with zeros behind."""
    if length <= len(array):
        return array[:length]
    new = np.zeros((length, *array.shape[1:]), array.dtype)
    new[: len(array)] = array
    return new
