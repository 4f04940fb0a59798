"""The learning-execution loop: Algorithm 1 of Suárez-Hernández et al. 2020, for any number of tests."""

from __future__ import annotations

import heapq
import math
from collections import Counter, defaultdict
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from menid_plan.allocation.decide import Time
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.runfile import Bound
from menid_plan.environments.seeds import seed_of
from menid_plan.errors import MenidError
from menid_plan.experience.attribution import Attributor
from menid_plan.experience.record import DistributionKey, Experience
from menid_plan.grounding.state import GroundAction, State
from menid_plan.learning.allocating import Gain, ToTest
from menid_plan.learning.clock import Clock
from menid_plan.learning.confidence import delta
from menid_plan.learning.counts import Evidence
from menid_plan.learning.curve import Point
from menid_plan.learning.events import Limits
from menid_plan.learning.executions import BrokenOffError, Executions
from menid_plan.learning.planner import Planner
from menid_plan.learning.settings import LearnSettings

# Tests of one action in one environment that may be given up in a row before it is let be for now.
MAX_GIVEN_UP = 3
# Tests of one action in a row, however little time they take.
MAX_TESTS = 100_000
# Rounds in which the clock may stand still, where nothing but the clock ends a run.
MAX_IDLE = 100_000
# Models drawn to see how sure the best action is.
DRAWS = 100


class StuckError(MenidError):
    """A run cannot go on: an episode is over where it begins, or time does not pass."""

    exit_code = 3


@dataclass(slots=True)
class Progress:
    """How far a run is.

    ``reward`` accumulated in the target, ``steps`` executions there, ``episodes`` that have ended and
    ``successes`` of them at the goal; ``unexplained`` experiences that no rule covers; ``executions``
    and ``spent`` (seconds) by environment.
    """

    reward: float = 0.0
    steps: int = 0
    episodes: int = 0
    successes: int = 0
    unexplained: int = 0
    executions: Counter[str] = field(default_factory=Counter)
    spent: dict[str, float] = field(default_factory=lambda: defaultdict(float))


class Loop:
    """One learning run. ``watch`` is called with a point of the curve after each step and each test.

    ``underway`` is called after each execution of a test: with the point where the run would be if the
    test ended there.

    ``state`` is that of the target, ``marked`` has the actions that were tested and not executed
    since.
    """

    def __init__(
        self,
        bound: Bound,
        settings: LearnSettings,
        evidence: Evidence,
        planner: Planner,
        attributor: Attributor,
        executions: Executions,
        clock: Clock,
        watch: Callable[[Point], None] = lambda _: None,
        underway: Callable[[Point], None] = lambda _: None,
    ) -> None:
        self.bound = bound
        self.settings = settings
        self.evidence = evidence
        self.planner = planner
        self.attributor = attributor
        self.executions = executions
        self.clock = clock
        self.watch = watch
        self.underway = underway
        self.progress = Progress()
        self.marked: set[GroundAction] = set()
        self.state: State = frozenset(bound.problem.init)
        self._semantics = attributor.semantics
        self._rng = np.random.default_rng(seed_of(settings.seed, "delta"))
        self._deltas: dict[tuple[str, DistributionKey], float] = {}
        self._in_episode = False
        self._episode_step = 0
        self._decisions = 0
        self._idle = 0
        self._tested = 0.0  # seconds of the clock
        self._now = 0.0  # the time of the last point, which is the same when a run is resumed
        self.gain: Gain | None = None
        if settings.allocate in ("gain", "target-only"):
            tests = bound.tests if settings.allocate == "gain" else ()
            self.gain = Gain(planner, evidence, (bound.target, *tests), settings)

    # ------------------------------------------------------------------------------ the algorithm

    def run(self) -> Progress:
        """Learn until the run is over. What is interrupted, at any point, can be resumed."""
        try:
            while not self.over:  # 2
                self._iterate()
        finally:
            self.executions.close()
        return self.progress

    def _iterate(self) -> None:
        """One round of Algorithm 1; the numbers are those of its lines."""
        if self.executions.replay.over:
            self.clock.caught_up()
        if not self._in_episode:
            self._begin_episode()
        if self._episode_is_over():
            self._end_episode("an episode is over")
            return
        if self.gain is not None and self.gain.knows(self.state):
            self._weigh_up(self.gain)
            return
        state = self.state  # 3
        action = self._decide(state)  # 4, 5
        if action is None:
            self._end_episode("the solver knows no action")
            return
        tests = () if action in self.marked else self._not_known_well(state, action)
        if tests:  # 6
            self.marked.add(action)  # 7
            for spec in tests:
                self._test(spec, state, action)  # 8 to 14
        else:
            self.marked.discard(action)  # 16
            self._execute(state, action)  # 17, 18
        self.planner.learned()  # 20

    def _weigh_up(self, gain: Gain) -> None:
        """One round without the marks and the bounds of Algorithm 1."""
        left, passed = self._seconds_left(gain), self._now
        chosen = gain.decide(self.state, self._left, Time(left, passed, self._tested))
        if chosen is None:
            self._end_episode("no action applies")
        elif isinstance(chosen, ToTest):
            executed = self._test(chosen.spec, chosen.state, chosen.action, chosen.number)
            if executed < chosen.number:
                gain.could_not()
        else:
            self._execute(self.state, chosen)

    def _seconds_left(self, gain: Gain) -> float:
        """How long the run will go on, as far as one can tell."""
        progress, limits = self.progress, self._limits()
        each = gain.execution_seconds()
        found = []
        if "hours" in limits:
            found.append(limits["hours"] * 3600.0 - self._now)
        if "steps" in limits:
            found.append((limits["steps"] - progress.steps) * each)
        if "episodes" in limits:
            steps = max(1.0, progress.steps / max(1, progress.episodes))
            found.append((limits["episodes"] - progress.episodes) * steps * each)
        return max(0.0, min(found))

    def _limits(self) -> Limits:
        """When the run is to end; in a repetition, as it was known then."""
        done = self.progress.executions.total()
        known = [limits for stored, limits in self.executions.limits if stored <= done]
        if known and known[-1] and not self.executions.replay.over:
            return known[-1]
        settings = self.settings
        own = {"hours": settings.hours, "steps": settings.steps, "episodes": settings.episodes}
        return {name: limit for name, limit in own.items() if limit is not None}

    def _decide(self, state: State) -> GroundAction | None:
        if not self.planner.is_asked:
            return self.planner.decide(state, self._left)
        self._decisions += 1
        return self.executions.decided(
            self._decisions, lambda: self.planner.decide(state, self._left)
        )

    def _not_known_well(self, state: State, action: GroundAction) -> tuple[EnvironmentSpec, ...]:
        """The tests to try an action in, since its distribution there is not known well enough."""
        settings = self.settings
        if settings.test_time <= 0.0:
            return ()
        key = self.attributor.distribution(state, action)
        if key is None:
            return ()
        found = [spec for spec in self._by_cost(action) if self._is_unsure(spec, key)]
        if not found:
            return ()
        if settings.stop == "best":
            certainty = self.planner.certainty(state, self._left, DRAWS)
            if certainty >= 1.0 - settings.epsilon:
                return ()
        return tuple(found) if settings.allocate == "paper" else (found[0],)

    def _by_cost(self, action: GroundAction) -> list[EnvironmentSpec]:
        """The tests, those of the shortest nominal duration first, those without one last."""

        def cost(spec: EnvironmentSpec) -> float:
            nominal = spec.nominal(action.action)
            return float("inf") if nominal is None else nominal

        return sorted(self.bound.tests, key=cost)

    def _is_unsure(self, spec: EnvironmentSpec, key: DistributionKey) -> bool:
        """Whether delta > delta_thres for the counts of a test environment."""
        settings = self.settings
        counts = self.evidence.counts(key)
        target, seen = counts[0], counts[self.evidence.environments.index(spec.name)]
        enough = settings.delta
        if settings.stop == "gap" and target.sum() > 0 and seen.sum() > 0:
            gap = np.abs(target / target.sum() - seen / seen.sum()).max()
            enough = max(enough, float(gap))
        # It costs as much as a step, is asked in every round, and changes with the counts alone.
        found = self._deltas.get((spec.name, key))
        if found is None:
            found = delta(seen, settings.epsilon, settings.delta_method, rng=self._rng)
            self._deltas[spec.name, key] = found
        return found > enough

    def _test(
        self, spec: EnvironmentSpec, state: State, action: GroundAction, number: int | None = None
    ) -> int:
        """Try an action in a state of a test; the target stays as it is.

        For the time T, or so many times if a number is given; how often it was executed.
        """
        most = MAX_TESTS if number is None else number
        time = self.settings.test_time if number is None else math.inf
        left = [time] * self.settings.lanes  # 8: the time left in each lane
        used = [0.0] * self.settings.lanes
        executed = given_up = 0
        key = self.attributor.distribution(state, action)
        look = 1
        with closing(self.executions.tests(spec, state, action)) as coming:
            for experience in coming:  # 10
                if experience is None:
                    given_up += 1
                    if given_up >= MAX_GIVEN_UP:
                        break
                    continue
                given_up = 0
                executed += 1
                self._learn(experience)  # 12
                lane = used.index(min(used))
                used[lane] += experience.duration  # 11
                left[lane] -= experience.duration  # 13
                self.underway(self._here("test", max(used)))
                if max(left) <= 0.0 or executed >= most:  # 9
                    break
                # Where time hardly passes T is no end: there, what is known well is known well.
                if (
                    number is None
                    and executed >= look
                    and sum(left) / len(left) > self._tests_left(executed)
                ):
                    if key is not None and not self._is_unsure(spec, key):
                        break
                    look = executed + max(1, executed // 20)
        self.executions.save()
        self.clock.spend(max(used))
        self._tested += max(used)
        self._point("test")
        return executed

    def _tests_left(self, executed: int) -> float:
        """The time that is left of T after so many tests if MAX_TESTS of them take all of it."""
        return self.settings.test_time * (1.0 - executed / MAX_TESTS)

    def _execute(self, state: State, action: GroundAction) -> None:
        """Execute an action in the target."""
        try:
            experience = self.executions.step(state, action, self.progress.steps)
        except BrokenOffError:
            self._in_episode = False
            return
        self._learn(experience)
        reward = experience.reward
        if reward is None:
            reward = self.attributor.reward(state, action, experience.after, experience.explanation)
        self.progress.reward += reward
        self.progress.steps += 1
        self.clock.spend(experience.duration)
        self.state = experience.after
        self._episode_step += 1
        if self._episode_is_final():  # not left to the next round, which a run may not have
            self._end_episode("an episode is over")
        self._point("step")

    def _learn(self, experience: Experience) -> None:
        """Count an experience: what it costs does not grow with what is known."""
        progress = self.progress
        progress.executions[experience.environment] += 1
        progress.spent[experience.environment] += experience.duration
        self._idle = self._idle + 1 if experience.duration == 0.0 else 0
        if self.gain is not None:
            self.gain.took(experience)
        if experience.explanation is None:
            progress.unexplained += 1
            return
        key = experience.explanation.key(experience.action)
        self.evidence.add(experience.environment, key, experience.explanation.weights)
        if self.gain is not None:
            self.gain.learned(key, experience, experience.explanation.weights)
        self._deltas.pop((experience.environment, key), None)

    # --------------------------------------------------------------------------- episodes, the end

    @property
    def over(self) -> bool:
        """Whether the run has come to its end; what is stored belongs to it in any case."""
        settings, progress = self.settings, self.progress
        if not self.executions.replay.over:
            return False
        if settings.clock == "virtual" and self._idle > MAX_IDLE and settings.hours is not None:
            raise StuckError(
                f"{MAX_IDLE} executions have taken no time, and the run is to end by the clock; give "
                "executions a duration, or the run a number of steps"
            )
        return (
            (settings.steps is not None and progress.steps >= settings.steps)
            or (settings.episodes is not None and progress.episodes >= settings.episodes)
            or (settings.hours is not None and self.clock.seconds >= settings.hours * 3600.0)
        )

    @property
    def _left(self) -> int | None:
        """How many steps the episode has left, if there is a horizon."""
        horizon = self.bound.problem.horizon
        return None if horizon is None else horizon - self._episode_step

    def _begin_episode(self) -> None:
        first = frozenset(self.bound.problem.init)
        self.state = self.executions.begin(first, self.progress.steps)
        self._episode_step = 0
        self._in_episode = True

    def _episode_is_over(self) -> bool:
        """At a goal, a dead end, the horizon or the limit, or where the goal is out of reach.

        That ends it only where nothing counts without the goal, by the objective.
        """
        return self._episode_is_final() or self.planner.is_hopeless(self.state, self._left)

    def _episode_is_final(self) -> bool:
        """Whether it is over, whatever was learned."""
        return (
            self._semantics.is_final(self.state, self._episode_step)
            or self._episode_step >= self.settings.episode_steps
        )

    def _end_episode(self, reason: str) -> None:
        if self._episode_step == 0:
            raise StuckError(
                f"{reason} in the very state in which episodes begin: nothing to learn"
            )
        self.progress.episodes += 1
        self.progress.successes += self._semantics.is_goal(self.state)
        self._in_episode = False

    def least_sure(self, number: int) -> list[tuple[DistributionKey, float]]:
        """The distributions whose error in the target may be the largest, by the Bonferroni bound."""
        epsilon = self.settings.epsilon
        bounds = [
            (key, delta(self.evidence.counts(key)[0], epsilon, "bonferroni"))
            for key in self.evidence.keys
        ]
        return heapq.nlargest(number, bounds, key=lambda pair: pair[1])

    def _point(self, what: Literal["step", "test"]) -> None:
        self.clock.come_to_point()
        self._now = self.clock.seconds
        self.watch(self._here(what))

    def _here(self, what: Literal["step", "test"], more: float = 0.0) -> Point:
        """The point at which the run is, so many seconds of executions further."""
        progress = self.progress
        seconds = self.clock.seconds + (more if self.settings.clock == "virtual" else 0.0)
        tests = sum(progress.executions.values()) - progress.steps
        return Point(seconds, progress.reward, progress.steps, progress.episodes, tests, what)
