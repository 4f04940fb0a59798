"""Total reward without discount: what can be stayed in forever, and what that is worth.

Three kinds of maximal end components, by their *gain*, the best reward per step in them:

- above 0: the total grows without bound; whoever reaches one (and is not doomed) has no finite best.
- below 0: staying costs without end, so that every policy of finite value leaves.
- 0: staying may be free. Sub-components of rows that pay 0 are merged into one unknown, from which
  one may leave by any of their rows, or, where that is allowed, stay for 0.
  If the rewards only cancel (+1, then -1), a potential h >= reward + P h turns them into rewards
  ``reward + P h - h <= 0``, of which the same can be said (Ng, Harada and Russell 1999).

See de Alfaro 1997, Baier et al. 2017, Haddad and Monmege 2018.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from menid_plan.mdp.model import MDP, Bools, Floats, SmallInts
from menid_solvers import row_kernels as kernels
from menid_solvers.graph import Graph, end_components

SWEEPS = 20_000


@dataclass(frozen=True, slots=True, eq=False)
class Endings:
    """The end components of some rows, told apart.

    Over states (bool[n]): ``growing`` is in a component of positive gain, ``open`` in one whose
    gain's sign could not be told. ``merged`` (int32[n], -1 for none) and ``inside`` (bool[r]) are the
    free components; ``potential`` (float64[n]) is 0 but where rewards cancel, and ``reward``
    (float64[r]) has it worked in.
    """

    growing: Bools
    open: Bools
    merged: SmallInts
    inside: Bools
    potential: Floats
    reward: Floats


def tell_endings(mdp: MDP, graph: Graph, rows: Bools, reward: Floats) -> Endings:
    """Find and judge the end components made of rows (bool[r]) that pay reward (float64[r])."""
    n = mdp.states
    growing = np.zeros(n, np.bool_)
    unsure = np.zeros(n, np.bool_)
    potential = np.zeros(n)
    if not bool(np.any(rows & (reward >= 0.0))):  # what can be stayed in only costs
        nowhere = np.full(n, -1, np.int32)
        return Endings(growing, unsure, nowhere, np.zeros(mdp.rows, np.bool_), potential, reward)
    component, within = end_components(graph, rows)
    if bool(within.any()):
        of_row = component[graph.row_state[within]]
        number = int(component.max()) + 1
        pays = np.zeros(number, np.bool_)
        costs = np.zeros(number, np.bool_)
        pays[of_row[reward[within] > 0.0]] = True
        costs[of_row[reward[within] < 0.0]] = True
        in_one = component >= 0
        growing[in_one] = (pays & ~costs)[component[in_one]]
        for mixed in np.flatnonzero(pays & costs):
            members = np.flatnonzero(component == mixed).astype(np.int32)
            sign = _gain_sign(graph, within, reward, members, potential)
            growing[members] = sign == 1
            unsure[members] = sign is None
    else:
        return Endings(growing, unsure, component, within, potential, reward)
    if bool(potential.any()):
        expected = np.zeros(mdp.rows)
        kernels.expect(*mdp.graph, rows, potential, expected)
        reward = np.where(rows, reward + expected - potential[graph.row_state], reward)
    free = within & (reward == 0.0)
    if bool(free.any()):
        merged, inside = end_components(graph, free)
    else:
        merged, inside = np.full(n, -1, np.int32), free
    return Endings(growing, unsure, merged, inside, potential, reward)


def _gain_sign(
    on: Graph, within: Bools, reward: Floats, members: SmallInts, potential: Floats
) -> int | None:
    """1, 0 or -1; None if it cannot be told. Where it is 0, writes the members' potential."""
    mdp, row_state = on.mdp, on.row_state
    graph = (*mdp.graph, within, reward)
    of_members = within & np.isin(row_state, members)
    scale = float(np.max(np.abs(reward[of_members])))
    h = np.zeros(mdp.states)
    if kernels.potential(*graph, members, 2 * len(members) + 2, h):
        expected = np.zeros(mdp.rows)
        kernels.expect(*mdp.graph, of_members, h, expected)
        left = (reward + expected - h[row_state])[of_members]
        if bool(np.all((left == 0.0) | (left < -1e-9 * scale))):
            potential[members] = h[members]
            return 0 if bool(np.any(left == 0.0)) else -1
    x = np.zeros(mdp.states)
    least, most = kernels.gain(*graph, members, 1e-12 * scale, SWEEPS, x, np.empty(len(members)))
    margin = 1e-12 * scale + 1e-14 * float(np.max(np.abs(x)))
    if least > margin:
        return 1
    return -1 if most < -margin else None
