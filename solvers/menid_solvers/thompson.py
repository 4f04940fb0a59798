"""Thompson sampling: draw a model from what was seen, solve it, act by it.

Thompson 1933; for Markov decision processes Strens 2000 and Osband, Russo and Van Roy 2013.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from menid_plan.mdp.model import Floats, Ints
from menid_plan.solving import Belief, Solution
from menid_solvers.options import demand_at_least, demand_positive
from menid_solvers.value_iteration import ValueIteration


@dataclass(slots=True)
class DirichletPosterior:
    """Independent Dirichlet distributions with parameters prior + counts.

    ``counts`` (float64, one for each slot) is copied. ``starts`` (int64) has the first slot of each
    distribution. A prior of 1 is uniform.
    """

    counts: Floats
    starts: Ints
    prior: float = 1.0

    @classmethod
    def of(cls, counts: Sequence[Sequence[float]], prior: float = 1.0) -> DirichletPosterior:
        """From the counts of each distribution."""
        starts = np.cumsum([0, *(len(row) for row in counts)])[:-1]
        return cls(np.concatenate([np.zeros(0), *counts]), starts, prior)

    def __post_init__(self) -> None:
        if not self.prior > 0.0:
            raise ValueError("the prior must be above 0")
        self.counts = np.array(self.counts, dtype=np.float64)
        if bool(np.any(self.counts < 0.0)):
            raise ValueError("counts must not be below 0")

    def mean(self) -> Floats:
        """The expected probabilities."""
        return self._normal(self.counts + self.prior)

    def sample(self, rng: np.random.Generator) -> Floats:
        """Probabilities drawn from all the distributions, which are gammas over their sums."""
        drawn = rng.standard_gamma(self.counts + self.prior)
        # Gammas of a tiny shape may all be 0 in double precision; numpy draws those another way.
        for number in np.flatnonzero(np.add.reduceat(drawn, self.starts) < 1e-290):
            part = slice(int(self.starts[number]), int(self._ends[number]))
            drawn[part] = rng.dirichlet(self.counts[part] + self.prior)
        return self._normal(drawn)

    def update(self, slot: int, weight: float = 1.0) -> None:
        """Learn that a slot's outcome was seen, with a weight (an attribution's share)."""
        self.counts[slot] += weight

    @property
    def _ends(self) -> Ints:
        return np.append(self.starts[1:], len(self.counts))

    def _normal(self, weights: Floats) -> Floats:
        sums = np.add.reduceat(weights, self.starts) if len(weights) else weights
        normal: Floats = weights / np.repeat(sums, self._ends - self.starts)
        return normal


@dataclass(frozen=True, slots=True)
class Thompson:
    """Posterior sampling: every action is the best one of a model drawn from what is believed.

    ``redraw`` is how many actions one draw serves, ``epsilon`` how exactly a draw is solved (by
    value-iteration). With ``warm`` the values of the last draw are the guess from which the next is
    solved: that saves time and, ties within epsilon aside, changes no action.
    Thompson 1933; Strens 2000; Osband, Russo and Van Roy 2013.
    """

    name: ClassVar[str] = "thompson"
    promise: ClassVar[str] = "takes an action as often as it is believed to be the best"
    needs: ClassVar[str] = ""

    redraw: int = 1
    epsilon: float = 1e-6
    warm: bool = True

    def __post_init__(self) -> None:
        demand_at_least(1, redraw=self.redraw)
        demand_positive(epsilon=self.epsilon)

    def policy(self, belief: Belief, rng: np.random.Generator) -> ThompsonPolicy:
        """A policy for what is believed."""
        return ThompsonPolicy(self, belief, rng)


@dataclass(slots=True)
class ThompsonPolicy:
    """Asks a freshly drawn and solved model for every action; made by `Thompson.policy`."""

    options: Thompson
    belief: Belief
    rng: np.random.Generator
    solution: Solution | None = field(default=None, init=False)
    _served: int = field(default=0, init=False)
    _drawn: Floats = field(default_factory=lambda: np.zeros(0), init=False)

    def action(self, state: int, seconds: float | None = None) -> int:
        """The row to take in a state, -1 if there is none; draws and solves a model if one is due."""
        if self.solution is None or self._served >= self.options.redraw:
            self.draw(seconds)
        assert self.solution is not None
        self._served += 1
        steps = self.solution.steps
        if steps is not None:
            return steps.row(state, steps.horizon)
        return int(self.solution.policy[state])

    def draw(self, seconds: float | None = None) -> Solution:
        """Draw a model and solve it, in so many seconds if they are given.

        One that is drawn again, as by who knows the probabilities, is not solved again.
        """
        self._served = 0
        drawn = self.belief.posterior.sample(self.rng)
        found, before = self.solution, self._drawn
        if found is not None and found.status != "limit" and np.array_equal(drawn, before):
            return found
        self._drawn = drawn.copy()
        mdp = self.belief.fill(drawn)
        start = None
        if self.options.warm and self.solution is not None and mdp.horizon is None:
            start = (self.solution.lower + self.solution.upper) / 2
            start = np.nan_to_num(start, posinf=0.0, neginf=0.0)
        solver = ValueIteration(epsilon=self.options.epsilon, max_seconds=seconds)
        self.solution = solver.solve(mdp, self.belief.objective, start=start)
        return self.solution

    def learned(self) -> None:
        """What is believed has changed: the next action is by a new draw."""
        self._served = self.options.redraw
