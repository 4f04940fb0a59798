"""The sparse MDP that solvers read.

A *row* is a state together with an action that applies in it. Rows of one state are neighbours, and
so are the transitions of one row. States at which an episode ends (goals, dead ends, the sink) have
no rows. With n states, r rows and t transitions::

    state_row       int64[n + 1]    rows of state s: state_row[s] <= row < state_row[s + 1]
    row_action      int32[r]        which ground action a row is, by its index
    row_reward      float64[r]      what a row pays on average: state, outcome and arrival, less cost
    row_transition  int64[r + 1]    transitions of a row, likewise
    next_state      int32[t]
    probability     float64[t]      of one row they sum to 1; an entry may be 0, and two entries of
                                    a row may lead to the same state
    goal            bool[n]         where the goal holds
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


@dataclass(frozen=True, slots=True, eq=False)
class MDP:
    """A Markov decision process; see the module for the shapes and their meaning.

    ``discount`` is between 0 and 1; ``horizon`` is the number of steps after which an episode ends,
    or None. ``has_goal`` says that the problem names a goal (though no state may satisfy it).
    """

    state_row: Ints
    row_action: SmallInts
    row_reward: Floats
    row_transition: Ints
    next_state: SmallInts
    probability: Floats
    goal: Bools
    initial: int = 0
    discount: float = 1.0
    horizon: int | None = None
    has_goal: bool = False

    @property
    def states(self) -> int:
        """How many states there are."""
        return len(self.state_row) - 1

    @property
    def rows(self) -> int:
        """How many pairs of a state and an action that applies in it."""
        return len(self.row_action)

    @property
    def transitions(self) -> int:
        """How many entries of rows."""
        return len(self.next_state)

    @property
    def row_state(self) -> SmallInts:
        """The state of each row (int32[r]); made anew each time it is asked for."""
        return np.repeat(np.arange(self.states, dtype=np.int32), np.diff(self.state_row))

    def arrays(self) -> tuple[NDArray[Any], ...]:
        """The arrays in the order of the module's table."""
        return (
            self.state_row, self.row_action, self.row_reward, self.row_transition,
            self.next_state, self.probability, self.goal,
        )  # fmt: skip
