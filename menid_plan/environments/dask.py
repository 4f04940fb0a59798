"""Lanes on the workers of a Dask scheduler."""

from __future__ import annotations

import pickle
import threading
import time
import uuid
from collections.abc import Mapping
from concurrent.futures import wait
from contextlib import suppress
from typing import Any

from menid_plan.environments.interface import Capabilities, EnvironmentFailedError, Execution
from menid_plan.environments.pool import LocalLane
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.worker import Task, WorkerFailedError
from menid_plan.errors import MenidError

_PATIENCE = 10.0  # seconds to find the scheduler
_PERIOD = 0.5  # seconds from one look at whether there are workers to the next


class _Kept:
    """What a thread of a Dask worker keeps: a lane, which is a process beside the Dask worker.

    So an environment that crashes or hangs leaves the Dask worker alone.
    """

    def __init__(self, pool: str, specs: bytes) -> None:
        self.pool = pool
        self.specs: Mapping[str, EnvironmentSpec] = pickle.loads(specs)  # noqa: S301
        self.lane = LocalLane(specs)


_kept: dict[int, _Kept] = {}
_lock = threading.Lock()


def _at_worker(pool: str, specs: bytes) -> _Kept:
    thread = threading.get_ident()
    found = _kept.get(thread)
    if found is None or found.pool != pool:
        if found is not None:  # of a pool that was never closed
            found.lane.close()
        found = _Kept(pool, specs)
        with _lock:
            _kept[thread] = found
    return found


# Failures are given back, not raised: Dask would write each of them into its log with a traceback.


def _build(pool: str, specs: bytes, name: str) -> Capabilities | MenidError:
    found = _at_worker(pool, specs)
    try:
        return found.lane.build(found.specs[name])
    except MenidError as error:
        return error


def _run(pool: str, specs: bytes, task: Task) -> Execution | MenidError:
    found = _at_worker(pool, specs)
    try:
        return found.lane.run(found.specs[task.environment], task)
    except MenidError as error:
        return error


def _interrupt(pool: str) -> None:
    for found in list(_kept.values()):
        if found.pool == pool:
            found.lane.interrupt()


def _end(pool: str) -> None:
    with _lock:
        ours = [thread for thread, found in _kept.items() if found.pool == pool]
        lanes = [_kept.pop(thread).lane for thread in ours]
    for lane in lanes:
        lane.close()


class Cluster:
    """A connection to a scheduler."""

    def __init__(self, address: str, specs: bytes, patience: float) -> None:
        """``specs`` is a pickled mapping from names to EnvironmentSpecs.

        Raises EnvironmentFailedError if the scheduler can't be reached, or has no workers for so many
        seconds; `ask` does as well.
        """
        try:
            from distributed import Client
        except ImportError as error:
            raise EnvironmentFailedError(
                "a scheduler needs Dask: pip install 'menid-plan[dask]'"
            ) from error
        try:
            connect: Any = Client
            self._client = connect(address, timeout=_PATIENCE, set_as_default=False)
        except (OSError, ValueError) as error:
            raise EnvironmentFailedError(f"the scheduler at {address}: {error}") from error
        self._address, self._waits = address, patience
        self._ending = threading.Event()
        try:
            self._client.wait_for_workers(1, timeout=patience)
        except BaseException as error:
            with suppress(Exception):
                self._client.close()
            if isinstance(error, TimeoutError):
                raise self._no_workers() from error
            raise
        self._executor = self._client.get_executor(pure=False)
        self._pool = uuid.uuid4().hex
        self._specs = specs

    def ask(self, function: Any, argument: object) -> Any:
        """What a function gives on one of the workers."""
        try:
            future = self._executor.submit(function, self._pool, self._specs, argument)
            self._wait(future)
            answer = future.result()
        except EnvironmentFailedError:
            raise
        except BaseException as error:  # cancelled, worker lost, scheduler gone
            raise WorkerFailedError("crash", f"Dask: {type(error).__name__}: {error}") from error
        if isinstance(answer, MenidError):
            raise answer
        return answer

    def _wait(self, future: Any) -> None:
        """Wait for a future; Dask itself would wait for workers, and would not be interrupted."""
        seen = time.monotonic()  # when there were workers
        patience = self._waits
        while not wait([future], _PERIOD).done:
            if self._has_workers():
                seen = time.monotonic()
            elif time.monotonic() - seen > patience:
                future.cancel()
                raise self._no_workers()
            if self._ending.is_set():
                patience = 0.0

    def _has_workers(self) -> bool:
        with suppress(Exception):
            return bool(self._client.scheduler_info()["workers"])
        return False

    def _no_workers(self) -> EnvironmentFailedError:
        return EnvironmentFailedError(f"the scheduler at {self._address} has no workers")

    def interrupt(self) -> None:
        """Kill the processes that the pool has on the workers."""
        self._ending.set()
        if not self._has_workers():
            return
        with suppress(Exception):
            self._client.run(_interrupt, self._pool)

    def close(self) -> None:
        """End those processes, in which nothing runs any more, and leave the scheduler."""
        with suppress(Exception):
            self._client.run(_end, self._pool)
        self._executor.shutdown()
        self._client.close()


class DaskLane:
    """A lane wherever the scheduler has room."""

    def __init__(self, cluster: Cluster) -> None:
        self._cluster = cluster

    def build(self, spec: EnvironmentSpec) -> Capabilities:
        """Build an environment on one of the workers."""
        found: Capabilities = self._cluster.ask(_build, spec.name)
        if not found.parallel:
            raise MenidError(
                f"environment `{spec.name}` allows no copies, and so can't run on a scheduler"
            )
        return found

    def run(self, spec: EnvironmentSpec, task: Task) -> Execution:  # noqa: ARG002
        """Execute on one of the workers."""
        found: Execution = self._cluster.ask(_run, task)
        return found

    def interrupt(self) -> None:
        """End what runs, of every lane."""
        self._cluster.interrupt()

    def close(self) -> None:
        """There is nothing that is this lane's alone."""
