"""Estimators on random rules: the error of their estimates, and the reward that they earn.

Nothing is executed: truths are drawn, what a test has to do with the target is given, and counts are
drawn from both.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from menid_plan.environments.seeds import seed_of
from menid_plan.learning.confidence import delta
from menid_plan.learning.estimators import ESTIMATORS, Empirical, Estimator, estimator
from menid_plan.learning.mixtures import Floats
from menid_plan.studies.pieces import Row

TARGET_ONLY = "target only"
"""What the mean of Dir(1 + x1) is called, beside the estimators' names."""

CANDIDATES: Mapping[str, tuple[str, Mapping[str, float]]] = {
    **{name: (name, {}) for name in ESTIMATORS},
    "robust, u .98": ("robust", {"weight": 0.98}),
    "sam, odds 50": ("sam", {"odds": 50.0}),
}
"""What is compared, by what it is called: the name of an estimator, and options.

All with their own options, and two that trust tests more beforehand: where there are many actions, a
little distrust of each test lets many be tried that it has shown to be bad.
"""


def moved(p: Floats, gap: float, rng: np.random.Generator) -> Floats:
    """Distributions (float64[n, k]) at a total variation of ``gap`` from each of ``p`` (float64[n, k]).

    Each is moved straight towards one certain outcome, drawn among those for which that can be done;
    ValueError if there is none.
    """
    lots = np.where(1.0 - p >= gap, rng.random(p.shape), -1.0)
    outcome = lots.argmax(axis=1)
    rows = np.arange(len(p))
    if lots[rows, outcome].min(initial=0.0) < 0.0:
        raise ValueError(f"no outcome is improbable enough for a gap of {gap:g}")
    share = gap / (1.0 - p[rows, outcome])
    found: Floats = (1.0 - share)[:, None] * p
    found[rows, outcome] += share
    return found


def squared_errors(table: Floats, truth: Floats) -> Floats:
    """The squared L2 error of each estimate (float64[1 + candidates]), the target only first.

    ``table`` is float64[environments, k], the target first, ``truth`` float64[k].
    """
    found = [_makers()[Empirical.name].posterior(table).mean()]
    found += [maker.posterior(table).estimate() for maker in _makers().values()]
    squares: Floats = ((np.array(found) - truth) ** 2).sum(axis=1)
    return squares


def root_mean_squares(squares: Floats) -> Row:
    """Root mean squares, and half of their 95 % intervals.

    ``squares`` are squared errors, float64[n, sizes, 1 + candidates].
    """
    errors = np.sqrt(squares.mean(axis=0))
    with np.errstate(divide="ignore", invalid="ignore"):
        halves = 1.96 * squares.std(axis=0) / (2.0 * errors * math.sqrt(len(squares)))
    names = (TARGET_ONLY, *CANDIDATES)
    return {
        "errors": dict(zip(names, errors.T.tolist(), strict=True)),
        "halves": dict(zip(names, np.nan_to_num(halves).T.tolist(), strict=True)),
    }


@dataclass(frozen=True, slots=True)
class ErrorTask:
    """Truths from Dir(2) over some ``outcomes``; a test with ``n2`` executions at each of the ``gaps``.

    ``n1`` are the sizes of the sample in the target, which grows.
    """

    outcomes: int
    n2: int
    gaps: tuple[float, ...]
    n1: tuple[int, ...]
    repetitions: int
    seed: int

    @property
    def name(self) -> str:
        """Tells it from all others."""
        gaps = " and ".join(f"{gap:g}" for gap in self.gaps)
        return (
            f"error: {self.outcomes} outcomes, N2 {self.n2}, gap {gaps}, {self.repetitions} times"
        )

    def run(self) -> Row:
        """The errors of all estimators; see `root_mean_squares`."""
        rng = np.random.default_rng(seed_of(self.seed, self.name))
        truths = rng.dirichlet([2.0] * self.outcomes, self.repetitions)
        tests = [rng.multinomial(self.n2, moved(truths, gap, rng)) for gap in self.gaps]
        steps = [rng.multinomial(step, truths) for step in np.diff(self.n1, prepend=0)]
        target = np.cumsum(steps, axis=0)
        squares = [
            [
                squared_errors(np.array([seen[i], *(test[i] for test in tests)], float), truth)
                for seen in target
            ]
            for i, truth in enumerate(truths)
        ]
        return root_mean_squares(np.array(squares))


@cache
def _makers() -> dict[str, Estimator]:
    return {called: estimator(name, **options) for called, (name, options) in CANDIDATES.items()}


# ------------------------------------------------------------------------------------ random actions

ACTIONS = 20
_SKEW = (0.3, 0.7)  # of the Beta distribution that success probabilities come from
_TARGET, _TEST, _TIME = 30.0, 0.4, 20.0  # seconds: an execution, a test, and T
_DELTA = _EPSILON = 0.05
MINUTES = (10, 60)
"""When reward is looked at."""

_Lie = Callable[[Floats, np.random.Generator], Floats]


def _noise(size: float) -> _Lie:
    return lambda p, rng: np.clip(p + rng.normal(0.0, size, len(p)), 0.0, 1.0)


def _half_permuted(p: Floats, rng: np.random.Generator) -> Floats:
    q = p.copy()
    some = rng.permutation(len(p))[: len(p) // 2]
    q[some] = p[rng.permutation(some)]
    return q


CASES: Mapping[str, _Lie] = {
    "right": lambda p, _: p,
    "noise 0.1": _noise(0.1),
    "noise 0.2": _noise(0.2),
    "half wrong": _half_permuted,
    "permuted": lambda p, rng: rng.permutation(p),
}
"""What the tests' success probabilities (float64[actions]) have to do with the target's."""


@dataclass(frozen=True, slots=True)
class RewardTask:
    """An hour with 20 actions that succeed or fail, learned of by each estimator in turn.

    Success probabilities come from Beta(.3, .7). An execution takes 30 s in the target and .4 s in the
    test. The learner is Algorithm 1 of Suárez-Hernández et al. 2020: Thompson sampling, T = 20 s, delta
    and epsilon .05. All estimators meet the same truth, the same tests and the same outcomes: the n-th
    execution of an action ends alike for each. ``empirical`` does not test.
    """

    case: str
    number: int
    seed: int

    @property
    def name(self) -> str:
        """Tells it from all others."""
        return f"reward: {self.case}, {self.number}"

    def run(self) -> Row:
        """Successes and failures by each of MINUTES, by what the candidates are called."""
        rng = np.random.default_rng(seed_of(self.seed, "reward", self.number))
        p = rng.beta(*_SKEW, ACTIONS)
        ends = rng.random((ACTIONS, math.ceil(60 * MINUTES[-1] / _TARGET))) < p[:, None]
        q = CASES[self.case](p, rng)
        size = math.ceil(_TIME / _TEST)
        # Of 400 tests the delta is below .05 for certain.
        tests = rng.binomial(size, q[:, None], (ACTIONS, math.ceil(400 / size)))
        return {
            name: _hour(
                maker, ends, tests if name != Empirical.name else tests[:, :0], size,
                np.random.default_rng(seed_of(self.seed, "draws", self.number)),
            )
            for name, maker in _makers().items()
        }  # fmt: skip


def _hour(
    maker: Estimator, ends: np.ndarray, tests: np.ndarray, size: int, rng: np.random.Generator
) -> Row:
    """One run: ``ends`` bool[actions, n] of executions, ``tests`` int[actions, m] of batches."""
    counts = np.zeros((ACTIONS, 2, 2))  # by action: target and test, successes and failures
    beliefs = [maker.posterior(table) for table in counts]
    batches = [0] * ACTIONS
    marked: set[int] = set()
    clock, result = 0.0, np.zeros((len(MINUTES), 2))
    until = 60.0 * np.array(MINUTES)
    while clock < until[-1]:
        a = int(np.argmax([belief.sample(rng)[0] for belief in beliefs]))
        row = counts[a]
        unsure = batches[a] < tests.shape[1] and _delta(*map(int, row[1])) > _DELTA
        if unsure and a not in marked:
            marked.add(a)
            good = int(tests[a, batches[a]])
            row[1] += good, size - good
            batches[a] += 1
            clock += _TIME
        else:
            marked.discard(a)
            outcome = 0 if ends[a, int(row[0].sum())] else 1
            row[0, outcome] += 1
            clock += _TARGET
            result[clock <= until, outcome] += 1
        beliefs[a] = maker.posterior(row)
    return {"successes": result[:, 0].tolist(), "failures": result[:, 1].tolist()}


@cache
def _delta(successes: int, failures: int) -> float:
    return delta([successes, failures], _EPSILON)


def drawn_errors(
    truths: Sequence[Sequence[Floats]], n2: int, n1: Sequence[int], repetitions: int, seed: int
) -> list[Floats]:
    """Squared errors of distributions that are known in every environment.

    ``truths`` are, of each distribution, those of the target and of the tests (float64[k]). Gives for
    each float64[repetitions, sizes, 1 + candidates].
    """
    rng = np.random.default_rng(seed)
    found = []
    for target, *tests in truths:
        seen = rng.multinomial(np.diff(n1, prepend=0), target, (repetitions, len(n1)))
        others = [rng.multinomial(n2, test, repetitions) for test in tests]
        rows = [
            [
                squared_errors(np.array([row, *(test[i] for test in others)], float), target)
                for row in np.cumsum(seen[i], axis=0)
            ]
            for i in range(repetitions)
        ]
        found.append(np.array(rows))
    return found
