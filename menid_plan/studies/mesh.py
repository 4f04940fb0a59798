"""How the quality of meshes changes times and outcomes of executions in the hard-drive scenes.

The mesh study of Suárez-Hernández et al. (2021): every action at every place, at meshes of many
qualities, each compared with the best.
"""

from __future__ import annotations

import csv
import io
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from importlib.metadata import packages_distributions, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from menid_plan.charts import chart
from menid_plan.environments.hdd import kind as scenes
from menid_plan.environments.hdd.kind import Hdd
from menid_plan.environments.interface import EnvironmentFailedError
from menid_plan.environments.pool import ExecutionFailedError, Failure, Pool, in_order
from menid_plan.environments.recording import HOPELESS
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.seeds import seed_of
from menid_plan.errors import LimitError
from menid_plan.grounding.semantics import Semantics
from menid_plan.grounding.state import GroundAction, State
from menid_plan.learning.mixtures import Floats
from menid_plan.model.domain import Domain, Problem
from menid_plan.studies.mesh_runs import Result, Run, RunsFile, RunsFileError

# Executions of one study, which would take weeks.
MAX_RUNS = 1_000_000
# The qualities of the paper.
LOWEST, HIGHEST = 0.00103, 0.01
_SCENE = Hdd(noise=1.0)
# Parts of the scenes that no execution of these depends on.
_APART = {"arm", "cache", "extra", "film", "robot", "validity"}


@dataclass(frozen=True, slots=True)
class Progress:
    """How many runs have a result, of how many, and how many failed."""

    done: int
    wanted: int
    failed: int


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """What was found for one action at n qualities; nan where there is nothing to be told.

    ``qualities`` (float64[n]); ``runs`` and ``failed`` (int64[n]) count those with and without a
    result. ``seconds`` (float64[n, 4]): mean, lower quartile, median, upper quartile over all runs.
    ``error`` (float64[n, 2]): the mean error against the run with the same seed at the highest quality,
    and its standard error. ``others`` (float64[n, 2]): the same against the other repetitions at the
    highest quality. ``floor``: the last row of ``others``, how far repetitions differ there.
    """

    action: str
    qualities: Floats
    runs: NDArray[np.int64]
    failed: NDArray[np.int64]
    seconds: Floats
    error: Floats
    others: Floats

    @property
    def floor(self) -> Floats:
        """The mean error between repetitions at the highest quality, and its standard error."""
        last: Floats = self.others[-1]
        return last


@dataclass(frozen=True, slots=True)
class MeshStudy:
    """The settings: ``actions`` by their names, numbers of ``qualities`` and ``repetitions``.

    ``scene`` is the environment at every quality; the hand's errors come from ``seed``.
    """

    domain: Domain
    problem: Problem
    actions: tuple[str, ...]
    qualities: int = 4
    repetitions: int = 2
    seed: int = 0
    scene: Hdd = _SCENE

    @property
    def grid(self) -> list[float]:
        """The qualities, evenly spaced; rounded, so that those of two studies can be the same."""
        found = np.linspace(LOWEST, HIGHEST, self.qualities).round(6)
        return [float(quality) for quality in found]

    def runs(self) -> Iterator[Run]:
        """All runs, in the order in which they are executed.

        Qualities alternate fastest: if the machine gets slower meanwhile, it does so for all of them.
        """
        calls = self.calls
        for repetition in range(self.repetitions):
            for call in calls:
                seed = seed_of(self.seed, "mesh", str(call), repetition)
                yield from (Run(call, quality, repetition, seed) for quality in self.grid)

    @property
    def calls(self) -> list[GroundAction]:
        """What is executed: the actions at each place where they apply in the initial state."""
        semantics = Semantics(self.domain, self.problem)
        applicable = semantics.applicable(semantics.initial_state)
        return [call for call, _ in applicable if call.action in self.actions]

    def run(
        self,
        path: Path,
        jobs: int = 1,
        progress: Callable[[Progress], None] = lambda _: None,
        failed: Callable[[Failure], None] = lambda _: None,
    ) -> dict[Run, Result]:
        """Execute what is not in the file of runs yet, and append it; the results of all runs.

        Runs that failed before are tried again. Raises RunsFileError, EnvironmentFailedError if
        nothing but failures comes, and OSError.
        """
        number = len(self.calls) * self.qualities * self.repetitions
        if number > MAX_RUNS:
            raise LimitError(f"the study has {number} executions; at most {MAX_RUNS} are made")
        wanted = list(self.runs())
        with RunsFile(path, self.origin()) as file:
            _check_atoms(self.domain, path, file.results.values())
            have = {run: file.results[run] for run in wanted if run in file.results}
            missing = [run for run in wanted if run not in have or have[run].failure]
            found = {run: result for run, result in have.items() if not result.failure}
            lost = 0
            last = -math.inf
            with Pool(map(self._spec, self.grid), jobs, failed=failed) as pool:
                futures = (
                    pool.submit(_name(run.quality), None, run.action, run.seed, number)
                    for number, run in enumerate(missing)
                )
                for future in in_order(futures):
                    run = missing[future.number]
                    try:
                        execution = future.result()
                    except EnvironmentFailedError as error:
                        found[run] = _failed(error)
                        lost += 1
                    else:
                        assert execution.duration is not None  # sessions see to that
                        found[run] = Result(execution.duration, execution.state)
                    file.add(run, found[run])
                    if lost == len(found) == min(HOPELESS, len(wanted)):
                        raise EnvironmentFailedError(
                            f"the first {lost} executions all failed; last: {found[run].failure}"
                        )
                    if time.monotonic() - last > 1.0:
                        last = time.monotonic()
                        progress(Progress(len(found), len(wanted), lost))
        progress(Progress(len(found), len(wanted), lost))
        return {run: found[run] for run in wanted}

    def origin(self) -> str:
        """A hash of all else that results depend on: the problem, and how the scenes are made."""
        objects = (*self.domain.constants, *self.problem.objects)
        parts = [
            [(thing.name, thing.type, thing.attributes) for thing in objects],
            [(each.name, each.parent) for each in self.domain.types],
            [(each.name, each.arguments) for each in self.domain.predicates],
            sorted(self.problem.init),
            replace(self.scene, quality=HIGHEST),
        ]
        names = packages_distributions()
        for module in ("pybullet", "manifold3d", "fast_simplification"):
            parts += [version(name) for name in names.get(module, ())]
        digest = sha256(repr(parts).encode())
        for file in sorted(Path(scenes.__file__).parent.glob("*.py")):
            if file.stem not in _APART:
                digest.update(file.read_bytes())
        return digest.hexdigest()[:12]

    def _spec(self, quality: float) -> EnvironmentSpec:
        # To make the meshes for the first time takes some ten seconds, and more on a busy machine.
        return EnvironmentSpec(
            _name(quality), replace(self.scene, quality=quality), self.domain, self.problem,
            start_timeout=600.0,
        )  # fmt: skip

    # ---------------------------------------------------------------------------------- results

    def curves(self, results: Mapping[Run, Result]) -> list[Curve]:
        """What the runs show, for each action that has any."""
        return [
            curve_of(name, self.grid, {r: f for r, f in results.items() if r.action.action == name})
            for name in self.actions
        ]

    def as_csv(self, curves: Sequence[Curve]) -> str:
        """A row for each action and quality; a cell is empty where there is nothing to be told."""
        stream = io.StringIO()
        rows = [row for curve in curves for row in _rows(curve)]
        writer = csv.DictWriter(stream, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        return stream.getvalue()

    def as_json(self, curves: Sequence[Curve], results: Mapping[Run, Result]) -> dict[str, Any]:
        """The settings, what was found for each action, and the runs that failed."""
        return {
            "settings": {
                "problem": self.problem.name,
                "actions": self.actions,
                "qualities": self.grid,
                "repetitions": self.repetitions,
                "seed": self.seed,
                "scene": {k: v for k, v in asdict(self.scene).items() if k != "quality"},
            },
            "actions": [
                {
                    "action": curve.action,
                    "floor": _told(curve.floor[0]),
                    "floor_se": _told(curve.floor[1]),
                    "qualities": _rows(curve),
                }
                for curve in curves
            ],
            "failed": [
                {**asdict(run), "action": str(run.action), "failure": result.failure}
                for run, result in results.items()
                if result.failure
            ],
        }

    def as_png(self, curves: Sequence[Curve], dpi: int = 200) -> bytes:
        """The figure, a column for each action; MissingDependencyError without Matplotlib."""

        def draw(figure: Any) -> None:
            panels = figure.subplots(2, len(curves), sharex=True, sharey="row", squeeze=False)
            for above, below, curve in zip(*panels, curves, strict=True):
                _draw(above, below, curve)
            panels[0, 0].set_ylabel("time of an execution (s)")
            panels[0, 0].set_ylim(bottom=0)
            panels[1, 0].set_ylabel("error of the outcome")
            panels[1, 0].set_ylim(bottom=0)
            handles, labels = panels[1, 0].get_legend_handles_labels()
            figure.legend(
                handles, labels, loc="outside lower center", ncols=len(curves), frameon=False
            )

        return chart((1.2 + 1.8 * len(curves), 3.8), draw, dpi)


# ------------------------------------------------------------------------------------- what is told


def error(state: State, best: State) -> float:
    """How far two sets of atoms differ: 1 - |s n s'| / |s u s'|, from 0 to 1 (0 if both are empty)."""
    union = state | best
    return 1 - len(state & best) / len(union) if union else 0.0


def mean_error(places: Iterable[Sequence[float]]) -> tuple[float, float]:
    """The mean over places of each place's mean error, and the standard error of that mean.

    The repetitions at a place are not independent of each other, so the deviation is that between
    places. Places without a number don't count; nan for a mean of none, or a deviation of one.
    """
    means = [float(np.mean(errors)) for errors in places if errors]
    if not means:
        return math.nan, math.nan
    deviation = float(np.std(means, ddof=1)) if len(means) > 1 else math.nan
    return float(np.mean(means)), deviation / math.sqrt(len(means))


def curve_of(action: str, grid: Sequence[float], results: Mapping[Run, Result]) -> Curve:
    """The curve of one action's runs; the last quality of the grid is the highest."""
    ends: dict[tuple[GroundAction, float], dict[int, State]] = {}
    for run, result in results.items():
        if not result.failure:
            ends.setdefault((run.action, run.quality), {})[run.repetition] = result.state
    calls = dict.fromkeys(run.action for run in results)

    def errors(quality: float, same: bool) -> tuple[float, float]:
        return mean_error(
            [
                error(state, best)
                for r, state in ends.get((call, quality), {}).items()
                for s, best in ends.get((call, grid[-1]), {}).items()
                if (r == s) is same
            ]
            for call in calls
        )

    seconds = [
        [f.seconds for r, f in results.items() if r.quality == quality and not f.failure]
        for quality in grid
    ]
    failed = [sum(r.quality == q and bool(f.failure) for r, f in results.items()) for q in grid]
    return Curve(
        action, np.array(grid), np.array([len(each) for each in seconds]), np.array(failed),
        np.array(
            [[np.mean(s), *np.quantile(s, (0.25, 0.5, 0.75))] if s else 4 * [math.nan]
             for s in seconds]
        ),
        np.array([errors(quality, True) for quality in grid]),
        np.array([errors(quality, False) for quality in grid]),
    )  # fmt: skip


def _rows(curve: Curve) -> list[dict[str, Any]]:
    keys = (
        "seconds", "seconds_q1", "seconds_median", "seconds_q3",
        "error", "error_se", "others", "others_se",
    )  # fmt: skip
    numbers = np.hstack([curve.seconds, curve.error, curve.others])
    counts = zip(curve.qualities.tolist(), curve.runs.tolist(), curve.failed.tolist(), strict=True)
    return [
        {"action": curve.action, "quality": quality, "runs": runs, "failed": failed}
        | dict(zip(keys, map(_told, row), strict=True))
        for (quality, runs, failed), row in zip(counts, numbers, strict=True)
    ]


def _told(number: float) -> float | None:
    """A number to six digits; None for nan, which JSON has no word for."""
    return None if math.isnan(number) else float(f"{number:.6g}")


def _draw(above: Any, below: Any, curve: Curve) -> None:
    """The time and the error of one action."""
    dark, light, warm = "#08306b", "#3f8fc5", "#d1490e"
    kept = 100 * curve.qualities
    _, low, median, high = curve.seconds.T
    above.plot(kept, median, linewidth=1.2, color=dark)
    above.fill_between(kept, low, high, color=light, alpha=0.25, linewidth=0)
    above.set_title(curve.action)
    mean, se = curve.error.T
    below.plot(kept, mean, linewidth=1.2, color=dark, label="against the best mesh, same seed")
    below.fill_between(kept, mean - se, mean + se, color=dark, alpha=0.2, linewidth=0)
    floor, floor_se = curve.floor
    if not math.isnan(floor):
        below.plot(
            kept, curve.others[:, 0], "--", linewidth=0.9, color=light,
            label="against the best mesh, other seeds",
        )  # fmt: skip
        below.axhline(floor, linewidth=0.9, color=warm, label="floor: best mesh, two seeds")
        below.axhspan(floor - floor_se, floor + floor_se, color=warm, alpha=0.15, linewidth=0)
    below.set_xlabel("vertices kept (%)")
    below.xaxis.set_major_formatter("{x:g}")
    for panel in (above, below):
        panel.grid(visible=True, linewidth=0.4, alpha=0.5)
        panel.margins(x=0.02)


def _check_atoms(domain: Domain, path: Path, results: Iterable[Result]) -> None:
    known = {predicate.name for predicate in domain.predicates}
    for result in results:
        for atom in result.state:
            if atom.predicate not in known:
                raise RunsFileError(f"{path} has the atom `{atom}`, which the domain does not know")


def _name(quality: float) -> str:
    """What the environment of a quality is called in messages."""
    return f"quality {quality:g}"


def _failed(error: EnvironmentFailedError) -> Result:
    last = error.failures[-1].message if isinstance(error, ExecutionFailedError) else str(error)
    return Result(failure=last or "failed")
