"""The kernel that encloses the core's unknowns, block by block; see `menid_solvers.bounds`."""

from __future__ import annotations

import numpy as np

from menid_plan.compiled import kernel
from menid_plan.mdp.model import Bools, Floats, Ints, Naturals, SmallInts
from menid_solvers.guess_kernels import guess_stay, guess_values
from menid_solvers.sweep_kernels import (
    choose_certified,
    choose_policy,
    sweep_all,
    sweep_shortest_stay,
    sweep_taken,
    sweep_up,
    take_rows,
)

_ROWS = "i8[::1], i4[::1], u4[::1], i4[::1], f8[::1], f8[::1], f8[::1]"

# What `state` holds between calls.
(
    BLOCK, PHASE, SHIFT, BLOCK_SWEEPS, LARGEST, SWEEPS, RESIDUAL, PATIENCE, WIDTH, STAY, MARK, LEAST,
    LEAPT, GIVEN_UP,
) = range(14)  # fmt: skip
STATE = 14
# What a call ends with.
DONE, MORE, SLOW = range(3)
# The phases of a block.
START, VALUE, DURATION, CHECK, UPPER = range(5)

ROUNDING = 1.2e-16  # a little over 2^-53
SHORTEST_AFTER = 64  # sweeps for the stay of a policy that may linger for nothing
LEAST_SHIFT = 2.5  # the least shift, in errors; twice as much where that turns out too little
LEAP = 32  # upward sweeps, after which it leaps if they have come down to rounding
PATIENT = 1024  # upward sweeps, after which it leaps in any case
LEAPS = 40  # so often, each twice as far as the one before; then the bound stays open
GIVE_UP = 300_000  # sweeps of a block, after which its bounds stay open


@kernel(f"void(i8, {_ROWS}, i8, f8[::1], f8[::1], i8[::1])")
def close_single(
    u: int,
    first_row: Ints,
    first_entry: SmallInts,
    target: Naturals,
    row_weight: SmallInts,
    weight: Floats,
    constant: Floats,
    floor: Floats,
    longest: int,
    hi: Floats,
    lo: Floats,
    policy: Ints,
) -> None:
    """Bounds of an unknown that depends on earlier ones only; rounding goes outward."""
    high = floor[u]
    low = floor[u]
    slack_of_ties = 0.0
    for i in range(first_row[u], first_row[u + 1]):
        up = constant[i]
        down = constant[i]
        size = abs(constant[i])
        begin, end = np.uint64(first_entry[i]), np.uint64(first_entry[i + 1])
        at = np.uint64(row_weight[i]) - begin
        for k in range(begin, end):
            above = weight[at + k] * hi[target[k]]
            below = weight[at + k] * lo[target[k]]
            up += above
            down += below
            size += max(abs(above), abs(below))
        error = ROUNDING * (longest + first_entry[i + 1] - first_entry[i] + 8) * size
        high = max(high, up + error)
        low = max(low, down - error)
        slack_of_ties = max(slack_of_ties, 4.0 * error)
    policy[u] = -1
    for i in range(first_row[u], first_row[u + 1]):
        down = constant[i]
        size = abs(constant[i])
        begin, end = np.uint64(first_entry[i]), np.uint64(first_entry[i + 1])
        at = np.uint64(row_weight[i]) - begin
        for k in range(begin, end):
            below = weight[at + k] * lo[target[k]]
            down += below
            size += abs(below)
        if down >= low - slack_of_ties:
            error = ROUNDING * (longest + first_entry[i + 1] - first_entry[i] + 8) * size
            policy[u] = i
            low = min(low, down - error)
            break
    hi[u] = high
    lo[u] = low


@kernel(
    f"i8({_ROWS}, i8[::1], i4[::1], i8, f8, f8, f8, b1, f8, i8,"
    " f8[::1], f8[::1], f8[::1], f8[::1], i8[::1], b1[::1],"
    " i8[::1], u4[::1], f8[::1], f8[::1], f8[::1])"
)
def advance(
    first_row: Ints,
    first_entry: SmallInts,
    target: Naturals,
    row_weight: SmallInts,
    weight: Floats,
    constant: Floats,
    floor: Floats,
    block_first: Ints,
    depth: SmallInts,
    longest: int,
    discount: float,
    epsilon: float,
    highest: float,
    guess: bool,
    work: float,
    sweep_limit: int,
    state: Floats,
    hi: Floats,
    lo: Floats,
    stay: Floats,
    policy: Ints,
    leaves: Bools,
    taken_first: Ints,
    taken_target: Naturals,
    taken_weight: Floats,
    taken_constant: Floats,
    measured: Floats,
) -> int:
    """Enclose blocks from where state stands, until work entries were read; see the module."""
    blocks = len(depth)
    deepest = 1
    for b in range(blocks):
        deepest = max(deepest, depth[b])
    own = epsilon / deepest
    unit = ROUNDING * (3 * longest + 12)
    spent = 0.0
    while state[BLOCK] < blocks:
        b = int(state[BLOCK])
        first = block_first[b]
        last = block_first[b + 1]
        rows = first_row[last] - first_row[first]
        block_work = float(first_entry[first_row[last]] - first_entry[first_row[first]])
        block_work += last - first
        policy_work = block_work * (last - first) / max(rows, 1)
        allowed = own * max(depth[b], 1)
        if spent > work or state[SWEEPS] >= sweep_limit:
            return MORE
        if state[PHASE] == START:
            if last - first == 1:
                close_single(
                    first,
                    first_row,
                    first_entry,
                    target,
                    row_weight,
                    weight,
                    constant,
                    floor,
                    longest,
                    hi,
                    lo,
                    policy,
                )
                state[LARGEST] = max(state[LARGEST], abs(hi[first]), abs(lo[first]))
                state[BLOCK] += 1
                spent += block_work
                continue
            state[STAY] = 1.0 / (1.0 - discount) if discount < 1.0 else 10.0
            state[SHIFT] = own / (4.0 * state[STAY])
            state[BLOCK_SWEEPS] = 0.0
            state[PATIENCE] = 100.0
            state[MARK] = 0.0
            state[LEAST] = LEAST_SHIFT
            state[PHASE] = VALUE
            for u in range(first, last):
                stay[u] = state[STAY] if discount < 1.0 else 0.0
            if guess:
                guess_values(
                    first, last, first_row, first_entry, target, row_weight, weight, constant, floor,
                    hi, leaves,
                )  # fmt: skip
                spent += 2 * block_work
        error = unit * state[LARGEST]
        least = state[LEAST] * error
        shift = max(state[SHIFT], least)
        state[SHIFT] = shift
        if state[BLOCK_SWEEPS] > state[PATIENCE]:
            return SLOW

        if state[PHASE] == VALUE:
            sweep_all(
                first, last, first_row, first_entry, target, row_weight, weight, constant, floor,
                hi, policy, measured,
            )  # fmt: skip
            state[SWEEPS] += 1
            state[BLOCK_SWEEPS] += 1
            spent += block_work
            state[LARGEST] = max(state[LARGEST], measured[2])
            state[RESIDUAL] = max(measured[0], measured[1])
            if state[RESIDUAL] > 0.25 * shift:
                if rows < 2 * (last - first):
                    continue
                enough = max(0.1 * state[RESIDUAL], 0.05 * shift)
                take_rows(
                    first, last, first_row, first_entry, target, row_weight, weight, constant,
                    floor, policy, taken_first, taken_target, taken_weight, taken_constant,
                )  # fmt: skip
                spent += 4 * policy_work
                for _ in range(min(30, int(3 * rows / (last - first)))):  # cheaper than all rows
                    sweep_taken(
                        first, last, taken_first, taken_target, taken_weight, taken_constant,
                        hi, measured,
                    )  # fmt: skip
                    spent += policy_work
                    if max(measured[0], measured[1]) <= enough:
                        break
                continue
            state[PHASE] = CHECK
            if discount == 1.0:
                choose_policy(
                    first, last, 0.0, True, first_row, first_entry, target, row_weight, weight,
                    constant, floor, hi, policy, leaves,
                )  # fmt: skip
                spent += 2 * block_work
                if stay[first] == 0.0:
                    guess_stay(
                        first, last, first_entry, target, row_weight, weight, stay, policy, leaves
                    )
                    spent += policy_work
                take_rows(
                    first, last, first_row, first_entry, target, row_weight, weight, constant,
                    floor, policy, taken_first, taken_target, taken_weight, taken_constant,
                )  # fmt: skip
                for j in range(last - first):
                    taken_constant[j] = 1.0
                state[MARK] = 0.0
                state[PHASE] = DURATION

        elif state[PHASE] == DURATION:
            if state[MARK] < SHORTEST_AFTER:
                sweep_taken(
                    first, last, taken_first, taken_target, taken_weight, taken_constant,
                    stay, measured,
                )  # fmt: skip
                spent += policy_work
            else:
                sweep_shortest_stay(
                    first, last, 0.05 * shift, first_row, first_entry, target, row_weight,
                    weight, constant, floor, hi, stay, policy, measured,
                )  # fmt: skip
                spent += block_work
            state[MARK] += 1
            state[SWEEPS] += 1
            state[BLOCK_SWEEPS] += 1
            state[RESIDUAL] = max(measured[0], measured[1])
            if measured[0] > 0.5 or measured[1] > 0.1 * measured[2]:
                continue
            # stay >= 0.5 + P stay: so often the shift is paid until the block is left.
            state[STAY] = measured[2]
            wanted = own / (4.0 * state[STAY])
            if wanted < 0.5 * shift:
                state[SHIFT] = wanted
                state[PHASE] = VALUE if shift > 1.1 * least else CHECK
            else:
                state[PHASE] = CHECK

        elif state[PHASE] == CHECK:
            width = 0.0
            for i in range(first_row[first], first_row[last]):
                begin, end = np.uint64(first_entry[i]), np.uint64(first_entry[i + 1])
                for k in range(begin, end):
                    if target[k] < first:
                        width = max(width, hi[target[k]] - lo[target[k]])
            state[WIDTH] = width
            largest = state[LARGEST]
            for u in range(first, last):
                lo[u] = hi[u] - width - shift * stay[u]
                hi[u] += shift * stay[u]
                largest = max(largest, abs(hi[u]))
                if lo[u] > -np.inf:
                    largest = max(largest, -lo[u])
            state[LARGEST] = largest
            error = unit * largest
            choose_certified(
                first, last, max(2.0 * error, 0.05 * shift), error, first_row, first_entry,
                target, row_weight, weight, constant, floor, hi, lo, policy, measured,
            )  # fmt: skip
            spent += 3 * block_work
            if measured[1] < error and state[BLOCK_SWEEPS] < GIVE_UP:
                for u in range(first, last):
                    hi[u] -= shift * stay[u]
                if shift <= 1.1 * least:
                    state[LEAST] *= 2.0
                state[SHIFT] = 0.125 * shift
                state[PHASE] = VALUE
                continue
            if measured[1] < error:
                for u in range(first, last):
                    lo[u] = -np.inf
            state[LEAPT] = 0.0
            # lo <= T(lo); T(hi) <= hi as well, or it rises until it is so.
            state[MARK] = 0.0 if measured[0] >= error else 1.0
            state[PHASE] = UPPER

        else:
            sure = state[MARK] == 0.0
            mark = int(state[MARK])
            leap = not sure and mark % LEAP == 0
            leap &= state[RESIDUAL] <= 2.0 * error or mark >= PATIENT
            if not sure:
                if leap:
                    for u in range(first, last):
                        taken_constant[u - first] = hi[u]
                sweep_up(
                    first, last, unit, first_row, first_entry, target, row_weight, weight, constant,
                    floor, hi, measured,
                )  # fmt: skip
                state[MARK] += 1
                state[SWEEPS] += 1
                state[BLOCK_SWEEPS] += 1
                spent += block_work
                state[LARGEST] = max(state[LARGEST], measured[2])
                state[RESIDUAL] = measured[0]
                sure = measured[0] == 0.0
            if leap and not sure:
                # One may linger at next to no loss: what a sweep lifts is lifted for long.
                far = 16.0 * 2.0 ** state[LEAPT]
                state[LEAPT] += 1
                largest = state[LARGEST]
                for u in range(first, last):
                    hi[u] += far * (hi[u] - taken_constant[u - first])
                    largest = max(largest, abs(hi[u]))
                state[LARGEST] = largest
                if state[LEAPT] == 1.0:
                    state[PATIENCE] = 0.0  # elimination may do it
            over = state[BLOCK_SWEEPS] >= GIVE_UP
            if not (sure or leap or over):
                continue
            gap = 0.0
            for u in range(first, last):
                gap = max(gap, hi[u] - lo[u])
            close = gap <= allowed
            last_try = over or shift <= 1.1 * least
            if not sure and not over and (close or last_try) and state[LEAPT] < LEAPS:
                continue
            if not sure and last_try:
                for u in range(first, last):
                    hi[u] = highest
            if last_try or (sure and close):
                for u in range(first, last):
                    stay[u] = 0.0
                if over and not (sure and close):
                    state[GIVEN_UP] += 1
                state[BLOCK] += 1
                state[PHASE] = START
                continue
            for u in range(first, last):
                hi[u] = lo[u] + state[WIDTH] + shift * stay[u]
            state[SHIFT] = 0.125 * shift
            state[PHASE] = VALUE
    return DONE
