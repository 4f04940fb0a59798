"""An environment that draws its outcomes from a column of the domain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from menid_plan.environments.interface import Capabilities, EnvironmentFailedError, Execution
from menid_plan.environments.registry import Place
from menid_plan.environments.sampling import Sampler
from menid_plan.environments.session import MAX_DURATION
from menid_plan.environments.settings import SettingError, check_range, unknown
from menid_plan.grounding.semantics import Semantics
from menid_plan.grounding.state import SINK, GroundAction, State


@dataclass(frozen=True, slots=True)
class Simulated:
    """Draws outcomes by the probabilities of a column of the domain.

    ``column`` is the environment whose probabilities count, by default the one of the same name.
    ``params`` sets params of the domain anew, for this environment alone. ``duration`` is how long an
    execution takes on the virtual clock, in seconds: a number, or one for each action. Rewards are
    those of the step that was drawn. Noise leaves the state as it is.
    """

    name: ClassVar[str] = "simulated"
    promise: ClassVar[str] = "draws outcomes from a column of the domain"
    needs: ClassVar[str] = ""

    column: str = ""
    params: Mapping[str, float] | None = None
    duration: float | Mapping[str, float] = 1.0

    def __post_init__(self) -> None:
        check_range(self, "duration", most=MAX_DURATION)

    def build(self, place: Place) -> SimulatedEnvironment:
        """Build it; SettingError for a column, param or action that the domain does not have."""
        domain = place.domain
        column = self.column or place.name
        columns = [e.name for e in domain.all_environments]
        if column not in columns:
            raise SettingError("column", f"`{column}`: {unknown('environment', column, columns)}")
        params = dict(place.params)
        for name, value in (self.params or {}).items():
            known = [p.name for p in domain.params]
            if name not in known:
                raise SettingError(f"params.{name}", unknown("param", name, known))
            params[name] = value
        semantics = Semantics(domain, place.problem, params)
        return SimulatedEnvironment(Sampler(semantics, column), self._durations(place))

    def _durations(self, place: Place) -> dict[str, float]:
        """The duration of every action in seconds, by its name."""
        actions = [a.name for a in place.domain.actions]
        if not isinstance(self.duration, Mapping):
            return dict.fromkeys(actions, self.duration)
        for name in self.duration:
            if name not in actions:
                raise SettingError(f"duration.{name}", unknown("action", name, actions))
        for name in actions:
            if name not in self.duration:
                raise SettingError("duration", f"there is none for action `{name}`")
        return dict(self.duration)


class SimulatedEnvironment:
    """A state that evolves by the definition of the language, with drawn outcomes."""

    capabilities = Capabilities()

    def __init__(self, sampler: Sampler, durations: Mapping[str, float]) -> None:
        self._sampler = sampler
        self._durations = durations
        self._state = sampler.semantics.initial_state
        self._rng: np.random.Generator | None = None

    def reset(self, state: State | None, seed: int) -> State:
        """Put it into a state (None: that of ``init``)."""
        self._state = self._sampler.semantics.initial_state if state is None else state
        self._rng = np.random.default_rng(seed)
        return self._state

    def execute(self, action: GroundAction) -> Execution:
        """Draw an outcome; EnvironmentFailedError where the action does not apply."""
        if self._rng is None:
            raise EnvironmentFailedError("it was not reset")
        drawn = self._sampler.draw(self._state, action, self._rng.random())
        assert drawn.state is not SINK
        self._state = drawn.state
        return Execution(drawn.state, drawn.reward, self._durations[action.action])

    def state(self) -> State:
        """The state that it is in."""
        return self._state

    def close(self) -> None:
        """There is nothing to let go of."""
