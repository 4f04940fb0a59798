"""How far states are from the goal, counted in steps."""

from __future__ import annotations

import numpy as np

from menid_plan.mdp.model import MDP, Ints, SmallInts


def goal_distance(mdp: MDP) -> Ints:
    """The least number of steps in which the goal can be reached (int64[n]).

    Outcomes of probability 0 lead nowhere. Of a state from which it cannot be reached, the largest
    int64: more than any number of steps that are left.
    """
    distance = np.full(mdp.states, np.iinfo(np.int64).max)
    happens = np.flatnonzero(mdp.probability > 0.0)
    into = happens[np.argsort(mdp.next_state[happens], kind="stable")]
    first = np.searchsorted(mdp.next_state[into], np.arange(mdp.states + 1))
    rows = np.searchsorted(mdp.row_transition, into, side="right") - 1
    before = np.searchsorted(mdp.state_row, rows, side="right") - 1
    front = np.flatnonzero(mdp.goal)
    steps = 0
    while len(front):
        distance[front] = steps
        found = np.unique(before[spans(first, front)])
        front = found[distance[found] > steps]
        steps += 1
    return distance


def spans(first: Ints | SmallInts, items: Ints) -> Ints:
    """The numbers ``first[i]``, ..., ``first[i + 1] - 1`` of every item i, one after the other."""
    begin, end = first[items], first[items + 1]
    sizes = end - begin
    offsets = np.arange(int(sizes.sum())) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return np.asarray(np.repeat(begin, sizes) + offsets, np.int64)
