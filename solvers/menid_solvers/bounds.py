"""Encloses the unknowns of a core: a lower and an upper bound for each, and a policy.

Block by block, from the ends backward. With T the right-hand side of the equations (`core`):

- ``hi`` is an upper bound if T(hi) <= hi. Sweeps iterate ``x = T(x) + c`` for a small c > 0; as soon
  as a sweep raises no unknown by more than c less the rounding, T(x) <= x holds, certified. This is
  optimistic value iteration (Hartmanns and Kaminski 2020) with the guess made from the start.
- The policy is greedy for ``hi`` and made to leave the block surely. ``lo`` iterates its own rows
  with -2 c until no unknown falls by more than that: lo <= T(lo), and the policy is worth lo.
- hi - lo is at most some 4 c times the expected stay in the block; if that is too wide, c shrinks.
- Where other rows than the policy's raise hi after all (one may linger at next to no loss), hi is
  lifted until T(hi) <= hi; it leaps ahead where that takes long, for any such hi will do.
- Where sweeps creep (slow mixing), the policy is solved by elimination and improved (Howard 1960),
  and the result verified by the same two inequalities.

Why these are bounds: the cores that are built have no end component in which one could stay without
loss (they are merged, see `menid_solvers.end_components`), so that T(hi) <= hi bounds every policy
that leaves, and the others earn minus infinity (Bertsekas and Tsitsiklis 1991).
Rounding: with n outcomes of a row at most, its weights are off by (3/2 n + 5) * 2^-53 of their sum,
and the sum of n products and a constant by n + 1 roundings of numbers up to twice the largest value.
Together that is less than the `unit` (3 n + 12) * 2^-53 times the largest value; c is never smaller
than 2.5 times that. If this makes the gap too wide the answer says so.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

import numpy as np

from menid_plan.mdp.model import Bools, Floats, Ints
from menid_plan.solving import Progress
from menid_solvers import bound_kernels as kernels
from menid_solvers import elimination_kernels as elimination
from menid_solvers.core import Core
from menid_solvers.sweep_kernels import choose_policy, slack, sweep_all

ROUNDING = 1.2e-16  # a little over 2^-53
CHEAP = 1e5  # what elimination of a block may cost in any case, in operations
SHIFTS = 12  # shifts that are tried, each twice the one before
WORK = 3e7  # entries read between two returns to Python: a tenth of a second or less


@dataclass(slots=True)
class Limits:
    """What a solve may use, and has used; shared by its stages."""

    max_iterations: int | None = None
    max_seconds: float | None = None
    progress: Progress | None = None
    started: float = field(default_factory=time.perf_counter)
    iterations: int = 0
    interrupted: bool = False

    @property
    def iterations_left(self) -> int:
        """How many sweeps are left."""
        most = 2**62 if self.max_iterations is None else self.max_iterations
        return max(0, most - self.iterations)

    @property
    def reached(self) -> bool:
        """Whether to stop."""
        late = self.max_seconds is not None and self.seconds >= self.max_seconds
        return self.interrupted or self.iterations_left == 0 or late

    @property
    def seconds(self) -> float:
        """Since the start."""
        return time.perf_counter() - self.started

    @property
    def reason(self) -> str:
        """Why it stopped, in words."""
        if self.interrupted:
            return "interrupted"
        if self.iterations_left == 0:
            return f"stopped after {self.max_iterations} iterations"
        return f"stopped after {self.max_seconds:g} seconds"


@dataclass(frozen=True, slots=True, eq=False)
class Enclosure:
    """Bounds and a policy of a core's unknowns; complete: every block was finished.

    ``given_up``: some are wide because sweeps were not enough, rather than for rounding.
    """

    lo: Floats
    hi: Floats
    policy: Ints
    complete: bool
    given_up: bool


def enclose(
    core: Core,
    epsilon: float,
    limits: Limits,
    *,
    lowest: float,
    highest: float,
    start: Floats | None = None,
    watch: int = -1,
) -> Enclosure:
    """Bounds of the unknowns that are at most epsilon apart, if the limits and doubles allow.

    What was not reached is between ``lowest`` and ``highest``. ``start`` (float64[u]) is a guess,
    ``watch`` the unknown whose bounds the progress tells.
    """
    hi = np.zeros(core.unknowns) if start is None else start.copy()
    lo = np.full(core.unknowns, lowest)
    stay = np.zeros(core.unknowns)
    policy = np.full(core.unknowns, -1, np.int64)
    leaves = np.zeros(core.unknowns, np.bool_)
    taken = (  # a policy's rows; memory that is not written to is never had
        np.empty(core.unknowns + 1, np.int64), np.empty(len(core.target), np.uint32),
        np.empty(len(core.target)), np.empty(core.unknowns),
    )  # fmt: skip
    state, measured = np.zeros(kernels.STATE), np.zeros(3)
    state[kernels.LARGEST] = max(
        np.max(core.constant, initial=0.0), -np.min(core.constant, initial=0.0)
    )
    finite = core.floor[np.isfinite(core.floor)]
    state[kernels.LARGEST] += np.max(np.abs(finite), initial=0.0)
    # Sweeps from 0 stay below values that are not negative: bounds for whoever stops early.
    guess = start is None and lowest < 0.0
    pace = _Pace()
    before = limits.iterations
    most = limits.iterations_left
    code = kernels.MORE
    try:
        while code != kernels.DONE:
            if limits.reached and code == kernels.MORE and state[kernels.BLOCK] < core.blocks:
                break
            code = kernels.advance(
                *core.rows(), core.block_first, core.depth, core.longest,
                core.discount, epsilon, highest, guess, WORK, most, state, hi, lo, stay, policy,
                leaves, *taken, measured,
            )  # fmt: skip
            limits.iterations = before + int(state[kernels.SWEEPS])
            if code == kernels.SLOW:
                sweeps = pace.sweeps_left(state)
                at = int(state[kernels.BLOCK])
                if _eliminate(core, epsilon, sweeps, state, hi, lo, policy, leaves):
                    stay[core.block_first[at] : core.block_first[at + 1]] = 0.0
                else:
                    state[kernels.PATIENCE] = 1.5 * state[kernels.BLOCK_SWEEPS]
            if limits.progress is not None:
                at = int(core.block_first[int(state[kernels.BLOCK])])
                known = watch < at
                limits.progress(
                    limits.iterations,
                    float(lo[watch]) if known else lowest,
                    float(hi[watch]) if known else highest,
                )
    except KeyboardInterrupt:
        limits.interrupted = True
    complete = code == kernels.DONE
    if not complete:
        _partial(core, state, hi, lo, policy, lowest, highest, lowest == 0.0 and start is None)
    return Enclosure(
        np.clip(lo, lowest, highest), np.clip(hi, lowest, highest), policy, complete,
        state[kernels.GIVEN_UP] > 0.0,
    )  # fmt: skip


@dataclass(slots=True)
class _Pace:
    """Foretells how many more sweeps a block will take, from how fast the changes shrank."""

    block: float = -1.0
    phase: float = -1.0
    shift: float = 0.0
    sweeps: float = 0.0
    residual: float = 0.0

    def sweeps_left(self, state: Floats) -> float:
        """An estimate, inf while there is nothing to estimate from; remembers the state."""
        block, phase, shift = state[kernels.BLOCK], state[kernels.PHASE], state[kernels.SHIFT]
        sweeps, residual = state[kernels.BLOCK_SWEEPS], state[kernels.RESIDUAL]
        left = math.inf
        if (block, phase, shift) == (self.block, self.phase, self.shift) and residual > shift:
            rate = math.log(max(self.residual / residual, 1.0 + 1e-9)) / (sweeps - self.sweeps)
            left = math.log(residual / shift) / rate
        self.block, self.phase, self.shift = float(block), float(phase), float(shift)
        self.sweeps, self.residual = float(sweeps), float(residual)
        return left


def _partial(
    core: Core,
    state: Floats,
    hi: Floats,
    lo: Floats,
    policy: Ints,
    lowest: float,
    highest: float,
    from_below: bool,
) -> None:
    """Put true bounds where blocks were not finished; the policy there is merely allowed."""
    block = min(int(state[kernels.BLOCK]), core.blocks)
    first = int(core.block_first[block])
    begun = block < core.blocks and state[kernels.PHASE] != kernels.START
    last = int(core.block_first[block + 1]) if begun else first
    high = np.full(last - first, highest)
    width = float(np.max(hi[:first] - lo[:first], initial=0.0))
    low = np.full(last - first, lowest)
    unit = kernels.ROUNDING * (3 * core.longest + 12)
    if begun and core.discount < 1.0 and state[kernels.BLOCK_SWEEPS] > 0:
        # After a sweep that changes x by at most d: |T(x) - x| <= d and a little, and T contracts.
        # What was measured last will not do: sweeps of one policy, or upward, may have followed.
        x, measured = hi[first:last], np.zeros(3)
        largest = max(float(state[kernels.LARGEST]), float(np.max(np.abs(x))))
        sweep_all(first, last, *core.rows(), hi, policy, measured)
        change = max(measured[0], measured[1]) + 2.0 * unit * max(largest, measured[2])
        reach = change / (1.0 - core.discount) * (1.0 + 1e-9)
        high = np.fmin(high, x + reach)  # what overflowed does not count
        low = np.fmax(low, x - reach - width)
    elif begun and state[kernels.PHASE] == kernels.UPPER:
        low = np.fmax(low, lo[first:last])  # certified already
    elif begun and from_below:
        # Sweeps that started below the values stay below, but for the rounding of each; up to 30 of
        # one policy follow each that is counted.
        sweeps = (state[kernels.BLOCK_SWEEPS] + 1) * 31 * (last - first)
        low = np.fmax(low, hi[first:last] - width - sweeps * unit * state[kernels.LARGEST])
    unset = np.arange(first, core.unknowns)
    lowest_row = core.first_row[unset]
    has_row = lowest_row < core.first_row[unset + 1]
    keep = (policy[unset] >= 0) | ~has_row
    policy[unset] = np.where(keep, policy[unset], lowest_row)
    hi[first:last] = high
    lo[first:last] = low
    hi[last:] = highest
    lo[last:] = lowest


def _eliminate(
    core: Core,
    epsilon: float,
    sweeps_left: float,
    state: Floats,
    hi: Floats,
    lo: Floats,
    policy: Ints,
    leaves: Bools,
) -> bool:
    """Solve the block at hand by policy iteration; False (and nothing lost) if that is no use."""
    block = int(state[kernels.BLOCK])
    first, last = int(core.block_first[block]), int(core.block_first[block + 1])
    band = elimination.bandwidth(first, last, core.first_row, core.first_entry, core.target)
    entries = core.first_entry[core.first_row[last]] - core.first_entry[core.first_row[first]]
    cost = (last - first) * max(band, 1) ** 2
    # Where nothing is foretold it may take a tenth of the time so far.
    worth = 3.0 * sweeps_left if math.isfinite(sweeps_left) else math.inf
    worth = min(worth, (3.0 if worth < math.inf else 0.03) * state[kernels.BLOCK_SWEEPS])
    rounds = min(50.0, max(CHEAP, worth * entries) / cost)
    if cost > 1e9 or rounds < 3:
        return False
    if (last - first) * (2 * band + 1) > 5e7:
        return False
    deepest = max(1, int(core.depth.max()))
    allowed = epsilon * max(int(core.depth[block]), 1) / deepest
    own = epsilon / deepest
    part = slice(first, last)
    x = hi.copy()
    before = policy[part].copy()  # which may be the one that lo is certified for
    choose_policy(first, last, state[kernels.SHIFT], False, *core.rows(), x, policy, leaves)
    n = last - first
    answer = np.empty((n, 3))
    room = np.empty((n, 2 * band + 1)), np.empty(n), np.empty(n)
    leaving = policy[part].copy()
    below = lo.copy()
    slacks = np.empty(3)
    scale, shift = 1.0, math.inf
    unit = kernels.ROUNDING * (3 * core.longest + 12)
    for _ in range(int(rounds)):
        state[kernels.SWEEPS] += 1
        if not elimination.solve_policy(
            first, last, band, *core.rows(), hi, lo, policy, answer, *room
        ):
            # Staying costs less than the shift pays for it: a smaller one.
            policy[part] = leaving
            scale /= 1000.0
            continue
        longest_stay = float(np.max(answer[:, 2]))
        largest = max(float(state[kernels.LARGEST]), float(np.max(np.abs(answer[:, :2]))))
        # Never larger again: by a larger one it may pay to stay, by that for staying not, in turn.
        shift = min(shift, scale * own / (4.0 * longest_stay))
        told = max(shift, 1.5 * unit * largest)
        x[part] = answer[:, 0] + told * answer[:, 2]
        if elimination.improve_policy(first, last, told, told / 4, *core.rows(), x, policy) == 0:
            break
    else:
        policy[part] = before
        return False
    # The least shift that is more than what elimination rounded off.
    wanted, shift = shift, max(shift, 0.1 * unit * largest)
    for _ in range(SHIFTS):
        x[part] = answer[:, 0] + shift * answer[:, 2]
        below[part] = answer[:, 1] - shift * answer[:, 2]
        slack(first, last, unit, *core.rows(), x, below, policy, slacks)
        if min(slacks[0], slacks[1]) >= 0.0:
            break
        shift *= 2.0
    gap = float(np.max(x[part] - below[part]))
    if not min(slacks[0], slacks[1]) >= 0.0 or (gap > allowed and shift <= wanted):
        policy[part] = before
        return False
    lo[part] = below[part]
    state[kernels.PHASE] = kernels.UPPER  # whoever interrupts here finds lo certified
    hi[part] = x[part]
    sizes = float(np.max(np.abs(x[part]))), float(np.max(np.abs(below[part])))
    state[kernels.LARGEST] = max(largest, *sizes)
    state[kernels.BLOCK] += 1
    state[kernels.PHASE] = kernels.START
    return True
