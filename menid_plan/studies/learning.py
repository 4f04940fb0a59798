"""Learning with simulations and without: accumulated reward against time.

The protocol is that of Suárez-Hernández et al. 2020: an hour of virtual time, T = 20 s against T = 0,
the m-estimate with m = 10, Thompson sampling, and failures that cost 0, 5 or 10 times what a success
brings in. An episode is one drive: it ends when the board is out, or after the horizon.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from scipy import stats

from menid_plan.charts import chart
from menid_plan.environments.recorded import Recorded
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.runfile import Bound, RunFile
from menid_plan.environments.seeds import seed_of
from menid_plan.learning.mixtures import Floats
from menid_plan.learning.settings import LearnSettings
from menid_plan.model.domain import Domain, Problem
from menid_plan.simulation import Estimate
from menid_plan.studies.runs import Result, Wanted, executed

Name: TypeAlias = Literal["simulation", "robot"]


@dataclass(frozen=True, slots=True)
class Learner:
    """One way to learn: the environments in which it tests, and what its curve is called."""

    name: str
    tests: tuple[str, ...]
    colour: str


@dataclass(frozen=True, slots=True)
class Setting:
    """A target, and the learners that are compared in it; the last one has no tests."""

    target: str
    learners: tuple[Learner, ...]


SETTINGS: Mapping[Name, Setting] = {
    "simulation": Setting(
        "fine",
        (
            Learner("tests in coarse", ("coarse",), "#1f5fa8"),
            Learner("no tests", (), "#d1490e"),
        ),
    ),
    "robot": Setting(
        "robot",
        (
            Learner("tests in coarse", ("coarse",), "#1f5fa8"),
            Learner("tests in fine", ("fine",), "#d1490e"),
            Learner("no tests", (), "#2e8540"),
        ),
    ),
}


@dataclass(frozen=True, slots=True)
class Interval:
    """A mean, and half the width of its 95 % interval (Student's t); NaN for a single value."""

    mean: float
    half: float

    @classmethod
    def of(cls, values: Floats) -> Interval:
        """Of some values (float64[n])."""
        found = Estimate.of(values)
        return cls(found.mean, float(stats.t.ppf(0.975, len(values) - 1)) * found.error)


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """What the runs of one learner show: ``reward`` is float64[runs, times]."""

    learner: Learner
    reward: Floats
    results: tuple[Result, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """The curves of all learners for one target and one penalty."""

    study: Name
    penalty: float
    curves: tuple[Curve, ...]

    @property
    def name(self) -> str:
        """What its files are called."""
        return f"{self.study}-{self.penalty:g}"

    def measures(self, hours: float) -> Mapping[str, Mapping[str, Floats]]:
        """What is told of each learner, by its name: of each run (float64[runs])."""
        grid = len(self.curves[0].reward[0]) - 1
        share = min(1.0, 1.0 / (6.0 * hours))  # ten minutes of the run
        early, late = round(share * grid), grid - round(share * grid)
        return {
            curve.learner.name: {
                EARLY: curve.reward[:, early],
                END: curve.reward[:, -1],
                LOWEST: np.minimum(curve.reward.min(axis=1), 0.0),
                SLOPE: (curve.reward[:, -1] - curve.reward[:, late]) / (60.0 * hours * share),
                EXECUTED: np.array([float(r.steps) for r in curve.results]),
                FAILED: np.array([float(r.steps - r.successes) for r in curve.results]),
                TESTED: np.array(
                    [float(sum(r.executions.values()) - r.steps) for r in curve.results]
                ),
            }
            for curve in self.curves
        }

    def differences(self, hours: float) -> Mapping[str, Mapping[str, Interval]]:
        """How much more a learner with tests has than the one without, run by run."""
        found = self.measures(hours)
        *others, base = found
        return {
            name: {
                key: Interval.of(found[name][key] - found[base][key])
                for key in (EARLY, END, LOWEST, SLOPE)
            }
            for name in others
        }


# What is told of each run.
EARLY, END = "reward at 10 minutes", "reward at the end"
LOWEST = "lowest reward"
SLOPE = "reward a minute, late"
EXECUTED, FAILED, TESTED = "executions", "failures", "tests"


@dataclass(frozen=True, slots=True)
class LearningStudy:
    """The settings; all that is random comes from ``seed``, and run i of every learner shares a seed.

    ``bank`` is the store whose experiences stand for the environments, or ``live`` the run file of
    those that are executed. ``hours`` are of the virtual clock, ``every`` the seconds between two
    points of a curve, ``test_time`` and ``m`` the paper's T and m. The domain's params ``win`` and
    ``fail`` are what a success brings in, here 1, and what a failure costs, the penalty.
    """

    domain: Domain
    problem: Problem
    bank: Path
    live: RunFile | None = None
    studies: tuple[Name, ...] = ("simulation", "robot")
    penalties: tuple[float, ...] = (0.0, 5.0, 10.0)
    runs: int = 5
    hours: float = 1.0
    every: float = 10.0
    test_time: float = 20.0
    m: float = 10.0
    seed: int = 0

    @property
    def grid(self) -> Floats:
        """The times of the curves, in seconds (float64[n])."""
        return np.arange(0.0, self.hours * 3600.0 + 1e-9, self.every)

    def execute(
        self, file: Path, jobs: int, told: Callable[[int, int], None] = lambda *_: None
    ) -> list[Panel]:
        """Do all runs, as many at once as there are ``jobs``; see `runs.executed`."""
        wanted = [
            self._wanted(study, penalty, learner, number)
            for study in self.studies
            for penalty in self.penalties
            for learner in SETTINGS[study].learners
            for number in range(self.runs)
        ]
        found = executed(wanted, self.grid, file, self.origin(), jobs, told)
        return [
            self._panel(study, penalty, found)
            for study in self.studies
            for penalty in self.penalties
        ]

    def origin(self) -> str:
        """A hash of what each run depends on, but for what its name tells."""
        parts = [self.domain, self.problem, self.hours, self.every, self.test_time, self.m]
        digest = sha256(repr([*parts, self.seed]).encode())
        if self.live is None:
            digest.update(self.bank.read_bytes())
        else:
            digest.update(repr((self.live.environments, self.live.kinds)).encode())
        return digest.hexdigest()[:16]

    def _wanted(self, study: Name, penalty: float, learner: Learner, number: int) -> Wanted:
        target = SETTINGS[study].target
        params = {"win": 1.0, "fail": penalty}
        settings = LearnSettings(
            seed=seed_of(self.seed, "learning", number), hours=self.hours,
            test_time=self.test_time if learner.tests else 0.0,
            estimator="decreasing-m", estimator_options={"m": self.m}, solver="thompson",
        )  # fmt: skip
        name = _run_name(study, penalty, learner, number)
        return Wanted(name, self._bound(target, learner.tests, params), settings, params)

    def _bound(self, target: str, tests: Sequence[str], params: Mapping[str, float]) -> Bound:
        """The environments, recorded or live, with these roles."""
        names = (target, *tests)
        if self.live is not None:
            tables = {
                name: replace(self.live.environments[name], role="target" if not i else "test")
                for i, name in enumerate(names)
            }
            live = replace(self.live, environments=tables)
            return live.bind(self.domain, self.problem, params)
        return recorded(self.domain, self.problem, self.bank, names, params)

    def _panel(self, study: Name, penalty: float, found: Mapping[str, Result]) -> Panel:
        curves = []
        for learner in SETTINGS[study].learners:
            results = tuple(
                found[_run_name(study, penalty, learner, number)] for number in range(self.runs)
            )
            reward = np.array([result.reward for result in results])
            curves.append(Curve(learner, reward, results))
        return Panel(study, penalty, tuple(curves))

    # ---------------------------------------------------------------------------------- results

    def as_csv(self, panel: Panel) -> str:
        """A row for each time: mean and standard deviation of each learner, then each of its runs."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        head, columns = ["seconds"], [self.grid]
        for curve in panel.curves:
            head += [f"{curve.learner.name}: {what}" for what in ("mean", "sd")]
            columns += [curve.reward.mean(axis=0), _deviation(curve.reward)]
            head += [f"{curve.learner.name}: run {i}" for i in range(self.runs)]
            columns += list(curve.reward)
        writer.writerow(head)
        writer.writerows([f"{cell:.6g}" for cell in row] for row in np.transpose(columns).tolist())
        return stream.getvalue()

    def as_json(self, panels: Sequence[Panel]) -> dict[str, Any]:
        """The settings, and what each panel shows."""
        return {
            "settings": {
                "problem": self.problem.name, "live": self.live is not None, "runs": self.runs,
                "hours": self.hours, "test_time": self.test_time, "m": self.m, "seed": self.seed,
            },
            "panels": [
                {
                    "study": panel.study,
                    "target": SETTINGS[panel.study].target,
                    "penalty": panel.penalty,
                    "learners": {
                        name: {key: interval_json(Interval.of(values)) for key, values in found.items()}
                        for name, found in panel.measures(self.hours).items()
                    },
                    "differences": {
                        name: {key: interval_json(value) for key, value in found.items()}
                        for name, found in panel.differences(self.hours).items()
                    },
                }
                for panel in panels
            ],
        }  # fmt: skip

    def as_png(self, panel: Panel, dpi: int = 200) -> bytes:
        """The figure: means, and three standard deviations about them, as the paper has them."""

        def draw(figure: Any) -> None:
            axes = figure.subplots()
            minutes = self.grid / 60.0
            for curve in panel.curves:
                mean, spread = curve.reward.mean(axis=0), 3.0 * _deviation(curve.reward)
                colour = curve.learner.colour
                axes.plot(minutes, mean, color=colour, linewidth=1.4, label=curve.learner.name)
                axes.fill_between(
                    minutes, mean - spread, mean + spread, color=colour, alpha=0.15, linewidth=0
                )
            axes.axhline(0.0, color="#444444", linewidth=0.6)
            axes.set_xlabel("time of the run (minutes)")
            axes.set_ylabel("accumulated reward")
            axes.set_title(f"target {SETTINGS[panel.study].target}, penalty {panel.penalty:g}")
            axes.grid(visible=True, linewidth=0.4, alpha=0.5)
            axes.margins(x=0.0)
            number = len(panel.curves)
            figure.legend(loc="outside lower center", ncols=number, frameon=False, handlelength=1.5)

        return chart((3.6, 2.8), draw, dpi)


def recorded(
    domain: Domain, problem: Problem, bank: Path, names: Sequence[str], params: Mapping[str, float]
) -> Bound:
    """Environments for which a bank stands, the target first, then the tests."""
    store = Recorded(str(bank.absolute()))
    declared = tuple(
        replace(e, role="target" if e.name == names[0] else "test") for e in domain.all_environments
    )
    domain = replace(domain, environments=declared)
    specs = tuple(
        EnvironmentSpec(name, store, domain, problem, "test" if i else "target", dict(params))
        for i, name in enumerate(names)
    )
    return Bound(domain, problem, specs[0], specs[1:])


def _run_name(study: Name, penalty: float, learner: Learner, number: int) -> str:
    return f"{study}-{penalty:g}-{learner.name.replace(' ', '-')}-{number}"


def _deviation(reward: Floats) -> Floats:
    """The standard deviation over runs (float64[times]); 0 for a single run."""
    if len(reward) < 2:
        return np.zeros(reward.shape[1])
    found: Floats = reward.std(axis=0, ddof=1)
    return found


def interval_json(found: Interval) -> dict[str, float | None]:
    """A mean, and half the width of its interval: null for a single value."""
    half = None if math.isnan(found.half) else round(found.half, 6)
    return {"mean": round(found.mean, 6), "half_width_95": half}
