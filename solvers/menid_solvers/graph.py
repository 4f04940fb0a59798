"""Questions about the graph of an MDP: what can be reached, surely or perhaps; end components.

An *end component* is a set of states and rows that can be kept to forever (de Alfaro 1997). They
are where the Bellman equations lose their unique solution, so the solvers treat them apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from menid_plan.mdp.model import MDP, Bools, Floats, Ints, SmallInts
from menid_solvers import graph_kernels as kernels


@dataclass(frozen=True, slots=True, eq=False)
class Predecessors:
    """Which rows lead to a state: row[first[s] : first[s + 1]] (int32), and each row's state."""

    first: Ints
    row: SmallInts
    row_state: SmallInts

    @classmethod
    def of(cls, mdp: MDP, rows: Bools) -> Predecessors:
        """Of an MDP, by the rows (bool[r]) that count."""
        first = np.empty(mdp.states + 1, np.int64)
        row = np.empty(mdp.transitions, np.int32)
        row_state = np.empty(mdp.rows, np.int32)
        kernels.predecessors(*_graph(mdp, rows), first, row, row_state)
        return cls(first, row, row_state)

    def reaching(self, rows: Bools, targets: Bools) -> Bools:
        """The states (bool[n]) from which targets can be reached by some choice of the rows."""
        found = targets.copy()
        kernels.reach(
            self.first, self.row, self.row_state, rows, found, np.empty_like(found, np.int32)
        )
        return found

    def without(self, mdp: MDP, rows: Bools, gone: Bools) -> None:
        """Take out, in place, rows that may lead to gone states and states left without rows."""
        kernels.attract_rows(
            mdp.state_row, self.first, self.row, self.row_state, rows, gone,
            np.empty(mdp.states, np.int64), np.empty(mdp.states, np.int32),
        )  # fmt: skip


def components(mdp: MDP, rows: Bools) -> tuple[int, SmallInts]:
    """How many strongly connected components, and each state's; edges lead to no higher number."""
    component = np.empty(mdp.states, np.int32)
    room = np.empty((4, mdp.states), np.int32), np.empty((2, mdp.states), np.int64)
    return kernels.strong_components(*_graph(mdp, rows), component, *room), component


def sure_reach(mdp: MDP, back: Predecessors, rows: Bools, targets: Bools) -> tuple[Bools, Bools]:
    """The states from which some policy reaches the targets with probability 1, and its rows.

    Rows (bool[r]) are those that never leave these states. Repeats: what cannot reach the targets
    goes, and so does every row that may lead there (de Alfaro 1997, the nested fixpoint).
    """
    rows = rows & ~targets[back.row_state]
    gone = np.zeros(mdp.states, np.bool_)
    while True:
        found = back.reaching(rows, targets)
        if bool(np.all(found | gone)):
            return found, rows
        gone = ~found
        back.without(mdp, rows, gone)


def end_components(mdp: MDP, back: Predecessors, rows: Bools) -> tuple[SmallInts, Bools]:
    """The maximal end components made of the given rows.

    Returns each state's component (int32[n], -1 for none) and the rows inside (bool[r]).
    """
    rows = rows.copy()
    gone = np.empty(mdp.states, np.bool_)
    while True:
        _, component = components(mdp, rows)
        taken = kernels.rows_that_leave(*_graph(mdp, rows), component, gone)
        back.without(mdp, rows, gone)
        if taken == 0:
            break
    inside = np.zeros(mdp.states, np.bool_)
    inside[back.row_state[rows]] = True
    component[~inside] = -1
    return component, rows


def _graph(mdp: MDP, rows: Bools) -> tuple[Ints, Ints, SmallInts, Floats, Bools]:
    return mdp.state_row, mdp.row_transition, mdp.next_state, mdp.probability, rows
