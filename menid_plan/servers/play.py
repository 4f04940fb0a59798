"""Rounds that a planner plays in an environment, and what came of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.seeds import seed_of
from menid_plan.exchange.flat import Call
from menid_plan.experience.attribution import Attributor
from menid_plan.grounding.state import Binding, GroundAction, State


@dataclass(slots=True)
class Round:
    """One round: the sum of its rewards, undiscounted and discounted, and how it ended."""

    reward: float = 0.0
    discounted: float = 0.0
    steps: int = 0
    goal: bool = False


@dataclass(slots=True)
class Results:
    """The finished rounds of a session, and why it ended early, if it did."""

    client: str = ""
    rounds: list[Round] = field(default_factory=list)
    failure: str = ""

    def summary(self) -> dict[str, object]:
        """What is told in JSON; ``error`` is the standard error of the mean."""
        done = self.rounds
        rewards = [each.reward for each in done]
        return {
            "client": self.client,
            "rounds": len(done),
            "mean": float(np.mean(rewards)) if done else None,
            "error": float(np.std(rewards, ddof=1)) / math.sqrt(len(done)) if done[1:] else None,
            "discounted": float(np.mean([each.discounted for each in done])) if done else None,
            "goal_rate": float(np.mean([each.goal for each in done])) if done else None,
            "rewards": rewards,
            "steps": [each.steps for each in done],
            "failure": self.failure,
        }


class Player:
    """Plays rounds in an environment. Its rewards count; where it gives none, the problem's do."""

    def __init__(self, spec: EnvironmentSpec, seed: int = 0) -> None:
        self.spec, self.seed = spec, seed
        self.session = spec.open()
        self.attributor = Attributor(spec.domain, spec.problem)
        self.semantics = self.attributor.semantics
        self.discount = 1.0 if spec.problem.discount is None else spec.problem.discount
        self.state: State = frozenset()
        self.round = Round()
        self._count = 0

    def begin(self) -> State:
        """Begin a round in the initial state."""
        self.round = Round()
        first = frozenset(self.spec.problem.init)
        self.state = self.session.reset(first, seed_of(self.seed, "round", self._count))
        self._count += 1
        return self.state

    @property
    def over(self) -> bool:
        """Whether nothing can be done any more."""
        return self.semantics.is_goal(self.state) or self.semantics.is_dead_end(self.state)

    def applies(self, call: Call, binding: Binding) -> bool:
        """Whether what a planner calls can be executed, with these objects for its parameters."""
        if self.over:
            return False
        covering = self.semantics.covering(self.state, call.bound(binding))
        return covering is not None and call.fits(covering, binding, self.state)

    def act(self, action: GroundAction) -> float:
        """Execute an action; what it pays."""
        before = self.state
        found = self.session.execute(action)
        reward = found.reward
        if reward is None:
            explanation = self.attributor.explain(before, action, found.state)
            reward = self.attributor.reward(before, action, found.state, explanation)
        self.state = found.state
        self.round.discounted += self.discount**self.round.steps * reward
        self.round.reward += reward
        self.round.steps += 1
        return reward

    def end(self) -> Round:
        """The round, finished."""
        self.round.goal = self.semantics.is_goal(self.state)
        return self.round

    def close(self) -> None:
        """Let go of the environment."""
        self.session.close()
