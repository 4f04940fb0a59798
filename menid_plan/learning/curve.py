"""`curve.csv`: a row for each step in the target and each time that an action was tested."""

from __future__ import annotations

import math
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from menid_plan.charts import chart


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


def read_curve(path: Path) -> tuple[Point, ...]:
    """The points of a `curve.csv`, less a row that a kill has cut.

    FileNotFoundError if there is none, ValueError that tells the first line that no run has written.
    """
    data = path.read_bytes()
    head, *rows = data[: data.rfind(b"\n") + 1].decode("ascii", "replace").splitlines() or [
        Curve.HEAD
    ]
    if head != Curve.HEAD:
        raise ValueError("line 1 is not the head of a learning curve")
    points: list[Point] = []
    before = (0.0, 0, 0, 0)
    for number, row in enumerate(rows, start=2):
        try:
            seconds, reward, steps, episodes, tests, what = row.split(",")
            point = Point(
                float(seconds), float(reward), int(steps), int(episodes), int(tests),
                "step" if what == "step" else "test",
            )  # fmt: skip
            now = (point.seconds, point.steps, point.episodes, point.tests)
            grows = all(old <= new for old, new in zip(before, now, strict=True))
            if not (str(point) == row and grows and math.isfinite(point.reward + point.seconds)):
                raise ValueError
        except ValueError:
            raise ValueError(f"line {number} is no point of a learning curve") from None
        points.append(point)
        before = now
    return tuple(points)


def time_unit(seconds: float) -> tuple[str, float]:
    """The unit in which the time of a run is drawn, and its seconds."""
    return ("hours", 3600.0) if seconds >= 3600 else ("minutes", 60.0)


def curve_png(path: Path) -> bytes:
    """A drawing of a `curve.csv`: the reward accumulated in the target, and the tests elsewhere.

    MissingDependencyError without Matplotlib.
    """
    points = read_curve(path)
    unit, scale = time_unit(points[-1].seconds if points else 0.0)
    times = [0.0, *(point.seconds / scale for point in points)]

    def draw(figure: Any) -> None:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        reward = [0.0, *(point.reward for point in points)]
        above.step(times, reward, where="post", linewidth=1.2, color="#08306b")
        above.set_ylabel("reward in the target")
        for key, label, colour in (
            ("steps", "in the target", "#08306b"), ("tests", "in the tests", "#d1490e"),
        ):  # fmt: skip
            number = [0, *(getattr(point, key) for point in points)]
            below.step(times, number, where="post", linewidth=1.2, color=colour, label=label)
        below.set_ylabel("executions")
        below.set_xlabel(f"time of the run ({unit})")
        below.legend(frameon=False)
        for panel in (above, below):
            panel.grid(visible=True, linewidth=0.4, alpha=0.5)
            panel.margins(x=0.02)

    return chart((5.2, 3.4), draw)
