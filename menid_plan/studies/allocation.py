"""Where to act: the rule that weighs up tests and executions, against the paper's and without tests.

On random actions (`bandits`), on the hard drive, whose outcomes come from the bank, and on two domains
with several steps, whose probabilities are drawn anew for each run.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from menid_plan.allocation.decide import Model
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.runfile import Bound
from menid_plan.environments.seeds import seed_of
from menid_plan.environments.simulated import Simulated
from menid_plan.experience.record import DistributionKey
from menid_plan.experience.store import Store
from menid_plan.grounding.ground import ground
from menid_plan.learning.counts import Evidence, domain_with
from menid_plan.learning.estimators import Empirical
from menid_plan.learning.mixtures import Floats
from menid_plan.learning.settings import LearnSettings
from menid_plan.mdp.explore import explore
from menid_plan.model.domain import Domain, Problem
from menid_plan.studies.bandits import ALONE, GAIN, MINUTES, PAPER, SIMULATORS, TESTING, Bandit
from menid_plan.studies.estimators import bank_frequencies, pair_text
from menid_plan.studies.learning import recorded
from menid_plan.studies.pieces import Row, done
from menid_plan.studies.runs import Wanted, forget, piece, result

ACTIONS = (20, 57)
DRIVE = (("robot", "coarse"), ("robot", "coarse", "fine"), ("fine", "coarse"))
LEARNERS: Mapping[str, LearnSettings] = {
    PAPER: LearnSettings(test_time=0.0),
    TESTING: LearnSettings(test_time=20.0),
    ALONE: LearnSettings(allocate="target-only"),
    GAIN: LearnSettings(allocate="gain"),
}
_TARGET, _TEST = 30.0, 0.4  # seconds of an execution, where the domain's probabilities are drawn


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """What came of the runs on one problem with one penalty.

    ``rewards`` (of each learner float64[runs, minutes]) are paired, as is ``oracle`` (float64[runs],
    what who knew all would earn in the whole time). ``counts`` (float64[runs, 4]) are executions,
    successes, failures and tests.
    """

    group: str
    name: str
    penalty: float
    minutes: Floats
    rewards: Mapping[str, Floats]
    counts: Mapping[str, Floats]
    oracle: Floats

    @property
    def short(self) -> str:
        """What it is called where there is little room."""
        return self.name.removeprefix("drive: ").replace("coarse and fine", "both")

    def regret(self, learner: str, minute: float) -> Floats:
        """How much less than the oracle's the reward is by then (float64[runs])."""
        at = self.at(minute)
        found: Floats = (
            self.oracle * self.minutes[at] / self.minutes[-1] - self.rewards[learner][:, at]
        )
        return found

    def at(self, minute: float) -> int:
        """The index of a time, or of the last one before it."""
        return max(0, int(np.searchsorted(self.minutes, 60.0 * minute + 1e-9)) - 1)


@dataclass(frozen=True)
class AllocationStudy:
    """The settings; all that is random comes from ``seed``.

    ``bandits`` are the runs of each learner with random actions, ``runs`` those on each of the other
    problems, ``hours`` of the virtual clock. ``files`` has domain and problem of the drive, the
    assembly and the stones, and ``bank`` stands for the environments of the drive.
    """

    files: Mapping[str, tuple[Domain, Problem]]
    bank: Path
    penalties: tuple[float, ...] = (0.0, 5.0, 10.0)
    bandits: int = 300
    runs: int = 30
    hours: float = 1.0
    seed: int = 0

    def execute(
        self, file: Path, jobs: int, told: Callable[[int, int], None] = lambda *_: None
    ) -> list[Case]:
        """Do it all, in so many processes; what ``file`` has is not done again (`pieces.done`)."""
        folder = file.with_suffix("")
        work: dict[str, Callable[[], Row]] = {}
        for name, penalty, learner, number in self._drawn():
            wanted = self._wanted(name, penalty, learner, number)
            work[wanted.name] = partial(piece, wanted, self.grid, folder)
        work |= {task.name: task.run for actions in ACTIONS for task in self._tasks(actions)}
        found = done(work, file, self.origin(), jobs, told, lambda name: forget(folder, name))
        shutil.rmtree(folder, ignore_errors=True)
        return [*self._bandit_cases(found), *self._model_cases(found)]

    def origin(self) -> str:
        """A hash of what each piece depends on, but for what its name tells."""
        digest = sha256(repr([self.hours, self.seed]).encode())
        digest.update(repr(self.files).encode())
        digest.update(self.bank.read_bytes())
        return digest.hexdigest()[:16]

    @property
    def grid(self) -> Floats:
        """The minutes at which the reward is looked at, in seconds (float64[n])."""
        return 60.0 * np.arange(1.0, max(1.0, 60.0 * self.hours) + 0.5)

    # ------------------------------------------------------------------------------ random actions

    def _tasks(self, actions: int) -> list[Bandit]:
        return [Bandit(actions, i, self.seed, self.penalties) for i in range(self.bandits)]

    def _bandit_cases(self, found: Mapping[str, Row]) -> Iterator[Case]:
        for actions in ACTIONS:
            rows = [found[task.name] for task in self._tasks(actions)]
            for simulator in SIMULATORS:
                for penalty in self.penalties:
                    here = [row[simulator][f"{penalty:g}"] for row in rows]
                    ends = {
                        name: np.array([[r[name]["successes"], r[name]["failures"]] for r in here])
                        for name in LEARNERS
                    }
                    best = np.array([row["oracle"] for row in rows])
                    yield Case(
                        f"{actions} random actions", simulator, penalty, MINUTES,
                        {n: each[:, 0] - penalty * each[:, 1] for n, each in ends.items()},
                        {
                            n: np.stack([
                                each[:, :, -1].sum(axis=1), each[:, 0, -1], each[:, 1, -1],
                                [r[n]["tests"] for r in here],
                            ], axis=1)
                            for n, each in ends.items()
                        },
                        np.maximum(0.0, (1.0 + penalty) * best - penalty) * MINUTES[-1] / 30.0,
                    )  # fmt: skip

    # ------------------------------------------------------------------------------ several steps

    @property
    def problems(self) -> tuple[str, ...]:
        """What the problems are called."""
        return (*(f"drive: {pair_text(pair)}" for pair in DRIVE), "assembly", "stones")

    def _drawn(self) -> Iterator[tuple[str, float, str, int]]:
        for name in self.problems:
            for penalty in self.penalties:
                for learner in LEARNERS:
                    for number in range(self.runs):
                        yield name, penalty, learner, number

    def _wanted(self, name: str, penalty: float, learner: str, number: int) -> Wanted:
        params = {"win": 1.0, "fail": penalty}
        settings = replace(
            LEARNERS[learner], seed=seed_of(self.seed, "allocation", number), hours=self.hours,
            objective="reward",
        )  # fmt: skip
        bound = self._bound(name, params, number)
        if learner in (PAPER, ALONE):
            bound = replace(bound, tests=())
        return Wanted(_run_name(name, penalty, learner, number), bound, settings, params)

    def _bound(self, name: str, params: Mapping[str, float], number: int) -> Bound:
        domain, problem = self.files[name.split(":")[0]]
        if name.startswith("drive"):
            pair = next(pair for pair in DRIVE if name == f"drive: {pair_text(pair)}")
            bank = self.bank
            found = recorded(domain, problem, bank, pair, params)
            target, *tests = (
                replace(spec, duration=self._durations[spec.name]) for spec in found.environments
            )
            return Bound(found.domain, problem, target, tuple(tests))
        domain = drawn(domain, problem, np.random.default_rng(seed_of(self.seed, name, number)))
        target, test = (
            EnvironmentSpec(
                e.name, Simulated(), domain, problem, e.role, dict(params), duration=seconds
            )
            for e, seconds in zip(domain.environments, (_TARGET, _TEST), strict=True)
        )
        return Bound(domain, problem, target, (test,))

    @cached_property
    def _durations(self) -> Mapping[str, Mapping[str, float]]:
        """What an execution of each action takes in each environment of the bank, on average."""
        took: dict[str, dict[str, list[float]]] = {}
        with Store.read(self.bank) as store:
            for each in store:
                actions = took.setdefault(each.environment, {})
                actions.setdefault(each.action.action, []).append(each.duration)
        return {
            name: {action: float(np.mean(seconds)) for action, seconds in actions.items()}
            for name, actions in took.items()
        }

    def _model_cases(self, found: Mapping[str, Row]) -> Iterator[Case]:
        for name in self.problems:
            for penalty in self.penalties:
                results = {
                    learner: [
                        result(found[_run_name(name, penalty, learner, i)])
                        for i in range(self.runs)
                    ]
                    for learner in LEARNERS
                }
                rates = [self._best(name, penalty, i) for i in range(self.runs)]
                yield Case(
                    "several steps", name, penalty, self.grid,
                    {n: np.array([each.reward for each in rs]) for n, rs in results.items()},
                    {
                        n: np.array([
                            [e.steps, e.won, e.lost, sum(e.executions.values()) - e.steps] for e in rs
                        ])
                        for n, rs in results.items()
                    },
                    np.maximum(0.0, rates) * self.grid[-1],
                )  # fmt: skip

    def _best(self, name: str, penalty: float, number: int) -> float:
        """The reward a second of who knows the target's probabilities."""
        params = {"win": 1.0, "fail": penalty}
        drive = name.startswith("drive")
        key = (name, penalty, 0 if drive else number)
        if key not in self._known:
            bound = self._bound(name, params, number)
            compiled = ground(bound.domain, bound.problem, params)
            structure = explore(compiled)
            target = bound.target
            evidence = Evidence(bound.domain, bound.problem, [target.name], Empirical())
            seen = self._frequencies[target.name] if drive else {}
            wide = max(len(d.rule.outcomes) for d in compiled.distributions)
            chances = np.zeros((len(compiled.distributions), wide))
            for row, d in zip(chances, compiled.distributions, strict=True):
                at = DistributionKey(d.action, d.rule.name, d.values)
                given = seen[at][0] if at in seen else evidence.given(at, target.name)
                assert given is not None
                row[: len(given)] = given
            actions = [structure.action(row).action for row in range(len(structure.row_rule))]
            seconds = np.array([target.nominal(action) for action in actions], np.float64)
            model = Model(structure, bound.problem.horizon)
            self._known[key] = model.solve(chances, seconds, 0.0).rate
        return self._known[key]

    @cached_property
    def _known(self) -> dict[tuple[str, float, int], float]:
        return {}

    @cached_property
    def _frequencies(self) -> Mapping[str, Mapping[DistributionKey, Sequence[Floats]]]:
        bank = self.bank
        return {target: bank_frequencies(bank, [target]) for target in ("robot", "fine")}


# Of the domains whose probabilities are drawn: how many succeed seldom, now and then, and mostly.
_SHARES = {"assembly": (0.6, 0.25, 0.15), "stones": (0.4, 0.2, 0.4)}
_NOISE = 0.2


def drawn(domain: Domain, problem: Problem, rng: np.random.Generator) -> Domain:
    """A domain with other probabilities for what is uncertain in its target, and in its test.

    The first outcome of each distribution gets a probability from a population of three kinds, and the
    second the rest; in the test normal noise is on it, with a standard deviation of .2.
    """
    keys, target, test = [], [], []
    mostly = (18.0, 1.5) if domain.name == "assembly" else (30.0, 1.0)
    for each in ground(domain, problem).distributions:
        if len(each.rule.outcomes) == 3:  # two, and noise
            kind = int(rng.choice(3, p=_SHARES[domain.name]))
            p = (rng.beta(0.5, 10.0), rng.uniform(0.2, 0.8), rng.beta(*mostly))[kind]
            q = float(np.clip(p + rng.normal(0.0, _NOISE), 0.0, 1.0))
            keys.append(DistributionKey(each.action, each.rule.name, each.values))
            target.append(np.array([p, 1.0 - p, 0.0]))
            test.append(np.array([q, 1.0 - q, 0.0]))
    first, second = (environment.name for environment in domain.environments)
    return domain_with(domain_with(domain, first, keys, target), second, keys, test)


def _run_name(name: str, penalty: float, learner: str, number: int) -> str:
    return re.sub(r"[^\w-]+", "-", f"{name}-{penalty:g}-{learner}-{number}")


def plain(case: Case) -> dict[str, Any]:
    """Means of a case, for JSON."""
    return {
        "problems": case.group, "case": case.name, "penalty": case.penalty,
        "oracle": round(float(case.oracle.mean()), 6),
        "learners": {
            name: {
                "reward": [round(x, 6) for x in case.rewards[name].mean(axis=0).tolist()],
                **dict(zip(
                    ("executions", "successes", "failures", "tests"),
                    (round(x, 6) for x in case.counts[name].mean(axis=0).tolist()), strict=True,
                )),
            }
            for name in LEARNERS
        },
    }  # fmt: skip
