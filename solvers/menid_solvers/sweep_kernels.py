"""Kernels that sweep over a block of the core's equations; see `menid_solvers.core`.

A sweep takes the unknowns first..last in order and uses new values at once (Gauss-Seidel). ``x`` is
changed in place; ``measured`` receives the largest rise, the largest fall and the largest |x|.
A policy holds a row of the core for each unknown, -1 for ending at once (the floor).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from menid_plan.compiled import kernel
from menid_plan.mdp.model import Bools, Floats, Ints, Naturals, SmallInts

_ROWS = "i8[::1], i4[::1], u4[::1], i4[::1], f8[::1], f8[::1], f8[::1]"
_TAKEN = "i8[::1], u4[::1], f8[::1], f8[::1]"

HALF = 1.11022303e-16  # a little over 2^-53: added to 1 it makes the next double, not the one after


@kernel(inline=True)
def row_value(
    row: Any, first_entry: Any, target: Any, row_weight: Any, weight: Any, constant: Any, x: Any
) -> Any:
    """What a row pays and expects of x."""
    value = constant[row]
    begin, end = np.uint64(first_entry[row]), np.uint64(first_entry[row + 1])
    at = np.uint64(row_weight[row]) - begin
    for k in range(begin, end):
        value += weight[at + k] * x[target[k]]
    return value


@kernel(f"void(i8, i8, {_ROWS}, f8[::1], i8[::1], f8[::1])")
def sweep_all(
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
    policy: Ints,
    measured: Floats,
) -> None:
    """x[u] = the best of the rows, for each unknown; policy: which it was, lowest first."""
    rise = 0.0
    fall = 0.0
    largest = 0.0
    for u in range(first, last):
        best = floor[u]
        chosen = -1
        for i in range(first_row[u], first_row[u + 1]):
            value = row_value(i, first_entry, target, row_weight, weight, constant, x)
            if value > best:
                best = value
                chosen = i
        change = best - x[u]
        rise = max(rise, change)
        fall = max(fall, -change)
        largest = max(largest, abs(best))
        x[u] = best
        policy[u] = chosen
    measured[0] = rise
    measured[1] = fall
    measured[2] = largest


@kernel(f"void(i8, i8, f8, {_ROWS}, f8[::1], f8[::1])")
def sweep_up(
    first: int,
    last: int,
    unit: float,
    first_row: Ints,
    first_entry: SmallInts,
    target: Naturals,
    row_weight: SmallInts,
    weight: Floats,
    constant: Floats,
    floor: Floats,
    x: Floats,
    measured: Floats,
) -> None:
    """x[u] rises to what no row of it exceeds in truth: where nothing rose, T(x) <= x.

    Weights and leak of a row sum to 1, so that it exceeds x[u] by constant - leak * x[u] + sum of
    weight * (x[target] - x[u]). What rounding may hide of that is ``unit`` of those terms' sizes: next
    to nothing where x is level, as it is where one can linger without loss. (Sums of weight * x hide
    that much of x, and it would be lifted for ever.) The policy is left alone.
    """
    rise = 0.0
    largest = 0.0
    for u in range(first, last):
        here = x[u]
        step = max(0.0, floor[u] - here)
        for i in range(first_row[u], first_row[u + 1]):
            loss = weight[row_weight[i] - 1] * here
            change = constant[i] - loss
            size = abs(constant[i]) + abs(loss)
            begin, end = np.uint64(first_entry[i]), np.uint64(first_entry[i + 1])
            at = np.uint64(row_weight[i]) - begin
            for k in range(begin, end):
                part = weight[at + k] * (x[target[k]] - here)
                change += part
                size += abs(part)
            if change + unit * size > 0.0:
                # Some more, so as not to come back for what rises after it; the next double at least,
                # which is not above the values that lift it.
                step = max(step, change + 3.0 * unit * size, HALF * abs(here))
        if step > 0.0:
            x[u] = here + step
        rise = max(rise, step)
        largest = max(largest, abs(here + step))
    measured[0] = rise
    measured[1] = 0.0
    measured[2] = largest


@kernel(f"void(i8, i8, {_ROWS}, i8[::1], {_TAKEN})")
def take_rows(
    first: int,
    last: int,
    first_row: Ints,  # noqa: ARG001 - all that reads rows takes the same arrays
    first_entry: SmallInts,
    target: Naturals,
    row_weight: SmallInts,
    weight: Floats,
    constant: Floats,
    floor: Floats,
    policy: Ints,
    taken_first: Ints,
    taken_target: Naturals,
    taken_weight: Floats,
    taken_constant: Floats,
) -> None:
    """Copy the policy's rows side by side, counted from the block's first unknown."""
    copied = 0
    taken_first[0] = 0
    for u in range(first, last):
        i = policy[u]
        if i < 0:
            taken_constant[u - first] = floor[u]
        else:
            taken_constant[u - first] = constant[i]
            begin, end = np.uint64(first_entry[i]), np.uint64(first_entry[i + 1])
            at = np.uint64(row_weight[i]) - begin
            for k in range(begin, end):
                taken_target[copied] = target[k]
                taken_weight[copied] = weight[at + k]
                copied += 1
        taken_first[u - first + 1] = copied


@kernel(f"void(i8, i8, {_TAKEN}, f8[::1], f8[::1])")
def sweep_taken(
    first: int,
    last: int,
    taken_first: Ints,
    taken_target: Naturals,
    taken_weight: Floats,
    taken_constant: Floats,
    x: Floats,
    measured: Floats,
) -> None:
    """x[u] = the policy's row, for each unknown.

    With constants of 1 and an x that is 0 in earlier blocks: the steps until the block is left.
    """
    rise = 0.0
    fall = 0.0
    largest = 0.0
    for u in range(first, last):
        j = u - first
        value = taken_constant[j]
        for k in range(np.uint64(taken_first[j]), np.uint64(taken_first[j + 1])):
            value += taken_weight[k] * x[taken_target[k]]
        change = value - x[u]
        rise = max(rise, change)
        fall = max(fall, -change)
        largest = max(largest, abs(value))
        x[u] = value
    measured[0] = rise
    measured[1] = fall
    measured[2] = largest


@kernel(f"void(i8, i8, f8, {_ROWS}, f8[::1], f8[::1], i8[::1], f8[::1])")
def sweep_shortest_stay(
    first: int,
    last: int,
    tie: float,
    first_row: Ints,
    first_entry: SmallInts,
    target: Naturals,
    row_weight: SmallInts,
    weight: Floats,
    constant: Floats,
    floor: Floats,
    x: Floats,
    stay: Floats,
    policy: Ints,
    measured: Floats,
) -> None:
    """stay[u] = 1 + what the row expects of it that makes it shortest: that is then the policy.

    Of the rows within tie of the best by x; stay is 0 in earlier blocks.
    """
    rise = 0.0
    fall = 0.0
    largest = 0.0
    for u in range(first, last):
        best = floor[u]
        for i in range(first_row[u], first_row[u + 1]):
            value = row_value(i, first_entry, target, row_weight, weight, constant, x)
            best = max(best, value)
        shortest = np.inf
        if floor[u] >= best - tie:
            shortest = 1.0
            policy[u] = -1
        for i in range(first_row[u], first_row[u + 1]):
            value = constant[i]
            length = 1.0
            begin, end = np.uint64(first_entry[i]), np.uint64(first_entry[i + 1])
            at = np.uint64(row_weight[i]) - begin
            for k in range(begin, end):
                value += weight[at + k] * x[target[k]]
                length += weight[at + k] * stay[target[k]]
            if value >= best - tie and length < shortest:
                shortest = length
                policy[u] = i
        change = shortest - stay[u]
        rise = max(rise, change)
        fall = max(fall, -change)
        largest = max(largest, shortest)
        stay[u] = shortest
    measured[0] = rise
    measured[1] = fall
    measured[2] = largest


@kernel(f"void(i8, i8, f8, f8, {_ROWS}, f8[::1], f8[::1], i8[::1], f8[::1])")
def choose_certified(
    first: int,
    last: int,
    tie: float,
    margin: float,
    first_row: Ints,
    first_entry: SmallInts,
    target: Naturals,
    row_weight: SmallInts,
    weight: Floats,
    constant: Floats,
    floor: Floats,
    hi: Floats,
    lo: Floats,
    policy: Ints,
    measured: Floats,
) -> None:
    """The lowest rows within tie of the best that raise lo by margin; else the policy stays.

    Such a policy leaves surely, and is worth lo: lo + margin <= T(lo) in each of its rows.
    ``measured`` receives what `slack` does.
    """
    above = np.inf
    below = np.inf
    for u in range(first, last):
        best_hi = floor[u]
        best = floor[u]
        for i in range(first_row[u], first_row[u + 1]):
            high = row_value(i, first_entry, target, row_weight, weight, constant, hi)
            value = row_value(i, first_entry, target, row_weight, weight, constant, lo)
            best_hi = max(best_hi, high)
            best = max(best, value)
        above = min(above, hi[u] - best_hi)
        kept = policy[u]
        worth = floor[u]
        for i in range(first_row[u], first_row[u + 1]):
            value = row_value(i, first_entry, target, row_weight, weight, constant, lo)
            if i == kept:
                worth = value
            if value >= best - tie and value >= lo[u] + margin:
                policy[u] = i
                worth = value
                break
        below = min(below, worth - lo[u])
    measured[0] = above
    measured[1] = below


@kernel(f"void(i8, i8, f8, {_ROWS}, f8[::1], f8[::1], i8[::1], f8[::1])")
def slack(
    first: int,
    last: int,
    unit: float,
    first_row: Ints,
    first_entry: SmallInts,
    target: Naturals,
    row_weight: SmallInts,
    weight: Floats,
    constant: Floats,
    floor: Floats,
    hi: Floats,
    lo: Floats,
    policy: Ints,
    measured: Floats,
) -> None:
    """measured: the least hi - T(hi), over all rows, and the least T(lo) - lo, of the policy.

    Less what rounding may hide of each, which is told as in `sweep_up`.
    """
    above = np.inf
    below = np.inf
    for u in range(first, last):
        high = hi[u]
        low = lo[u]
        above = min(above, high - floor[u])
        if policy[u] < 0:
            below = min(below, floor[u] - low)
        for i in range(first_row[u], first_row[u + 1]):
            leak = weight[row_weight[i] - 1]
            rise = constant[i] - leak * high
            gain = constant[i] - leak * low
            high_size = abs(constant[i]) + abs(leak * high)
            low_size = abs(constant[i]) + abs(leak * low)
            begin, end = np.uint64(first_entry[i]), np.uint64(first_entry[i + 1])
            at = np.uint64(row_weight[i]) - begin
            for k in range(begin, end):
                part = weight[at + k] * (hi[target[k]] - high)
                rise += part
                high_size += abs(part)
                part = weight[at + k] * (lo[target[k]] - low)
                gain += part
                low_size += abs(part)
            above = min(above, -(rise + unit * high_size))
            if i == policy[u]:
                below = min(below, gain - unit * low_size)
    measured[0] = above
    measured[1] = below


@kernel(f"void(i8, i8, f8, b1, {_ROWS}, f8[::1], i8[::1], b1[::1])")
def choose_policy(
    first: int,
    last: int,
    tie: float,
    chosen_before: bool,
    first_row: Ints,
    first_entry: SmallInts,
    target: Naturals,
    row_weight: SmallInts,
    weight: Floats,
    constant: Floats,
    floor: Floats,
    x: Floats,
    policy: Ints,
    leaves: Bools,
) -> None:
    """The lowest rows within tie of the best, changed where they would never leave the block.

    With ``chosen_before`` the policy has the best rows already.

    Leaving is sure if from every unknown the policy can leave (the block is finite). Unknowns from
    which it cannot take the best row that leads to one from which it can.
    """
    for u in range(first, last):
        leaves[u] = False
        if chosen_before:
            continue
        best = floor[u]
        for i in range(first_row[u], first_row[u + 1]):
            value = row_value(i, first_entry, target, row_weight, weight, constant, x)
            best = max(best, value)
        policy[u] = -1
        for i in range(first_row[u], first_row[u + 1]):
            value = row_value(i, first_entry, target, row_weight, weight, constant, x)
            if value >= best - tie:
                policy[u] = i
                break
    left = last - first
    while left > 0:
        before = left
        for step in range(2 * (last - first)):  # there and back
            u = first + step if step < last - first else 2 * last - first - 1 - step
            if leaves[u]:
                continue
            i = policy[u]
            out = i < 0 or weight[row_weight[i] - 1] > 0.0
            if not out:
                begin, end = np.uint64(first_entry[i]), np.uint64(first_entry[i + 1])
                at = np.uint64(row_weight[i]) - begin
                for k in range(begin, end):
                    t = target[k]
                    if t < first or leaves[t]:
                        out = True
                        break
            if out:
                leaves[u] = True
                left -= 1
        if left < before:
            continue
        # The rest would stay for ever: the best row into the part that leaves.
        for u in range(first, last):
            if leaves[u]:
                continue
            best = floor[u]
            chosen = -2
            if best > -np.inf:
                chosen = -1
            for i in range(first_row[u], first_row[u + 1]):
                out = weight[row_weight[i] - 1] > 0.0
                value = constant[i]
                begin, end = np.uint64(first_entry[i]), np.uint64(first_entry[i + 1])
                at = np.uint64(row_weight[i]) - begin
                for k in range(begin, end):
                    t = target[k]
                    value += weight[at + k] * x[t]
                    if t < first or leaves[t]:
                        out = True
                if out and (chosen == -2 or value > best):
                    best = value
                    chosen = i
            if chosen != -2:
                policy[u] = chosen
                leaves[u] = True
                left -= 1
        if left == before:
            return  # there is no way out; the core's builder sees to it that this cannot be
