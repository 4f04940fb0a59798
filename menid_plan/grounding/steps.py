"""What happens in one step, as values: the covering rule, the reward's parts, the transitions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from menid_plan.errors import MeaningError
from menid_plan.grounding.state import (
    Binding,
    GroundAction,
    NextState,
    State,
    binding_text,
    state_text,
)
from menid_plan.model.rules import Rule


@dataclass(frozen=True, slots=True)
class Covering:
    """A rule that covers a state for an action instance.

    ``binding`` gives the objects of the action's parameters and of the deictic references.
    """

    action: GroundAction
    rule: Rule
    binding: Binding = field(hash=False)

    @property
    def values(self) -> tuple[str, ...]:
        """The objects of the rule's `per` parameters, which have a distribution of their own."""
        return tuple(self.binding[name] for name in self.rule.per)

    def __str__(self) -> str:
        where = f" ({binding_text(self.binding)})" if self.binding else ""
        return f"`{self.rule.name}`{where}"


class RuleConflict(MeaningError):  # noqa: N818 - the field calls it so
    """Several rules cover a state for one action instance."""

    def __init__(self, coverings: Sequence[Covering], state: State) -> None:
        super().__init__(coverings, state)
        self.coverings = tuple(coverings)
        self.state = state

    @property
    def action(self) -> GroundAction:
        """The action instance."""
        return self.coverings[0].action

    def __str__(self) -> str:
        rules = " and ".join(map(str, self.coverings))
        return f"`{self.action}` is covered by rules {rules} in the state {state_text(self.state)}"


@dataclass(frozen=True, slots=True)
class Reward:
    """What a step pays, by its parts; ``cost`` is subtracted."""

    state: float = 0.0
    outcome: float = 0.0
    cost: float = 0.0
    goal: float = 0.0
    dead_end: float = 0.0

    @property
    def total(self) -> float:
        """The step's reward."""
        return self.state + self.outcome - self.cost + self.goal + self.dead_end


@dataclass(frozen=True, slots=True)
class Transition:
    """One way in which a step may go. Its probability is positive."""

    probability: float
    outcome: str
    state: NextState
    reward: float
