"""How sure an estimate is: the delta bound, and Thompson's sample size.

Delta is the error that the empirical distribution exceeds with no more than the probability epsilon,
under the posterior Dir(1 + counts) (Suárez-Hernández et al. 2020, section II, Algorithm 2).
"""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike

from menid_plan.learning.exact_delta import exact_delta
from menid_plan.learning.mixtures import MOST, Floats

Method: TypeAlias = Literal["exact", "monte-carlo", "bonferroni"]
"""How the bound is found: all digits; Algorithm 2; or an upper bound from each outcome alone."""

METHODS: tuple[Method, ...] = get_args(Method)
SAMPLES = 10_000
"""How many distributions Algorithm 2 draws unless it is told."""


def delta(
    counts: ArrayLike,
    epsilon: float,
    method: Method = "exact",
    samples: int = SAMPLES,
    rng: np.random.Generator | None = None,
) -> float:
    """The smallest d with Pr(max_i |p_i - q_i| > d) <= epsilon.

    p ~ Dir(1 + counts), and q = counts / N is its mode (uniform if N = 0). ``counts`` (float64[k],
    k >= 2) may be fractional; 0 < epsilon < 1. ``samples`` and ``rng`` are for ``monte-carlo``; without
    ``rng`` it draws from a generator of its own with the seed 0. Raises ValueError for input that means
    nothing, for counts whose sum is beyond 1e12, and for ``exact`` with an epsilon below 1e-7.
    """
    seen = checked_counts(counts)
    check_epsilon(epsilon)
    if method == "exact":
        return exact_delta(seen, epsilon)
    if method == "bonferroni":
        return _bonferroni(seen, epsilon)
    if method == "monte-carlo":
        errors = drawn_errors(seen, samples, rng or np.random.default_rng(0))
        place = rank(epsilon, samples) - 1
        return float(np.partition(errors, place)[place])
    raise ValueError(f"there is no method `{method}`; there are: {', '.join(METHODS)}")


def gap_by_chance(target: ArrayLike, test: ArrayLike, samples: int = SAMPLES) -> float:
    """How often two samples of one distribution are as far apart as these, or further.

    How far is the largest difference of a relative frequency, max_i |x_i / N - y_i / M|. A permutation
    test: all executions are dealt out to the two environments again, so many times, from a seed of its
    own. ``target`` and ``test`` are counts (float64[k], of which neither is all 0), rounded to whole
    numbers; beyond a thousand million of them as if there were no more.
    """
    x, y = checked_counts(target), checked_counts(test)
    shrunk = min(1.0, 9e8 / float(x.sum() + y.sum()))
    x, y = np.rint(shrunk * x), np.rint(shrunk * y)
    n, m, both = x.sum(), y.sum(), (x + y).astype(np.int64)
    if not (n and m):
        return 1.0
    rng = np.random.default_rng(0)
    dealt = rng.multivariate_hypergeometric(both, int(n), size=samples, method="marginals")
    gaps = np.abs(dealt / n - (both - dealt) / m).max(axis=1)
    found = np.abs(x / n - y / m).max()
    return float((1 + np.count_nonzero(gaps >= found * (1.0 - 1e-12))) / (1 + samples))


def drawn_errors(counts: Floats, samples: int, rng: np.random.Generator) -> Floats:
    """Errors max_i |p_i - q_i| of distributions drawn from Dir(1 + counts), float64[samples].

    Lines 3 to 8 of Algorithm 2 (Suárez-Hernández et al. 2020). ``counts`` is float64[k].
    """
    if samples < 1:
        raise ValueError("samples must be at least 1")
    drawn = rng.standard_gamma(counts + 1.0, (samples, len(counts)))
    drawn /= np.add.reduce(drawn, axis=1, keepdims=True)
    drawn -= mode(counts)
    np.abs(drawn, out=drawn)
    found: Floats = np.maximum.reduce(drawn, axis=1)
    return found


def rank(epsilon: float, samples: int) -> int:
    """Which of the sorted errors is the bound, from 1: (1 - epsilon) S, rounded, halves up."""
    return max(1, math.floor((1.0 - epsilon) * samples + 0.5))


def mode(counts: Floats) -> Floats:
    """The empirical distribution (float64[k]), uniform without counts."""
    size = float(counts.sum())
    found: Floats = counts / size if size > 0.0 else np.full(len(counts), 1.0 / len(counts))
    return found


def _bonferroni(counts: Floats, epsilon: float) -> float:
    """An upper bound: each error alone exceeds it with no more than its share of epsilon.

    Two outcomes have the same error, which has all of epsilon. At a mode of 0 or 1 there is one side
    only, elsewhere each side has half.
    """
    from scipy.special import betainccinv, betaincinv

    q, alpha = mode(counts), counts + 1.0
    rest = alpha.sum() - alpha
    if len(q) == 2:
        q, alpha, rest = q[:1], alpha[:1], rest[:1]
    share = epsilon / len(q) / np.where((q == 0.0) | (q == 1.0), 1.0, 2.0)
    below = np.where(q == 0.0, 0.0, q - betaincinv(alpha, rest, share))
    above = np.where(q == 1.0, 0.0, betainccinv(alpha, rest, share) - q)
    return float(max(below.max(), above.max()))


# --------------------------------------------------------------------------- Thompson's sample size


def thompson_samples(alpha: float, d: float, k: int | None = None) -> int:
    """How many observations bring every error below d with probability 1 - alpha, whatever is true.

    n = z(alpha / 2k)^2 (1/k) (1 - 1/k) / d^2, rounded up, where z is the normal distribution's upper
    quantile; for k outcomes, or for the worst k (None). Thompson 1987, Sample size for estimating
    multinomial proportions.
    """
    if not 0.0 < d < math.inf:
        raise ValueError("d must be finite and above 0")
    exact = thompson_product(alpha, k)[0] / d / d
    if not math.isfinite(exact):
        raise ValueError("d is too small")
    return math.ceil(exact * (1.0 - 1e-12))  # rounding must not cost an observation


def thompson_delta(alpha: float, n: float, k: int | None = None) -> float:
    """The error that n observations allow for by `thompson_samples`."""
    if not 0.0 < n < math.inf:
        raise ValueError("n must be finite and above 0")
    return math.sqrt(thompson_product(alpha, k)[0] / n)


def thompson_product(alpha: float, k: int | None = None) -> tuple[float, int]:
    """d^2 n of Thompson's table, and the number of outcomes k for which it holds."""
    if not 0.0 < alpha < 1.0:
        raise ValueError("alpha must lie between 0 and 1")
    if k is not None and k < 2:
        raise ValueError("k must be at least 2")
    # The product tends to 0 as k grows; even for alpha near 1 its largest value is well before 50.
    numbers = range(2, 50) if k is None else (k,)
    return max((_product(alpha, number), number) for number in numbers)


def _product(alpha: float, k: int) -> float:
    z = -NormalDist().inv_cdf(alpha / (2.0 * k))
    return z * z / k * (1.0 - 1.0 / k)


# ------------------------------------------------------------------------------------------- input


def checked_counts(counts: ArrayLike) -> Floats:
    """Counts as float64[k]; ValueError unless there are two or more, not below 0, and at most MOST."""
    seen = np.asarray(counts, np.float64)
    if seen.ndim != 1:
        raise ValueError(f"counts must be a row of numbers, not {seen.shape}")
    if len(seen) < 2:
        raise ValueError("at least two counts are needed, one for each outcome")
    values = seen.tolist()
    if not all(map(math.isfinite, values)):
        raise ValueError("counts must be finite")
    if min(values) < 0.0:
        raise ValueError("counts must not be below 0")
    if sum(values) > MOST:
        raise ValueError(
            f"the count {max(values):g} is too large: counts must sum to no more than {MOST:g}, for "
            "beyond that a bound cannot be computed to enough digits"
        )
    return seen


def check_epsilon(epsilon: float) -> None:
    """ValueError unless epsilon lies between 0 and 1."""
    if not 0.0 < epsilon < 1.0:
        raise ValueError("epsilon must lie between 0 and 1")
