"""What is believed about one categorical distribution: a Dirichlet distribution, or several mixed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats: TypeAlias = NDArray[np.float64]

MOST = 1e12
"""The largest sum of counts, and the largest weight, for which beliefs and bounds are found.

There an error may be some 1e-12, and probabilities are known to 1e-16: beyond, too few digits are left.
"""

# From so many values on, loading SciPy and calling it is quicker than the standard library's lgamma.
_MANY = 3000


def log_gamma(values: Floats) -> Floats:
    """The logarithms of the gamma function at positive numbers (an array of any shape)."""
    if values.size >= _MANY:
        from scipy.special import gammaln

        found: Floats = gammaln(values)
        return found
    flat = [math.lgamma(value) for value in values.ravel().tolist()]
    return np.array(flat, np.float64).reshape(values.shape)


def log_beta(parameters: Floats) -> Floats:
    """The logarithm of the multivariate beta function B, of each row.

    ``parameters`` is float64[..., k], all above 0; the result float64[...].
    """
    sums = np.add.reduce(parameters, axis=-1)
    both = log_gamma(np.concatenate([parameters, sums[..., None]], axis=-1))
    found: Floats = np.add.reduce(both[..., :-1], axis=-1) - both[..., -1]
    return found


def log_evidence(parameters: Floats, counts: Floats) -> Floats:
    """How well Dir(parameters) foresees counts: log B(parameters + counts) / B(parameters).

    ``parameters`` is float64[m, k], ``counts`` float64[k], the result float64[m]: the logarithm of the
    probability of one sequence of outcomes with these counts.
    """
    ours = log_beta(np.concatenate([parameters + counts, parameters]))
    found: Floats = ours[: len(parameters)] - ours[len(parameters) :]
    return found


def normalised(log_weights: Floats) -> Floats:
    """Weights that sum to 1, from logarithms (float64[m]) of which any constant may be missing."""
    weights = np.exp(log_weights - log_weights.max())
    found: Floats = weights / weights.sum()
    return found


@dataclass(frozen=True, slots=True, eq=False)
class DirichletMixture:
    """A belief about one distribution over k outcomes, and the point estimate that goes with it.

    With probability ``weights[c]`` (float64[m], sum 1) the distribution is drawn from a Dirichlet
    with the parameters ``parameters[c]`` (float64[m, k], above 0). ``point`` (float64[k]) is what the
    estimator that made the belief answers; None: the mean.
    """

    weights: Floats
    parameters: Floats
    point: Floats | None = None

    def estimate(self) -> Floats:
        """The point estimate (float64[k], sum 1), by the formula of the estimator."""
        return self.mean() if self.point is None else self.point

    def mean(self) -> Floats:
        """The expected distribution (float64[k])."""
        sums = np.add.reduce(self.parameters, axis=1)
        found: Floats = (self.weights / sums) @ self.parameters
        return found

    def intervals(self, probability: float) -> Floats:
        """The highest-density interval of each outcome's probability (float64[k, 2]).

        It is the shortest that holds it with ``probability``. Of a mixture, an outcome has a mixture of
        Beta distributions; where that has several peaks, one interval spans those that it needs.
        """
        from scipy.optimize import brentq, minimize_scalar
        from scipy.special import betainc

        rest = np.add.reduce(self.parameters, axis=1)[:, None] - self.parameters
        found = np.empty((self.parameters.shape[1], 2))
        for outcome in range(len(found)):
            a, b = self.parameters[:, outcome], rest[:, outcome]

            def quantile(p: float, a: Floats = a, b: Floats = b) -> float:
                if not 0.0 < p < 1.0:
                    return float(p >= 1.0)
                return float(brentq(lambda x: self.weights @ betainc(a, b, x) - p, 0.0, 1.0))

            def width(below: float) -> float:
                return quantile(below + probability) - quantile(below)

            most = 1.0 - probability
            inside = minimize_scalar(width, bounds=(0.0, most), method="bounded").x
            below = min((0.0, most, float(inside)), key=width)
            found[outcome] = quantile(below), quantile(below + probability)
        return found

    def sample(self, rng: np.random.Generator, size: int | None = None) -> Floats:
        """A distribution drawn from the belief (float64[k]), or so many of them (float64[size, k])."""
        if len(self.weights) == 1:
            only: Floats = rng.dirichlet(self.parameters[0], size)
            return only
        edges = np.cumsum(self.weights)
        if size is None:
            one: Floats = rng.dirichlet(self.parameters[_component(edges, rng.random())])
            return one
        parameters = self.parameters[_component(edges, rng.random(size))]
        drawn = rng.standard_gamma(parameters)
        sums = drawn.sum(axis=1)
        # Gammas of a tiny shape may all be 0 in double precision; numpy draws those another way.
        for row in np.flatnonzero(sums < 1e-290).tolist():
            drawn[row] = rng.dirichlet(parameters[row])
            sums[row] = 1.0
        found: Floats = drawn / sums[:, None]
        return found


def _component(edges: Floats, numbers: ArrayLike) -> NDArray[np.int64]:
    """Which component numbers in [0, 1) fall to; rounding at the upper end goes to the last one."""
    return np.minimum(np.searchsorted(edges, numbers, side="right"), len(edges) - 1)
