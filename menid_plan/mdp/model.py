"""The sparse MDP that solvers read.

A *row* is a state together with an action that applies in it. Rows of one state are neighbours, and
so are the transitions of one row. States at which an episode ends (goals, dead ends, the sink) have
no rows. A *kind* of rows has one action and one distribution, as all rows of a ground rule do; few
kinds make millions of rows, so that probabilities are written down for kinds. With n states, r rows,
t transitions and k kinds, which have q probabilities in all::

    state_row         int64[n + 1]   rows of state s: state_row[s] <= row < state_row[s + 1]
    row_kind          int32[r]       the kind of a row
    row_reward        float64[r]     what a row pays on average: state, outcome and arrival, less cost
    row_transition    int32[r + 1]   transitions of a row, as many as its kind has probabilities
    next_state        int32[t]       where each leads; two of a row may lead to the same state
    kind_first        int64[k + 1]   probabilities of a kind, likewise
    kind_probability  float64[q]     of one kind they sum to 1; an entry may be 0
    kind_action       int32[k]       which ground action a kind is, by its index
    goal              bool[n]        where the goal holds

The i-th transition of row has the probability ``kind_probability[kind_first[row_kind[row]] + i]``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Ints: TypeAlias = NDArray[np.int64]
SmallInts: TypeAlias = NDArray[np.int32]
Floats: TypeAlias = NDArray[np.float64]
Bools: TypeAlias = NDArray[np.bool_]
# Indices that cannot be negative cost compiled code no test; so do loops over uint64.
Naturals: TypeAlias = NDArray[np.uint32]
Graph: TypeAlias = tuple[Ints, SmallInts, SmallInts, SmallInts, Ints, Floats]


@dataclass(frozen=True, slots=True, eq=False)
class MDP:
    """A Markov decision process; see the module for the shapes and their meaning.

    ``discount`` is between 0 and 1; ``horizon`` is the number of steps after which an episode ends,
    or None. ``has_goal`` says that the problem names a goal (though no state may satisfy it).
    """

    state_row: Ints
    row_kind: SmallInts
    row_reward: Floats
    row_transition: SmallInts
    next_state: SmallInts
    kind_first: Ints
    kind_probability: Floats
    kind_action: SmallInts
    goal: Bools
    initial: int = 0
    discount: float = 1.0
    horizon: int | None = None
    has_goal: bool = False

    @classmethod
    def of_rows(
        cls,
        state_row: Ints,
        row_action: SmallInts,
        row_reward: Floats,
        row_transition: SmallInts,
        next_state: SmallInts,
        probability: Floats,
        goal: Bools,
        **more: Any,
    ) -> MDP:
        """An MDP in which each row is a kind of its own; ``probability`` is a float64[t]."""
        kinds = np.arange(len(row_action), dtype=np.int32)
        first = row_transition.astype(np.int64)
        return cls(
            state_row, kinds, row_reward, row_transition.astype(np.int32), next_state, first,
            probability, row_action, goal, **more,
        )  # fmt: skip

    @property
    def states(self) -> int:
        """How many states there are."""
        return len(self.state_row) - 1

    @property
    def rows(self) -> int:
        """How many pairs of a state and an action that applies in it."""
        return len(self.row_kind)

    @property
    def transitions(self) -> int:
        """How many entries of rows."""
        return len(self.next_state)

    @property
    def row_action(self) -> SmallInts:
        """Which ground action each row is (int32[r]); made anew each time it is asked for."""
        return self.kind_action[self.row_kind]

    @property
    def probability(self) -> Floats:
        """Of each transition (float64[t]); made anew each time it is asked for."""
        shift = self.to_probability(np.arange(self.rows))
        at = np.repeat(shift, np.diff(self.row_transition)) + np.arange(self.transitions)
        chances: Floats = self.kind_probability[at]
        return chances

    def to_probability(self, rows: Ints) -> Ints:
        """What to add to a transition's number to have that of its probability, for some rows."""
        shift: Ints = self.kind_first[self.row_kind[rows]] - self.row_transition[rows]
        return shift

    def row_probabilities(self, row: int) -> Floats:
        """Of the transitions of one row, in their order."""
        kind = self.row_kind[row]
        return self.kind_probability[self.kind_first[kind] : self.kind_first[kind + 1]]

    @property
    def graph(self) -> Graph:
        """The arrays that say which state leads where, as the compiled kernels take them."""
        return (
            self.state_row, self.row_transition, self.next_state, self.row_kind, self.kind_first,
            self.kind_probability,
        )  # fmt: skip

    @property
    def row_state(self) -> SmallInts:
        """The state of each row (int32[r]); made anew each time it is asked for."""
        return np.repeat(np.arange(self.states, dtype=np.int32), np.diff(self.state_row))

    def rows_of(self, states: Bools) -> Bools:
        """Which rows (bool[r]) are of some states (bool[n])."""
        return np.repeat(states, np.diff(self.state_row))
