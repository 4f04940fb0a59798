"""The rule: test where that earns the most by the second, else execute, and count what that teaches.

docs/allocation.md derives it. It looks at a `View`: the rows in which distributions are made use of.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from menid_plan.allocation import worth
from menid_plan.allocation.belief import LEAST, PRIOR, RELATIONS, STRENGTH, Belief
from menid_plan.mdp.model import Floats, Ints

# So many tests, or executions, are looked ahead.
TESTS: Ints = np.array([1, 4, 16, 64])
EXECUTIONS: Ints = np.array([1, 2, 4, 8, 16, 32])
# For so many executions what a test taught is counted as gain: later the target itself would teach it.
USED_FOR = 20.0
# Where there are only costs, this part of the largest of them stands for the highest reward.
PART_OF_COST = 1.0 / 11.0
# Time for tests: as much as so many executions take, and a share of the clock.
FIRST_TESTS = 10.0
SHARE = 0.25
# What an execution earns at least for its time to be worth something: a part of its highest reward.
LEAST_WORTH = 0.1
# A difference so small that it only decides where there is no other.
ALIKE = 1e-6
# Rows that are looked at, those that matter most.
MOST_ROWS = 400


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What there is to choose from, as the belief has it: R rows, in which distributions are used.

    ``distribution`` (int64[R]) is that of a row, ``payoffs`` (float64[R, K]) what each of its outcomes
    brings in, what follows included, ``others`` (float64[R]) what the best of the other rows in its
    state does, and ``visits`` (float64[R]) how often a second its state is come to. ``seconds``
    (float64[R]) is how long an execution takes, ``test_seconds`` (float64[tests, R]) how long a test,
    above 0, and infinite where there can be none. A second earns ``rate`` if one does what is best by
    what is expected, and ``hoped`` if one knew what is best; ``most`` is the highest reward that a
    second may bring.
    """

    distribution: Ints
    payoffs: Floats
    others: Floats
    visits: Floats
    seconds: Floats
    test_seconds: Floats
    rate: float
    hoped: float
    most: float


@dataclass(frozen=True, slots=True)
class Tests:
    """To execute the action of a row so often in a test (from 0 on)."""

    row: int
    test: int
    number: int
    gain: float


@dataclass(slots=True)
class Rule:
    """Compares by the second; remembers what it has worked out until the shared weights change.

    ``order`` (float64[D], from 0 to 1) decides between distributions that are alike: it is to be
    random, lest the order of a file helps or harms.
    """

    belief: Belief
    order: Floats
    _memory: dict[bytes, Floats] = field(default_factory=dict)

    def forget(self) -> None:
        """The shared weights have changed."""
        self._memory.clear()

    def tests(self, view: View, left: float, passed: float, tested: float) -> Tests | None:
        """The tests that earn the most a second, if any earn something.

        ``left`` are the seconds that the run has left, ``passed`` those that went by, of which
        ``tested`` were for tests.
        """
        execution = float(view.seconds.mean())
        if tested > FIRST_TESTS * execution + SHARE * passed:
            return None
        best: Tests | None = None
        unit = highest_reward(view, self.belief.outcomes)
        if unit <= 0.0:
            return None  # whatever comes of anything, it is all the same
        used = min(USED_FOR * execution, left)
        floor = LEAST_WORTH * unit / execution
        for test in range(self.belief.tests):
            rows = np.flatnonzero(np.isfinite(view.test_seconds[test]))
            rows, gains = self._gains(view, rows, test)
            if not len(rows):
                continue
            of = view.distribution[rows]
            total = np.zeros((len(self.belief.outcomes), len(TESTS)))
            np.add.at(total, of, gains)
            improved = total[of]
            took = view.test_seconds[test, rows][:, None] * TESTS
            price = np.maximum(np.maximum(view.hoped, view.rate + improved), floor)
            net = (improved * (used - took) - price * took) / took
            net = np.where(took <= left, net * (1.0 + ALIKE * self.order[of][:, None]), 0.0)
            row, size = np.unravel_index(int(net.argmax()), net.shape)
            if net[row, size] > (best.gain if best else 0.0):
                # In which state the distribution is tested: where it matters most.
                row = np.flatnonzero(of == of[row])[gains[of == of[row], size].argmax()]
                best = Tests(int(rows[row]), test, int(TESTS[size]), float(net[row, size]))
        return best

    def bonuses(self, view: View, left: float) -> Floats:
        """What an execution of each distribution teaches is worth: float64[D], in units of reward."""
        rows, gains = self._gains(view, np.arange(len(view.distribution)), None)
        found = np.zeros(len(self.order))
        if len(rows):
            took = view.seconds[rows][:, None] * EXECUTIONS
            worths = gains * np.maximum(left - took, 0.0) / EXECUTIONS
            total = np.zeros((len(found), len(EXECUTIONS)))
            np.add.at(total, view.distribution[rows], worths)
            found = total.max(axis=1)
        return found + ALIKE * view.most * float(view.seconds.mean()) * self.order

    def _gains(self, view: View, rows: Ints, test: int | None) -> tuple[Ints, Floats]:
        """Rows that matter, and what a second is worth more after so many tests (or executions)."""
        belief = self.belief
        payoffs = view.payoffs[rows]
        outcomes = belief.outcomes[view.distribution[rows]]
        has = np.arange(payoffs.shape[1]) < outcomes[:, None]
        low = np.where(has, payoffs, np.inf).min(axis=1)
        span = np.where(has, payoffs, -np.inf).max(axis=1) - low
        with np.errstate(divide="ignore", invalid="ignore"):
            others = np.round((view.others[rows] - low) / span, 4)
            scaled = np.where(has, (payoffs - low[:, None]) / span[:, None], 0.0)
        weight = view.visits[rows] * span
        matter = (span > 0.0) & (others > 0.0) & (others < 1.0) & (weight > 0.0)
        if np.count_nonzero(matter) > MOST_ROWS:
            matter &= weight >= np.partition(weight[matter], -MOST_ROWS)[-MOST_ROWS]
        rows, others, scaled, weight = rows[matter], others[matter], scaled[matter], weight[matter]
        sizes = EXECUTIONS if test is None else TESTS
        if not len(rows):
            return rows, np.zeros((0, len(sizes)))
        of = view.distribution[rows]
        mark = np.full((len(rows), 1), -1.0 if test is None else float(test))
        keys = np.concatenate(
            [
                mark, others[:, None], scaled, belief.groups[of, None],
                belief.counts[of].reshape(len(of), -1),
            ],
            axis=1,
        )  # fmt: skip
        names = [key.tobytes() for key in keys]
        missing = {name: i for i, name in enumerate(names) if name not in self._memory}
        if missing:
            at = np.array(list(missing.values()))
            found = self._worked_out(of[at], scaled[at], others[at], test, sizes)
            self._memory.update(zip(missing, found, strict=True))
        return rows, np.array([self._memory[name] for name in names]) * weight[:, None]

    def _worked_out(
        self, of: Ints, scaled: Floats, others: Floats, test: int | None, sizes: Ints
    ) -> Floats:
        """By the kernels: float64[rows, sizes], in units of the scaled payoffs."""
        belief = self.belief
        gains = np.zeros((len(of), len(sizes)))
        has = belief.parameters[of].sum(axis=2) > 0.0
        up = (belief.parameters[of] @ scaled[:, :, None])[:, :, 0]
        down = belief.parameters[of].sum(axis=2) - up
        seen = belief.counts[of]
        successes = (seen @ scaled[:, :, None])[:, :, 0]
        failures = seen.sum(axis=2) - successes
        if test is None:
            weight = np.where(has, belief.weights[of], 0.0)
            a = np.where(has, up + successes[:, :1], 1.0)
            b = np.where(has, down + failures[:, :1], 1.0)
            worth.executions(a, b, weight, others, sizes, np.empty(a.shape[1]), gains)
            return gains
        columns = np.r_[RELATIONS * test : RELATIONS * (test + 1)]
        rest = np.setdiff1d(np.arange(belief.components), columns)
        weight = belief.prior_weights(belief.shared, of, test)[:, rest]
        own = np.tile(belief.shared.related[test], (len(of), 1))
        # Classes of its own for a coin: those of the distribution, seen through the payoffs.
        known = np.stack(
            [
                successes[:, 0], failures[:, 0], successes[:, 1 + test], failures[:, 1 + test],
                scaled.sum(axis=1), belief.outcomes[of].astype(np.float64), others,
            ],
            axis=1,
        )  # fmt: skip
        class_a = (belief.classes[of] @ scaled[:, :, None])[:, :, 0]
        class_b = belief.classes[of].sum(axis=2) - class_a
        space = np.empty((4, belief.components + RELATIONS))
        worth.tests(
            np.ascontiguousarray(up[:, rest]), np.ascontiguousarray(down[:, rest]),
            np.ascontiguousarray(weight), own, class_a, class_b, known, STRENGTH, PRIOR, LEAST,
            sizes, space, gains,
        )  # fmt: skip
        return gains


def highest_reward(view: View, outcomes: Ints) -> float:
    """The highest reward of an execution; where all there is are costs, a part of the largest.

    ``outcomes`` (int64[D]) is how many each distribution has.
    """
    if view.most > 0.0:
        return view.most * float(view.seconds.mean())
    has = np.arange(view.payoffs.shape[1]) < outcomes[view.distribution][:, None]
    high = np.where(has, view.payoffs, -np.inf).max(axis=1)
    span = float((high - np.where(has, view.payoffs, np.inf).min(axis=1)).max())
    return PART_OF_COST * span
