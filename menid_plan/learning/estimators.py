"""Estimators of the target's outcome distribution from what was seen in several environments.

All are conjugate: each makes a Dirichlet distribution, or a mixture of them, of a table of counts.
docs/estimating.md has the formulas side by side, and when to use which.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike

from menid_plan.errors import MenidError
from menid_plan.learning.mixtures import (
    MOST,
    DirichletMixture,
    Floats,
    log_beta,
    log_evidence,
    normalised,
)

# 2^12 subsets of tests are what one update may still weigh up.
MAX_TESTS = 12
_ONE = np.ones(1)


class UnknownEstimatorError(MenidError):
    """There is no estimator of that name, or it has no such option."""

    exit_code = 2


class Estimator(Protocol):
    """A frozen dataclass of options that turns counts into a belief about the target.

    ``promise`` says in a line when it is right, ``reference`` whose it is.
    """

    name: ClassVar[str]
    promise: ClassVar[str]
    reference: ClassVar[str]

    def posterior(self, counts: ArrayLike, prior: ArrayLike | None = None) -> DirichletMixture:
        """What is believed about the target after some counts.

        ``counts`` (float64[e, k]) says how often each of k outcomes was seen: row 0 in the target, the
        others in the tests, in their order; they may be fractional. ``prior`` (float64[k]) are pseudo
        counts, such as given probabilities times a weight. Raises ValueError for counts of another
        shape, negative, not finite, or whose sum is beyond 1e12.
        """


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """Counts that were looked over: of the target, of the tests that have any, and the pseudo counts.

    ``rows`` says which tests those are.
    """

    target: Floats
    tests: Floats
    rows: tuple[int, ...]
    prior: Floats

    @property
    def base(self) -> Floats:
        """The parameters of the belief before anything was seen: Dir(1), and the pseudo counts."""
        found: Floats = self.prior + 1.0
        return found


def _seen(counts: ArrayLike, prior: ArrayLike | None) -> tuple[_Seen, int]:
    """The counts as arrays, and the number of tests, those without data included."""
    table = np.asarray(counts, np.float64)
    if table.ndim != 2 or 0 in table.shape:
        raise ValueError(f"counts must be a table [environments, outcomes], not {table.shape}")
    pseudo = np.zeros(table.shape[1]) if prior is None else np.asarray(prior, np.float64)
    if pseudo.shape != table.shape[1:]:
        raise ValueError(f"the prior has the shape {pseudo.shape}, and not {table.shape[1:]}")
    sums = [*np.add.reduce(table, axis=1).tolist(), float(np.add.reduce(pseudo))]
    if not all(map(math.isfinite, sums)):
        raise ValueError("counts must be finite")
    if np.minimum.reduce(table, axis=None) < 0.0 or np.minimum.reduce(pseudo) < 0.0:
        raise ValueError("counts must not be below 0")
    if max(sums) > MOST:
        raise ValueError(f"the counts of an environment sum to {max(sums):g}, beyond {MOST:g}")
    rows = tuple(row for row in range(1, len(table)) if sums[row] > 0.0)
    tests = table[1:] if len(rows) == len(table) - 1 else table[list(rows)]
    return _Seen(table[0], tests, tuple(row - 1 for row in rows), pseudo), len(table) - 1


def _single(weighted: Floats, prior: Floats) -> DirichletMixture:
    """Dir(1 + counts), and as the estimate its mode: uniform where nothing has weight."""
    total = weighted + prior
    size = float(np.add.reduce(total))
    point = total / size if size > 0.0 else np.full(len(total), 1.0 / len(total))
    return DirichletMixture(_ONE, (total + 1.0)[None, :], point)


def _weighed(parameters: Floats, log_prior: Floats, target: Floats) -> DirichletMixture:
    """A mixture of priors (float64[m, k]) with log weights, after the target's counts."""
    weights = normalised(log_prior + log_evidence(parameters, target))
    return DirichletMixture(weights, parameters + target)


@dataclass(frozen=True, slots=True)
class Empirical:
    """The target's own frequencies: x1 / N1. Belief: Dir(1 + x1).

    What the paper's baseline T = 0 learns by (Suárez-Hernández et al. 2020, the empirical
    distribution of section II).
    """

    name: ClassVar[str] = "empirical"
    promise: ClassVar[str] = "the target alone; right in the end, whatever the tests are worth"
    reference: ClassVar[str] = "Suárez-Hernández et al. 2020, the baseline"

    def posterior(self, counts: ArrayLike, prior: ArrayLike | None = None) -> DirichletMixture:
        """What is believed of the target; see `Estimator.posterior`."""
        seen, _ = _seen(counts, prior)
        return _single(seen.target, seen.prior)


@dataclass(frozen=True, slots=True)
class Pooled:
    """All environments as if they were one: sum_j x_j / sum_j N_j. Belief: Dir(1 + sum_j x_j).

    The best there is if the tests equal the target (Suárez-Hernández et al. 2020, Proposition 1).
    """

    name: ClassVar[str] = "pooled"
    promise: ClassVar[str] = "best if the tests equal the target; else as wrong as they are"
    reference: ClassVar[str] = "Suárez-Hernández et al. 2020, Proposition 1"

    def posterior(self, counts: ArrayLike, prior: ArrayLike | None = None) -> DirichletMixture:
        """What is believed of the target; see `Estimator.posterior`."""
        seen, _ = _seen(counts, prior)
        return _single(seen.target + np.add.reduce(seen.tests, axis=0), seen.prior)


@dataclass(frozen=True, slots=True)
class DecreasingM:
    """(x1 + sum_j w_j x_j) / (N1 + sum_j w_j N_j) with w_j = m_j / sqrt(1 + N1).

    ``m`` is one number for all tests, or one for each in their order. Belief: the Dirichlet
    distribution whose mode this is. Suárez-Hernández et al. 2020, the decreasing-m-estimate, after
    Martínez et al. 2015; several tests are ours.
    """

    name: ClassVar[str] = "decreasing-m"
    promise: ClassVar[str] = "quick while target data is scarce and the tests are near the target"
    reference: ClassVar[str] = "Suárez-Hernández et al. 2020, the decreasing-m-estimate"

    m: float | tuple[float, ...] = 10.0

    def __post_init__(self) -> None:
        if isinstance(self.m, Sequence):
            object.__setattr__(self, "m", tuple(_number("m", m) for m in self.m))
        each = self.m if isinstance(self.m, tuple) else (_number("m", self.m),)
        if not all(0.0 <= m <= MOST for m in each):
            raise ValueError(f"m must be finite, at most {MOST:g}, and not below 0")

    def posterior(self, counts: ArrayLike, prior: ArrayLike | None = None) -> DirichletMixture:
        """What is believed of the target; see `Estimator.posterior`.

        Raises ValueError if there is another number of tests than of ``m``.
        """
        seen, tests = _seen(counts, prior)
        each = self.m if isinstance(self.m, tuple) else (float(self.m),) * tests
        if len(each) != tests:
            raise ValueError(f"{len(each)} values of m were given for {tests} tests")
        scale = math.sqrt(1.0 + float(np.add.reduce(seen.target)))
        weights = np.array([each[row] / scale for row in seen.rows])
        return _single(seen.target + weights @ seen.tests, seen.prior)


@dataclass(frozen=True, slots=True)
class RobustMixture:
    """Either a test is right, or it says nothing: u Dir(1 + a x_j) + (1 - u) Dir(1).

    ``weight`` is u, the trust beforehand; a = min(1, cap / N_j), so that a test counts for at most
    ``cap`` observations. With several tests each has a component of weight u / their number. The
    robust prior of Schmidli et al. 2014.
    """

    name: ClassVar[str] = "robust"
    promise: ClassVar[str] = "drops a test that the target's data contradicts"
    reference: ClassVar[str] = "Schmidli et al. 2014, robust meta-analytic-predictive prior"

    weight: float = 0.5
    cap: float = 300.0

    def __post_init__(self) -> None:
        _check_share(self.weight)
        _check_positive("cap", self.cap)

    def posterior(self, counts: ArrayLike, prior: ArrayLike | None = None) -> DirichletMixture:
        """What is believed of the target; see `Estimator.posterior`."""
        seen, _ = _seen(counts, prior)
        each = len(seen.rows)
        logs = [math.log1p(-self.weight)] + [math.log(self.weight / max(1, each))] * each
        return _weighed(_or_nothing(seen, self.cap), np.array(logs), seen.target)


@dataclass(frozen=True, slots=True)
class SAM:
    """The robust mixture with a trust u that depends on the data: self-adapting.

    u / (1 - u) is the likelihood ratio of the target's counts, at the test's estimate q against the
    likeliest of the distributions in which one outcome's probability is ``shift`` above or below q's
    (the others keep their proportions). ``odds`` multiplies the ratio. Yang et al. 2023, for two
    outcomes; more outcomes and several tests are ours.
    """

    name: ClassVar[str] = "sam"
    promise: ClassVar[str] = "as robust, and drops a test sooner where it is off by the shift"
    reference: ClassVar[str] = "Yang et al. 2023, self-adapting mixture prior"

    shift: float = 0.15
    odds: float = 1.0
    cap: float = 300.0

    def __post_init__(self) -> None:
        _check_share(self.shift, "shift")
        _check_positive("odds", self.odds)
        _check_positive("cap", self.cap)

    def posterior(self, counts: ArrayLike, prior: ArrayLike | None = None) -> DirichletMixture:
        """What is believed of the target; see `Estimator.posterior`."""
        seen, _ = _seen(counts, prior)
        spread = math.log(self.odds) - math.log(max(1, len(seen.rows)))
        logs = [0.0] + [spread + self._log_ratio(row, seen.target) for row in seen.tests]
        return _weighed(_or_nothing(seen, self.cap), np.array(logs), seen.target)

    def _log_ratio(self, test: Floats, target: Floats) -> float:
        k, size = len(test), float(np.add.reduce(test))
        total = float(np.add.reduce(target))
        best = -math.inf if k > 1 else 0.0
        for seen, often in zip(test.tolist(), target.tolist(), strict=True) if k > 1 else ():
            q = (seen + 1.0) / (size + k)
            for moved in (min(q + self.shift, 1.0 - _EDGE), max(q - self.shift, _EDGE)):
                # The others keep their proportions, so that only the share of all of them counts.
                gain = often * math.log(moved / q)
                gain += (total - often) * math.log((1.0 - moved) / (1.0 - q))
                best = max(best, gain)
        return -best


# How close to 0 or 1 SAM's alternatives may come, where the shift would lead past them.
_EDGE = 1e-4


@dataclass(frozen=True, slots=True)
class PowerPrior:
    """A test's counts to an unknown power a: Dir(1 + sum_j a_j x_j), a_j uniform on a grid.

    ``points`` is the size of the grid on [0, 1]; with several tests it shrinks so that no more than
    some 500 combinations are weighed up. Ibrahim and Chen 2000; normalised, so that a can be learned,
    by Duan, Ye and Smith 2006. At most MAX_TESTS tests (ValueError).
    """

    name: ClassVar[str] = "power-prior"
    promise: ClassVar[str] = "learns how much a test counts; leans towards trust"
    reference: ClassVar[str] = "Duan, Ye and Smith 2006, normalised power prior"

    points: int = 21

    def __post_init__(self) -> None:
        _check_points(self.points, 2)

    def posterior(self, counts: ArrayLike, prior: ArrayLike | None = None) -> DirichletMixture:
        """What is believed of the target; see `Estimator.posterior`."""
        seen, _ = _seen(counts, prior)
        powers = _powers(_checked_number(seen), self.points)
        return _weighed(seen.base + powers @ seen.tests, np.zeros(len(powers)), seen.target)


@dataclass(frozen=True, slots=True)
class PrecisionGrid:
    """The target lies about the test, nobody knows how near: Dir(s q_j), s uniform on a grid.

    q_j = (x_j + 1) / (N_j + k). ``points`` values of s lie evenly in their logarithms from 1 to
    ``highest``. With several tests the target lies about one of them. A discrete form of the
    commensurate prior of Hobbs et al. 2011. Without any tests: Dir(1).
    """

    name: ClassVar[str] = "precision-grid"
    promise: ClassVar[str] = "learns how near a test is; gains also from tests that are a bit off"
    reference: ClassVar[str] = "Hobbs et al. 2011, commensurate prior, on a grid"

    points: int = 16
    highest: float = 1000.0

    def __post_init__(self) -> None:
        _check_points(self.points, 1)
        _check_positive("highest", self.highest, MOST)

    def posterior(self, counts: ArrayLike, prior: ArrayLike | None = None) -> DirichletMixture:
        """What is believed of the target; see `Estimator.posterior`."""
        seen, _ = _seen(counts, prior)
        if not seen.rows:
            return DirichletMixture(_ONE, (seen.base + seen.target)[None, :])
        sums = np.add.reduce(seen.tests, axis=1, keepdims=True)
        centres = (seen.tests + 1.0) / (sums + seen.tests.shape[1])
        grid = _precisions(self.points, self.highest)
        spread = (grid[:, None, None] * centres).reshape(-1, centres.shape[1])
        return _weighed(spread + seen.prior, np.zeros(len(spread)), seen.target)


@dataclass(frozen=True, slots=True)
class SubsetMixture:
    """Every subset of the tests may be what equals the target; the others have their own Dir(1).

    ``weight`` is the probability beforehand that a test equals the target. A subset S has the weight
    u^|S| (1 - u)^(tests outside) B(1 + x1 + sum_S x_j) / B(1) prod_outside B(1 + x_j) / B(1), and the
    belief Dir(1 + x1 + sum_S x_j). Multi-source exchangeability models, Kaizer et al. 2018. At most
    MAX_TESTS tests (ValueError).
    """

    name: ClassVar[str] = "subsets"
    promise: ClassVar[str] = "finds out which of several tests equal the target"
    reference: ClassVar[str] = "Kaizer, Koopmeiners and Hobbs 2018, multi-source exchangeability"

    weight: float = 0.5

    def __post_init__(self) -> None:
        _check_share(self.weight)

    def posterior(self, counts: ArrayLike, prior: ArrayLike | None = None) -> DirichletMixture:
        """What is believed of the target; see `Estimator.posterior`."""
        seen, _ = _seen(counts, prior)
        inside = _powers(_checked_number(seen), 2)
        k = len(seen.target)
        one = np.ones((1, k))
        own = log_beta(one + seen.tests) - log_beta(one) if seen.rows else np.zeros(0)
        together = seen.base + seen.target + inside @ seen.tests
        log_weights = log_beta(together) + (1.0 - inside) @ (own + math.log1p(-self.weight))
        log_weights += inside.sum(axis=1) * math.log(self.weight)
        return DirichletMixture(normalised(log_weights), together)


ESTIMATORS: dict[str, type[Estimator]] = {
    kind.name: kind
    for kind in (
        Empirical,
        Pooled,
        DecreasingM,
        RobustMixture,
        SAM,
        PowerPrior,
        PrecisionGrid,
        SubsetMixture,
    )
}
"""The estimators by name."""


def estimator(name: str, **options: Any) -> Estimator:
    """An estimator by its name, with its options.

    Raises UnknownEstimatorError, which tells the names there are, ValueError for an option's value.
    """
    kind = ESTIMATORS.get(name)
    if kind is None:
        known = ", ".join(ESTIMATORS)
        raise UnknownEstimatorError(
            f"there is no estimator `{name}`{_meant(name, ESTIMATORS)}; there are: {known}"
        )
    known_options = option_names(kind)
    for option in options:
        if option not in known_options:
            known = ", ".join(known_options) or "none"
            raise UnknownEstimatorError(
                f"the estimator `{name}` has no option `{option}`"
                f"{_meant(option, known_options)}; its options: {known}"
            )
    return kind(**options)


def option_names(kind: type[Estimator]) -> list[str]:
    """The names of an estimator's options."""
    assert isinstance(kind, type)
    return [field.name for field in fields(kind)]  # type: ignore[arg-type]


def _meant(name: str, known: Any) -> str:
    from difflib import get_close_matches

    near = get_close_matches(name, list(known), 1)
    return f"; did you mean `{near[0]}`?" if near else ""


def _or_nothing(seen: _Seen, cap: float) -> Floats:
    """The parameters of components: first one that no test counts in, then one for each test."""
    sums = np.add.reduce(seen.tests, axis=1, keepdims=True)
    shares = cap / np.maximum(sums, cap) * seen.tests
    return np.concatenate([seen.base[None, :], seen.base + shares])


def _checked_number(seen: _Seen) -> int:
    number = len(seen.rows)
    if number > MAX_TESTS:
        raise ValueError(f"{number} tests have data, and at most {MAX_TESTS} can be weighed up")
    return number


_COMBINATIONS = 512


@cache
def _powers(tests: int, points: int) -> Floats:
    """All combinations of powers of the tests, float64[combinations, tests].

    Fewer points for each test the more tests there are, but 0 and 1 always.
    """
    if tests > 1:
        most = 2
        while (most + 1) ** tests <= _COMBINATIONS:
            most += 1
        points = min(points, most)
    grid = np.linspace(0.0, 1.0, points).tolist()
    found = np.array(list(itertools.product(grid, repeat=tests)), np.float64)
    found.flags.writeable = False
    return found


@cache
def _precisions(points: int, highest: float) -> Floats:
    return np.geomspace(1.0, highest, points)


# A finer grid would say the same, and take the memory of the machine.
_MOST_POINTS = 10_000


def _number(name: str, value: object) -> float:
    """A number; what comes from a file or the command line may be anything."""
    try:
        if isinstance(value, str | bool):
            raise TypeError
        return float(value)  # type: ignore[arg-type]
    except (TypeError, OverflowError):
        raise ValueError(f"{name} must be a number, not `{value}`") from None


def _check_share(value: float, name: str = "weight") -> None:
    if not 0.0 < _number(name, value) < 1.0:
        raise ValueError(f"{name} must lie between 0 and 1")


def _check_positive(name: str, value: float, most: float = math.inf) -> None:
    number = _number(name, value)
    if not 0.0 < number < math.inf:
        raise ValueError(f"{name} must be finite and above 0")
    if number > most:
        raise ValueError(f"{name} must be at most {most:g}")


def _check_points(value: int, least: int) -> None:
    if _number("points", value) != value or not least <= value <= _MOST_POINTS or value % 1:
        raise ValueError(f"points must be a whole number from {least} to {_MOST_POINTS}")
