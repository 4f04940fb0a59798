"""A worker: a process that keeps environments and executes actions in them.

The process reads requests from its standard input and answers on what was its standard output, both
as pickles behind their length. What environments print goes to standard error instead.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from typing import IO, Literal, TypeAlias

from menid_plan.environments.interface import (
    CannotResetError,
    Capabilities,
    EnvironmentFailedError,
    Execution,
)
from menid_plan.environments.orphans import die_with_parent
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.session import Session, said
from menid_plan.errors import MenidError
from menid_plan.grounding.state import GroundAction, State

Trouble: TypeAlias = Literal["crash", "timeout", "error"]
"""How an execution failed: its process ended, it took too long, or the environment said so."""


@dataclass(frozen=True, slots=True)
class Task:
    """An action to be executed in an environment, in a state (None: its own first one)."""

    environment: str
    state: State | None
    action: GroundAction
    seed: int


class WorkerFailedError(EnvironmentFailedError):
    """A worker ended, or was ended since it took too long."""

    def __init__(self, trouble: Trouble, message: str) -> None:
        super().__init__(trouble, message)
        self.trouble: Trouble = trouble
        self.message = message

    def __str__(self) -> str:
        return self.message


class Runner:
    """Builds environments when they are first asked for, and keeps them."""

    def __init__(self, specs: Mapping[str, EnvironmentSpec]) -> None:
        self._specs = specs
        self._sessions: dict[str, Session] = {}

    def build(self, name: str) -> Capabilities:
        """Build an environment unless it is there; what it can do."""
        if name not in self._sessions:
            self._sessions[name] = self._specs[name].open()
        return self._sessions[name].capabilities

    def run(self, task: Task) -> Execution:
        """Put the environment into the state and execute the action.

        Raises EnvironmentFailedError; the environment is built anew at the next task then.
        """
        self.build(task.environment)
        session = self._sessions[task.environment]
        try:
            session.reset(task.state, task.seed)
            return session.execute(task.action)
        except CannotResetError:
            raise
        except EnvironmentFailedError:
            del self._sessions[task.environment]
            with contextlib.suppress(Exception, SystemExit):
                session.close()
            raise

    def close(self) -> None:
        """Close all environments."""
        while self._sessions:
            _, session = self._sessions.popitem()
            with contextlib.suppress(Exception, SystemExit):  # nothing depends on it any more
                session.close()


# --------------------------------------------------------------------------- the side of the caller

# An answer: what was asked for, or a failure's kind and message. Exceptions themselves are not sent,
# since not every exception survives being pickled.
_Failure: TypeAlias = tuple[Literal["failed", "cannot-reset", "wrong"], str, int]


class WrongTaskError(MenidError):
    """A worker met an error that trying again is no help against; with the exit code of that."""

    def __init__(self, message: str, exit_code: int) -> None:
        super().__init__(message, exit_code)
        self.message = message
        self.exit_code = exit_code

    def __str__(self) -> str:
        return self.message


# Not `-m`: a module that is also the main program would have all its classes twice.
# The path comes by arguments: PYTHONPATH would reach the programs that environments start, which may
# be of another Python.
_PROGRAM = """\
import signal, sys
signal.signal(signal.SIGINT, signal.SIG_IGN)
sys.path[:] = sys.argv[2:]
from menid_plan.environments.worker import main
main()
"""


class Worker:
    """A worker process, started when it is made; for use by one thread."""

    def __init__(self, specs: bytes) -> None:
        """``specs`` is a pickled mapping from names to EnvironmentSpecs."""
        # The worker finds modules where this process does.
        path = [entry or os.getcwd() for entry in sys.path]
        self._process = subprocess.Popen(  # noqa: S603 - our own program
            [sys.executable, "-P", "-c", _PROGRAM, str(os.getpid()), *path],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        self._late = False
        with contextlib.suppress(OSError):  # the first request will tell
            self._send(specs)

    @property
    def pid(self) -> int:
        """The id of the process."""
        return self._process.pid

    def build(self, name: str, timeout: float | None) -> Capabilities:
        """Build an environment; what it can do. Raises as `run`."""
        answer = self._ask(name, timeout, "starting")
        assert isinstance(answer, Capabilities)
        return answer

    def run(self, task: Task, timeout: float | None, grace: float = 0.0) -> Execution:
        """Execute; ``timeout`` is in seconds, of which so many more are let pass as ``grace`` says.

        Raises EnvironmentFailedError (WorkerFailedError if the process ended), or WrongTaskError.
        """
        answer = self._ask(task, timeout, f"executing `{task.action}`", grace)
        assert isinstance(answer, Execution)
        return answer

    def _ask(
        self, request: object, timeout: float | None, doing: str, grace: float = 0.0
    ) -> object:
        _watch.begin(self, None if timeout is None else timeout + grace)
        try:
            self._send(pickle.dumps(request))
            assert self._process.stdout is not None
            data = _receive(self._process.stdout)
        except OSError:
            data = None
        finally:
            _watch.end(self)
        if data is None or self._late:
            code = self._end()
            if self._late:
                raise WorkerFailedError("timeout", f"{doing} took more than {timeout:g} s")
            raise WorkerFailedError("crash", f"{doing}, its process ended with {_ending(code)}")
        answer = pickle.loads(data)  # noqa: S301 - it comes from our own program
        if not isinstance(answer, tuple):
            return answer
        kind, message, exit_code = answer
        match kind:
            case "cannot-reset":
                raise CannotResetError(message)
            case "wrong":
                raise WrongTaskError(message, exit_code)
            case _:
                raise EnvironmentFailedError(message)

    def _send(self, data: bytes) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(len(data).to_bytes(8, "little") + data)
        self._process.stdin.flush()

    def too_late(self) -> None:
        """Kill the process since it took too long; called from the thread that watches."""
        self._late = True
        self._process.kill()

    def kill(self) -> None:
        """End the process at once; may be called from another thread."""
        self._process.kill()

    def _end(self) -> int:
        """Wait for the process, which closed its output or was killed; its exit code."""
        try:
            code = self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()
        return code

    def close(self, patience: float = 5.0) -> None:
        """Let the process close its environments and end; kill it if that takes too long."""
        timer = threading.Timer(patience, self._process.kill)
        timer.daemon = True
        timer.start()
        with contextlib.suppress(OSError, ValueError):
            self._send(pickle.dumps(None))
        self._process.wait()
        timer.cancel()
        self._end()


class _Watch:
    """One thread for the time limits of all workers of this process; it looks ten times a second.

    A timer for each request would cost more than a short execution does.
    """

    PERIOD = 0.1

    def __init__(self) -> None:
        self._deadlines: dict[Worker, float] = {}
        self._lock = threading.Lock()
        self._running = False

    def begin(self, worker: Worker, timeout: float | None) -> None:
        if timeout is None:
            return
        with self._lock:
            self._deadlines[worker] = time.monotonic() + timeout
            if self._running:
                return
            self._running = True
        threading.Thread(target=self._look, daemon=True).start()

    def end(self, worker: Worker) -> None:
        with self._lock:
            self._deadlines.pop(worker, None)

    def _look(self) -> None:
        while True:
            time.sleep(self.PERIOD)
            now = time.monotonic()
            with self._lock:
                if not self._deadlines:
                    self._running = False
                    return
                for worker in [w for w, deadline in self._deadlines.items() if deadline < now]:
                    del self._deadlines[worker]
                    worker.too_late()  # within the lock: whoever ends it sees that it was late


_watch = _Watch()


def _ending(code: int) -> str:
    if code >= 0:
        return f"exit code {code}"
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"


def _receive(stream: IO[bytes]) -> bytes | None:
    """The next message; None if the stream has ended."""
    head = stream.read(8)
    if len(head) < 8:
        return None
    length = int.from_bytes(head, "little")
    data = stream.read(length)
    return data if len(data) == length else None


# --------------------------------------------------------------------------- the side of the worker


def _answer(runner: Runner, request: object) -> object:
    try:
        if isinstance(request, str):
            return runner.build(request)
        assert isinstance(request, Task)
        return runner.run(request)
    except CannotResetError as error:
        return "cannot-reset", str(error), error.exit_code
    except EnvironmentFailedError as error:
        return "failed", str(error), error.exit_code
    except MenidError as error:
        return "wrong", str(error), error.exit_code
    except (Exception, SystemExit) as error:  # a kind of environment that fails in its own way
        return "failed", said(error), 5


def main() -> None:
    """What the process of a worker does; its argument is the id of the caller's process."""
    die_with_parent(int(sys.argv[1]))
    # Ctrl-C reaches every process of a terminal; the caller decides what becomes of this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    requests: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def listen() -> None:
        while (data := _receive(sys.stdin.buffer)) is not None:
            requests.put(data)
        os._exit(1)  # the caller is gone, and with it the reason for whatever runs here

    threading.Thread(target=listen, daemon=True).start()
    try:
        runner = Runner(pickle.loads(requests.get()))  # noqa: S301
        while True:
            request = pickle.loads(requests.get())  # noqa: S301
            if request is None:
                runner.close()
                answers.flush()
                os._exit(0)
            data = pickle.dumps(_answer(runner, request))
            answers.write(len(data).to_bytes(8, "little") + data)
            answers.flush()
    except BaseException:
        # Python can't end by itself in a proper way: a thread is reading standard input.
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)
