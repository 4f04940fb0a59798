"""Draws what an action leads to from the probabilities that a domain writes of an environment."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from itertools import accumulate

from menid_plan.environments.interface import EnvironmentFailedError
from menid_plan.grounding.recent import Recent
from menid_plan.grounding.semantics import Semantics
from menid_plan.grounding.state import GroundAction, State, state_text
from menid_plan.grounding.steps import Transition


@dataclass(frozen=True, slots=True)
class _Ways:
    """The ways a step may go, and the sums of their probabilities up to each but the last."""

    sums: tuple[float, ...]
    transitions: tuple[Transition, ...]


class _Kept(Recent[tuple[State, GroundAction], _Ways]):
    SIZE = 20_000


class Sampler:
    """Draws transitions by the definition of the language; what was drawn from once is kept."""

    def __init__(self, semantics: Semantics, column: str) -> None:
        self.semantics = semantics
        self.column = column
        self._ways = _Kept()

    def draw(self, state: State, action: GroundAction, chance: float) -> Transition:
        """The transition at which the probabilities first sum to more than ``chance`` (0 <= . < 1).

        Raises EnvironmentFailedError where the action does not apply, MeaningError where two rules
        cover or probabilities are missing.
        """
        key = (state, action)
        ways = self._ways.get(key)
        if ways is None:
            ways = self._ways[key] = self._find(state, action)
        return ways.transitions[bisect_right(ways.sums, chance)]

    def _find(self, state: State, action: GroundAction) -> _Ways:
        found = tuple(self.semantics.transitions(state, action, self.column))
        if not found:
            raise EnvironmentFailedError(
                f"`{action}` does not apply in the state {state_text(state)}"
            )
        # Without the last sum, rounding can't leave a chance that is above all of them.
        sums = tuple(accumulate(transition.probability for transition in found[:-1]))
        return _Ways(sums, found)
