"""Small kernels over the rows of an MDP: what a row expects, the gain of a component."""

from __future__ import annotations

import numpy as np

from menid_plan.compiled import kernel
from menid_plan.mdp.model import Bools, Floats, Ints, SmallInts


@kernel("void(i8[::1], i4[::1], i4[::1], i4[::1], i8[::1], f8[::1], b1[::1], f8[::1], f8[::1])")
def expect(
    state_row: Ints,  # noqa: ARG001 - all that reads the graph takes the same arrays
    row_transition: SmallInts,
    next_state: SmallInts,
    row_kind: SmallInts,
    kind_first: Ints,
    kind_probability: Floats,
    row_counts: Bools,
    x: Floats,
    expected: Floats,
) -> None:
    """expected[r] = sum of probability * x[next] over the row, as a mean; rows that count only."""
    for r in range(len(row_transition) - 1):
        if not row_counts[r]:
            continue
        total = 0.0
        value = 0.0
        begin, end = np.uint64(row_transition[r]), np.uint64(row_transition[r + 1])
        of_kind = np.uint64(kind_first[row_kind[r]]) - begin
        for e in range(begin, end):
            if kind_probability[of_kind + e] > 0.0:
                total += kind_probability[of_kind + e]
                value += kind_probability[of_kind + e] * x[next_state[e]]
        expected[r] = value / total


@kernel(
    "UniTuple(f8, 2)(i8[::1], i4[::1], i4[::1], i4[::1], i8[::1], f8[::1], b1[::1], f8[::1], i4[::1],"
    " f8, i8, f8[::1], f8[::1])"
)
def gain(
    state_row: Ints,
    row_transition: SmallInts,
    next_state: SmallInts,
    row_kind: SmallInts,
    kind_first: Ints,
    kind_probability: Floats,
    row_counts: Bools,
    reward: Floats,
    members: SmallInts,
    margin: float,
    sweeps: int,
    x: Floats,
    change: Floats,
) -> tuple[float, float]:
    """Bounds on the best reward per step within an end component, from damped value iteration.

    Ends once the sign is known by more than margin, or after the sweeps. For any x the best gain is
    between the least and the largest T(x) - x (Odoni 1969).
    """
    least = -np.inf
    most = np.inf
    for _ in range(sweeps):
        low = np.inf
        high = -np.inf
        for j in range(len(members)):
            s = members[j]
            best = -np.inf
            for r in range(state_row[s], state_row[s + 1]):
                if row_counts[r]:
                    value = reward[r]
                    begin, end = np.uint64(row_transition[r]), np.uint64(row_transition[r + 1])
                    of_kind = np.uint64(kind_first[row_kind[r]]) - begin
                    for e in range(begin, end):
                        value += kind_probability[of_kind + e] * x[next_state[e]]
                    best = max(best, value)
            change[j] = best - x[s]
            low = min(low, change[j])
            high = max(high, change[j])
        least = max(least, low)
        most = min(most, high)
        if least > margin or most < -margin:
            break
        base = change[0]
        for j in range(len(members)):
            x[members[j]] += 0.5 * (change[j] - base)
    return least, most


@kernel(
    "b1(i8[::1], i4[::1], i4[::1], i4[::1], i8[::1], f8[::1], b1[::1], f8[::1], i4[::1], i8, f8[::1])"
)
def potential(
    state_row: Ints,
    row_transition: SmallInts,
    next_state: SmallInts,
    row_kind: SmallInts,
    kind_first: Ints,
    kind_probability: Floats,
    row_counts: Bools,
    reward: Floats,
    members: SmallInts,
    sweeps: int,
    h: Floats,
) -> bool:
    """The least h >= 0 with h >= reward + P h on the rows of an end component, if it is exact.

    True if the sweeps ended in a fixed point to the last bit, as they do for whole rewards and
    certain outcomes.
    """
    for _ in range(sweeps):
        changed = False
        for j in range(len(members)):
            s = members[j]
            best = 0.0
            for r in range(state_row[s], state_row[s + 1]):
                if row_counts[r]:
                    value = reward[r]
                    begin, end = np.uint64(row_transition[r]), np.uint64(row_transition[r + 1])
                    of_kind = np.uint64(kind_first[row_kind[r]]) - begin
                    for e in range(begin, end):
                        value += kind_probability[of_kind + e] * h[next_state[e]]
                    best = max(best, value)
            if best != h[s]:
                h[s] = best
                changed = True
        if not changed:
            return True
    return False
