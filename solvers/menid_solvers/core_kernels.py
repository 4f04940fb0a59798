"""Kernels that build the equations which the sweeps iterate; see `menid_solvers.core`."""

from __future__ import annotations

import numpy as np

from menid_plan.compiled import kernel
from menid_plan.mdp.model import Bools, Floats, Ints, Naturals, SmallInts

SHORT = 8  # entries of a row among which a target is searched one by one


@kernel(
    "UniTuple(i8, 2)(i4[::1], i8, b1[::1], i4[::1], i4[::1], i4[::1], i8[::1], i8[::1],"
    " i8[::1], i4[::1], i4[::1])"
)
def number_unknowns(
    component: SmallInts,
    components: int,
    known: Bools,
    merged: SmallInts,
    unknown: SmallInts,
    member: SmallInts,
    member_first: Ints,
    block_first: Ints,
    start: Ints,
    listed: SmallInts,
    shared: SmallInts,
) -> tuple[int, int]:
    """Number the unknowns: components in order, within one the highest state first.

    States of one merged set (merged[s] >= 0) share an unknown. Writes the unknown of each state (-1
    where the value is known), the states of each unknown, and the first unknown of each block.
    Returns how many unknowns and blocks there are.
    """
    n = len(component)
    start[:] = 0  # room of components + 1, as listed and shared of n
    for s in range(n):
        if not known[s]:
            start[component[s] + 1] += 1
    for c in range(components):
        start[c + 1] += start[c]
    number = start[components]
    for s in range(n - 1, -1, -1):
        if not known[s]:
            listed[start[component[s]]] = s
            start[component[s]] += 1
    shared[:] = -1
    unknowns = 0
    blocks = 0
    current = -1
    unknown[:] = -1
    for k in range(number):
        s = listed[k]
        if component[s] != current:
            current = component[s]
            block_first[blocks] = unknowns
            blocks += 1
        m = merged[s]
        if m >= 0 and shared[m] >= 0:
            unknown[s] = shared[m]
            continue
        unknown[s] = unknowns
        if m >= 0:
            shared[m] = unknowns
        unknowns += 1
    block_first[blocks] = unknowns
    member_first[: unknowns + 1] = 0
    for k in range(number):
        member_first[unknown[listed[k]] + 1] += 1
    for u in range(unknowns):
        member_first[u + 1] += member_first[u]
    for k in range(number):
        u = unknown[listed[k]]
        member[member_first[u]] = listed[k]
        member_first[u] += 1
    for u in range(unknowns, 0, -1):
        member_first[u] = member_first[u - 1]
    member_first[0] = 0
    return unknowns, blocks


@kernel(
    "UniTuple(i8, 3)(i8[::1], i8[::1], i4[::1], f8[::1], b1[::1], f8[::1], f8[::1], f8,"
    " i4[::1], i4[::1], i8[::1], i8[::1], i8,"
    " i8[::1], i8[::1], i8[::1], f8[::1], f8[::1], u4[::1], f8[::1], i4[::1],"
    " i4[::1], i8[::1])"
)
def compile_rows(
    state_row: Ints,
    row_transition: Ints,
    next_state: SmallInts,
    probability: Floats,
    row_counts: Bools,
    reward: Floats,
    known_value: Floats,
    discount: float,
    unknown: SmallInts,
    member: SmallInts,
    member_first: Ints,
    block_first: Ints,
    blocks: int,
    first_row: Ints,
    first_entry: Ints,
    source: Ints,
    constant: Floats,
    leak: Floats,
    target: Naturals,
    weight: Floats,
    depth: SmallInts,
    block_of: SmallInts,
    place: Ints,
) -> tuple[int, int, int]:
    """Write the rows of every unknown: loops solved for, known values put in, doubles merged.

    depth[b] is the highest number of blocks of several unknowns on a way out of block b, itself
    included. Returns the numbers of rows and entries, and the most entries of a row.
    """
    unknowns = block_first[blocks]
    place[:] = -1  # of an entry in the row at hand; room of unknowns, as block_of
    rows = 0
    entries = 0
    longest = 0
    for b in range(blocks):
        deepest = 0
        for u in range(block_first[b], block_first[b + 1]):
            block_of[u] = b
        for u in range(block_first[b], block_first[b + 1]):
            first_row[u] = rows
            for m in range(member_first[u], member_first[u + 1]):
                s = member[m]
                for r in range(state_row[s], state_row[s + 1]):
                    if not row_counts[r]:
                        continue
                    begin = entries
                    stays = 0.0
                    ends = 0.0
                    moves = 0.0
                    gained = 0.0
                    last = row_transition[r + 1]
                    short = last - row_transition[r] <= SHORT
                    for e in range(np.uint64(row_transition[r]), np.uint64(last)):
                        p = probability[e]
                        if p <= 0.0:
                            continue
                        t = next_state[e]
                        v = unknown[t]
                        if v < 0:
                            ends += p
                            gained += p * known_value[t]
                        elif v == u:
                            stays += p
                        else:
                            moves += p
                            at = entries
                            if short:  # the row at hand is at hand, the places of all unknowns not
                                for k in range(begin, entries):
                                    if target[k] == v:
                                        at = k
                            elif place[v] >= begin:
                                at = place[v]
                            else:
                                place[v] = entries
                            if at < entries:
                                weight[at] += p
                            else:
                                target[entries] = v
                                weight[entries] = p
                                entries += 1
                    divisor = moves + ends + (1.0 - discount) * stays
                    if divisor <= 0.0:
                        continue  # it loops forever, and pays less than nothing
                    factor = discount / divisor
                    for e in range(begin, entries):
                        weight[e] *= factor
                    if blocks > 1:
                        for e in range(begin, entries):
                            other = block_of[target[e]]
                            if other != b:
                                deepest = max(deepest, depth[other])
                    total = moves + ends + stays
                    constant[rows] = (reward[r] * total + discount * gained) / divisor
                    leak[rows] = (discount * ends + (1.0 - discount) * total) / divisor
                    source[rows] = r
                    first_entry[rows] = begin
                    longest = max(longest, entries - begin)
                    rows += 1
                    first_entry[rows] = entries
        depth[b] = deepest + (1 if block_first[b + 1] - block_first[b] > 1 else 0)
    first_row[unknowns] = rows
    first_entry[rows] = entries
    return rows, entries, longest
