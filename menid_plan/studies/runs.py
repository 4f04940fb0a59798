"""Learning runs of a study: many, in several processes, each kept as soon as it has ended."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from menid_plan.environments.runfile import Bound, WorkersTable
from menid_plan.learning.counts import Evidence
from menid_plan.learning.curve import Point
from menid_plan.learning.mixtures import Floats
from menid_plan.learning.run import STORE, Run
from menid_plan.learning.settings import LearnSettings
from menid_plan.model.domain import param_values
from menid_plan.model.expressions import evaluate
from menid_plan.studies.pieces import Row, RunsError, done


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
    each environment, ``steps`` in the target, ``successes`` how many episodes ended at the goal, and
    ``executed`` (one for each time) the steps by then. ``won`` and ``lost`` are how many executions
    in the target had an outcome that brings in something, or costs something (where failing does).
    """

    name: str
    reward: tuple[float, ...]
    executions: Mapping[str, int]
    steps: int
    episodes: int
    successes: int
    executed: tuple[float, ...] = ()
    won: float = 0.0
    lost: float = 0.0


def executed(
    wanted: Sequence[Wanted],
    grid: Floats,
    file: Path,
    origin: str,
    jobs: int,
    told: Callable[[int, int], None] = lambda *_: None,
) -> dict[str, Result]:
    """What comes of all runs, by their names; ``grid`` (float64[n]) are times in seconds.

    See `pieces.done`. A run that was interrupted is gone on with, in a folder beside the file.
    """
    folder = file.with_suffix("")
    work = {each.name: partial(piece, each, grid, folder) for each in wanted}
    found = done(work, file, origin, jobs, told, lambda name: forget(folder, name))
    shutil.rmtree(folder, ignore_errors=True)
    try:
        return {name: result(row) for name, row in found.items()}
    except (KeyError, TypeError, ValueError) as error:
        raise RunsError(f"{file}: there is no run of a study in one of its lines") from error


def piece(wanted: Wanted, grid: Floats, folder: Path) -> Row:
    """One run as a piece of a study, with a folder of its own in ``folder``."""
    return asdict(run(wanted, grid, folder / wanted.name))


def result(row: Row) -> Result:
    """What a piece tells of a run; KeyError, TypeError, ValueError if it is of something else."""
    reward, executed = (tuple(map(float, row[key])) for key in ("reward", "executed"))
    return Result(**{**row, "reward": reward, "executed": executed})


def forget(folder: Path, name: str) -> None:
    """Remove the folder of a run that was kept."""
    shutil.rmtree(folder / name, ignore_errors=True)


def run(wanted: Wanted, grid: Floats, folder: Path) -> Result:
    """One run, in a folder in which it may have been interrupted before."""
    reward, steps = np.zeros((2, len(grid)))

    def point(now: Point) -> None:
        since = np.searchsorted(grid, now.seconds)
        reward[since:], steps[since:] = now.reward, now.steps

    learning = Run(
        folder, wanted.bound, wanted.settings, WorkersTable(0), params=wanted.params,
        resume=(folder / STORE).exists(), watch=point,
    )  # fmt: skip
    progress = learning.learn()
    return Result(
        wanted.name, tuple(reward.tolist()), dict(progress.executions), progress.steps,
        progress.episodes, progress.successes, tuple(steps.tolist()),
        *_tally(learning.evidence, wanted.params),
    )  # fmt: skip


def _tally(evidence: Evidence, params: Mapping[str, float]) -> tuple[float, float]:
    """Executions in the target whose outcome pays, and that costs, if each failure costs 1."""
    costly = {"fail": 1.0} if "fail" in params else {}
    values = param_values(evidence.domain, None, {**params, **costly})
    found = [0.0, 0.0]
    for key in evidence.keys:
        for outcome, seen in zip(evidence.rule(key).outcomes, evidence.counts(key)[0], strict=True):
            paid = 0.0 if outcome.reward is None else evaluate(outcome.reward, values)
            found[0] += float(seen) if paid > 0.0 else 0.0
            found[1] += float(seen) if paid < 0.0 else 0.0
    return found[0], found[1]
