"""Learning runs of a study: many, in several processes, each kept as soon as it has ended."""

from __future__ import annotations

import json
import multiprocessing
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from menid_plan.environments.runfile import Bound, WorkersTable
from menid_plan.errors import MenidError
from menid_plan.experience.files import lock
from menid_plan.learning.curve import Point
from menid_plan.learning.mixtures import Floats
from menid_plan.learning.run import Run
from menid_plan.learning.settings import LearnSettings


class RunsError(MenidError):
    """A file of runs that can't be gone on with; the message says why."""

    exit_code = 3


@dataclass(frozen=True, slots=True)
class Wanted:
    """A run that is to be: its ``name`` tells it from all others of the study."""

    name: str
    bound: Bound
    settings: LearnSettings
    params: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Result:
    """What came of a run.

    ``reward`` (one for each time of the grid) is accumulated in the target by then, ``executions`` in
    each environment, ``steps`` in the target, and ``successes`` how many episodes ended at the goal.
    """

    name: str
    reward: tuple[float, ...]
    executions: Mapping[str, int]
    steps: int
    episodes: int
    successes: int


def executed(
    wanted: Sequence[Wanted],
    grid: Floats,
    file: Path,
    origin: str,
    jobs: int,
    told: Callable[[int, int], None] = lambda *_: None,
) -> dict[str, Result]:
    """What comes of all runs, by their names; ``grid`` (float64[n]) are times in seconds.

    ``file`` has a line for each that has ended, and ``origin`` is what it must be of: what is there is
    not run again. A run that was interrupted is gone on with, in a folder beside the file. ``told`` is
    called with the number of runs that have ended, and of all. Raises RunsError for a file of another
    origin, and whatever a run raises.
    """
    with lock(file):
        found = _read(file, origin)
        missing = [each for each in wanted if each.name not in found]
        done = len(wanted) - len(missing)
        told(done, len(wanted))
        if missing:
            folder = file.with_suffix("")
            for each, result in _results(missing, grid, folder, jobs):
                found[each.name] = result
                with file.open("a", encoding="utf-8") as stream:
                    stream.write(json.dumps({"origin": origin, **asdict(result)}) + "\n")
                shutil.rmtree(folder / each.name, ignore_errors=True)
                done += 1
                told(done, len(wanted))
            shutil.rmtree(folder, ignore_errors=True)
    return {each.name: found[each.name] for each in wanted}


def _results(
    missing: Sequence[Wanted], grid: Floats, folder: Path, jobs: int
) -> Iterable[tuple[Wanted, Result]]:
    if jobs == 1:
        for each in missing:
            yield each, run(each, grid, folder / each.name)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, context) as pool:
        futures = {pool.submit(run, each, grid, folder / each.name): each for each in missing}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.kill()  # what it was at is gone on with the next time
            raise


def run(wanted: Wanted, grid: Floats, folder: Path) -> Result:
    """One run, in a folder in which it may have been interrupted before."""
    reward = np.zeros(len(grid))

    def point(now: Point) -> None:
        reward[np.searchsorted(grid, now.seconds) :] = now.reward

    learning = Run(
        folder, wanted.bound, wanted.settings, WorkersTable(0), params=wanted.params,
        resume=folder.exists(), watch=point,
    )  # fmt: skip
    progress = learning.learn()
    return Result(
        wanted.name, tuple(reward.tolist()), dict(progress.executions), progress.steps,
        progress.episodes, progress.successes,
    )  # fmt: skip


def _read(file: Path, origin: str) -> dict[str, Result]:
    """The results in a file; the line that a kill has cut is dropped."""
    if not file.exists():
        return {}
    data = file.read_bytes()
    whole = data[: data.rfind(b"\n") + 1]
    if whole != data:
        with file.open("r+b") as stream:
            stream.truncate(len(whole))
    found = {}
    for number, line in enumerate(whole.splitlines(), start=1):
        try:
            row: dict[str, Any] = json.loads(line)
            there = row.pop("origin")
            result = Result(**{**row, "reward": tuple(map(float, row["reward"]))})
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise RunsError(f"{file}, line {number}: it is no run of a study") from error
        if there != origin:
            raise RunsError(
                f"{file} has runs with other settings or experiences: choose another folder, or move "
                "the file away"
            )
        found[result.name] = result
    return found
