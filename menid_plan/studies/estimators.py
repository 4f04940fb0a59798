"""Whom to believe: the error of every estimator, and the reward that is earned by it.

On random rules and actions, whose truth is drawn, and on the hard drive, where a bank of executions is
the truth.
"""

from __future__ import annotations

import csv
import io
import math
import re
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from menid_plan.environments.seeds import seed_of
from menid_plan.experience.record import DistributionKey
from menid_plan.experience.store import Store
from menid_plan.learning.estimators import DecreasingM, Empirical
from menid_plan.learning.mixtures import Floats
from menid_plan.learning.settings import LearnSettings
from menid_plan.model.domain import Domain, Problem
from menid_plan.studies.learning import Interval, interval_json, recorded
from menid_plan.studies.pieces import Row, done
from menid_plan.studies.random_rules import (
    CANDIDATES,
    CASES,
    MINUTES,
    TARGET_ONLY,
    ErrorTask,
    RewardTask,
    drawn_errors,
    root_mean_squares,
)
from menid_plan.studies.runs import Wanted, forget, piece, result

BASE = DecreasingM.name
"""What the others are compared with: the paper's."""

# Random rules: numbers of outcomes, of executions in the test and in the target, and gaps.
OUTCOMES = (2, 3, 5)
TESTED = (30, 300, 3000)
GAPS = ((0.0,), (0.1,), (0.3,), (0.0, 0.3))
EXECUTED = (0, 5, 10, 20, 50, 200, 500)

# The hard drive: the target, then the tests, of the runs and of the errors.
RUNS = (("fine", "coarse"), ("robot", "coarse"), ("robot", "coarse", "fine"))
PAIRS = (("fine", "coarse"), ("robot", "coarse"), ("robot", "fine"))
DRIVE_TESTED = (50, 500)
DRIVE_EXECUTED = (0, 5, 20, 50, 200)
# Actions by the total variation between target and test: up to each of these.
CLASSES = (0.02, 0.2, 1.0)
_PENALTY = 5.0  # what runs plan with; Thompson sampling does not heed it

RANDOM, DRIVE = "random", "hard drive"
_TEST_TIME = 20.0  # T, in seconds


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Root mean squared L2 errors: ``errors[estimator][i]`` with ``n1[i]`` executions in the target.

    ``rules`` are random or the hard drive's, ``tests`` says what was tested, ``gap`` how far off it
    is, ``n2`` how often. ``halves`` are half of the 95 % intervals; ``number`` of distributions.
    """

    rules: str
    outcomes: str
    tests: str
    gap: str
    n2: int
    n1: tuple[int, ...]
    number: int
    errors: Mapping[str, Sequence[float]]
    halves: Mapping[str, Sequence[float]]


@dataclass(frozen=True, slots=True, eq=False)
class Rewards:
    """Accumulated reward by an estimator: its mean, and how much more it is than decreasing-m's.

    Runs of one number are paired. ``tests`` says what was tested; a failure costs the ``penalty``.
    """

    actions: str
    tests: str
    penalty: float
    minutes: float
    rewards: Mapping[str, Interval]
    more: Mapping[str, Interval]


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """All that the study found."""

    errors: tuple[Errors, ...]
    rewards: tuple[Rewards, ...]


@dataclass(frozen=True, slots=True)
class EstimatorStudy:
    """The settings; all that is random comes from ``seed``.

    ``bank`` stands for the environments of the hard drive, ``runs`` are those of each estimator there,
    of ``hours`` of the virtual clock; ``random_runs`` those with random actions, ``repetitions`` the
    truths of each kind of random rule. An hour, T = 20 s and Thompson sampling are the paper's.
    """

    domain: Domain
    problem: Problem
    bank: Path
    penalties: tuple[float, ...] = (0.0, 5.0, 10.0)
    runs: int = 10
    hours: float = 1.0
    random_runs: int = 200
    repetitions: int = 4000
    seed: int = 0

    @property
    def minutes(self) -> tuple[float, ...]:
        """When the reward on the hard drive is looked at: after ten minutes, and at the end."""
        return tuple(sorted({min(10.0, 60.0 * self.hours), 60.0 * self.hours}))

    @property
    def repeated(self) -> int:
        """How many times counts are drawn from each of the hard drive's distributions."""
        return math.ceil(self.repetitions / 100)

    def execute(
        self, file: Path, jobs: int, told: Callable[[int, int], None] = lambda *_: None
    ) -> Found:
        """Do it all, in so many processes; what ``file`` has is not done again (`pieces.done`)."""
        folder = file.with_suffix("")
        errors = {task.name: task for task in self._error_tasks()}
        rewards = {task.name: task for task in self._reward_tasks()}
        drive = {wanted.name: wanted for wanted in self._wanted()}
        pairs = {_pair_name(*pair, self.repeated): pair for pair in self._pairs()}
        grid = 60.0 * np.array(self.minutes)
        # The longest come first, so that no process is left alone with one in the end.
        work: dict[str, Callable[[], Row]] = {
            **{name: partial(piece, wanted, grid, folder) for name, wanted in drive.items()},
            **{name: task.run for name, task in errors.items()},
            **{name: partial(self._drive_errors, *pair) for name, pair in pairs.items()},
            **{name: task.run for name, task in rewards.items()},
        }
        found = done(work, file, self.origin(), jobs, told, lambda name: forget(folder, name))
        shutil.rmtree(folder, ignore_errors=True)
        return Found(
            tuple(_random_errors(task, found[name]) for name, task in errors.items())
            + tuple(e for name in pairs for e in _of_classes(found[name])),
            tuple(self._random_rewards(found)) + tuple(self._drive_rewards(found)),
        )

    def origin(self) -> str:
        """A hash of what each piece depends on, but for what its name tells."""
        digest = sha256(repr([self.domain, self.problem, self.seed]).encode())
        digest.update(self.bank.read_bytes())
        return digest.hexdigest()[:16]

    # ---------------------------------------------------------------------------- random rules

    def _error_tasks(self) -> Iterator[ErrorTask]:
        for outcomes in OUTCOMES:
            for n2 in TESTED:
                for gaps in GAPS:
                    yield ErrorTask(outcomes, n2, gaps, EXECUTED, self.repetitions, self.seed)

    def _reward_tasks(self) -> Iterator[RewardTask]:
        for case in CASES:
            for number in range(self.random_runs):
                yield RewardTask(case, number, self.seed)

    def _random_rewards(self, found: Mapping[str, Row]) -> Iterator[Rewards]:
        for case in CASES:
            rows = [found[RewardTask(case, i, self.seed).name] for i in range(self.random_runs)]
            ends = {
                name: np.array([[row[name]["successes"], row[name]["failures"]] for row in rows])
                for name in CANDIDATES
            }
            yield from self._compared(RANDOM, case, MINUTES, ends)

    # -------------------------------------------------------------------------- the hard drive

    def _wanted(self) -> Iterator[Wanted]:
        params = {"win": 1.0, "fail": _PENALTY}
        for environments in RUNS:
            bound = recorded(self.domain, self.problem, self.bank, environments, params)
            for name, (kind, options) in CANDIDATES.items():
                for number in range(self.runs):
                    settings = LearnSettings(
                        seed=seed_of(self.seed, "drive", number), hours=self.hours,
                        test_time=0.0 if name == Empirical.name else _TEST_TIME, estimator=kind,
                        estimator_options=options, solver="thompson",
                    )  # fmt: skip
                    run_name = _run_name(environments, self.hours, name, number)
                    yield Wanted(run_name, bound, settings, params)

    def _drive_rewards(self, found: Mapping[str, Row]) -> Iterator[Rewards]:
        for environments in RUNS:
            ends = {}
            for name in CANDIDATES:
                rows = [
                    result(found[_run_name(environments, self.hours, name, number)])
                    for number in range(self.runs)
                ]
                reward = np.array([row.reward for row in rows])
                executed = np.array([row.executed for row in rows])
                failures = (executed - reward) / (1.0 + _PENALTY)
                ends[name] = np.stack([executed - failures, failures], axis=1)
            yield from self._compared(DRIVE, pair_text(environments), self.minutes, ends)

    def _compared(
        self, actions: str, tests: str, minutes: Sequence[float], ends: Mapping[str, Floats]
    ) -> Iterator[Rewards]:
        """``ends`` are successes and failures, float64[runs, 2, minutes], of each estimator."""
        for penalty in self.penalties:
            for at, minute in enumerate(minutes):
                rewards = {n: each[:, 0, at] - penalty * each[:, 1, at] for n, each in ends.items()}
                yield Rewards(
                    actions, tests, penalty, minute,
                    {name: Interval.of(each) for name, each in rewards.items()},
                    {n: Interval.of(r - rewards[BASE]) for n, r in rewards.items() if n != BASE},
                )  # fmt: skip

    def _pairs(self) -> Iterator[tuple[tuple[str, str], int]]:
        for pair in PAIRS:
            for n2 in DRIVE_TESTED:
                yield pair, n2

    def _drive_errors(self, pair: tuple[str, str], n2: int) -> Row:
        """Errors on the hard drive, of distributions in classes by their gaps."""
        frequencies = bank_frequencies(self.bank, pair)
        gaps = np.array([0.5 * np.abs(p - q).sum() for p, q in frequencies.values()])
        # Shares of a hundred executions: what is meant to be a bound shall not be missed by rounding.
        classes = np.searchsorted(np.array(CLASSES) + 1e-9, gaps)
        seed = seed_of(self.seed, "drive errors", *pair, n2)
        truths = list(frequencies.values())
        squares = drawn_errors(truths, n2, DRIVE_EXECUTED, self.repeated, seed)
        found = []
        for number, (low, high) in enumerate(zip((0.0, *CLASSES), CLASSES, strict=False)):
            here = [each for each, c in zip(squares, classes, strict=True) if c == number]
            if here:
                found.append(
                    {
                        "gap": f"{low:g}-{high:g}",
                        "number": len(here),
                        **root_mean_squares(np.concatenate(here)),
                    }
                )
        return {"tests": pair_text(pair), "n2": n2, "classes": found}

    # ------------------------------------------------------------------------------ what is told

    def as_json(self, found: Found) -> dict[str, Any]:
        """The settings, all errors and all rewards."""
        return {
            "settings": {
                "problem": self.problem.name, "runs": self.runs, "hours": self.hours,
                "random_runs": self.random_runs, "repetitions": self.repetitions, "seed": self.seed,
            },
            "errors": [
                {
                    "rules": each.rules, "outcomes": each.outcomes, "tests": each.tests,
                    "gap": each.gap, "N2": each.n2, "N1": each.n1, "distributions": each.number,
                    "error": _rounded(each.errors), "half_width_95": _rounded(each.halves),
                }
                for each in found.errors
            ],
            "rewards": [
                {
                    "actions": each.actions, "tests": each.tests, "penalty": each.penalty,
                    "minutes": each.minutes,
                    "reward": {n: interval_json(i) for n, i in each.rewards.items()},
                    f"more than {BASE}": {n: interval_json(i) for n, i in each.more.items()},
                }
                for each in found.rewards
            ],
        }  # fmt: skip

    def errors_csv(self, found: Found) -> str:
        """A row for each error."""
        rows: list[list[object]] = [
            ["rules", "outcomes", "tests", "gap", "N2", "N1", "estimator", "error", "half_95"]
        ]
        for each in found.errors:
            for name, errors in each.errors.items():
                halves = each.halves[name]
                for n1, *values in zip(each.n1, errors, halves, strict=True):
                    place = [each.rules, each.outcomes, each.tests, each.gap, each.n2, n1, name]
                    rows.append([*place, *(f"{value:.6g}" for value in values)])
        return _csv(rows)

    def rewards_csv(self, found: Found) -> str:
        """A row for each estimator, penalty and time; the last columns are empty for decreasing-m."""
        head = ["actions", "tests", "penalty", "minutes", "estimator", "reward", "half_95"]
        rows: list[list[object]] = [[*head, "more", "more_half_95"]]
        for each in found.rewards:
            for name, reward in each.rewards.items():
                place = [each.actions, each.tests, f"{each.penalty:g}", f"{each.minutes:g}", name]
                more = _cells(each.more[name]) if name in each.more else ["", ""]
                rows.append([*place, *_cells(reward), *more])
        return _csv(rows)


def bank_frequencies(
    bank: Path, environments: Sequence[str]
) -> dict[DistributionKey, list[Floats]]:
    """How often each outcome was seen of all, by distribution: float64[k] of each environment.

    Only distributions that were seen in all of them; what no rule covers is left out.
    """
    counts: dict[DistributionKey, dict[str, Floats]] = {}
    with Store.read(bank) as store:
        for each in store:
            if each.environment in environments and each.explanation is not None:
                weights = np.array(each.explanation.weights)
                here = counts.setdefault(each.explanation.key(each.action), {})
                here[each.environment] = here.get(each.environment, 0.0) + weights
    return {
        key: [here[name] / here[name].sum() for name in environments]
        for key, here in sorted(counts.items())
        if len(here) == len(environments)
    }


def relative(errors: Iterable[Errors]) -> dict[str, float]:
    """Errors over those of the target alone: geometric means over all tables and sizes above 0."""
    logs: dict[str, list[float]] = {name: [] for name in CANDIDATES}
    for each in errors:
        for name, found in logs.items():
            for i, n1 in enumerate(each.n1):
                if n1 > 0:
                    found.append(np.log(each.errors[name][i] / each.errors[TARGET_ONLY][i]))
    return {name: float(np.exp(np.mean(found))) for name, found in logs.items()}


def _random_errors(task: ErrorTask, row: Row) -> Errors:
    tests = "one test" if len(task.gaps) == 1 else "two tests"
    return Errors(
        RANDOM, str(task.outcomes), tests, gap_text(task.gaps), task.n2, task.n1, task.repetitions,
        row["errors"], row["halves"],
    )  # fmt: skip


def _of_classes(row: Row) -> Iterator[Errors]:
    for each in row["classes"]:
        yield Errors(
            DRIVE, "3 or 4", row["tests"], each["gap"], row["n2"], DRIVE_EXECUTED, each["number"],
            each["errors"], each["halves"],
        )  # fmt: skip


def _run_name(environments: Sequence[str], hours: float, name: str, number: int) -> str:
    called = re.sub(r"\W+", "-", name)
    return f"drive-{'-'.join(environments)}-{hours:g}-{called}-{number}"


def _pair_name(environments: Sequence[str], n2: int, repeated: int) -> str:
    return f"drive errors: {pair_text(environments)}, N2 {n2}, {repeated} times"


def gap_text(gaps: Sequence[float]) -> str:
    """The gaps of tests, in words."""
    return " and ".join(f"{gap:g}" for gap in gaps)


def pair_text(environments: Sequence[str]) -> str:
    """A target, and the tests by which it is learned of."""
    target, *tests = environments
    return f"{target} by {' and '.join(tests)}"


def _rounded(columns: Mapping[str, Sequence[float]]) -> dict[str, list[float]]:
    return {name: [round(value, 6) for value in values] for name, values in columns.items()}


def _cells(found: Interval) -> list[str]:
    return [f"{found.mean:.6g}", f"{found.half:.6g}"]


def _csv(rows: Iterable[Sequence[object]]) -> str:
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(rows)
    return stream.getvalue()
