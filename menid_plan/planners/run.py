"""A planner of others plays rounds: our server, its process, its time, and what it says."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from menid_plan.planners.known import Planner, PlannerError, PlannerMissingError
from menid_plan.servers.listen import HOST, listening
from menid_plan.servers.play import Results
from menid_plan.servers.wire import Wire

# Seconds that a planner may take to end once the session has.
GRACE = 10.0
TAIL = 2000  # bytes of what it printed that are shown if it failed
MOST_OUTPUT = 256 * 2**20  # bytes that it may print


@dataclass(frozen=True, slots=True)
class Run:
    """What came of it: the session's results, why it failed (empty if it did not), the last output."""

    results: Results | None
    failure: str
    output: str


def run(
    planner: Planner, files: Mapping[str, str], play: Callable[[Wire], Results], seconds: float
) -> Run:
    """Start a planner in a folder of its own, and let it play; it ends after so many seconds.

    ``files`` are the texts of a domain and of an instance or a problem, by the names of their files.
    Raises PlannerError for ``files`` that can't lie there, PlannerMissingError if one of these or the
    program is missing. What it exits with counts for nothing: PROST says 0 where it failed.
    """
    _check(planner, files)
    with (
        tempfile.TemporaryDirectory(prefix="menid-planner-", ignore_cleanup_errors=True) as name,
        listening(0) as server,
        ThreadPoolExecutor(1) as threads,
        tempfile.TemporaryFile() as output,
    ):
        folder = Path(name)
        for file, text in files.items():
            (folder / file).write_text(text, encoding="utf-8")
        for file in planner.files:
            (folder / Path(file).name).symlink_to(Path(file).absolute())
        domain, instance = files
        called = re.search(r"^(?:instance|\(define \(problem) ([^\s)]+)", files[instance], re.M)
        assert called is not None
        places = {
            "folder": name, "domain": str(folder / domain), "instance": str(folder / instance),
            "name": called[1], "host": HOST, "port": str(server.getsockname()[1]),
        }  # fmt: skip
        command = planner.filled(places)
        try:
            process = subprocess.Popen(  # noqa: S603 - what the user declared
                command, cwd=folder, stdin=subprocess.DEVNULL, stdout=output,
                stderr=subprocess.STDOUT, start_new_session=True,
            )  # fmt: skip
        except OSError as error:
            raise PlannerMissingError(f"`{command[0]}`: {error.strerror}") from error

        def too_much() -> bool:
            return os.fstat(output.fileno()).st_size > MOST_OUTPUT

        until = time.monotonic() + seconds
        connection = session = None
        try:
            connection = _accepted(server, process, until, too_much)
            results = None
            if connection is not None:
                # It is the time in all that counts, not that of a message.
                session = threads.submit(play, Wire(connection, seconds + GRACE))
                while not session.done() and time.monotonic() < until and not too_much():
                    time.sleep(0.02)
                if session.done():
                    results = session.result()
                    with suppress(subprocess.TimeoutExpired):
                        process.wait(min(GRACE, max(until - time.monotonic(), 0.1)))
            if results is None and too_much():
                failure = f"it has printed more than {MOST_OUTPUT // 2**20} MiB"
            else:
                failure = _failure(results, connection is not None, process, until, seconds)
        finally:
            # All that it started; the session sees that it is gone, and ends.
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            if connection is not None:
                with suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)
                connection.close()
        if results is None and session is not None:
            # The rounds that it has finished count all the same.
            with suppress(Exception):
                results = session.result(GRACE)
                results.failure = failure
        output.seek(max(os.fstat(output.fileno()).st_size - TAIL, 0))
        said = output.read(TAIL).decode(errors="replace")
    return Run(results, failure, said)


def _check(planner: Planner, files: Mapping[str, str]) -> None:
    """See that what is linked into the folder is there, and under names that nothing else has."""
    taken = set(files)
    for file in planner.files:
        name = Path(file).name
        if not name or name in taken:
            raise PlannerError(f"files: `{file}`: something else in the folder is called `{name}`")
        if not Path(file).exists():
            raise PlannerMissingError(f"files: there is no file `{file}`")
        taken.add(name)


def _accepted(
    server: socket.socket,
    process: subprocess.Popen[bytes],
    until: float,
    given_up: Callable[[], bool],
) -> socket.socket | None:
    """The planner's connection; None if it ended, is given up, or did not ask in time."""
    server.settimeout(0.1)
    while time.monotonic() < until and not given_up():
        with suppress(TimeoutError):
            connection, _ = server.accept()
            return connection
        if process.poll() is not None:
            return None
    return None


def _failure(
    results: Results | None,
    connected: bool,
    process: subprocess.Popen[bytes],
    until: float,
    seconds: float,
) -> str:
    if results is not None:
        return results.failure
    if time.monotonic() >= until:
        return f"it was not done after {seconds:g} s"
    assert not connected
    return f"it ended with {process.poll()} before it asked for the task"
