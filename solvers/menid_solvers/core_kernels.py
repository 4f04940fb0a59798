"""Kernels that build the equations which the sweeps iterate; see `menid_solvers.core`."""

from __future__ import annotations

import numpy as np

from menid_plan.compiled import kernel
from menid_plan.mdp.model import Bools, Floats, Ints, Naturals, SmallInts

SHORT = 8  # entries of a row among which a target is searched one by one
PATTERN = 38  # entries of a row of which it can be told in 63 bits where they lead


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
    "UniTuple(i8, 4)(i8[::1], i4[::1], i4[::1], i4[::1], i8[::1], f8[::1], b1[::1], f8[::1], f8[::1],"
    " f8, i4[::1], i4[::1], i8[::1], i8[::1], i8,"
    " i8[::1], i4[::1], i4[::1], f8[::1], u4[::1], i4[::1], f8[::1], i4[::1],"
    " i4[::1], i8[::1], i8[::1], i4[::1])"
)
def compile_rows(
    state_row: Ints,
    row_transition: SmallInts,
    next_state: SmallInts,
    row_kind: SmallInts,
    kind_first: Ints,
    kind_probability: Floats,
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
    first_entry: SmallInts,
    source: SmallInts,
    constant: Floats,
    target: Naturals,
    row_weight: SmallInts,
    weight: Floats,
    depth: SmallInts,
    block_of: SmallInts,
    place: Ints,
    known_pattern: Ints,
    known_weight: SmallInts,
) -> tuple[int, int, int, int]:
    """Write the rows of every unknown: loops solved for, known values put in, doubles merged.

    depth[b] is the highest number of blocks of several unknowns on a way out of block b, itself
    included. Returns the numbers of rows, entries and weights, and the most transitions of a row.
    """
    unknowns = block_first[blocks]
    place[:] = -1  # of an entry in the row at hand; room of unknowns, as block_of
    # For each kind, which transitions of its last row led where, and its weights.
    known_pattern[:] = -1
    rows = 0
    entries = 0
    weights = 0
    longest = 0
    most = 0  # the largest depth so far
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
                    before = entries
                    stays = 0.0
                    ends = 0.0
                    moves = 0.0
                    gained = 0.0
                    pattern = 1
                    begin, end = np.uint64(row_transition[r]), np.uint64(row_transition[r + 1])
                    of_kind = np.uint64(kind_first[row_kind[r]]) - begin
                    short = end - begin <= SHORT
                    for e in range(begin, end):
                        p = kind_probability[of_kind + e]
                        if p <= 0.0:
                            continue
                        t = next_state[e]
                        v = unknown[t]
                        if v < 0:
                            ends += p
                            gained += p * known_value[t]
                            pattern = 3 * pattern
                        elif v == u:
                            stays += p
                            pattern = 3 * pattern + 1
                        else:
                            moves += p
                            at = entries
                            if short:  # the row at hand is at hand, the places of all unknowns not
                                for k in range(before, entries):
                                    if target[k] == v:
                                        at = k
                            elif place[v] >= before:
                                at = place[v]
                            else:
                                place[v] = entries
                            if at == entries:
                                target[entries] = v
                                entries += 1
                                pattern = 3 * pattern + 2
                            else:
                                pattern = -2
                        if end - begin > PATTERN:
                            pattern = -2
                    divisor = moves + ends + (1.0 - discount) * stays
                    if divisor <= 0.0:
                        continue  # it loops forever, and pays less than nothing
                    total = moves + ends + stays
                    if pattern < 0 or known_pattern[row_kind[r]] != pattern:
                        weights += 1
                        known_pattern[row_kind[r]] = pattern
                        known_weight[row_kind[r]] = weights
                        weight[weights - 1] = (discount * ends + (1.0 - discount) * total) / divisor
                        for k in range(weights, weights + entries - before):
                            weight[k] = 0.0
                        following = 0
                        for e in range(begin, end):
                            p = kind_probability[of_kind + e]
                            v = unknown[next_state[e]]
                            if p <= 0.0 or v < 0 or v == u:
                                continue
                            k = following
                            if pattern < 0:
                                k = 0
                                while target[before + k] != v:
                                    k += 1
                            weight[weights + k] += p
                            following += 1
                        for k in range(weights, weights + entries - before):
                            weight[k] *= discount / divisor
                        row_weight[rows] = weights
                        weights += entries - before
                    else:
                        row_weight[rows] = known_weight[row_kind[r]]
                    if deepest < most:
                        for e in range(before, entries):
                            other = block_of[target[e]]
                            if other != b:
                                deepest = max(deepest, depth[other])
                    constant[rows] = (reward[r] * total + discount * gained) / divisor
                    source[rows] = r
                    first_entry[rows] = before
                    longest = max(longest, int(end - begin))
                    rows += 1
        depth[b] = deepest + (1 if block_first[b + 1] - block_first[b] > 1 else 0)
        most = max(most, depth[b])
    first_row[unknowns] = rows
    first_entry[rows] = entries
    return rows, entries, weights, longest
