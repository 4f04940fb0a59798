"""Sums over the experiences of a store."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TypeAlias

from menid_plan.experience.record import DistributionKey, Explanation

_Lookup: TypeAlias = Callable[[int], tuple[DistributionKey, Explanation]]


@dataclass(slots=True)
class Totals:
    """How much was done in an environment.

    ``seconds`` are of all executions; ``reward`` is the sum of those that the environment gave itself,
    in ``rewarded`` executions. ``explained`` and ``noise`` share the executions that a rule covered, as
    their weights have it; ``unexplained`` are the others.
    """

    executions: int = 0
    seconds: float = 0.0
    reward: float = 0.0
    rewarded: int = 0
    explained: float = 0.0
    noise: float = 0.0
    unexplained: int = 0


def add_up_counts(
    pairs: Iterable[tuple[int, int]], look_up: _Lookup
) -> dict[tuple[int, DistributionKey], tuple[float, ...]]:
    """The sum of weights by environment and distribution.

    ``pairs`` are the numbers of environment and explanation of each experience; sums are made in
    their order.
    """
    sums: dict[tuple[int, DistributionKey], list[float]] = {}
    # What one pair adds to: the list of sums, and which of them by how much.
    adds: dict[tuple[int, int], tuple[list[float], list[tuple[int, float]]]] = {}
    for pair in pairs:
        found = adds.get(pair)
        if found is None:
            key, explanation = look_up(pair[1])
            weights = explanation.weights
            row = sums.setdefault((pair[0], key), [0.0] * len(weights))
            found = adds[pair] = row, [(i, w) for i, w in enumerate(weights) if w]
        row, shares = found
        for index, weight in shares:
            row[index] += weight
    return {key: tuple(row) for key, row in sums.items()}


def add_up_totals(
    rows: Iterable[tuple[int, float, float | None, int | None]], look_up: _Lookup
) -> dict[int, Totals]:
    """The totals by number of the environment.

    ``rows`` have the numbers of environment and explanation and, between them, duration and reward.
    """
    found: dict[int, Totals] = {}
    noises: dict[int, float] = {}
    for environment, duration, reward, explanation in rows:
        totals = found.get(environment)
        if totals is None:
            totals = found[environment] = Totals()
        totals.executions += 1
        totals.seconds += duration
        if reward is not None:
            totals.reward += reward
            totals.rewarded += 1
        if explanation is None:
            totals.unexplained += 1
            continue
        noise = noises.get(explanation)
        if noise is None:
            noise = noises[explanation] = look_up(explanation)[1].weights[-1]
        totals.noise += noise
        totals.explained += 1.0 - noise
    return found
