"""What tests and executions teach: compiled.

A row is a place where a distribution is made use of: each outcome has a payoff there, and there is
something else that one could do instead. The payoffs are scaled to [0, 1], and the distribution becomes
a coin that succeeds with the probability that is its mean payoff: exact for two payoffs, else an
approximation with the same mean (the trick of Agrawal and Goyal 2012). Counts of the coin are sums of
payoffs. A component Dir(a) of a belief becomes Beta(sum of a f, sum of a (1 - f)) for payoffs f.
"""

from __future__ import annotations

import math
from typing import Any

from menid_plan.compiled import kernel

HALF_LOG_TWO_PI = 0.9189385332046727
# Outcomes less probable than that are left out.
NEGLIGIBLE = 1e-9


@kernel(inline=True)
def log_gamma(x: float) -> float:
    """The logarithm of the gamma function of a number above 0 (Stirling's series, from 7 on)."""
    shift = 1.0
    while x < 7.0:
        shift *= x
        x += 1.0
    r = 1.0 / (x * x)
    series = (1.0 / 12.0 - r * (1.0 / 360.0 - r * (1.0 / 1260.0 - r / 1680.0))) / x
    return (x - 0.5) * math.log(x) - x + HALF_LOG_TWO_PI + series - math.log(shift)


@kernel(inline=True)
def log_fit(a: float, b: float, successes: float, failures: float) -> float:
    """The logarithm of B(a + successes, b + failures) / B(a, b)."""
    return (
        log_gamma(a + successes) - log_gamma(a) + log_gamma(b + failures) - log_gamma(b)
        + log_gamma(a + b) - log_gamma(a + b + successes + failures)
    )  # fmt: skip


@kernel("void(f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], i8[::1], f8[::1], f8[:, ::1])")
def executions(
    a: Any, b: Any, weight: Any, others: Any, sizes: Any, chance: Any, gain: Any
) -> None:
    """Write how much better one can choose after so many executions of a coin: gain[rows, sizes].

    ``a``, ``b``, ``weight`` [rows, components] are its posterior, ``others`` [rows] what the next best
    promises; ``chance`` [components] is space to work in.
    """
    components = a.shape[1]
    for row in range(a.shape[0]):
        mean = 0.0
        for j in range(components):
            if weight[row, j] > 0.0:
                mean += weight[row, j] * a[row, j] / (a[row, j] + b[row, j])
        for index in range(len(sizes)):
            n = sizes[index]
            for j in range(components):
                chance[j] = 0.0
                if weight[row, j] > 1e-7:
                    none = log_fit(a[row, j], b[row, j], 0.0, n)
                    chance[j] = weight[row, j] * math.exp(none)
            best, total = 0.0, 0.0
            for k in range(n + 1):
                mass, expected = 0.0, 0.0
                for j in range(components):
                    if chance[j] > 0.0:
                        up, down = a[row, j] + k, b[row, j] + n - k
                        mass += chance[j]
                        expected += chance[j] * up / (up + down)
                        if k < n:
                            chance[j] *= (n - k) / (k + 1.0) * up / (down - 1.0)
                best += max(others[row] * mass, expected)
                total += mass
            gain[row, index] = max(0.0, best / total - max(others[row], mean))


@kernel(
    "void(f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1],"
    " f8[::1], f8, f8, i8[::1], f8[:, ::1], f8[:, ::1])"
)
def tests(
    a: Any, b: Any, weight: Any, related: Any, class_a: Any, class_b: Any, seen: Any,
    strength: Any, prior: float, least: float, sizes: Any, space: Any, gain: Any,
) -> None:  # fmt: skip
    """Write how much better one can choose after so many tests of a coin: gain[rows, sizes].

    ``a``, ``b``, ``weight`` [rows, components] is the prior of what the test does not change, and
    ``related`` [rows, relations] the weights of the relations to it, but for one factor in all.
    ``class_a`` and ``class_b`` [rows, classes] are what a coin may be in the test, all alike
    beforehand. ``seen`` [rows, 7]: successes and failures in the target, in the test; sum of payoffs,
    outcomes, and what the next best promises. For ``strength``, ``prior`` and ``least`` see `belief`.
    ``space`` [4, at least components + relations and classes] is to work in.
    """
    components, classes, relations = a.shape[1], class_a.shape[1], related.shape[1]
    fit, mean, chance, start = space[0], space[1], space[2], space[3]
    for row in range(a.shape[0]):
        won, lost, up, down = seen[row, 0], seen[row, 1], seen[row, 2], seen[row, 3]
        payoffs, outcomes, others = seen[row, 4], seen[row, 5], seen[row, 6]
        executed = won + lost > 0.0
        for j in range(components):
            if weight[row, j] > 0.0:
                fit[j] = math.log(weight[row, j])
                if executed:
                    fit[j] += log_fit(a[row, j], b[row, j], won, lost)
                mean[j] = (a[row, j] + won) / (a[row, j] + b[row, j] + won + lost)
        total = 0.0
        for i in range(classes):
            start[i] = 0.0
            if class_a[row, i] + class_b[row, i] > 0.0:
                start[i] = math.exp(log_fit(class_a[row, i], class_b[row, i], up, down))
                total += start[i]
        for index in range(len(sizes)):
            n = sizes[index]
            for i in range(classes):
                chance[i] = 0.0
                if start[i] > 0.0:
                    none = log_fit(class_a[row, i] + up, class_b[row, i] + down, 0.0, n)
                    chance[i] = start[i] / total * math.exp(none)
            best, expected, mass = 0.0, 0.0, 0.0
            for k in range(n + 1):
                likely = 0.0
                for i in range(classes):
                    if chance[i] > 0.0:
                        likely += chance[i]
                        if k < n:
                            x, y = class_a[row, i] + up + k, class_b[row, i] + down + n - k
                            chance[i] *= (n - k) / (k + 1.0) * x / (y - 1.0)
                if likely < NEGLIGIBLE:
                    continue
                tested = up + down + n
                estimate = (up + k + prior * payoffs) / (tested + prior * outcomes)
                for r in range(relations):
                    j = components + r
                    s = strength[r]
                    spread = 1.0 / (s + 1.0) + s / (s + 1.0) / (tested + outcomes)
                    size = 1.0 / spread - 1.0
                    q = estimate
                    if r == relations - 1:
                        q = (payoffs - estimate) / max(1.0, outcomes - 1.0)
                    x = size * q + least * payoffs
                    y = size * (1.0 - q) + least * (outcomes - payoffs)
                    fit[j] = math.log(related[row, r])
                    if executed:
                        fit[j] += log_fit(x, y, won, lost)
                    mean[j] = (x + won) / (x + y + won + lost)
                most = fit[components]
                for j in range(components + relations):
                    if j >= components or weight[row, j] > 0.0:
                        most = max(most, fit[j])
                sum_weights, sum_means = 0.0, 0.0
                for j in range(components + relations):
                    if j >= components or weight[row, j] > 0.0:
                        w = math.exp(fit[j] - most)
                        sum_weights += w
                        sum_means += w * mean[j]
                then = sum_means / sum_weights
                best += likely * max(others, then)
                expected += likely * then
                mass += likely
            gain[row, index] = max(0.0, best / mass - max(others, expected / mass))
