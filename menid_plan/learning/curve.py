"""`curve.csv`: a row for each step in the target and each time that an action was tested."""

from __future__ import annotations

from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True, slots=True)
class Point:
    """A point of the learning curve: ``what`` the run has just done, and how far it is.

    ``seconds`` on its clock, ``reward`` accumulated in the target, ``steps`` executions there,
    ``episodes`` that have ended, ``tests`` executions elsewhere.
    """

    seconds: float
    reward: float
    steps: int
    episodes: int
    tests: int
    what: Literal["step", "test"]

    def __str__(self) -> str:
        return f"{self.seconds!r},{self.reward!r},{self.steps},{self.episodes},{self.tests},{self.what}"


class Curve:
    """The file, to be written row by row; rows that are there already stay.

    A run that is resumed comes to its old points again. From the first row that differs on, the file
    is written anew, so that whatever happened to it, it ends as the run has it.
    """

    HEAD = "seconds,reward,steps,episodes,tests,what"

    def __init__(self, path: Path) -> None:
        self._file = path.open("r+b" if path.exists() else "w+b")
        data = self._file.read()
        whole = data[: data.rfind(b"\n") + 1]
        self._file.truncate(len(whole))  # behind it is a row that a kill has cut
        self._old = deque(whole.splitlines())
        self._place = 0
        self._write(self.HEAD)

    def times(self) -> list[float]:
        """The seconds of the rows that are there, up to the first that tells none."""
        found = []
        for row in self._old:
            try:
                found.append(float(row.split(b",")[0]))
            except ValueError:
                break
        return found

    def add(self, point: Point) -> None:
        """Write a point down; raises OSError."""
        self._write(str(point))

    def _write(self, text: str) -> None:
        row = text.encode("ascii")
        if self._old and self._old[0] == row:
            self._old.popleft()
        else:
            if self._old:
                self._old.clear()
                self._file.truncate(self._place)
            self._file.seek(self._place)
            self._file.write(row + b"\n")
            self._file.flush()
        self._place += len(row) + 1

    def close(self) -> None:
        """Let go of the file."""
        with suppress(OSError):  # what could not be written was told when it was tried
            self._file.close()
