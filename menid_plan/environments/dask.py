"""Lanes on the workers of a Dask scheduler.

What a Dask worker keeps for a pool ends with the pool. If this process is killed nobody is left to say
so; but the scheduler forgets what a client wanted when its connection ends, so as long as the
scheduler knows of the pool's *sign of life*, a task that nothing else is done with, the pool is there.
"""

from __future__ import annotations

import asyncio
import itertools
import pickle
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError, Future, wait
from contextlib import contextmanager, suppress
from typing import Any

from menid_plan.environments.interface import Capabilities, EnvironmentFailedError, Execution
from menid_plan.environments.lanes import LocalLane
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.worker import Task, WorkerFailedError, WrongTaskError
from menid_plan.errors import MenidError

_PATIENCE = 10.0  # seconds to find the scheduler
_PERIOD = 0.5  # seconds from one look at whether there are workers to the next
_ENDING = 2.0  # seconds for which workers are waited for, to end what runs, and then the rest
_LOOKS = 2.0  # seconds from one look of a Dask worker for the sign of life to the next
_MISSES = 5  # looks in a row that may fail, since a scheduler may be busy

# ----------------------------------------------------------------------- the side of the Dask worker


class _Kept:
    """What a Dask worker keeps for a pool: lanes, each of which is a process beside the Dask worker.

    So an environment that crashes or hangs leaves the Dask worker alone.
    """

    def __init__(self, pool: str, specs: bytes, dask_worker: Any) -> None:
        self.specs: Mapping[str, EnvironmentSpec] = pickle.loads(specs)  # noqa: S301
        self._pool = pool
        self._pickled = specs
        self._dask_worker = dask_worker
        self._idle: list[LocalLane] = []
        self._busy: list[LocalLane] = []
        self._lock = threading.Lock()
        self._ended = threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()

    @contextmanager
    def lane(self) -> Iterator[LocalLane]:
        """A lane for one task. There are no more of them than tasks that ran at once."""
        with self._lock:
            if self._ended.is_set():
                raise WorkerFailedError("crash", "its pool has ended")
            lane = self._idle.pop() if self._idle else LocalLane(self._pickled)
            self._busy.append(lane)
        try:
            yield lane
        finally:
            with self._lock:
                self._busy.remove(lane)
                if not self._ended.is_set():
                    self._idle.append(lane)
            if self._ended.is_set():
                lane.close()

    def interrupt(self) -> None:
        """Kill the processes in which something runs."""
        with self._lock:
            for lane in self._busy:
                lane.interrupt()

    def end(self) -> None:
        """Kill these processes, and close the others."""
        with _lock:
            _kept.pop((self._dask_worker.id, self._pool), None)
        with self._lock:
            self._ended.set()
            idle, self._idle = self._idle, []
        self.interrupt()
        for lane in idle:
            lane.close()
        while self._busy:  # again: one may just have started what is to be killed
            time.sleep(0.1)
            self.interrupt()

    def _watch(self) -> None:
        """End when the sign of life is gone, or the scheduler is."""
        misses = 0
        while not self._ended.wait(_LOOKS):
            there = self._is_there()
            misses = misses + 1 if there is None else 0
            if there is False or misses == _MISSES:
                self.end()

    def _is_there(self) -> bool | None:
        """Whether the scheduler knows of the sign of life; None if it did not answer."""
        from distributed import sync

        key = _sign_of_life(self._pool)
        try:
            worker: Any = self._dask_worker
            ask = worker.scheduler.get_task_status
            states = sync(worker.loop, ask, keys=[key], callback_timeout=_PATIENCE)
            return states[key] is not None
        except Exception:  # whatever it is, the worker may be ending
            return None


_kept: dict[tuple[str, str], _Kept] = {}  # several Dask workers may share a process
_lock = threading.Lock()


def _sign_of_life(pool: str) -> str:
    return f"menid-plan-{pool}"


def _begun(pool: str, specs: bytes, number: int) -> _Kept:
    """What is kept for a pool, of which a task begins; the pool is told.

    For Dask does a task again whose worker was lost, and says nothing.
    """
    from distributed import get_worker

    worker: Any = get_worker()
    worker.log_event(pool, number)
    with _lock:
        found = _kept.get((worker.id, pool))
        if found is None:
            found = _kept[worker.id, pool] = _Kept(pool, specs, worker)
    return found


# Failures are given back, not raised: Dask would write each of them into its log with a traceback.


def _build(pool: str, specs: bytes, number: int, name: str) -> Capabilities | MenidError:
    found = _begun(pool, specs, number)
    try:
        with found.lane() as lane:
            return lane.build(found.specs[name])
    except MenidError as error:
        return error


def _run(pool: str, specs: bytes, number: int, task: Task) -> Execution | MenidError:
    found = _begun(pool, specs, number)
    try:
        with found.lane() as lane:
            return lane.run(found.specs[task.environment], task)
    except MenidError as error:
        return error


def _interrupt(pool: str, dask_worker: Any) -> None:
    found = _kept.get((dask_worker.id, pool))
    if found is not None:
        found.interrupt()


async def _end(pool: str, dask_worker: Any) -> None:
    found = _kept.get((dask_worker.id, pool))
    if found is not None:
        await asyncio.to_thread(found.end)  # environments may take their time to close


# ------------------------------------------------------------------------------ the side of the pool


class _Asked:
    """Something that a worker was asked for."""

    def __init__(self, number: int, what: tuple[object, object], future: Any) -> None:
        self.number = number
        self.what = what
        self.future = future
        self.lost = 0  # workers, of which was told


class Cluster:
    """A connection to a scheduler."""

    def __init__(self, address: str, specs: bytes, patience: float) -> None:
        """``specs`` is a pickled mapping from names to EnvironmentSpecs.

        Raises EnvironmentFailedError if the scheduler can't be reached, or has no workers for so many
        seconds; `answer` does as well.
        """
        try:
            from distributed import Client
        except ImportError as error:
            raise EnvironmentFailedError(
                "a scheduler needs Dask: pip install 'menid-plan[dask]'"
            ) from error
        try:
            _look_for_scheduler(address)
            connect: Any = Client
            self._client = connect(address, timeout=_PATIENCE, set_as_default=False)
        except TimeoutError as error:
            message = f"the scheduler at {address} gives no answer within {_PATIENCE:g} s"
            raise EnvironmentFailedError(message) from error
        except (OSError, ValueError) as error:
            raise EnvironmentFailedError(f"the scheduler at {address}: {error}") from error
        except Exception as error:  # Dask takes the answers of other programs for something
            message = f"what answers at {address} is no Dask scheduler"
            raise EnvironmentFailedError(message) from error
        self._address, self._waits = address, patience
        self._ending = threading.Event()
        self._end_of_patience: threading.Timer | None = None
        self._interrupting: threading.Thread | None = None
        try:
            self._client.wait_for_workers(1, timeout=patience)
        except BaseException as error:
            self._leave()
            if isinstance(error, TimeoutError):
                raise self._no_workers() from error
            raise
        self._executor = self._client.get_executor(pure=False)
        self._pool: str = self._client.id
        self._specs = specs
        self._numbers = itertools.count()
        self._begun: Counter[int] = Counter()  # how often workers began with what they were asked
        self._lock = threading.Lock()
        self._life: Any = None

    def ask(self, function: Callable[..., object], argument: object) -> _Asked:
        """Ask one of the workers for what a function gives."""
        number = next(self._numbers)
        try:
            self._check_connection()
            self._show_life()
            future = self._executor.submit(function, self._pool, self._specs, number, argument)
        except MenidError:
            raise
        except Exception as error:
            raise _lost(error) from error
        return _Asked(number, (function, argument), future)

    def answer(self, asked: _Asked) -> Any:
        """The answer. Raises LostWorkerError if another worker has to give it; then ask again."""
        try:
            self._wait(asked)
            answer = asked.future.result()
        except MenidError:
            raise
        except BaseException as error:  # cancelled, worker lost for good, scheduler gone
            raise _lost(error) from error
        self._begun.pop(asked.number, None)
        if isinstance(answer, MenidError):
            raise answer
        return answer

    def forget(self, asked: _Asked) -> None:
        """No answer is wanted any more."""
        if self._client.status != "closed":
            asked.future.cancel()
        self._begun.pop(asked.number, None)

    def _wait(self, asked: _Asked) -> None:
        """Wait for a future; Dask itself would wait for workers, and would not be interrupted."""
        seen = time.monotonic()  # when there were workers
        patience = self._waits
        while True:
            done = wait([asked.future], _PERIOD).done
            if self._begun[asked.number] > asked.lost + 1:
                asked.lost += 1
                raise LostWorkerError
            if done:
                return
            self._check_connection()
            if self._has_workers():
                seen = time.monotonic()
            elif time.monotonic() - seen > patience:
                self.forget(asked)
                raise self._no_workers()
            if self._ending.is_set():
                patience = 0.0

    def _check_connection(self) -> None:
        """Raise an error that no execution is blamed for if the client could not connect again."""
        if self._client.status == "closed":
            message = f"the connection to the scheduler at {self._address} was lost"
            raise WrongTaskError(message, EnvironmentFailedError.exit_code)

    def _show_life(self) -> None:
        """Have the scheduler know of the pool, again where it has lost the connection."""
        with self._lock:
            if self._life is None or self._life.cancelled():
                self._client.subscribe_topic(self._pool, self._note)
                self._life = self._client.submit(bool, key=_sign_of_life(self._pool))

    def _note(self, event: tuple[float, object]) -> None:
        """A worker begins with something; told before it answers. Dask itself has events there, too."""
        _, number = event
        if isinstance(number, int):
            self._begun[number] += 1

    def _has_workers(self) -> bool:
        with suppress(Exception):
            return bool(self._client.scheduler_info()["workers"])
        return False

    def _no_workers(self) -> EnvironmentFailedError:
        return EnvironmentFailedError(f"the scheduler at {self._address} has no workers")

    def interrupt(self) -> None:
        """Begin to kill what runs; what does not end soon, as where a machine hangs, is left alone."""
        self._ending.set()
        if self._end_of_patience is None:
            self._end_of_patience = threading.Timer(_ENDING, self._leave)
            self._end_of_patience.daemon = True
            self._end_of_patience.start()
        if self._interrupting is None or not self._interrupting.is_alive():
            self._interrupting = self._begin_everywhere(_interrupt)

    def close(self) -> None:
        """End the pool's processes, in which nothing runs any more, and leave the scheduler."""
        self._begin_everywhere(_end).join(_ENDING)
        if self._end_of_patience is not None:
            self._end_of_patience.cancel()
        self._leave()

    def _begin_everywhere(self, function: Callable[..., object]) -> threading.Thread:
        """Have a function called on all workers, of which some may not answer."""

        def call() -> None:
            with suppress(Exception):
                self._client.run(function, self._pool)

        thread = threading.Thread(target=call, daemon=True)
        thread.start()
        return thread

    def _leave(self) -> None:
        """Leave the scheduler; whoever waits for it gets an exception."""
        with suppress(Exception):
            # Else it would try to tell this client, too, that this client has left.
            self._client.unsubscribe_topic(self._client.id)
        with suppress(Exception):
            self._client.close(timeout=_ENDING)


class LostWorkerError(WorkerFailedError):
    """A worker was lost while it was at work; the scheduler has given the work to another one."""

    def __init__(self) -> None:
        super().__init__("crash", "its Dask worker was lost")


def _lost(error: BaseException) -> WorkerFailedError:
    if isinstance(error, CancelledError):
        return WorkerFailedError("crash", "the connection was lost, or the scheduler restarted")
    return WorkerFailedError("crash", f"Dask: {type(error).__name__}: {error}")


def _look_for_scheduler(address: str) -> None:
    """Raise an exception unless a scheduler answers.

    A Client that fails to connect waits for ever where the other side is silent, and has its own
    connection closed at some time later.
    """
    from distributed import Security, rpc

    async def look() -> None:
        connect: Any = rpc
        security: Any = Security
        there = connect(address, connection_args=security().get_connection_args("client"))
        try:
            found = await there.identity()
        finally:
            await there.close_rpc()
        if not (isinstance(found, dict) and found.get("type") == "Scheduler"):
            raise TypeError(found)

    answer: Future[None] = Future()

    def answered() -> None:
        try:
            answer.set_result(asyncio.run(asyncio.wait_for(look(), _PATIENCE)))
        except BaseException as error:
            answer.set_exception(error)

    # Not here, where a loop may be running, as in notebooks.
    threading.Thread(target=answered, daemon=True).start()
    answer.result()


class DaskLane:
    """A lane wherever the scheduler has room."""

    def __init__(self, cluster: Cluster) -> None:
        self._cluster = cluster
        self._left: _Asked | None = (
            None  # what was asked for, and goes on after its worker was lost
        )

    def build(self, spec: EnvironmentSpec) -> Capabilities:
        """Build an environment on one of the workers."""
        found: Capabilities = self._ask(_build, spec.name)
        if not found.parallel:
            raise MenidError(
                f"environment `{spec.name}` allows no copies, and so can't run on a scheduler"
            )
        return found

    def run(self, spec: EnvironmentSpec, task: Task) -> Execution:  # noqa: ARG002
        """Execute on one of the workers."""
        found: Execution = self._ask(_run, task)
        return found

    def _ask(self, function: Callable[..., object], argument: object) -> Any:
        asked, self._left = self._left, None
        if asked is not None and asked.what != (function, argument):
            self._cluster.forget(asked)
            asked = None
        if asked is None:
            asked = self._cluster.ask(function, argument)
        try:
            return self._cluster.answer(asked)
        except LostWorkerError:
            self._left = asked
            raise

    def interrupt(self) -> None:
        """End what runs, of every lane."""
        self._cluster.interrupt()

    def close(self) -> None:
        """There is nothing that is this lane's alone."""
