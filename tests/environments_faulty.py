"""Kinds of environments that go wrong in every way; workers import this module by its name."""

from __future__ import annotations

import os
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from menid_plan.environments.interface import (
    CannotResetError,
    Capabilities,
    EnvironmentFailedError,
    Execution,
)
from menid_plan.environments.registry import Place
from menid_plan.environments.simulated import Simulated, SimulatedEnvironment
from menid_plan.grounding.state import GroundAction, State


@dataclass(frozen=True)
class Faulty:
    """A simulated environment that has a fault in every ``every``-th seed, or in its first attempt.

    With ``once`` (a folder) an execution fails only until the folder has a file with its seed's name.
    """

    name: ClassVar[str] = "faulty"
    promise: ClassVar[str] = "goes wrong"
    needs: ClassVar[str] = ""

    fault: str = ""
    every: int = 1
    once: str = ""
    parallel: bool = True
    repeatable: bool = True
    anywhere: bool = True
    diary: str = ""

    def build(self, place: Place) -> FaultyEnvironment:
        if self.fault == "start":
            raise EnvironmentFailedError("it does not start")
        if self.diary:
            with Path(self.diary).open("a") as file:
                file.write(f"{os.getpid()}\n")
        return FaultyEnvironment(self, Simulated().build(place))


class FaultyEnvironment:
    def __init__(self, settings: Faulty, inner: SimulatedEnvironment) -> None:
        self.settings = settings
        self.inner = inner
        self.seed = 0
        self.closed = 0

    @property
    def capabilities(self) -> Capabilities:
        s = self.settings
        return Capabilities(s.anywhere, s.repeatable, s.parallel)

    def reset(self, state: State | None, seed: int) -> State:
        self.seed = seed
        if self.settings.fault == "cannot-reset" and state is not None:
            raise CannotResetError("not there")
        if self.settings.fault == "resets-elsewhere" and state is not None:
            return frozenset()
        return self.inner.reset(state, seed)

    def execute(self, action: GroundAction) -> Execution:
        found = self.inner.execute(action)
        if self.seed % self.settings.every or not self._still():
            return found
        match self.settings.fault:
            case "exit":
                os._exit(3)
            case "segfault":
                sys.stderr.flush()
                os.kill(os.getpid(), signal.SIGSEGV)
            case "hang":
                time.sleep(3600)
            case "raise":
                raise ZeroDivisionError("of all things")
            case "fail":
                raise EnvironmentFailedError("the gripper is stuck")
            case "nan":
                return Execution(found.state, float("nan"), found.duration)
            case "negative":
                return Execution(found.state, found.reward, -1.0)
            case "list":
                return Execution(list(found.state), found.reward)  # type: ignore[arg-type]
            case "unknown-atom":
                atom = next(iter(found.state))._replace(predicate="nowhere")
                return Execution(found.state | {atom})
            case "random":
                return Execution(found.state, time.perf_counter())
            case "print":
                print("a line on standard output")
                os.write(1, b"and one past Python\n")
        return found

    def _still(self) -> bool:
        if not self.settings.once:
            return True
        mark = Path(self.settings.once) / str(self.seed)
        if mark.exists():
            return False
        mark.touch()
        return True

    def state(self) -> State:
        if self.settings.fault == "forgets":
            return frozenset()
        return self.inner.state()

    def close(self) -> None:
        self.closed += 1
        if self.settings.fault == "close" and self.closed > 1:
            raise RuntimeError("closed already")
