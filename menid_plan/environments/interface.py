"""What an environment is: it is put into a state, and executes actions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from menid_plan.errors import MenidError
from menid_plan.grounding.state import GroundAction, State


@dataclass(frozen=True, slots=True)
class Execution:
    """What came of an action: the state after it, and what it paid and took.

    ``reward`` is None where the problem's rewards say it all; ``duration`` is in seconds, None where
    it is to be measured from outside.
    """

    state: State
    reward: float | None = None
    duration: float | None = None


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What an environment can do.

    ``reset_to_any``: it can be put into any state of the domain, not only into its own first one.
    ``repeatable``: with the same seed it does the same. ``parallel``: copies of it may run at once.
    ``note`` tells a user more in a line: how many experiences a record has, what a program calls
    itself.
    """

    reset_to_any: bool = True
    repeatable: bool = True
    parallel: bool = True
    note: str = ""


class Environment(Protocol):
    """A place where actions are executed, one after the other.

    Failures are raised as EnvironmentFailedError; after one, the next ``reset`` starts afresh. Seeds
    are whole numbers, 0 <= seed < 2**53: what every program can read without loss.
    """

    @property
    def capabilities(self) -> Capabilities:
        """What it can do."""

    def reset(self, state: State | None, seed: int) -> State:
        """Put it into a state (None: its own first one) and seed its chances; the state it is in.

        Raises CannotResetError where it can't be put into that state.
        """

    def execute(self, action: GroundAction) -> Execution:
        """Execute an action in the state that it is in."""

    def state(self) -> State:
        """The state that it is in."""

    def close(self) -> None:
        """Let go of whatever it holds; may be called twice."""


class EnvironmentFailedError(MenidError):
    """An environment broke down, or does not keep to its protocol; no outcome was seen."""

    exit_code = 5


class CannotResetError(EnvironmentFailedError):
    """An environment cannot be put into a state."""


class NotRecordedError(EnvironmentFailedError):
    """A record has nothing of an action in a state: there it can't say what happens."""
