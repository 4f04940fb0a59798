"""One experience: what an action did in an environment, and how the domain explains it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from menid_plan.grounding.state import GroundAction, State


class DistributionKey(NamedTuple):
    """Which distribution over outcomes: a rule of an action and the values of its ``per``."""

    action: str
    rule: str
    values: tuple[str, ...] = ()

    def __str__(self) -> str:
        per = f" for {', '.join(self.values)}" if self.values else ""
        return f"{self.action}.{self.rule}{per}"


@dataclass(frozen=True, slots=True)
class Explanation:
    """The rule that covered a step, and the share of each outcome that could have led there.

    ``values`` are those of the rule's ``per`` parameters. ``weights`` (one for each outcome, noise
    last) sum to 1.
    """

    rule: str
    values: tuple[str, ...]
    weights: tuple[float, ...]

    def key(self, action: GroundAction) -> DistributionKey:
        """The distribution that it is evidence for; ``action`` is the one that was executed."""
        return DistributionKey(action.action, self.rule, self.values)


@dataclass(frozen=True, slots=True)
class Experience:
    """An execution of an action.

    ``reward`` is None where the environment gives none; ``duration`` is in seconds, measured or
    nominal as the environment has it. ``seed`` is what the execution drew its chances from, ``when``
    the time at its end in seconds since 1970. ``explanation`` is None where no rule of the action
    covers the state. ``number`` counts from 0: in the target environment the steps of the run, in a
    test environment the tests of this action there.
    """

    environment: str
    state: State
    action: GroundAction
    after: State
    reward: float | None
    duration: float
    seed: int
    when: float
    explanation: Explanation | None
    number: int
