"""The search for reachable states: arrays that grow, stretches of states expanded side by side."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from hashlib import shake_256
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from menid_plan.errors import LimitError, MeaningError
from menid_plan.grounding.ground import GroundProblem
from menid_plan.grounding.state import binding_text, state_text
from menid_plan.mdp import kernel
from menid_plan.mdp.program import LANES, PLANES
from menid_plan.memory import demand

Progress = Callable[[int, int, int], None]
"""Called now and then with the states found, those expanded, and the transitions."""

STRETCH = 8192  # states that a thread expands before numbers are given
ROOM = 2**16  # states for which there is room from the start
TABLE = 2**15  # places for them in the table from the start
DIRECT = 22  # bits of a state up to which the table has a place for each that there could be
LARGE = 2**26  # bytes
MOST = 2**31 - 1  # transitions that can be numbered
WORTH = 4096  # states that wait to be expanded from which on several threads share the work


def threads() -> int:
    """How many threads search: one for each core that the process may use, up to eight."""
    if hasattr(os, "sched_getaffinity"):
        return min(8, len(os.sched_getaffinity(0)))
    return min(8, os.cpu_count() or 1)


class Search:
    """The arrays of a search, which grow as it goes on; see `menid_plan.mdp.explore`."""

    def __init__(
        self, problem: GroundProblem, happens: NDArray[np.uint8], to_sink: bool, max_states: int
    ) -> None:
        self.problem = problem
        noise = kernel.FALLS if to_sink else kernel.STAYS
        is_noise = problem.tables.slot_noise & (happens == kernel.HAPPENS)
        self.follow = np.where(is_noise, noise, happens).astype(np.uint8)
        self.max_states = max_states
        words = problem.tables.words
        self.expanded, self.found, self.rows, self.transitions = 0, 1, 0, 0
        # Numbers at random, but always the same; none if every state may have its own place.
        self.direct = words == 1 and problem.layout.bits <= DIRECT
        self.table = np.zeros(2**problem.layout.bits if self.direct else TABLE, np.int32)
        salt = b"" if self.direct else shake_256(b"states").digest(16 * words)
        self.salt = np.array(np.frombuffer(salt, np.uint64))
        # Memory that is not written to is not taken, so that there may be plenty from the start.
        self.words = np.empty((ROOM, words), np.uint64)
        self.words[0] = problem.initial
        self.state_row = np.empty(ROOM + 1, np.int64)
        self.goal = np.empty(ROOM, np.bool_)
        self.reward = np.empty(ROOM, np.float64)
        self.row_rule = np.empty(4 * ROOM, np.int32)
        self.row_transition = np.empty(4 * ROOM + 1, np.int32)
        self.next_state = np.empty(16 * ROOM, np.int32)
        self.state_row[0] = self.row_transition[0] = 0
        kernel.settle(self.table, self.words, 0, self.salt, self.words, 1, np.empty(1, np.int32))

    def run(self, progress: Progress | None) -> None:
        """Expand states until there are no more."""
        chunks = [_Chunk(self)]
        with ThreadPoolExecutor(max(1, threads() - 1)) as pool:
            while self.expanded < self.found:
                self._advance(chunks, pool)
                if self.found > self.max_states:
                    raise LimitError(
                        f"more than {self.max_states} states can be reached, the limit: "
                        f"{self.found} were found when they were counted, {self.expanded} of them "
                        f"expanded, with {self.transitions} transitions"
                    )
                if progress is not None:
                    progress(self.found, self.expanded, self.transitions)

    def _advance(self, chunks: list[_Chunk], pool: ThreadPoolExecutor) -> None:
        """Expand some states, alone or side by side."""
        waiting = self.found - self.expanded
        if threads() == 1 or waiting < WORTH:
            chunk = chunks[0]
            end = chunk.expand(self.expanded, self.expanded + STRETCH, alone=True)
            used, ends = [chunk], [end]
        else:
            chunks += [_Chunk(self) for _ in range(threads() - len(chunks))]
            todo = min(waiting, STRETCH * len(chunks))
            used = chunks
            bounds = (np.linspace(0, todo, len(used) + 1).astype(int) + self.expanded).tolist()
            spans = list(pairwise(bounds))
            running: list[Future[int]] = [
                pool.submit(chunk.expand, *span)
                for chunk, span in zip(used[1:], spans[1:], strict=True)
            ]
            ends = [used[0].expand(*spans[0]), *(future.result() for future in running)]
        for chunk, end in zip(used, ends, strict=True):
            if end == kernel.CONFLICT:
                raise self._conflict(*chunk.clash.tolist())
            if end == kernel.UNKNOWN:
                raise self._unknown(*chunk.clash.tolist())
            self._take(chunk)

    def _take(self, chunk: _Chunk) -> None:
        """Number what a chunk found and put it behind what was found before."""
        last, rows, transitions, fresh, _ = chunk.counts.tolist()
        states = last - chunk.first
        self.make_room(self.found + fresh, self.rows + rows, self.transitions + transitions)
        next_state = self.next_state[self.transitions : self.transitions + transitions]
        if fresh:
            number = np.empty(fresh, np.int32)
            self.found = kernel.settle(
                self.table, self.words, self.found, self.salt, chunk.new, fresh, number
            )
            kernel.put_numbers(transitions, chunk.next_state, number, next_state)
        else:
            next_state[:] = chunk.next_state[:transitions]
        self.row_rule[self.rows : self.rows + rows] = chunk.row_rule[:rows]
        ends = slice(self.rows + 1, self.rows + rows + 1)
        np.add(chunk.row_transition[1 : rows + 1], self.transitions, out=self.row_transition[ends])
        ends = slice(chunk.first + 1, last + 1)
        np.add(chunk.state_row[1 : states + 1], self.rows, out=self.state_row[ends])
        self.goal[chunk.first : last] = chunk.goal[:states]
        self.reward[chunk.first : last] = chunk.reward[:states]
        self.rows += rows
        self.transitions += transitions
        self.expanded = last

    def make_room(self, states: int, rows: int = 0, transitions: int = 0) -> None:
        """See to it that the arrays hold so many."""
        if transitions > MOST:
            raise LimitError(f"more than {MOST} transitions, the limit; {self._so_far}")
        self._grow(states, "words", "goal", "state_row", "reward")
        self._grow(rows, "row_rule", "row_transition")
        self._grow(transitions, "next_state")
        if 2 * states > len(self.table) and not self.direct:
            size = len(self.table)
            while 2 * states > size:
                size *= 2
            self.table = np.empty(0, np.int32)
            demand(4.0 * size, self._so_far)
            self.table = np.zeros(size, np.int32)
            kernel.rehash(self.table, self.words, self.found, self.salt)

    def _grow(self, needed: int, *names: str) -> None:
        """Make arrays twice as long, large ones by a third, or as needed, if there is memory."""
        arrays = [getattr(self, name) for name in names]
        before = len(arrays[0])
        if needed + 1 <= before:
            return
        more = max(needed + 1 - before, before if arrays[0].nbytes < LARGE else before // 3)
        demand(float(sum(more * a.itemsize * (a.size // len(a)) for a in arrays)), self._so_far)
        for array in arrays:  # in place, so that large ones need not be copied
            array.resize((len(array) + more, *array.shape[1:]), refcheck=False)

    @property
    def _so_far(self) -> str:
        return (
            f"so far {self.found} states were found, {self.expanded} of them expanded, "
            f"with {self.transitions} transitions"
        )

    def _rule_text(self, number: int) -> str:
        rule = self.problem.rules[number]
        binding = f" ({binding_text(rule.binding)})" if rule.binding else ""
        return f"`{rule.rule.name}`{binding}"

    def _state_text(self, state: int) -> str:
        return state_text(self.problem.unpack(self.words[state]))

    def _conflict(self, state: int, first: int, second: int) -> MeaningError:
        action = self.problem.rules[first].action
        return MeaningError(
            f"`{action}` is covered by rules {self._rule_text(first)} and "
            f"{self._rule_text(second)} in the state {self._state_text(state)}"
        )

    def _unknown(self, state: int, number: int, _: int) -> MeaningError:
        distribution = self.problem.distributions[self.problem.rule_distribution[number]]
        return MeaningError(
            f"rule {distribution} has no probabilities in this environment, and covers the state "
            f"{self._state_text(state)}: write a column for it, or learn one with `menid learn`"
        )


class _Chunk:
    """A stretch of states being expanded: what a thread finds, and its room to work in."""

    def __init__(self, search: Search) -> None:
        self.search = search
        tables = search.problem.tables
        most = max(tables.outcomes, tables.rules)  # of one state
        self.most = most
        rows, size = max(4 * STRETCH, 2 * most), max(16 * STRETCH, 2 * most)
        self.first = self.last = 0
        self.counts = np.zeros(5, np.int64)
        self.state_row = np.empty(STRETCH + 1, np.int64)
        self.goal = np.empty(STRETCH, np.bool_)
        self.reward = np.empty(STRETCH, np.float64)
        self.row_rule = np.empty(rows, np.int32)
        self.row_transition = np.empty(rows + 1, np.int32)
        self.next_state = np.empty(size, np.int32)
        self.new = np.empty((size, tables.words), np.uint64)
        self.clash = np.zeros(3, np.int64)
        words = tables.words
        sizes = (tables.extended_words, tables.rules // 64 + 1, words, words)
        self.room: list[Any] = [np.zeros(length, np.uint64) for length in sizes]
        self.room.append(np.zeros(max(tables.rules, len(tables.effect)) + 1, np.uint32))
        self.room += [np.empty((most + 1, words), np.uint64), np.empty(most, np.int64)]
        bits = 64 * tables.extended_words
        self.room += [np.zeros(length, np.uint64) for length in (bits, LANES, PLANES)]
        self.room.append(np.zeros((LANES, tables.extended_words), np.uint64))

    def expand(self, first: int, last: int, alone: bool = False) -> int:
        """Expand some states; says how it ended."""
        search = self.search
        self.first, self.last = first, last
        self.counts[:] = (first, 0, 0, 0, search.found)
        while True:
            end = self._call(WORTH if alone and threads() > 1 else 2**62 if alone else 0)
            if alone:
                search.found = int(self.counts[4])
            if end == kernel.NO_ROOM:
                search.make_room(search.found + self.most)
                continue
            if end != kernel.FULL:
                return end
            for name in ("row_rule", "row_transition", "next_state", "new"):
                array = getattr(self, name)
                demand(2.0 * array.nbytes, self.search._so_far)
                setattr(self, name, of_length(array, 2 * len(array)))

    def _call(self, alone: int) -> int:
        search = self.search
        t = search.problem.tables
        expand: Any = kernel.expand  # its parameters are too many to be told apart by their types
        return int(expand(
            t.words, t.entry, t.op, t.literal, t.segment, t.rule, t.rule_action,
            t.outcome_change, t.outcome_effects, t.effect, t.change, t.field,
            *t.rule_watch.arrays(), *t.effect_watch.arrays(),
            t.reward_entries, t.reward_value, t.goal_entries, search.follow,
            search.table, search.words, search.salt, self.first, self.last, alone,
            self.counts, self.state_row, self.goal, self.reward, self.row_rule,
            self.row_transition, self.next_state, self.new, self.clash, *self.room,
        ))  # fmt: skip


def of_length(array: Any, length: int) -> Any:
    """The beginning of an array, or a longer one that begins like it, with zeros behind."""
    if length <= len(array):
        return array[:length]
    new = np.zeros((length, *array.shape[1:]), array.dtype)
    new[: len(array)] = array
    return new
