"""A program that answers line by line: its standard streams, how it ended, and how to end it."""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import subprocess
import threading
from collections import deque
from collections.abc import Sequence
from pathlib import Path

from menid_plan.environments.interface import EnvironmentFailedError
from menid_plan.environments.orphans import wrapped

# A line longer than this, in bytes, is refused.
MAX_LINE = 16 * 2**20

# How much is kept of what a program says on its standard error.
_KEPT_LINES = 20
_KEPT_WIDTH = 500


class Program:
    """A running program; it answers each line on its input with one on its output.

    It is started without a shell, in a process group of its own, which is killed when this object is
    closed. On Linux the kernel also kills the program if this process ends in any way; elsewhere it
    is for the program to end when its standard input does.
    """

    def __init__(self, command: Sequence[str], folder: Path) -> None:
        """Start it in a folder; raises EnvironmentFailedError if that fails."""
        try:
            self._process = subprocess.Popen(  # noqa: S603 - the command is the user's own
                wrapped(list(command)),
                cwd=folder,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                start_new_session=True,
            )
        except (OSError, ValueError) as error:
            raise EnvironmentFailedError(f"can't start `{command[0]}`: {error}") from error
        self._lines: queue.Queue[bytes | None] = queue.Queue(maxsize=100)
        self._requests: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._said: deque[str] = deque(maxlen=_KEPT_LINES)
        self._threads = [
            threading.Thread(target=work, daemon=True)
            for work in (self._read, self._write, self._listen)
        ]
        for thread in self._threads:
            thread.start()

    @property
    def pid(self) -> int:
        """The id of the process."""
        return self._process.pid

    def ask(self, line: bytes, timeout: float | None) -> bytes:
        """Send a line and wait for the answer, so many seconds at most.

        Raises EnvironmentFailedError, with the end of what the program said on standard error.
        """
        if not self._lines.empty():
            stray = self._lines.get()
            if stray is None:  # it has ended by itself, and there will never be an answer
                self._lines.put(None)
                raise EnvironmentFailedError(self._ending())
            raise EnvironmentFailedError(f"a line that was not asked for: {quoted(stray)}")
        self._requests.put(line)
        try:
            answer = self._lines.get(timeout=timeout)
        except queue.Empty:
            raise EnvironmentFailedError(
                f"no answer within {timeout:g} s{self.last_words()}"
            ) from None
        if answer is None:
            self._lines.put(None)
            raise EnvironmentFailedError(self._ending())
        if len(answer) > MAX_LINE:
            raise EnvironmentFailedError(
                f"a line of more than {MAX_LINE // 2**20} MiB: {quoted(answer)}"
            )
        return answer

    def tell(self, line: bytes) -> None:
        """Send a line that is not answered, and end the input."""
        self._requests.put(line)
        self._requests.put(None)

    def close(self, patience: float = 2.0) -> None:
        """Wait so many seconds for the program to end, then kill it and all that it started."""
        self._requests.put(None)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(patience)
        if hasattr(os, "killpg"):
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.kill()
        self._process.wait()
        while self._threads[0].is_alive():  # it may wait for room
            with contextlib.suppress(queue.Empty):
                self._lines.get(timeout=0.05)
        for thread in self._threads:
            thread.join(1)
        for stream in (self._process.stdin, self._process.stdout, self._process.stderr):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()

    def _ending(self) -> str:
        try:
            code = self._process.wait(1)
        except subprocess.TimeoutExpired:
            return f"the program closed its output{self.last_words()}"
        how = f"exit code {code}" if code >= 0 else f"signal {-code}"
        return f"the program ended with {how}{self.last_words()}"

    def last_words(self) -> str:
        """The end of what the program said on standard error, for the end of a message."""
        if self._process.poll() is not None:
            self._threads[2].join(0.5)
        said = list(self._said)
        return "; it said:\n    " + "\n    ".join(said) if said else ""

    # ------------------------------------------------------------------------------- its threads

    def _read(self) -> None:
        assert self._process.stdout is not None
        with contextlib.suppress(OSError, ValueError):
            while line := self._process.stdout.readline(MAX_LINE + 1):
                self._lines.put(line)
                if len(line) > MAX_LINE:
                    break
        self._lines.put(None)

    def _write(self) -> None:
        stream = self._process.stdin
        assert stream is not None
        with contextlib.suppress(OSError, ValueError):  # that it ended is seen by who reads
            while (line := self._requests.get()) is not None:
                stream.write(line)
                stream.flush()
        with contextlib.suppress(OSError, ValueError):
            stream.close()

    def _listen(self) -> None:
        stream = self._process.stderr
        assert stream is not None
        with contextlib.suppress(OSError, ValueError):
            while line := stream.readline(65536):
                text = line.decode("utf-8", errors="replace").rstrip()
                self._said.append(text[:_KEPT_WIDTH])


def quoted(line: bytes, width: int = 80) -> str:
    """A line for a message: shortened, and harmless to a terminal."""
    text = line[: 4 * width].decode("utf-8", errors="replace").strip()
    text = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)
    return f"`{text[:width]}…`" if len(text) > width else f"`{text}`"
