"""A lane executes one task after the other: in a process of its own, or right here.

Those on other machines are in `menid_plan.environments.dask`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from menid_plan.environments.interface import Capabilities, EnvironmentFailedError, Execution
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.worker import Runner, Task, Worker, WorkerFailedError

# An environment that watches the time itself gets to say so, and to end its own processes.
_GRACE = 1.0


class Lane(Protocol):
    """Executes one task after the other."""

    def build(self, spec: EnvironmentSpec) -> Capabilities:
        """Build an environment; raises as `run`."""

    def run(self, spec: EnvironmentSpec, task: Task) -> Execution:
        """Execute; raises EnvironmentFailedError, WorkerFailedError if a process was lost."""

    def interrupt(self) -> None:
        """Have what runs come to an end; called from another thread."""

    def close(self) -> None:
        """Let go of everything; called where `run` is."""


class HereLane:
    """A lane in this process."""

    def __init__(self, specs: Mapping[str, EnvironmentSpec]) -> None:
        self._runner = Runner(specs)

    def build(self, spec: EnvironmentSpec) -> Capabilities:
        """Build an environment."""
        return self._runner.build(spec.name)

    def run(self, spec: EnvironmentSpec, task: Task) -> Execution:  # noqa: ARG002
        """Execute."""
        return self._runner.run(task)

    def interrupt(self) -> None:
        """Nothing runs here while another thread could say so."""

    def close(self) -> None:
        """Close the environments."""
        self._runner.close()


class LocalLane:
    """A lane in a process of its own, which is started when needed and anew when lost."""

    def __init__(self, specs: bytes) -> None:
        self._specs = specs
        self._worker: Worker | None = None
        self._built: set[str] = set()

    def build(self, spec: EnvironmentSpec) -> Capabilities:
        """Build an environment in the process."""
        try:
            if self._worker is None:
                self._worker = Worker(self._specs)
            found = self._worker.build(spec.name, spec.start_timeout)
        except WorkerFailedError:
            self._lost()
            raise
        self._built.add(spec.name)
        return found

    def run(self, spec: EnvironmentSpec, task: Task) -> Execution:
        """Execute in the process; building has a time limit of its own."""
        if spec.name not in self._built:
            self.build(spec)
        assert self._worker is not None
        try:
            return self._worker.run(task, spec.timeout, _GRACE)
        except WorkerFailedError:
            self._lost()
            raise
        except EnvironmentFailedError:
            self._built.discard(spec.name)  # it is built anew
            raise

    def _lost(self) -> None:
        self._worker = None
        self._built.clear()

    def interrupt(self) -> None:
        """Kill the process."""
        worker = self._worker
        if worker is not None:
            worker.kill()

    def close(self) -> None:
        """End the process."""
        if self._worker is not None:
            self._worker.close()
            self._lost()
