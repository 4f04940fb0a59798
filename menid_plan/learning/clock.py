"""What the time is in a run: by what executions are said to take, or by the clock on the wall."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable
from typing import Protocol


def clock_text(seconds: float) -> str:
    """Hours, minutes and seconds, as 1:02:03."""
    hours, rest = divmod(round(seconds), 3600)
    minutes, rest = divmod(rest, 60)
    return f"{hours}:{minutes:02}:{rest:02}"


class Clock(Protocol):
    """The time of a run, in seconds since it began."""

    @property
    def seconds(self) -> float:
        """What it shows."""

    def spend(self, seconds: float) -> None:
        """An execution, or several side by side, took so long."""

    def come_to_point(self) -> None:
        """The run has come to the next point of its curve."""

    def caught_up(self) -> None:
        """From here on nothing is a repetition."""


class VirtualClock:
    """Stands still but for the durations of executions: the same in every repetition of a run."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def spend(self, seconds: float) -> None:
        """Go on by so much."""
        self.seconds += seconds

    def come_to_point(self) -> None:
        """Nothing: the durations tell all."""

    def caught_up(self) -> None:
        """Nothing."""


class RealClock:
    """Seconds that really go by while the run does; the time between two sittings is left out.

    ``past`` are the times of the points that the run came to before it was resumed, in order.
    """

    def __init__(self, past: Iterable[float] = ()) -> None:
        self._past = deque(past)
        self._before = 0.0
        self._since: float | None = None

    @property
    def seconds(self) -> float:
        """What it shows."""
        return self._before + (0.0 if self._since is None else time.monotonic() - self._since)

    def spend(self, seconds: float) -> None:
        """Nothing: the time has gone by already. Only in a repetition is it added."""
        if self._since is None:
            self._before += seconds

    def come_to_point(self) -> None:
        """In a repetition, show the time at which the run was here before, if that is known."""
        if self._past:
            self._before = self._past.popleft()

    def caught_up(self) -> None:
        """Start to run."""
        self._past.clear()
        if self._since is None:
            self._since = time.monotonic()
