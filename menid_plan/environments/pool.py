"""Executions in several workers at once, each of which may crash or hang without harm to the others.

Tasks go to lanes (see `menid_plan.environments.lanes`). What a task gives depends on its state, action
and seed alone, so the number of lanes changes nothing but the time.
"""

from __future__ import annotations

import pickle
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from dataclasses import dataclass, replace

from menid_plan.environments.interface import (
    CannotResetError,
    Capabilities,
    EnvironmentFailedError,
    Execution,
    NotRecordedError,
)
from menid_plan.environments.lanes import HereLane, Lane, LocalLane
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.session import without_name
from menid_plan.environments.worker import Task, Trouble, WorkerFailedError
from menid_plan.grounding.state import GroundAction, State


@dataclass(frozen=True, slots=True)
class Failure:
    """One failed attempt at an execution; ``attempt`` counts from 1."""

    environment: str
    action: GroundAction
    number: int
    attempt: int
    trouble: Trouble
    message: str

    def __str__(self) -> str:
        return (
            f"environment `{self.environment}`, `{self.action}`, execution {self.number}, "
            f"attempt {self.attempt}: {self.message}"
        )


@dataclass(frozen=True, slots=True)
class Counts:
    """What happened in an environment: executions that gave a result, and attempts that failed.

    ``given_up``: executions of which every attempt failed.
    """

    executions: int = 0
    crashes: int = 0
    timeouts: int = 0
    errors: int = 0
    given_up: int = 0


class ExecutionFailedError(EnvironmentFailedError):
    """Every attempt at an execution failed; ``failures`` tells how."""

    def __init__(self, failures: Sequence[Failure]) -> None:
        super().__init__(failures)
        self.failures = tuple(failures)

    def __str__(self) -> str:
        last = self.failures[-1]
        return (
            f"environment `{last.environment}`: execution {last.number}, `{last.action}`, failed "
            f"{len(self.failures)} times; last: {last.message}"
        )


class ExecutionFuture(Future[Execution]):
    """The execution to come; its exception is ExecutionFailedError, or another MenidError."""

    def __init__(self, task: Task, number: int) -> None:
        super().__init__()
        self.task = task
        self.number = number


# Seconds that a scheduler may be without workers where no environment says how long it may start.
_PATIENCE = 60.0


class Pool:
    """Executes tasks in test environments: in worker processes, or in this one (``workers=0``).

    With ``scheduler``, the address of a Dask scheduler, they run on its workers, ``workers`` at once,
    each in a process of its own there. ``failed`` is called for each attempt that failed, from
    any thread, one at a time. To be closed, best by ``with``.
    """

    def __init__(
        self,
        specs: Iterable[EnvironmentSpec],
        workers: int = 1,
        scheduler: str | None = None,
        failed: Callable[[Failure], None] | None = None,
    ) -> None:
        self._specs = {spec.name: spec for spec in specs}
        self._failed = failed
        self._counts = {name: Counts() for name in self._specs}
        self._running = dict.fromkeys(self._specs, 0)
        self._capabilities: dict[str, Capabilities] = {}
        self._owner: dict[str, Lane] = {}  # of environments of which there may be one copy
        self._pending: deque[ExecutionFuture] = deque()
        self._changed = threading.Condition(threading.RLock())
        self._closed = False
        self._here: HereLane | None = None
        self._threads: list[threading.Thread] = []
        self._lanes: list[Lane] = []
        self._cluster = None
        if scheduler:
            from menid_plan.environments.dask import Cluster, DaskLane

            patience = max(
                (s.start_timeout or _PATIENCE for s in self._specs.values()), default=0.0
            )
            self._cluster = Cluster(scheduler, pickle.dumps(self._specs), patience)
            self._lanes = [DaskLane(self._cluster) for _ in range(max(1, workers))]
        elif workers:
            data = pickle.dumps(self._specs)
            self._lanes = [LocalLane(data) for _ in range(workers)]
        else:
            self._here = HereLane(self._specs)
        for lane in self._lanes:
            thread = threading.Thread(target=self._serve, args=(lane,), daemon=True)
            self._threads.append(thread)
            thread.start()

    def __enter__(self) -> Pool:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def workers(self) -> int:
        """How many executions can run at once."""
        return max(1, len(self._lanes))

    @property
    def in_place(self) -> bool:
        """Whether tasks are executed in this process, at once when they are submitted."""
        return self._here is not None

    @property
    def counts(self) -> Mapping[str, Counts]:
        """What happened so far, by environment."""
        with self._changed:
            return dict(self._counts)

    def submit(
        self,
        environment: str,
        state: State | None,
        action: GroundAction,
        seed: int,
        number: int = 0,
    ) -> ExecutionFuture:
        """Have an action executed in an environment that is put into a state.

        ``number`` is for `in_order` and messages. Without workers it is executed now. Raises KeyError
        for an unknown environment, RuntimeError if the pool is closed.
        """
        self._specs[environment]
        future = ExecutionFuture(Task(environment, state, action, seed), number)
        with self._changed:
            if self._closed:
                raise RuntimeError("the pool is closed")
            if self._here is None:
                self._pending.append(future)
                self._changed.notify_all()
        if self._here is not None:
            future.set_running_or_notify_cancel()
            self._execute(self._here, future)
        return future

    def close(self) -> None:
        """Cancel what waits, end what runs, close the environments; may be called twice."""
        with self._changed:
            self._closed = True
            while self._pending:
                self._pending.popleft().cancel()
            self._changed.notify_all()
        for thread in self._threads:
            while thread.is_alive():
                # Again and again: a lane may just have started what is to be interrupted.
                if sum(self._running.values()) > 0:
                    for lane in self._lanes:
                        lane.interrupt()
                thread.join(0.1)
        if self._here is not None:
            self._here.close()
        if self._cluster is not None:
            self._cluster.close()
            self._cluster = None

    # ------------------------------------------------------------------------------------- lanes

    def _serve(self, lane: Lane) -> None:
        """What the thread of a lane does. The thread outlives the processes that it starts."""
        while (future := self._take(lane)) is not None:
            name = future.task.environment
            try:
                if future.set_running_or_notify_cancel():
                    self._execute(lane, future)
            finally:
                with self._changed:
                    self._running[name] -= 1
                    self._changed.notify_all()
        lane.close()

    def _take(self, lane: Lane) -> ExecutionFuture | None:
        """The first task that may run in a lane, once there is one; None if the pool is closed."""
        with self._changed:
            while not self._closed:
                for future in self._pending:
                    if self._may_run(future.task.environment, lane):
                        self._pending.remove(future)
                        self._running[future.task.environment] += 1
                        return future
                self._changed.wait()
        return None

    def _may_run(self, name: str, lane: Lane) -> bool:
        capabilities = self._capabilities.get(name)
        if capabilities is None:  # the first one to be built tells whether there may be more
            return self._running[name] == 0
        if not capabilities.parallel:
            return self._owner[name] is lane
        limit = self._specs[name].workers
        return limit is None or self._running[name] < limit

    def _execute(self, lane: Lane, future: ExecutionFuture) -> None:
        """Execute a task and settle its future."""
        try:
            execution = self._attempts(lane, future)
        except BaseException as error:  # whoever waits for the result has to know
            future.set_exception(error)
            if lane is self._here and not isinstance(error, Exception):
                raise  # Ctrl-C in this very thread
        else:
            self._add(future.task.environment, executions=1)
            future.set_result(execution)

    def _attempts(self, lane: Lane, future: ExecutionFuture) -> Execution:
        """Execute a task, again if it fails; raises ExecutionFailedError when that is enough."""
        task = future.task
        spec = self._specs[task.environment]
        failures: list[Failure] = []
        while len(failures) <= spec.retries:
            try:
                self._learn(lane, spec)
                return lane.run(spec, task)
            except CannotResetError:
                raise
            except EnvironmentFailedError as error:
                if self._closed:
                    raise CancelledError from error
                trouble = error.trouble if isinstance(error, WorkerFailedError) else "error"
                attempt = len(failures) + 1
                message = without_name(str(error), spec.name)
                failures.append(
                    Failure(spec.name, task.action, future.number, attempt, trouble, message)
                )
                self._note(failures[-1])
                if isinstance(error, NotRecordedError):
                    break  # nor is it there the next time
        self._add(spec.name, given_up=1)
        raise ExecutionFailedError(failures)

    def _learn(self, lane: Lane, spec: EnvironmentSpec) -> None:
        """Build an environment for the first time, and learn how many copies there may be."""
        if spec.name in self._capabilities:
            return
        found = lane.build(spec)
        with self._changed:
            self._capabilities[spec.name] = found
            self._owner[spec.name] = lane
            self._changed.notify_all()

    def _note(self, failure: Failure) -> None:
        match failure.trouble:
            case "crash":
                self._add(failure.environment, crashes=1)
            case "timeout":
                self._add(failure.environment, timeouts=1)
            case _:
                self._add(failure.environment, errors=1)
        if self._failed is not None:
            with self._changed:
                self._failed(failure)

    def _add(self, name: str, **more: int) -> None:
        with self._changed:
            old = self._counts[name]
            sums = {key: getattr(old, key) + value for key, value in more.items()}
            self._counts[name] = replace(old, **sums)


def in_order(futures: Iterable[ExecutionFuture]) -> Iterator[ExecutionFuture]:
    """Futures by their numbers, each as soon as it and all before it are done.

    If the caller stops early the rest is cancelled: results that came too many are dropped.
    """
    waiting = deque(sorted(futures, key=lambda future: future.number))
    try:
        while waiting:
            with suppress(Exception, CancelledError):
                waiting[0].exception()
            yield waiting.popleft()
    finally:
        for future in waiting:
            future.cancel()
