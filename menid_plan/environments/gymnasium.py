"""A domain and a problem as a Gymnasium environment, for agents that learn by reinforcement.

Importing this module needs Gymnasium, an extra: ``pip install 'menid-plan[gymnasium]'``.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from menid_plan.environments.sampling import Sampler
from menid_plan.errors import MeaningError
from menid_plan.grounding.ground import ground
from menid_plan.grounding.recent import Recent
from menid_plan.grounding.semantics import Noise, Semantics
from menid_plan.grounding.state import SINK, GroundAction, State, state_text
from menid_plan.language.files import check_files
from menid_plan.model.domain import Domain, Problem

Observation = NDArray[np.int8]
Mask = NDArray[np.int8]


class _Masks(Recent[State, Mask]):
    SIZE = 20_000


class _Observations(Recent[State, Observation]):
    SIZE = 20_000


class GymEnv(gymnasium.Env[Observation, np.int64]):
    """A problem whose outcomes are drawn from a column of its domain.

    Actions are numbers, Discrete: ``actions[i]`` is the ground action. Observations are
    MultiBinary: entry i is 1 where the atom ``facts[i]`` holds; atoms that never change are left
    out. ``info["action_mask"]`` (int8, one entry for each action) is 1 where an action applies;
    one that does not leaves the state as it is and pays ``penalty``.

    ``environment`` is the column, by default the target's; ``params`` sets params of the domain anew;
    ``noise`` is as in `Semantics`. An episode terminates in a goal, a dead end or the sink (of which
    the observation is all zeros), and is truncated at the problem's horizon. Rewards are those of the
    language, not discounted. Raises MeaningError where nothing can be done or changed, and if the
    problem ends where it begins.
    """

    metadata: dict[str, Any] = {"render_modes": ["ansi"], "render_fps": 1}  # noqa: RUF012 - the base class has it so

    def __init__(
        self,
        domain: Domain,
        problem: Problem,
        environment: str | None = None,
        *,
        params: Mapping[str, float] | None = None,
        noise: Noise = "stay",
        penalty: float = 0.0,
        render_mode: str | None = None,
    ) -> None:
        self._semantics = Semantics(domain, problem, params, noise)
        if self._semantics.is_final(self._semantics.initial_state):
            raise MeaningError(f"problem `{problem.name}` ends where it begins")
        self._sampler = Sampler(self._semantics, environment or domain.target)
        grounded = ground(domain, problem, params)
        self.facts = grounded.facts
        self.actions: tuple[GroundAction, ...] = grounded.actions
        if not self.facts or not self.actions:
            raise MeaningError(f"in problem `{problem.name}` there is nothing to do, or to change")
        self.action_space = gymnasium.spaces.Discrete(len(self.actions))
        self.observation_space = gymnasium.spaces.MultiBinary(len(self.facts))
        self.render_mode = render_mode
        self._penalty = float(penalty)
        self._state: State | None = None
        self._steps = 0
        self._masks = _Masks()
        self._observations = _Observations()

    @classmethod
    def from_files(cls, *paths: str | Path, **options: Any) -> GymEnv:
        """The environment of a problem's file, with its domain's if that is not found beside it.

        ``options`` are those of the constructor. Raises InputError if there are errors in the files.
        """
        from menid_plan.errors import InputError

        results = check_files(paths, together=True)
        errors = [d for result in results for d in result.diagnostics if d.is_error]
        if errors:
            raise InputError(errors)
        for result in results:
            if result.problem is not None and result.known is not None:
                return cls(result.known.domain, result.problem, **options)
        raise MeaningError("the files hold no problem")

    @property
    def state(self) -> State | None:
        """The state that it is in; None before the first reset, and in the sink."""
        return self._state

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; ``options`` may have a ``state`` (a frozenset of atoms) to begin in."""
        super().reset(seed=seed)
        self._state = (options or {}).get("state", self._semantics.initial_state)
        self._steps = 0
        return self._observation(self._state), {"action_mask": self.action_masks()}

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Execute an action by its number; observation, reward, terminated, truncated and info."""
        if self._state is None:
            raise gymnasium.error.ResetNeeded("the environment was not reset")
        before, chosen = self._state, self.actions[int(action)]
        self._steps += 1
        outcome, reward, after = "", self._penalty, before
        if self.action_masks()[int(action)]:
            drawn = self._sampler.draw(before, chosen, float(self.np_random.random()))
            outcome, reward = drawn.outcome, drawn.reward
            if drawn.state is SINK:
                self._state = None
                nothing = np.zeros(len(self.facts), np.int8)
                info = {"action_mask": self.action_masks(), "outcome": outcome}
                return nothing, reward, True, False, info
            after = drawn.state
        self._state = after
        horizon = self._semantics.problem.horizon
        ended = self._semantics.is_goal(after) or self._semantics.is_dead_end(after)
        truncated = horizon is not None and self._steps >= horizon and not ended
        info = {"action_mask": self.action_masks(), "outcome": outcome}
        return self._observation(after), reward, ended, truncated, info

    def action_masks(self) -> Mask:
        """Which actions apply in the state that it is in (int8, 1 or 0); the name is sb3-contrib's."""
        if self._state is None:
            return np.zeros(len(self.actions), np.int8)
        found = self._masks.get(self._state)
        if found is None:
            applicable = {ground for ground, _ in self._semantics.applicable(self._state)}
            found = np.array([action in applicable for action in self.actions], np.int8)
            self._masks[self._state] = found
        return found.copy()

    def render(self) -> str | None:
        """The atoms of the state as a text, in render mode ``ansi``."""
        if self.render_mode != "ansi":
            return None
        return "sink" if self._state is None else state_text(self._state)

    def _observation(self, state: State) -> Observation:
        found = self._observations.get(state)
        if found is None:
            found = np.array([fact in state for fact in self.facts], np.int8)
            self._observations[state] = found
        return found.copy()
