"""Kernels that guess where to begin: one pass from the way out backward."""

from __future__ import annotations

import numpy as np

from menid_plan.compiled import kernel
from menid_plan.mdp.model import Bools, Floats, Ints, Naturals, SmallInts

_ROWS = "i8[::1], i4[::1], u4[::1], i4[::1], f8[::1], f8[::1], f8[::1]"

LIKELY = 0.05  # a guess is made from a row that leads with this probability to guessed values
PASSES = 4


@kernel(f"void(i8, i8, {_ROWS}, f8[::1], b1[::1])")
def guess_values(
    first: int,
    last: int,
    first_row: Ints,
    first_entry: SmallInts,
    target: Naturals,
    row_weight: SmallInts,
    weight: Floats,
    constant: Floats,
    floor: Floats,
    x: Floats,
    guessed: Bools,
) -> None:
    """x[u]: the best row's value if it were repeated until it leads to a value guessed before."""
    for u in range(first, last):
        guessed[u] = False
    for _ in range(PASSES):
        left = 0
        for u in range(first, last):
            if guessed[u]:
                continue
            best = floor[u]
            for i in range(first_row[u], first_row[u + 1]):
                value = constant[i]
                known = weight[row_weight[i] - 1]
                begin, end = np.uint64(first_entry[i]), np.uint64(first_entry[i + 1])
                at = np.uint64(row_weight[i]) - begin
                for k in range(begin, end):
                    t = target[k]
                    if t < first or guessed[t]:
                        known += weight[at + k]
                        value += weight[at + k] * x[t]
                if known >= LIKELY:
                    best = max(best, value / known)
            if best > -np.inf:
                x[u] = best
                guessed[u] = True
            else:
                left += 1
        if left == 0:
            break


@kernel("void(i8, i8, i4[::1], u4[::1], i4[::1], f8[::1], f8[::1], i8[::1], b1[::1])")
def guess_stay(
    first: int,
    last: int,
    first_entry: SmallInts,
    target: Naturals,
    row_weight: SmallInts,
    weight: Floats,
    stay: Floats,
    policy: Ints,
    guessed: Bools,
) -> None:
    """The same for the expected number of steps by which the policy leaves the block."""
    for u in range(first, last):
        guessed[u] = False
        stay[u] = 1.0
    for _ in range(PASSES):
        left = 0
        for u in range(first, last):
            if guessed[u]:
                continue
            i = policy[u]
            if i < 0:
                guessed[u] = True
                continue
            value = 1.0
            known = weight[row_weight[i] - 1]
            begin, end = np.uint64(first_entry[i]), np.uint64(first_entry[i + 1])
            at = np.uint64(row_weight[i]) - begin
            for k in range(begin, end):
                t = target[k]
                if t < first:
                    known += weight[at + k]
                elif guessed[t]:
                    known += weight[at + k]
                    value += weight[at + k] * stay[t]
            if known >= LIKELY:
                stay[u] = value / known
                guessed[u] = True
            else:
                left += 1
        if left == 0:
            break
