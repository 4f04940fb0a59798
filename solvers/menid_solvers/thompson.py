"""Thompson sampling: draw a model from what was seen, solve it, act by it.

Thompson 1933; for Markov decision processes Strens 2000 and Osband, Russo and Van Roy 2013.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Protocol, TypeAlias

import numpy as np

from menid_plan.mdp.model import MDP, Floats
from menid_plan.solving import Objective, Solution, Solver
from menid_solvers.value_iteration import ValueIteration

Probabilities: TypeAlias = Sequence[Floats]
"""The outcome probabilities of every distribution: float64[outcomes of that one], each sums to 1."""


class Posterior(Protocol):
    """What is believed about the outcome distributions."""

    def sample(self, rng: np.random.Generator) -> Probabilities:
        """Draw one set of distributions."""

    def update(self, distribution: int, outcome: int, weight: float) -> None:
        """Learn that an outcome of a distribution was seen, with a weight (an attribution's share)."""


@dataclass(slots=True)
class DirichletPosterior:
    """Independent Dirichlet distributions with parameters prior + counts.

    ``counts`` (float64[outcomes] for each distribution) is copied; a prior of 1 is uniform.
    """

    counts: list[Floats]
    prior: float = 1.0

    def __post_init__(self) -> None:
        if not self.prior > 0.0:
            raise ValueError("the prior must be above 0")
        self.counts = [np.array(row, dtype=np.float64) for row in self.counts]

    def sample(self, rng: np.random.Generator) -> Probabilities:
        """Draw one set of distributions."""
        return [rng.dirichlet(row + self.prior) for row in self.counts]

    def update(self, distribution: int, outcome: int, weight: float = 1.0) -> None:
        """Add to a count."""
        self.counts[distribution][outcome] += weight


@dataclass(slots=True)
class ThompsonPolicy:
    """Asks a freshly drawn and solved model for every action.

    ``fill`` puts drawn probabilities into the structure of the MDP, which is not built again. The
    values of the last draw are the guess from which the next is solved: that saves time and, ties
    within the solver's epsilon aside, changes no action (``warm=False`` leaves it away).
    ``redraw`` is how many actions one draw serves. Every random number comes from ``rng``.
    """

    name: ClassVar[str] = "thompson"
    promise: ClassVar[str] = "acts as often by an action as it is believed to be the best"
    needs: ClassVar[str] = ""

    fill: Callable[[Probabilities], MDP]
    posterior: Posterior
    rng: np.random.Generator
    solver: Solver = field(default_factory=ValueIteration)
    objective: Objective = "reward"
    redraw: int = 1
    warm: bool = True
    solution: Solution | None = field(default=None, init=False)
    _served: int = field(default=0, init=False)

    def action(self, state: int, seconds: float | None = None) -> int:  # noqa: ARG002
        """The row to take in a state, -1 if there is none; draws and solves a model if one is due."""
        if self.solution is None or self._served >= self.redraw:
            self.draw()
        assert self.solution is not None
        self._served += 1
        steps = self.solution.steps
        if steps is not None:
            return steps.row(state, steps.horizon)
        return int(self.solution.policy[state])

    def draw(self) -> Solution:
        """Draw a model and solve it."""
        mdp = self.fill(self.posterior.sample(self.rng))
        start = None
        if self.warm and self.solution is not None and mdp.horizon is None:
            start = (self.solution.lower + self.solution.upper) / 2
            start = np.nan_to_num(start, posinf=0.0, neginf=0.0)
        self.solution = self.solver.solve(mdp, self.objective, start=start)
        self._served = 0
        return self.solution

    def update(self, distribution: int, outcome: int, weight: float = 1.0) -> None:
        """Learn from an outcome; the next action is by a new draw."""
        self.posterior.update(distribution, outcome, weight)
        self._served = self.redraw
