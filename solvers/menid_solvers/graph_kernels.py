"""Kernels over the graph of an MDP: components, end components, and sure reachability.

All read the arrays of `menid_plan.mdp.model.MDP` and a mask of the rows that count; entries of
probability 0 are no edges.
"""

from __future__ import annotations

import numpy as np

from menid_plan.compiled import kernel
from menid_plan.mdp.model import Bools, Floats, Ints, SmallInts

_GRAPH = "i8[::1], i8[::1], i4[::1], f8[::1], b1[::1]"


@kernel(f"i8({_GRAPH}, i4[::1], i4[:, ::1], i8[:, ::1])")
def strong_components(
    state_row: Ints,
    row_transition: Ints,
    next_state: SmallInts,
    probability: Floats,
    row_counts: Bools,
    component: SmallInts,
    room: SmallInts,
    places: Ints,
) -> int:
    """Number the strongly connected components so that edges never lead to a higher number.

    Writes component (int32[n]) and returns how many there are. Tarjan 1972, without recursion;
    ``room`` (int32[4, n]) and ``places`` (int64[2, n]) are to work in.
    """
    n = len(state_row) - 1
    index, low, path, stack = room[0], room[1], room[2], room[3]
    row_at, entry_at = places[0], places[1]  # where the visit of a state goes on
    index[:] = 0  # order of discovery from 1; 0 is unseen
    component[:] = -1
    seen = 0
    found = 0
    height = 0
    for root in range(n):
        if index[root] != 0:
            continue
        depth = 0
        path[0] = root
        fresh = True
        while depth >= 0:
            s = path[depth]
            if fresh:
                seen += 1
                index[s] = seen
                low[s] = seen
                stack[height] = s
                height += 1
                row_at[s] = state_row[s]
                entry_at[s] = row_transition[state_row[s]]
                fresh = False
            r = row_at[s]
            e = entry_at[s]
            last = state_row[s + 1]
            child = -1
            while r < last:
                if row_counts[r]:
                    end = row_transition[r + 1]
                    while e < end:
                        t = next_state[e]
                        if probability[e] > 0.0:
                            if index[t] == 0:
                                child = t
                                break
                            if component[t] < 0 and index[t] < low[s]:
                                low[s] = index[t]
                        e += 1
                    if child >= 0:
                        break
                r += 1
                e = row_transition[r]
            if child >= 0:
                row_at[s] = r
                entry_at[s] = e + 1
                depth += 1
                path[depth] = child
                fresh = True
                continue
            if low[s] == index[s]:
                while True:
                    height -= 1
                    t = stack[height]
                    component[t] = found
                    if t == s:
                        break
                found += 1
            depth -= 1
            if depth >= 0:
                parent = path[depth]
                low[parent] = min(low[parent], low[s])
    return found


@kernel("void(i8[::1], i8[::1], i4[::1], f8[::1], b1[::1], i8[::1], i4[::1], i4[::1])")
def predecessors(
    state_row: Ints,
    row_transition: Ints,
    next_state: SmallInts,
    probability: Floats,
    row_counts: Bools,
    first: Ints,
    row: SmallInts,
    row_state: SmallInts,
) -> None:
    """Which rows lead to a state: row[first[s] : first[s + 1]], a row once for each entry.

    Writes first (int64[n + 1]), row (int32[t]) and the state of each row (int32[r]).
    """
    n = len(state_row) - 1
    first[:] = 0
    for s in range(n):
        for r in range(state_row[s], state_row[s + 1]):
            row_state[r] = s
            if row_counts[r]:
                for e in range(np.uint64(row_transition[r]), np.uint64(row_transition[r + 1])):
                    if probability[e] > 0.0:
                        first[next_state[e] + 1] += 1
    for s in range(n):
        first[s + 1] += first[s]
    for s in range(n):
        for r in range(state_row[s], state_row[s + 1]):
            if row_counts[r]:
                for e in range(np.uint64(row_transition[r]), np.uint64(row_transition[r + 1])):
                    if probability[e] > 0.0:
                        t = next_state[e]
                        row[first[t]] = r
                        first[t] += 1
    for s in range(n, 0, -1):
        first[s] = first[s - 1]
    first[0] = 0


@kernel("void(i8[::1], i8[::1], i4[::1], i4[::1], b1[::1], b1[::1], i8[::1], i4[::1])")
def attract_rows(
    state_row: Ints,
    first: Ints,
    row: SmallInts,
    row_state: SmallInts,
    row_counts: Bools,
    gone: Bools,
    left: Ints,
    queue: SmallInts,
) -> None:
    """Take out every row that may lead to a gone state, and every state left without a row.

    Changes row_counts and gone in place; a state that had no rows at all stays unless it is gone.
    """
    n = len(state_row) - 1
    left[:] = 0  # room of n, as queue
    for s in range(n):
        for r in range(state_row[s], state_row[s + 1]):
            if row_counts[r]:
                left[s] += 1
    tail = 0
    for s in range(n):
        if gone[s]:
            queue[tail] = s
            tail += 1
    head = 0
    while head < tail:
        t = queue[head]
        head += 1
        for k in range(first[t], first[t + 1]):
            r = row[k]
            if row_counts[r]:
                row_counts[r] = False
                s = row_state[r]
                left[s] -= 1
                if left[s] == 0 and not gone[s]:
                    gone[s] = True
                    queue[tail] = s
                    tail += 1


@kernel("void(i8[::1], i4[::1], i4[::1], b1[::1], b1[::1], i4[::1])")
def reach(
    first: Ints,
    row: SmallInts,
    row_state: SmallInts,
    row_counts: Bools,
    found: Bools,
    queue: SmallInts,
) -> None:
    """Add to found every state from which a found one can be reached by rows that count."""
    n = len(found)
    tail = 0
    for s in range(n):
        if found[s]:
            queue[tail] = s
            tail += 1
    head = 0
    while head < tail:
        t = queue[head]
        head += 1
        for k in range(first[t], first[t + 1]):
            r = row[k]
            s = row_state[r]
            if row_counts[r] and not found[s]:
                found[s] = True
                queue[tail] = s
                tail += 1


@kernel(f"i8({_GRAPH}, i4[::1], b1[::1])")
def rows_that_leave(
    state_row: Ints,
    row_transition: Ints,
    next_state: SmallInts,
    probability: Floats,
    row_counts: Bools,
    component: SmallInts,
    gone: Bools,
) -> int:
    """Take out the rows that may leave their component; gone: the states then without a row.

    Returns how many rows were taken out.
    """
    taken = 0
    for s in range(len(state_row) - 1):
        left = 0
        for r in range(state_row[s], state_row[s + 1]):
            if not row_counts[r]:
                continue
            for e in range(np.uint64(row_transition[r]), np.uint64(row_transition[r + 1])):
                if probability[e] > 0.0 and component[next_state[e]] != component[s]:
                    row_counts[r] = False
                    taken += 1
                    break
            if row_counts[r]:
                left += 1
        gone[s] = left == 0
    return taken
