"""Where a learning run acts next, if that is not for the paper's loop to say."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from menid_plan.allocation.decide import Decider, Model, Time, believed
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.seeds import seed_of
from menid_plan.experience.record import DistributionKey, Experience
from menid_plan.grounding.state import GroundAction, State
from menid_plan.learning.counts import Evidence
from menid_plan.learning.planner import Planner
from menid_plan.learning.settings import LearnSettings
from menid_plan.mdp.model import Floats

# A test is taken to take this part of an execution at least.
QUICKEST = 1e-3


@dataclass(frozen=True, slots=True)
class ToTest:
    """To execute an action so often in a state of a test."""

    spec: EnvironmentSpec
    state: State
    action: GroundAction
    number: int


class Gain:
    """Weighs up tests and executions by what they bring in by the second; see docs/allocation.md.

    It knows the states of the problem: where an environment has come to another one, `knows` says so.
    ``environments`` are the target and the tests that may be used. What an execution takes is nominal,
    else the mean of those seen, of the action or of all. Until one was seen, a test is taken to take
    next to no time, and an execution in the target a second.
    """

    def __init__(
        self,
        planner: Planner,
        evidence: Evidence,
        environments: Sequence[EnvironmentSpec],
        settings: LearnSettings,
    ) -> None:
        self._planner = planner
        self._environments = environments
        self._settings = settings
        structure = planner.structure
        problem = structure.problem
        steps = planner.problem.horizon
        steps = settings.episode_steps if steps is None else min(steps, settings.episode_steps)
        self._model = Model(structure, steps, goals=planner.objective != "reward")
        keys = [DistributionKey(d.action, d.rule.name, d.values) for d in problem.distributions]
        self._index = {key: index for index, key in enumerate(keys)}
        rows = [evidence.environments.index(spec.name) for spec in environments]

        def counts(index: int) -> Floats:
            found = evidence.counts(keys[index])[rows]
            given = evidence.given(keys[index], environments[0].name)
            if given is not None and settings.prior_weight > 0.0:
                found[0] += settings.prior_weight * given
            return found

        self._belief = believed(structure, counts, len(environments) - 1)
        names = sorted({action.action for action in problem.actions})
        of_action = np.array([names.index(action.action) for action in problem.actions], np.int64)
        self._names = names
        self._action = of_action[problem.tables.rule_action[structure.row_rule]]
        self._took: dict[str, dict[str, float]] = defaultdict(lambda: defaultdict(float))
        self._seen: dict[str, Counter[str]] = defaultdict(Counter)
        self._asked = (-1, -1)
        self._impossible: set[tuple[int, int]] = set()  # tests, by their number and the row
        self._decider = Decider(
            self._model, self._belief, self._seconds,
            np.random.default_rng(seed_of(settings.seed, "gain")),
        )  # fmt: skip

    def knows(self, state: State) -> bool:
        """Whether a state is one of those that it weighs up."""
        return self._planner.number(state) is not None

    def decide(self, state: State, left: int | None, time: Time) -> ToTest | GroundAction | None:
        """What to do next, with so many steps left; None where nothing can be done."""
        number = self._planner.number(state)
        assert number is not None
        found = self._decider.decide(number, left, time)
        structure = self._model.structure
        if isinstance(found, int):
            return None if found < 0 else structure.action(found)
        where = structure.state(int(self._model.state[found.row]))
        assert isinstance(where, frozenset)
        spec = self._environments[1 + found.test]
        self._asked = (found.test, found.row)
        return ToTest(spec, where, structure.action(found.row), found.number)

    def could_not(self) -> None:
        """The tests that were asked for last cannot be done."""
        self._impossible.add(self._asked)

    def learned(
        self, key: DistributionKey, experience: Experience, weights: Sequence[float]
    ) -> None:
        """Take in an experience, which counts for a distribution with these weights."""
        names = [spec.name for spec in self._environments]
        index = self._index.get(key)
        if index is not None and experience.environment in names:
            self._belief.add(index, names.index(experience.environment), np.asarray(weights))

    def took(self, experience: Experience) -> None:
        """Take in how long an execution took."""
        action = experience.action.action
        self._took[experience.environment][action] += experience.duration
        self._seen[experience.environment][action] += 1

    def execution_seconds(self) -> float:
        """How long an execution in the target takes, by what is known."""
        return float(self._seconds(0).mean())

    def _seconds(self, environment: int) -> Floats:
        spec = self._environments[environment]
        took, seen = self._took[spec.name], self._seen[spec.name]
        total = seen.total()
        mean = sum(took.values()) / total if total else (0.0 if environment else 1.0)
        known = []
        for name in self._names:
            nominal = spec.nominal(name)
            if nominal is None:
                nominal = took[name] / seen[name] if seen[name] else mean
            known.append(nominal)
        lanes = self._settings.lanes if environment else 1
        found = np.array(known)[self._action] / lanes
        if environment == 0:
            return np.asarray(np.maximum(found, 1e-9))
        # What takes no time would be tested for ever: how long it takes to decide is not counted.
        found = np.maximum(found, QUICKEST * self.execution_seconds())
        for test, row in self._impossible:
            if test == environment - 1:
                found[row] = np.inf
        return np.asarray(found)
