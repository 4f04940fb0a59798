"""Kernels that solve a block for one policy exactly, for blocks in which sweeps creep.

Elimination without subtraction (Grassmann, Taksar and Heyman 1985): every state keeps its rates to
others and out of the block, so that nothing cancels however rarely the block is left.
"""

from __future__ import annotations

import numpy as np

from menid_plan.compiled import kernel
from menid_plan.mdp.model import Floats, Ints, Naturals, SmallInts

_ROWS = "i8[::1], i4[::1], u4[::1], i4[::1], f8[::1], f8[::1], f8[::1]"


@kernel("i8(i8, i8, i8[::1], i4[::1], u4[::1])")
def bandwidth(
    first: int, last: int, first_row: Ints, first_entry: SmallInts, target: Naturals
) -> int:
    """The largest distance between two unknowns of the block that a row of it connects."""
    widest = 0
    for u in range(first, last):
        for k in range(first_entry[first_row[u]], first_entry[first_row[u + 1]]):
            if target[k] >= first:
                widest = max(widest, abs(target[k] - u))
    return widest


@kernel(
    f"b1(i8, i8, i8, {_ROWS}, f8[::1], f8[::1], i8[::1], f8[:, ::1], f8[:, ::1], f8[::1], f8[::1])"
)
def solve_policy(
    first: int,
    last: int,
    band: int,
    first_row: Ints,  # noqa: ARG001 - all sweeps take the same arrays
    first_entry: SmallInts,
    target: Naturals,
    row_weight: SmallInts,
    weight: Floats,
    constant: Floats,
    floor: Floats,
    hi: Floats,
    lo: Floats,
    policy: Ints,
    answer: Floats,
    rate: Floats,
    out: Floats,
    total: Floats,
) -> bool:
    """The policy's values in a block, for upper and lower values around it, and its duration.

    answer[j] receives the value with earlier blocks at hi, that at lo, and the expected number of
    sweeps of the shift until the block is left. False if the policy may never leave it.
    """
    n = last - first
    rate[:, :] = 0.0  # rate[j, band + d]: from first + j to first + j + d
    for j in range(n):
        u = first + j
        i = policy[u]
        answer[j, 2] = 1.0
        if i < 0:
            out[j] = 1.0
            answer[j, 0] = floor[u]
            answer[j, 1] = floor[u]
            continue
        above = constant[i]
        below = constant[i]
        out[j] = weight[row_weight[i] - 1]
        begin, end = np.uint64(first_entry[i]), np.uint64(first_entry[i + 1])
        at = np.uint64(row_weight[i]) - begin
        for k in range(begin, end):
            t = target[k]
            if t >= first:
                rate[j, band + t - u] += weight[at + k]
            else:
                above += weight[at + k] * hi[t]
                below += weight[at + k] * lo[t]
                out[j] += weight[at + k]
        answer[j, 0] = above
        answer[j, 1] = below
    for j in range(n):
        width = min(band, n - 1 - j)
        total[j] = out[j]
        for d in range(1, width + 1):
            total[j] += rate[j, band + d]
        if not total[j] > 0.0:
            return False
        for d in range(1, width + 1):
            back = rate[j + d, band - d]
            if back == 0.0:
                continue
            factor = back / total[j]
            out[j + d] += factor * out[j]
            for c in range(3):
                answer[j + d, c] += factor * answer[j, c]
            for g in range(1, width + 1):
                rate[j + d, band + g - d] += factor * rate[j, band + g]
            rate[j + d, band] = 0.0
    for j in range(n - 1, -1, -1):
        for c in range(3):
            value = answer[j, c]
            for d in range(1, min(band, n - 1 - j) + 1):
                value += rate[j, band + d] * answer[j + d, c]
            answer[j, c] = value / total[j]
            if not abs(answer[j, c]) < np.inf:
                return False
    return True


@kernel(f"i8(i8, i8, f8, f8, {_ROWS}, f8[::1], i8[::1])")
def improve_policy(
    first: int,
    last: int,
    shift: float,
    tie: float,
    first_row: Ints,
    first_entry: SmallInts,
    target: Naturals,
    row_weight: SmallInts,
    weight: Floats,
    constant: Floats,
    floor: Floats,
    x: Floats,
    policy: Ints,
) -> int:
    """Change the policy where shift + a row is better than x by more than tie; how often."""
    changes = 0
    for u in range(first, last):
        best = x[u] + tie
        chosen = -2
        if floor[u] + shift > best:
            best = floor[u] + shift
            chosen = -1
        for i in range(first_row[u], first_row[u + 1]):
            value = constant[i] + shift
            begin, end = np.uint64(first_entry[i]), np.uint64(first_entry[i + 1])
            at = np.uint64(row_weight[i]) - begin
            for k in range(begin, end):
                value += weight[at + k] * x[target[k]]
            if value > best:
                best = value
                chosen = i
        if chosen != -2:
            policy[u] = chosen
            changes += 1
    return changes
