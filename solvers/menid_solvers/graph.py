"""Questions about the graph of an MDP: what can be reached, surely or perhaps; end components.

An *end component* is a set of states and rows that can be kept to forever (de Alfaro 1997). They
are where the Bellman equations lose their unique solution, so the solvers treat them apart.

Most graphs answer within a few sweeps over their states, in the order in which they were found and
back. Only for the others are lists of predecessors made, which take time linear in the transitions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from menid_plan.mdp.model import MDP, Bools, Ints, SmallInts
from menid_plan.memory import demand
from menid_solvers import graph_kernels as kernels

SWEEPS = 4


@dataclass(frozen=True, eq=False)
class Graph:
    """The graph of an MDP's rows (bool[r])."""

    mdp: MDP
    rows: Bools

    @cached_property
    def row_state(self) -> SmallInts:
        """The state of each row (int32[r])."""
        return self.mdp.row_state

    @cached_property
    def predecessors(self) -> tuple[Ints, SmallInts]:
        """Which rows lead to a state: row[first[s] : first[s + 1]] (int64[n + 1], int32[t])."""
        mdp = self.mdp
        demand(4.0 * mdp.transitions, f"the predecessors of {mdp.states} states")
        first = np.empty(mdp.states + 1, np.int64)
        row = np.empty(mdp.transitions, np.int32)
        kernels.predecessors(*mdp.graph, self.rows, first, row)
        return first, row

    def reaching(self, rows: Bools, targets: Bools) -> Bools:
        """The states (bool[n]) from which targets can be reached by some choice of the rows."""
        found = targets.copy()
        if bool(found.any()) and not kernels.sweep_reach(*self.mdp.graph, rows, SWEEPS, found):
            queue = np.empty(self.mdp.states, np.int32)
            kernels.reach(*self.predecessors, self.row_state, rows, found, queue)
        return found

    def without(self, rows: Bools, gone: Bools) -> None:
        """Take out, in place, rows that may lead to gone states and states left without rows."""
        if not bool(gone.any()) or kernels.sweep_attract(*self.mdp.graph, rows, SWEEPS, gone):
            return
        n = self.mdp.states
        kernels.attract_rows(
            self.mdp.state_row, *self.predecessors, self.row_state, rows, gone,
            np.empty(n, np.int64), np.empty(n, np.int32),
        )  # fmt: skip

    def steer(self, rows: Bools, target: Bools, policy: SmallInts) -> None:
        """Set the policy so that the targets come nearer: the lowest row with a nearer next state.

        Only states from which the rows that count lead to a target are changed, and no target is.
        """
        mdp = self.mdp
        kernels.steer(
            *mdp.graph, *self.predecessors, self.row_state, rows, target, policy,
            np.empty(mdp.states, np.int32), np.empty(mdp.states, np.int32),
        )  # fmt: skip


def components(mdp: MDP, rows: Bools) -> tuple[int, SmallInts]:
    """How many strongly connected components, and each state's; edges lead to no higher number."""
    component = np.empty(mdp.states, np.int32)
    graph = (*mdp.graph, rows)
    room = np.empty((3, mdp.states), np.int32)
    found = kernels.one_component(*graph, SWEEPS, component, room)
    if found == 0:
        places = np.empty((2, mdp.states), np.int64)
        every = bool(rows.all()) and bool(np.all(mdp.kind_probability > 0.0))
        found = kernels.strong_components(*graph, every, component, room, places)
    return found, component


def lowest_rows(mdp: MDP, rows: Bools) -> SmallInts:
    """The lowest row that counts (bool[r]) of each state, -1 if there is none (int32[n])."""
    policy = np.empty(mdp.states, np.int32)
    kernels.lowest_rows(mdp.state_row, rows, policy)
    return policy


def sure_reach(graph: Graph, rows: Bools, targets: Bools) -> tuple[Bools, Bools, Bools]:
    """The states from which some policy reaches the targets with probability 1, and its rows.

    The third answer are those from which they can be reached at all. Rows (bool[r]) are those that
    never leave these states. Repeats: what cannot reach the targets goes, and so does every row that
    may lead there (de Alfaro 1997, the nested fixpoint).
    """
    rows = rows & graph.mdp.rows_of(~targets)
    gone = np.zeros(graph.mdp.states, np.bool_)
    possible: Bools | None = None
    while True:
        found = graph.reaching(rows, targets)
        possible = found if possible is None else possible
        if bool(np.all(found | gone)):
            return found, rows, possible
        gone = ~found
        graph.without(rows, gone)


def end_components(graph: Graph, rows: Bools) -> tuple[SmallInts, Bools]:
    """The maximal end components made of the given rows.

    Returns each state's component (int32[n], -1 for none) and the rows inside (bool[r]).
    """
    mdp = graph.mdp
    rows = rows.copy()
    # Whatever may lead out of the states that can be stayed in belongs to none.
    graph.without(rows, lowest_rows(mdp, rows) < 0)
    gone = np.empty(mdp.states, np.bool_)
    while bool(rows.any()):
        _, component = components(mdp, rows)
        taken = kernels.rows_that_leave(*mdp.graph, rows, component, gone)
        if taken == 0:
            break
        graph.without(rows, gone)
    else:
        return np.full(mdp.states, -1, np.int32), rows
    component[lowest_rows(mdp, rows) < 0] = -1
    return component, rows
