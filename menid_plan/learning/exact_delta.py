"""The delta bound to all digits: the distribution of the largest error under a Dirichlet.

Two outcomes need one integral of a Beta density. With three or four, the sum of a pair is Beta
distributed and the shares within a pair are again, so one integral is left. With more, the Dirichlet is
a vector of gammas under the condition that they sum to 1 (Levin 1981 does so for the multinomial); the
density of a sum of cut-off gammas is a convolution, read off its Fourier series.
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
        if len(self.q) <= 4:
            return self._of_pairs(d)
        return self._of_many(d)

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

    # ------------------------------------------------------------------------------ two outcomes

    def _of_two(self, d: float) -> float:
        (a, b), q = self.alpha, self.q[0]
        edges = _edges(max(0.0, q - d), min(1.0, q + d), a, b, self.negligible)
        nodes, weights = _panels(edges)
        return float(weights @ _beta_density(nodes, a, b))

    # ---------------------------------------------------------------------- three or four outcomes

    def _of_pairs(self, d: float) -> float:
        order = _pairing(self.alpha)
        alpha, q = [self.alpha[i] for i in order], [self.q[i] for i in order]
        a, b, middle = sum(alpha[:2]), sum(alpha[2:]), q[0] + q[1]
        one = len(q) == 3
        reach = d if one else 2.0 * d
        low, high = max(0.0, middle - reach), min(1.0, middle + reach)
        bends = [middle, *(side + sign * d for side in q[:2] for sign in (-1.0, 1.0))]
        if not one:
            bends += [1.0 - side - sign * d for side in q[2:] for sign in (-1.0, 1.0)]
        nodes, weights = _panels(_edges(low, high, a, b, self.negligible, bends))
        value = _beta_density(nodes, a, b) * weights
        value *= _share_within(nodes, alpha[:2], q[:2], d)
        if not one:
            value *= _share_within(1.0 - nodes, alpha[2:], q[2:], d)
        return float(value.sum())

    # -------------------------------------------------------------------------- any number of them

    def _of_many(self, d: float) -> float:
        total = sum(self.alpha)
        number: dict[tuple[float, float], int] = {}
        for pair in zip(self.alpha, self.q, strict=True):
            number[pair] = number.get(pair, 0) + 1
        parts: list[tuple[float, float, float, int]] = []
        for (a, q), often in number.items():
            low, high = _support(a / total, math.sqrt(a) / total, a, a, self.negligible)
            low, high = max(0.0, q - d, low), min(1.0, q + d, high)
            if low >= high:
                return 0.0
            parts.append((a, low, high, often))
        least = sum(low * often for _, low, _, often in parts)
        greatest = sum(high * often for _, _, high, often in parts)
        # With that period no other copy of the density reaches the sum 1.
        period = 1.001 * max(greatest - 1.0, 1.0 - least)
        if not least < 1.0 < greatest:
            return 0.0
        density = _series(parts, total, period, self.negligible)
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
    # A power that is not whole bends at the end of its range: shorter and shorter panels there.
    if low == 0.0 and a < 8.0 and a != int(a):
        inner += [10.0**-power * min(high, spread) for power in (0.5, 1.0, 2.0, 3.0, 5.0, 8.0)]
    if high == 1.0 and b < 8.0 and b != int(b):
        inner += [
            1.0 - 10.0**-power * min(1.0 - low, spread) for power in (0.5, 1.0, 2.0, 3.0, 5.0, 8.0)
        ]
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


# ------------------------------------------------------------------------------------------ pairs


def _pairing(alpha: tuple[float, ...]) -> list[int]:
    """An order of three or four outcomes: a pair, and the rest.

    The sum of the pair varies as little as it may, so that what varies more is within the pairs,
    where the integrand is smooth.
    """
    k, total = len(alpha), sum(alpha)
    rests = [(i,) for i in range(3)] if k == 3 else [(0, 1), (0, 2), (0, 3)]
    sums = [sum(alpha[i] for i in rest) for rest in rests]
    best = min(range(3), key=lambda n: sums[n] * (total - sums[n]))
    return [i for i in range(k) if i not in rests[best]] + list(rests[best])


def _share_within(t: Floats, alpha: list[float], q: list[float], d: float) -> Floats:
    """Pr(|p1 - q1| <= d and |p2 - q2| <= d) given p1 + p2 = t, for each t."""
    from scipy.special import betainc  # type: ignore[import-untyped]

    (a, b), (first, second) = alpha, q
    low = np.maximum(t - (second + d), max(0.0, first - d))
    high = np.minimum(np.minimum(t - (second - d), first + d), t)
    high = np.maximum(low, high)
    both = betainc(a, b, np.minimum(np.concatenate([low, high]) / np.concatenate([t, t]), 1.0))
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
