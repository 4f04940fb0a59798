"""The runs of a mesh study, and the file that keeps them."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from menid_plan.errors import MenidError
from menid_plan.experience.codec import action_of, atoms_column, state_of
from menid_plan.experience.files import lock
from menid_plan.grounding.state import GroundAction, State


class RunsFileError(MenidError):
    """A file of runs that can't be gone on with; the message says why."""

    exit_code = 3


@dataclass(frozen=True, slots=True)
class Run:
    """An execution in the initial state; runs that differ in nothing but their quality share a seed."""

    action: GroundAction
    quality: float
    repetition: int
    seed: int


@dataclass(frozen=True, slots=True)
class Result:
    """What came of a run: measured seconds and the atoms at its end, or in words how it failed."""

    seconds: float = math.nan
    state: State = frozenset()
    failure: str = ""


class RunsFile:
    """The file of runs, to be appended to; ``results`` are those that it has.

    The line that a kill has cut is dropped. Of a run that is there twice the later result counts.
    RunsFileError if lines are no runs, or of another origin; StoreError if another process has it.
    """

    HEAD = ("action", "quality", "repetition", "seed", "seconds", "atoms", "failure", "origin")

    def __init__(self, path: Path, origin: str) -> None:
        self.results: dict[Run, Result] = {}
        self._path, self._origin = path, origin
        self._lock = lock(path)
        try:
            self._file = path.open("r+b" if path.exists() else "w+b")
        except BaseException:
            self._lock.close()
            raise
        try:
            data = self._file.read()
            whole = data[: data.rfind(b"\n") + 1]
            if not whole and not _line(self.HEAD).startswith(data):  # not a head that was cut
                raise RunsFileError(f"{path}, line 1: it is no run of a mesh study")
            self._read(whole)
            self._file.truncate(len(whole))
            self._file.seek(len(whole))
            if not whole:
                self._write(self.HEAD)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()
        self._lock.close()

    def __enter__(self) -> RunsFile:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def add(self, run: Run, result: Result) -> None:
        """Append a result; raises OSError."""
        seconds = "" if result.failure else repr(result.seconds)
        failure = " ".join(result.failure.split())  # in one line: each run has one
        self._write(
            (str(run.action), run.quality, run.repetition, run.seed, seconds,
             atoms_column(result.state), failure, self._origin)
        )  # fmt: skip

    def _write(self, row: Sequence[object]) -> None:
        self._file.write(_line(row))
        self._file.flush()

    def _read(self, data: bytes) -> None:
        for number, line in enumerate(data.splitlines(), start=1):
            try:
                (row,) = csv.reader([line.decode()])
                if number == 1:
                    if tuple(row) != self.HEAD:
                        raise ValueError
                    continue
                call, quality, repetition, seed, seconds, atoms, failure, origin = row
                run = Run(action_of(call), float(quality), int(repetition), int(seed))
                result = Result(float(seconds or "nan"), state_of(atoms), failure)
                if not failure and not 0 <= result.seconds < math.inf:
                    raise ValueError
            except (ValueError, csv.Error) as error:
                raise RunsFileError(
                    f"{self._path}, line {number}: it is no run of a mesh study"
                ) from error
            if origin != self._origin:
                raise RunsFileError(
                    f"{self._path} has runs of another domain or problem, or of another version of the"
                    " scenes: choose another folder, or move the file away"
                )
            self.results[run] = result


def _line(row: Sequence[object]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(row)
    return text.getvalue().encode()
