"""The delta bound to all digits: the distribution of the largest error under a Dirichlet.

Two outcomes need one integral of a Beta density. With three or four, the sum of a pair is Beta
distributed and the shares within a pair are again, so one integral is left. With more, the Dirichlet is
a vector of gammas under the condition that they sum to 1 (Levin 1981 does so for the multinomial); the
density of a sum of cut-off gammas is a convolution, read off its Fourier series.

Up to four outcomes give seven digits or more; fractions below 1, whose densities bend at 0, and
more outcomes give at least four. Where counts sum to more than 1e9 rounding takes some of the seven;
four are left up to 1e12.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np

from menid_plan.learning.mixtures import Floats

# Below that, what rounding leaves of 1 - Pr(within) is no longer much smaller than epsilon.
LEAST_EPSILON = 1e-7

_NODES = 16
_SHORTER = (0.3, 0.1, 0.01, 1e-3, 1e-5, 1e-8)
_STEPS = (4.0, 10.0, 24.0)  # standard deviations from the mean at which panels end


def exact_delta(counts: Floats, epsilon: float) -> float:
    """The d with Pr(max_i |p_i - q_i| > d) = epsilon, p ~ Dir(1 + counts), q = counts / N or uniform.

    ``counts`` is float64[k], k >= 2. Raises ValueError for an epsilon below LEAST_EPSILON.
    """
    if epsilon < LEAST_EPSILON:
        raise ValueError(f"the exact bound needs an epsilon of {LEAST_EPSILON:g} or more")
    size = float(counts.sum())
    if size == 0.0 and len(counts) == 2:
        return (1.0 - epsilon) / 2.0
    if len(counts) == 2 and float(counts.min()) == 0.0:
        # One outcome only was seen: the error is the other's probability, Beta(1, 1 + N).
        return -math.expm1(math.log(epsilon) / (size + 1.0))
    errors = Errors.of(counts, epsilon)
    return _root(lambda d: 1.0 - errors.within(d), epsilon, errors.guess(epsilon), errors.most)


@dataclass(frozen=True, slots=True)
class Errors:
    """The largest error max_i |p_i - q_i|, with p ~ Dir(alpha).

    ``alpha`` are the parameters, all at least 1; ``q`` (sum 1) the estimate. ``negligible`` is what may
    be wrong with a probability.
    """

    alpha: tuple[float, ...]
    q: tuple[float, ...]
    negligible: float

    @classmethod
    def of(cls, counts: Floats, epsilon: float) -> Errors:
        """After some counts (float64[k]), to find where a probability is epsilon."""
        seen = counts.tolist()
        size, k = math.fsum(seen), len(seen)
        q = tuple(x / size for x in seen) if size > 0.0 else (1.0 / k,) * k
        return cls(tuple(x + 1.0 for x in seen), q, 1e-9 * min(epsilon, 1.0 - epsilon))

    @property
    def most(self) -> float:
        """The largest error that can be."""
        return max(max(q, 1.0 - q) for q in self.q)

    def within(self, d: float) -> float:
        """Pr(max_i |p_i - q_i| <= d)."""
        if d >= self.most:
            return 1.0
        if len(self.q) == 2:
            return self._of_two(d)
        parts = self._parts(d)
        if len(parts) == 1:
            return 1.0
        if len(parts) <= 4:
            return _of_few(parts, self.negligible)
        return _of_many(parts, self.negligible)

    def _of_two(self, d: float) -> float:
        # The smaller probability is integrated over: numbers near 0 are exact, near 1 they are not.
        (a, q), (b, _) = sorted(zip(self.alpha, self.q, strict=True))
        edges = _edges(max(0.0, q - d), min(1.0, q + d), a, b, self.negligible)
        nodes, weights = _panels(edges)
        return float(weights @ _beta_density(nodes, a, b))

    def _parts(self, d: float) -> list[_Part]:
        """The outcomes, where those that cannot be off by d are one: their gammas add up to one."""
        total = math.fsum(self.alpha)
        parts, free = [], [0.0, 0.0]
        for a, q in zip(self.alpha, self.q, strict=True):
            low, high = _support(a / total, math.sqrt(a) / total, a, a, self.negligible)
            if max(low, 0.0) >= q - d and min(high, 1.0) <= q + d:
                free = [free[0] + a, free[1] + q]
            else:
                parts.append(_Part(a, q, d))
        if free[0] > 0.0:
            parts.append(_Part(free[0], free[1], math.inf))
        return parts

    def guess(self, epsilon: float) -> float:
        """About the bound: the errors as independent normal ones."""
        total = sum(self.alpha)
        spreads = [math.sqrt(a * (total - a) / (total + 1.0)) / total for a in self.alpha]
        spreads = spreads[:1] if len(spreads) == 2 else spreads
        d = 2.0 * max(spreads)
        for _ in range(3):  # Newton's method for the logarithm of the sum of the tails
            tail = sum(math.erfc(d / s * _ROOT_HALF) for s in spreads) or 1e-300
            slope = sum(math.exp(-0.5 * (d / s) ** 2) / s for s in spreads) * _NORMAL or 1e-300
            d = max(d / 2.0, d + math.log(tail / epsilon) * tail / slope)
        return d


@dataclass(frozen=True, slots=True, order=True)
class _Part:
    """A component of the Dirichlet: its parameter, the estimate, and how far off it may be."""

    alpha: float
    q: float
    d: float

    @property
    def range(self) -> tuple[float, float]:
        return max(0.0, self.q - self.d), min(1.0, self.q + self.d)


# ----------------------------------------------------------------------------- two to four components


def _of_few(parts: list[_Part], negligible: float) -> float:
    """The probability that all components are in their ranges, for two, three or four of them."""
    groups = _groups(parts)
    (a, low, high, bends), (b, least, most, others) = map(_sum_of, groups, [_sum_alpha(parts)] * 2)
    low, high = max(low, 1.0 - most), min(high, 1.0 - least)
    if low >= high:
        return 0.0
    bends += [1.0 - bend for bend in others]
    t, weights = _panels(_edges(low, high, a, b, negligible, bends))
    value = _beta_density(t, a, b) * weights
    for group, total in zip(groups, (t, 1.0 - t), strict=True):
        if len(group) == 2:
            value *= _share_within(total, *group)
    return float(value.sum())


def _sum_alpha(parts: Iterable[_Part]) -> float:
    """The sum of the components' parameters."""
    return math.fsum(part.alpha for part in parts)


def _groups(parts: list[_Part]) -> tuple[list[_Part], list[_Part]]:
    """The components in two groups of one or two, first the one with the smaller sum.

    That sum is integrated over: numbers near 0 are exact, near 1 they are not. It varies as little as
    it may, so that what varies more is within the groups, where the integrand is smooth.
    """
    firsts: list[tuple[int, ...]]
    firsts = [(0, i) for i in range(1, 4)] if len(parts) == 4 else [(i,) for i in range(len(parts))]
    total = _sum_alpha(parts)
    splits = []
    for first in firsts:
        one = [parts[i] for i in first]
        size = _sum_alpha(one)
        rest = [part for i, part in enumerate(parts) if i not in first]
        splits.append((size * (total - size), (one, rest) if 2.0 * size <= total else (rest, one)))
    return min(splits, key=lambda split: split[0])[1]


def _sum_of(group: list[_Part], total: float) -> tuple[float, float, float, list[float]]:
    """A group's sum: its parameter, its range, and where the integrand over it bends."""
    low = sum(part.range[0] for part in group)
    high = min(1.0, sum(part.range[1] for part in group))
    alpha = _sum_alpha(group)
    bends = [sum(part.q for part in group)]
    if len(group) == 2:
        small, large = sorted(group)
        ends = [part.q + sign * part.d for part in group for sign in (-1.0, 1.0)]
        spread = math.sqrt(small.alpha) / total
        if large.d > 10.0 * spread:  # what the larger one may be is passed within a short way
            far = [small.alpha / total + step * spread for step in (0.0, 4.0, 12.0)]
            ends += [large.q + sign * large.d + step for step in far for sign in (-1.0, 1.0)]
        bends += [end for end in ends if math.isfinite(end)]
    return alpha, low, high, bends


# ------------------------------------------------------------------------------- more components


def _of_many(parts: list[_Part], negligible: float) -> float:
    """The same for any number of components, as gammas under the condition that they sum to 1."""
    total = _sum_alpha(parts)
    number: dict[_Part, int] = {}
    for part in parts:
        number[part] = number.get(part, 0) + 1
    gammas: list[tuple[float, float, float, int]] = []
    for part, often in number.items():
        spread = math.sqrt(part.alpha) / total
        low, high = _support(part.alpha / total, spread, part.alpha, part.alpha, negligible)
        low, high = max(part.range[0], low), min(part.range[1], high)
        if low >= high:
            return 0.0
        gammas.append((part.alpha, low, high, often))
    least = sum(low * often for _, low, _, often in gammas)
    greatest = sum(high * often for _, _, high, often in gammas)
    if not least < 1.0 < greatest:
        return 0.0
    # With that period no other copy of the density reaches the sum 1.
    period = 1.001 * max(greatest - 1.0, 1.0 - least)
    density = _series(gammas, total, period, negligible)
    return density / (math.sqrt(total / math.tau) * math.exp(-_stirling_rest(total)))


_ROOT_HALF = math.sqrt(0.5)
_NORMAL = math.sqrt(2.0 / math.pi)


def _root(tail: Callable[[float], float], epsilon: float, guess: float, most: float) -> float:
    """Where a tail probability, which falls from 1 at 0 to 0 at ``most``, is epsilon.

    Secants of the tail's logarithm, which is nearly a parabola; halving where they lead astray. When a
    step is 1e-7 of the whole, what is left after it is of the order of that times the step before.
    """
    low, high = 0.0, most
    last, last_value = 0.0, -math.log(epsilon)
    d = guess if guess < most else most / 2.0
    for number in range(200):
        probability = tail(d)
        value = math.log(probability / epsilon) if probability > 0.0 else -math.inf
        if value > 0.0:
            low = d
        else:
            high = d
        if number == 0:
            following = d * (1.0 + min(0.05, max(-0.05, value / 8.0)) + 1e-3)
        elif math.isfinite(value) and value != last_value:
            following = d - value * (d - last) / (value - last_value)
        else:
            following = (low + high) / 2.0
        last, last_value = d, value
        if not low < following < high:
            following = (low + high) / 2.0
        if (number > 1 and abs(following - d) <= 1e-7 * d) or high - low <= 1e-15 * high:
            return following
        d = following
    return d


# ------------------------------------------------------------------------------------- quadrature


@cache
def _gauss() -> tuple[Floats, Floats]:
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    return nodes, weights


def _panels(edges: list[float]) -> tuple[Floats, Floats]:
    """The nodes and weights of Gauss's rule on each interval between neighbouring edges."""
    x, w = _gauss()
    ends = np.array(edges)
    half = (ends[1:] - ends[:-1]) / 2.0
    nodes = (ends[:-1] + half)[:, None] + half[:, None] * x
    return nodes.ravel(), (half[:, None] * w).ravel()


def _support(
    mean: float, spread: float, a: float, b: float, negligible: float
) -> tuple[float, float]:
    """Where nearly all is of a gamma (b = a) or Beta distribution.

    A gamma variable of shape a is above a + sqrt(2 a L) + L with a probability of less than exp(-L);
    Beta tails are lighter.
    """
    level = -math.log(negligible)
    normal = math.sqrt(2.0 * level)
    return (
        mean - (normal + level / math.sqrt(b)) * spread,
        mean + (normal + level / math.sqrt(a)) * spread,
    )


def _edges(
    low: float, high: float, a: float, b: float, negligible: float, bends: Iterable[float] = ()
) -> list[float]:
    """Where panels end, for Beta(a, b) between ``low`` and ``high``, with bends of the integrand."""
    total = a + b
    mean = a / total
    spread = math.sqrt(mean * (b / total) / (total + 1.0))
    least, greatest = _support(mean, spread, a, b, negligible)
    low, high = max(low, least), min(high, greatest)
    if low >= high:
        return [mean, mean]
    inner = [mean, *bends]
    inner += [mean + sign * step * spread for step in _STEPS for sign in (-1.0, 1.0)]
    # A power that is not whole bends ever more towards 0, or 1: shorter and shorter panels there.
    if low < spread and a < 8.0 and a != int(a):
        inner += [scale * min(high, spread) for scale in _SHORTER]
    if 1.0 - high < spread and b < 8.0 and b != int(b):
        inner += [1.0 - scale * min(1.0 - low, spread) for scale in _SHORTER]
    # In a very short panel at 0 or 1 a node would be rounded to the end, where no density is.
    short = 1e-12 * (high - low)
    inside = sorted({x for x in inner if low + short < x < high - short})
    return [low, *inside, high]


def _stirling_rest(x: float) -> float:
    """What Stirling's formula leaves: log Gamma(x) - ((x - 1/2) log x - x + log(2 pi) / 2)."""
    if x < 16.0:
        return math.lgamma(x) - ((x - 0.5) * math.log(x) - x + 0.5 * math.log(math.tau))
    y = 1.0 / (x * x)
    return (1.0 / 12.0 - y * (1.0 / 360.0 - y * (1.0 / 1260.0 - y / 1680.0))) / x


def _beta_density(t: Floats, a: float, b: float) -> Floats:
    """The density of Beta(a, b) at numbers inside (0, 1).

    Written about the mean so that nothing large cancels, however large the parameters are.
    """
    mean = a / (a + b)
    rest = _stirling_rest(a + b) - _stirling_rest(a) - _stirling_rest(b)
    factor = math.sqrt(a * (b / (a + b)) / math.tau) * math.exp(rest)
    step = t - mean
    up, down = step / mean, step / (mean - 1.0)
    inner = a * (np.log1p(up) - up) + b * (np.log1p(down) - down)
    density: Floats = factor * np.exp(inner) / (t * (1.0 - t))
    return density


def _share_within(t: Floats, one: _Part, two: _Part) -> Floats:
    """The probability that both are in their ranges given that they sum to t, for each t."""
    from scipy.special import betainc

    low = np.maximum(t - (two.q + two.d), max(0.0, one.q - one.d))
    high = np.minimum(np.minimum(t - (two.q - two.d), one.q + one.d), t)
    high = np.maximum(low, high)
    shares = np.minimum(np.concatenate([low, high]) / np.concatenate([t, t]), 1.0)
    both = betainc(one.alpha, two.alpha, shares)
    found: Floats = both[len(t) :] - both[: len(t)]
    return found


# --------------------------------------------------------------------------------- Fourier series

_TERMS = 2048


def _series(
    parts: list[tuple[float, float, float, int]], total: float, period: float, negligible: float
) -> float:
    """The density at 1 of the sum of gammas, each zero outside its interval.

    ``parts`` are (shape, low, high, how many); all have the rate ``total``. The density is made
    periodic; its coefficients are products of the parts' Fourier transforms.
    """
    found, start, length = 0.0, 0, 64
    while True:
        product = np.ones(length, np.complex128)
        for shape, low, high, often in parts:
            wave = math.tau / period
            transform = _transform(shape, total, low, high, wave, start, length)
            product *= transform**often
        terms = product.real
        found += float(2.0 * terms.sum() - (terms[0] if start == 0 else 0.0))
        rest = float(np.abs(product[-length // 4 :]).sum())
        start, length = start + length, max(64, start + length)
        if rest <= min(1e-8, 1e6 * negligible) * abs(found) or start >= _TERMS:
            return found / period


def _transform(
    shape: float, total: float, low: float, high: float, wave: float, start: int, length: int
) -> np.ndarray[tuple[int], np.dtype[np.complex128]]:
    """The Fourier transform about the mean, at ``length`` multiples of ``wave`` from ``start`` on."""
    mean, spread = shape / total, math.sqrt(shape) / total
    turns = wave * (start + length) * (high - low)
    number = math.ceil(max(turns / 12.0, (high - low) / (3.0 * spread), 2.0))
    edges = np.linspace(low, high, number + 1).tolist()
    if low == 0.0 and shape < 8.0 and shape != int(shape):
        first = edges[1]
        edges[1:1] = [first * 10.0**-power for power in (8, 5, 3, 2, 1)]
    nodes, weights = _panels(edges)
    step = (nodes - mean) / mean
    inner = shape * (np.log1p(step) - step)
    factor = math.sqrt(shape / math.tau) * math.exp(-_stirling_rest(shape))
    values = weights * factor * np.exp(inner) / nodes
    turn = np.exp(-1j * wave * (nodes - mean))
    powers = np.empty((length, len(nodes)), np.complex128)
    powers[0] = np.exp(-1j * wave * start * (nodes - mean)) * values
    powers[1:] = turn
    np.multiply.accumulate(powers, axis=0, out=powers)
    found: np.ndarray[tuple[int], np.dtype[np.complex128]] = powers.sum(axis=1)
    return found
