"""What is believed of the target's distributions, where nobody knows which tests to believe.

Each distribution takes after what was seen of it in one of the tests (closely, loosely, or the other
way round) or after none. How often which is the case is learned from the distributions that were
executed in the target, and holds for all: a test that was found to lie about some is believed less
about the others. A distribution that takes after no test is one of a population: it has one likely
outcome, or several. The distributions of one group (here those of one rule) share a population,
which is learned likewise.

That makes a mixture of Dirichlet distributions of each. Near work: the robust mixture prior of
Schmidli et al. 2014, in which the weight is given, and of one distribution; empirical Bayes (Robbins
1956).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from menid_plan.mdp.model import Bools, Floats, Ints

RELATIONS = 3  # closely, loosely, the other way round
# How many executions in the target what a test shows is worth, however often it was tested.
STRENGTH = np.array([300.0, 8.0, 30.0])
# Pseudo counts of the relations to one test, and of taking after none.
RELATED = np.array([1.0, 1.0, 0.1])
UNRELATED = 1.0
# A small part of every outcome, so that none is impossible.
LEAST = 0.05
# Of a test without data; the estimate from it is (x + PRIOR) / (n + PRIOR k).
PRIOR = 0.25
# Rounds of expectation and maximisation.
ROUNDS = 4


def classes(outcomes: int) -> Floats:
    """The classes of a population of distributions over k outcomes: float64[k + 1, k].

    Of the first k each has one likely outcome (for two outcomes, Beta(.5, 6) and Beta(6, .5)); in the
    last no outcome is likelier than another.
    """
    found = np.full((outcomes + 1, outcomes), 0.5 / max(1, outcomes - 1))
    np.fill_diagonal(found, 6.0)
    found[-1] = 3.0 / outcomes
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Weights:
    """How often which is the case.

    ``related`` (float64[tests, 3]) and ``unrelated`` sum to 1; ``populations`` (float64[groups, K + 1])
    has a line of classes for each group, which sums to 1.
    """

    related: Floats
    unrelated: float
    populations: Floats


class Belief:
    """What is believed of D distributions; counts are added, and `learn` takes them in.

    ``outcomes`` says of each how many it has, ``groups`` (from 0 on) to which group it belongs, and
    ``tests`` how many environments there are beside the target. ``counts`` is float64[D, 1 + tests, K],
    the target first, with 0 for outcomes that a distribution does not have. Of each distribution the J
    components are the three relations to each test, then the classes of its population:
    ``parameters`` (float64[D, J, K]) are those of the prior, ``weights`` (float64[D, J]) those of the
    posterior, which is a mixture of Dir(parameters + counts in the target).
    """

    def __init__(self, outcomes: Sequence[int], groups: Sequence[int], tests: int) -> None:
        from scipy.special import gammaln  # to load it takes longer than a decision

        self._log_gamma = gammaln
        self.outcomes: Ints = np.array(outcomes, np.int64)
        self.groups: Ints = np.array(groups, np.int64)
        self.tests = tests
        number, most = len(self.outcomes), int(self.outcomes.max(initial=1))
        self.relations = RELATIONS * tests
        self.components = self.relations + most + 1
        self.counts = np.zeros((number, 1 + tests, most))
        self.parameters = np.zeros((number, self.components, most))
        self.classes = np.zeros((number, most + 1, most))
        self._has = np.zeros((number, self.components), np.bool_)
        self._fit = np.zeros((number, self.components))
        for index, k in enumerate(self.outcomes.tolist()):
            self.classes[index, : k + 1, :k] = classes(k)
            self._has[index, self.relations : self.relations + k + 1] = True
        self.parameters[:, self.relations :] = self.classes
        self._changed: set[int] = set()
        self.shared = self._maximised(self._prior_counts())
        self.weights = self._weights(self.shared)

    def add(self, index: int, environment: int, seen: Floats) -> None:
        """Count outcomes (float64[k]) of a distribution in an environment, 0 for the target."""
        self.counts[index, environment, : len(seen)] += seen
        self._changed.add(index)

    def learn(self) -> bool:
        """Take in what was added; whether anything but those distributions has changed by it."""
        changed = sorted(self._changed)
        if not changed:
            return False
        self._changed.clear()
        executed: Bools = np.asarray(self.counts[:, 0].any(axis=1))
        for index in changed:
            self._refresh(index)
        if executed[changed].any():
            self.shared = self._learned(executed)
            self.weights = self._weights(self.shared)
            return True
        self.weights[changed] = self._weights(self.shared, np.array(changed))
        return False

    def mean(self) -> Floats:
        """What is expected of each distribution: float64[D, K]."""
        after = self.parameters + self.counts[:, :1]
        sums = np.maximum(after.sum(axis=2), 1e-300)
        found: Floats = ((self.weights / sums)[:, None, :] @ after)[:, 0]
        return found

    def sample(self, rng: np.random.Generator, size: int) -> Floats:
        """Distributions drawn from what is believed: float64[size, D, K]."""
        edges = np.cumsum(self.weights, axis=1)[:, :-1]
        drawn = rng.random((size, len(edges), 1))
        which = (drawn >= edges).sum(axis=2)
        after = self.parameters + self.counts[:, :1]
        gammas = rng.standard_gamma(after[np.arange(len(edges)), which])
        sums = gammas.sum(axis=2, keepdims=True)
        # Gammas of a tiny shape may all be 0 in double precision.
        return np.where(sums > 0.0, gammas / np.where(sums > 0.0, sums, 1.0), self.mean())

    # ------------------------------------------------------------------------------------ learning

    def _refresh(self, index: int) -> None:
        """Make the components of one distribution, and see how well each foresaw the target."""
        k = int(self.outcomes[index])
        target, *tests = self.counts[index, :, :k]
        for test, seen in enumerate(tests):
            total = seen.sum()
            if total > 0.0:
                columns = slice(RELATIONS * test, RELATIONS * (test + 1))
                self.parameters[index, columns, :k] = related(seen)
                self._has[index, columns] = True
        has, log_gamma = self._has[index], self._log_gamma
        before = self.parameters[index, has, :k]
        if target.any():
            after = before + target
            self._fit[index, has] = (
                (log_gamma(after) - log_gamma(before)).sum(axis=1)
                - log_gamma(after.sum(axis=1)) + log_gamma(before.sum(axis=1))
            )  # fmt: skip

    def _learned(self, executed: Bools) -> Weights:
        """The weights that explain best what was executed (a maximum of their posterior is near)."""
        rows = np.flatnonzero(executed)
        tested = self._has[rows, : self.relations].any(axis=1)
        found = self._maximised(self._prior_counts())
        for _ in range(ROUNDS):
            posterior = self._weights(found, rows)
            related, unrelated, populations = self._prior_counts()
            ours = posterior[:, self.relations :]
            related += posterior[:, : self.relations].sum(axis=0).reshape(related.shape)
            # Part of it is that of taking after a test which has no data.
            share = found.unrelated / self._unknown(found, self._has[rows])
            unrelated += float((ours.sum(axis=1) * share)[tested].sum())
            np.add.at(populations, self.groups[rows], ours)
            found = self._maximised((related, unrelated, populations))
        return found

    def _prior_counts(self) -> tuple[Floats, float, Floats]:
        number = int(self.groups.max(initial=0)) + 1
        populations = np.zeros((number, self.classes.shape[1]))
        populations[self.groups] = self._has[:, self.relations :]
        return np.tile(RELATED, (self.tests, 1)), UNRELATED, populations

    @staticmethod
    def _maximised(counts: tuple[Floats, float, Floats]) -> Weights:
        related, unrelated, populations = counts
        total = related.sum() + unrelated
        return Weights(
            related / total, unrelated / total,
            populations / np.maximum(populations.sum(axis=1, keepdims=True), 1e-300),
        )  # fmt: skip

    def prior_weights(
        self, shared: Weights, rows: Ints | None = None, known: int | None = None
    ) -> Floats:
        """The weights of components before the target was seen: float64[rows, J].

        What takes after a test without data is like any of its population. ``known`` is a test that is
        to count as one with data.
        """
        rows = np.arange(len(self.outcomes)) if rows is None else rows
        has = self._has[rows]
        if known is not None:
            has[:, RELATIONS * known : RELATIONS * (known + 1)] = True
        found = np.where(has, 1.0, 0.0)
        found[:, : self.relations] *= shared.related.ravel()
        classes = shared.populations[self.groups[rows]]
        found[:, self.relations :] *= self._unknown(shared, has)[:, None] * classes
        return found

    def _unknown(self, shared: Weights, has: Bools) -> Floats:
        """The weight of taking after no test, or after one without data: float64[rows]."""
        missing = np.where(has[:, : self.relations], 0.0, shared.related.ravel())
        found: Floats = shared.unrelated + missing.sum(axis=1)
        return found

    def _weights(self, shared: Weights, rows: Ints | None = None) -> Floats:
        rows = np.arange(len(self.outcomes)) if rows is None else rows
        with np.errstate(divide="ignore"):
            logs = np.log(self.prior_weights(shared, rows)) + self._fit[rows]
        weights = np.exp(logs - logs.max(axis=1, keepdims=True))
        found: Floats = weights / weights.sum(axis=1, keepdims=True)
        return found


def related(seen: Floats) -> Floats:
    """The parameters of the three relations to a test with these counts (float64[k]): float64[3, k].

    The strength S of a relation falls short of `STRENGTH` where the test is not known well itself: the
    variance of the two is that of a Beta distribution with a share for either.
    """
    k, total = len(seen), float(seen.sum())
    estimate = (seen + PRIOR) / (total + PRIOR * k)
    spread = 1.0 / (STRENGTH + 1.0) + STRENGTH / (STRENGTH + 1.0) / (total + k)
    strength = 1.0 / spread - 1.0
    means = np.array([estimate, estimate, (1.0 - estimate) / max(1, k - 1)])
    found: Floats = strength[:, None] * means + LEAST
    return found
