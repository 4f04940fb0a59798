"""An environment in use: what it says is checked, and every execution gets a duration."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import TypeVar

from menid_plan.environments.interface import (
    CannotResetError,
    Capabilities,
    Environment,
    EnvironmentFailedError,
    Execution,
)
from menid_plan.errors import MeaningError, MenidError
from menid_plan.experience.check import AtomChecker
from menid_plan.grounding.state import GroundAction, State, state_text
from menid_plan.model.domain import Domain, Problem

T = TypeVar("T")

# Seconds that an execution may be said to take: 30 years.
MAX_DURATION = 1e9


class Session:
    """An environment around another one that keeps it to the protocol.

    States are of known atoms, rewards finite, durations never None: nominal if ``nominal`` gives one
    for an action's name, else what the environment says, else measured. Whatever goes wrong inside is
    raised as EnvironmentFailedError that names the environment.
    """

    def __init__(
        self,
        environment: Environment,
        domain: Domain,
        problem: Problem,
        name: str,
        nominal: Callable[[str], float | None] = lambda _: None,
    ) -> None:
        self.environment = environment
        self.name = name
        self._atoms = AtomChecker(domain, problem)
        self._nominal = nominal

    @property
    def capabilities(self) -> Capabilities:
        """What it can do."""
        return self.environment.capabilities

    def reset(self, state: State | None, seed: int) -> State:
        """Put it into a state, and see that it is in that state."""
        found = self._checked(self._guarded(lambda: self.environment.reset(state, seed)))
        if state is not None and found != state:
            parts = []
            if state - found:
                parts.append(f"without {state_text(state - found)}")
            if found - state:
                parts.append(f"with {state_text(found - state)}")
            raise CannotResetError(
                f"environment `{self.name}` was to be put into a state, and is in another: "
                f"{' and '.join(parts)}"
            )
        return found

    def execute(self, action: GroundAction) -> Execution:
        """Execute an action; the result has a duration in seconds."""
        start = time.perf_counter()
        found = self._guarded(lambda: self.environment.execute(action))
        measured = time.perf_counter() - start
        state = self._checked(found.state)
        reward, duration = found.reward, found.duration
        if reward is not None and not math.isfinite(reward):
            raise EnvironmentFailedError(f"{self._where(action)}: the reward is {reward}")
        if duration is not None and not 0 <= duration <= MAX_DURATION:
            raise EnvironmentFailedError(
                f"{self._where(action)}: the duration is {duration} s, not from 0 to {MAX_DURATION:g}"
            )
        nominal = self._nominal(action.action)
        if nominal is not None:
            duration = nominal
        return Execution(state, reward, measured if duration is None else duration)

    def state(self) -> State:
        """The state that it is in."""
        return self._checked(self._guarded(self.environment.state))

    def close(self) -> None:
        """Close the environment."""
        self.environment.close()

    def _where(self, action: GroundAction) -> str:
        return f"environment `{self.name}`, `{action}`"

    def _checked(self, state: State) -> State:
        if not isinstance(state, frozenset):
            raise EnvironmentFailedError(
                f"environment `{self.name}`: a state is a frozenset of atoms, "
                f"not a {type(state).__name__}"
            )
        try:
            self._atoms.check(state)
        except MeaningError as error:
            raise EnvironmentFailedError(f"environment `{self.name}`: {error}") from error
        return state

    def _guarded(self, call: Callable[[], T]) -> T:
        """The result of a call into the environment; its exceptions as EnvironmentFailedError."""
        try:
            return call()
        except EnvironmentFailedError as error:
            raise type(error)(f"environment `{self.name}`: {error}") from error
        except MenidError:
            raise  # the domain means nothing there, or is too large: trying again is no help
        except (Exception, SystemExit) as error:
            raise EnvironmentFailedError(f"environment `{self.name}`: {said(error)}") from error


def said(error: BaseException) -> str:
    """An exception in words; what calls sys.exit ends an execution and nothing else."""
    if isinstance(error, SystemExit):
        return f"it called sys.exit({'' if error.code is None else repr(error.code)})"
    return f"{type(error).__name__}: {error}"


def without_name(message: str, environment: str) -> str:
    """A message of an environment for where its name stands already."""
    return message.removeprefix(f"environment `{environment}`: ")
