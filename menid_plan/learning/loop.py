"""The learning-execution loop: Algorithm 1 of Suárez-Hernández et al. 2020, for any number of tests.

What was executed before is not executed again: a run that is resumed takes the same decisions from the
beginning, for all its chances come from the seeds of the run, and reads the results from the store.
"""

from __future__ import annotations

import heapq
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field

import numpy as np

from menid_plan.environments.interface import CannotResetError, EnvironmentFailedError, Execution
from menid_plan.environments.pool import ExecutionFuture, Failure, Pool
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.runfile import Bound
from menid_plan.environments.seeds import seed_of
from menid_plan.environments.session import Session
from menid_plan.errors import MenidError
from menid_plan.experience.attribution import Attributor
from menid_plan.experience.record import DistributionKey, Experience
from menid_plan.experience.store import Store
from menid_plan.grounding.state import GroundAction, State, state_text
from menid_plan.learning.confidence import delta
from menid_plan.learning.counts import Evidence
from menid_plan.learning.planner import Planner
from menid_plan.learning.settings import LearnSettings

# Executions of one action in one test environment that may fail in a row before it is let be.
MAX_FAILURES = 3
# Tests of one action in a row, however little time they take.
MAX_TESTS = 100_000
# Models drawn to see how sure the best action is.
DRAWS = 100


class StuckError(MenidError):
    """Nothing can be done in the state in which the target begins."""

    exit_code = 3


@dataclass(slots=True)
class Progress:
    """How far a run is.

    ``seconds`` on its clock, ``reward`` accumulated in the target, ``steps`` executions there,
    ``executions`` and ``spent`` (seconds) by environment, ``failed`` attempts by environment.
    """

    seconds: float = 0.0
    reward: float = 0.0
    steps: int = 0
    episodes: int = 0
    successes: int = 0
    unexplained: int = 0
    executions: Counter[str] = field(default_factory=Counter)
    spent: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    failed: Counter[str] = field(default_factory=Counter)


@dataclass(frozen=True, slots=True)
class Point:
    """A point of the learning curve: after a step in the target, or tests."""

    seconds: float
    reward: float
    steps: int
    episodes: int
    tests: int
    what: str


class Loop:
    """One learning run. ``watch`` is called with a point of the curve after each step and each test.

    ``failed`` is told of every attempt at an execution that failed.
    """

    def __init__(
        self,
        bound: Bound,
        settings: LearnSettings,
        evidence: Evidence,
        planner: Planner,
        store: Store,
        *,
        workers: int = 0,
        scheduler: str = "",
        watch: Callable[[Point], None] = lambda _: None,
        failed: Callable[[Failure], None] = lambda _: None,
    ) -> None:
        self.bound = bound
        self.settings = settings
        self.evidence = evidence
        self.planner = planner
        self.store = store
        self.watch = watch
        self.progress = Progress()
        self.attributor = Attributor(
            bound.domain, bound.problem, planner.params, settings.attribution
        )
        self.marked: set[GroundAction] = set()
        self.rng = np.random.default_rng(seed_of(settings.seed, "delta"))
        self._failed = failed
        self._stored = {
            (e.environment, e.action if e.environment != bound.target.name else None, e.number): e
            for e in store
        }
        specs = (bound.target, *(bound.tests if settings.test_time > 0 else ()))
        self._pool = Pool(specs, workers, scheduler or None, self._note)
        self._tested: Counter[tuple[str, GroundAction]] = Counter()
        self._session: Session | None = None
        self._started = time.monotonic()
        self._offset = 0.0
        self._semantics = self.attributor.semantics
        self.state: State = self._semantics.initial_state
        self._episode_step = 0
        self._begun = False
        self._in_pool: bool | None = None

    # ------------------------------------------------------------------------------ the algorithm

    def run(self) -> Progress:
        """Learn until the run is over; may be interrupted at any point, and resumed."""
        try:
            while not self.over:
                self._iterate()
        finally:
            self._pool.close()
            if self._session is not None:
                self._session.close()
        return self.progress

    def _iterate(self) -> None:
        """One round of Algorithm 1; the numbers are those of its lines."""
        if not self._begun:
            self._begin_episode()
        if self._semantics.is_final(self.state, self._episode_step) or (
            self._episode_step >= self.settings.episode_steps
        ):
            self._end_episode()
            return
        state = self.state  # 3
        horizon = self.bound.problem.horizon
        left = None if horizon is None else horizon - self._episode_step
        action = self.planner.decide(state, left)  # 4, 5
        if action is None:
            self._end_episode()
            return
        tests = () if action in self.marked else self._insufficient(state, action)
        if tests:  # 6
            self.marked.add(action)  # 7
            for spec in tests:
                self._test(spec, state, action)  # 8 to 14
        else:
            self.marked.discard(action)  # 16
            self._execute(state, action)  # 17, 18
        self.planner.learned()  # 20

    def _insufficient(self, state: State, action: GroundAction) -> tuple[EnvironmentSpec, ...]:
        """The tests in which an action's distribution is not known well enough, and is to be tried."""
        settings = self.settings
        if settings.test_time <= 0.0:
            return ()
        key = self.attributor.distribution(state, action)
        if key is None:
            return ()
        found = [spec for spec in self._by_cost(action) if self._is_unsure(spec, key)]
        if not found:
            return ()
        sure = 1.0 - settings.epsilon
        if settings.stop == "best" and self.planner.certainty(state, DRAWS) >= sure:
            return ()
        return tuple(found) if settings.tests == "all" else (found[0],)

    def _by_cost(self, action: GroundAction) -> list[EnvironmentSpec]:
        """The tests, those of the shortest nominal duration first, those without one last."""

        def cost(spec: EnvironmentSpec) -> float:
            nominal = spec.nominal(action.action)
            return float("inf") if nominal is None else nominal

        return sorted(self.bound.tests, key=cost)

    def _is_unsure(self, spec: EnvironmentSpec, key: DistributionKey) -> bool:
        settings = self.settings
        counts = self.evidence.counts(key)
        seen = counts[self.evidence.environments.index(spec.name)]
        error = delta(seen, settings.epsilon, settings.delta_method, rng=self.rng)
        enough = settings.delta
        if settings.stop == "gap" and counts[0].sum() > 0 and seen.sum() > 0:
            gap = np.abs(counts[0] / counts[0].sum() - seen / seen.sum()).max()
            enough = max(enough, float(gap))
        return error > enough

    # -------------------------------------------------------------------------------- executions

    def _test(self, spec: EnvironmentSpec, state: State, action: GroundAction) -> None:
        """Try an action for the time T, in a state like the target's; the target stays as it is."""
        learned: list[Experience] = []
        lanes = [0.0] * self.settings.lanes
        executed = failures = 0
        coming = self._tests(spec, state, action)
        try:
            for experience in coming:
                if experience is None:
                    failures += 1
                    if failures >= MAX_FAILURES:
                        break
                    continue
                failures = 0
                learned.append(experience)
                self._learn(experience)
                heapq.heapreplace(lanes, lanes[0] + experience.duration)
                self.progress.spent[spec.name] += experience.duration
                executed += 1
                if lanes[0] >= self.settings.test_time or executed >= MAX_TESTS:
                    break
        except CannotResetError as error:
            self._note_message(spec.name, str(error))
        finally:
            coming.close()
            self.store.add(learned)
        self.progress.seconds += max(lanes)
        self._point("test")

    def _tests(
        self, spec: EnvironmentSpec, state: State, action: GroundAction
    ) -> Generator[Experience | None, None, None]:
        """One test of an action after the other, as they come; None for one that failed.

        Some are under way ahead of time where there are workers; whoever stops leaves them.
        """
        waiting: list[tuple[int, ExecutionFuture | Experience]] = []
        ahead = self._tested[spec.name, action]
        try:
            while True:
                while len(waiting) < self._pool.workers:
                    waiting.append((ahead, self._begin_test(spec, state, action, ahead)))
                    ahead += 1
                number, begun = waiting.pop(0)
                self._tested[spec.name, action] = number + 1
                if isinstance(begun, Experience):
                    yield begun
                    continue
                try:
                    execution = begun.result()
                except CannotResetError:
                    raise
                except EnvironmentFailedError:
                    yield None  # counted and told already
                else:
                    yield self._experience(spec, state, action, execution, begun.task.seed, number)
        finally:
            for _, begun in waiting:
                if not isinstance(begun, Experience):
                    begun.cancel()

    def _begin_test(
        self, spec: EnvironmentSpec, state: State, action: GroundAction, number: int
    ) -> ExecutionFuture | Experience:
        stored = self._stored.get((spec.name, action, number))
        if stored is not None:
            return stored
        seed = seed_of(self.settings.seed, spec.name, str(action), number)
        return self._pool.submit(spec.name, state, action, seed, number)

    def _execute(self, state: State, action: GroundAction) -> None:
        """Execute an action in the target."""
        spec = self.bound.target
        number = self.progress.steps
        experience = self._stored.get((spec.name, None, number))
        if experience is None:
            seed = seed_of(self.settings.seed, spec.name, number)
            execution = self._in_target(state, action, seed)
            experience = self._experience(spec, state, action, execution, seed, number)
            self.store.add([experience])
        self._learn(experience)
        reward = experience.reward
        if reward is None:
            reward = self.attributor.reward(state, action, experience.after, experience.explanation)
        progress = self.progress
        progress.reward += reward
        progress.steps += 1
        progress.seconds += experience.duration
        progress.spent[spec.name] += experience.duration
        self.state = experience.after
        self._episode_step += 1
        self._point("step")

    def _in_target(self, state: State, action: GroundAction, seed: int) -> Execution:
        """What an action does in the target, which is in that state or is put into it."""
        if self._repeatable():
            return self._pool.submit(self.bound.target.name, state, action, seed).result()
        session = self._open_target()
        found = session.state()
        if found != state:
            raise CannotResetError(
                f"environment `{self.bound.target.name}` is in the state {state_text(found)}, and the "
                f"run goes on from {state_text(state)}"
            )
        return session.execute(action)

    def _repeatable(self) -> bool:
        """Whether the target can be put into any state, and does the same with the same seed.

        Then each of its steps has a seed of its own and can be repeated, in a worker too. Any other
        target goes on from where it is, and is reset at the beginning of an episode only.
        """
        if self._in_pool is None:
            capabilities = self._open_target().capabilities
            self._in_pool = capabilities.reset_to_any and capabilities.repeatable
            if self._in_pool and self._session is not None:
                self._session.close()
                self._session = None
        return self._in_pool

    def _open_target(self) -> Session:
        if self._session is None:
            self._session = self.bound.target.open()
        return self._session

    def _begin_episode(self) -> None:
        """Put the target into the first state of an episode."""
        number = self.progress.steps
        stored = self._stored.get((self.bound.target.name, None, number))
        self._episode_step = 0
        self._begun = True
        if stored is not None:
            self.state = stored.state
        elif self._repeatable():
            self.state = self._semantics.initial_state
        else:
            seed = seed_of(self.settings.seed, self.bound.target.name, "reset", number)
            self.state = self._open_target().reset(None, seed)

    def _experience(
        self,
        spec: EnvironmentSpec,
        state: State,
        action: GroundAction,
        execution: Execution,
        seed: int,
        number: int,
    ) -> Experience:
        """What was seen, explained by what is believed at the time."""

        def chances(key: DistributionKey) -> Sequence[float]:
            row = self.evidence.environments.index(spec.name)
            return [float(x) for x in self.evidence.counts(key)[row] + 1.0]

        explanation = self.attributor.explain(state, action, execution.state, chances)
        assert execution.duration is not None  # sessions see to that
        return Experience(
            spec.name, state, action, execution.state, execution.reward, execution.duration, seed,
            time.time(), explanation, number,
        )  # fmt: skip

    def _learn(self, experience: Experience) -> None:
        self.progress.executions[experience.environment] += 1
        if experience.explanation is None:
            self.progress.unexplained += 1
            return
        key = experience.explanation.key(experience.action)
        self.evidence.add(experience.environment, key, experience.explanation.weights)

    # ----------------------------------------------------------------------------- time and limits

    @property
    def over(self) -> bool:
        """Whether the run has come to its end."""
        settings, progress = self.settings, self.progress
        return (
            (settings.steps is not None and progress.steps >= settings.steps)
            or (settings.episodes is not None and progress.episodes >= settings.episodes)
            or (settings.hours is not None and self.seconds >= settings.hours * 3600.0)
        )

    @property
    def seconds(self) -> float:
        """What the clock of the run shows."""
        if self.settings.clock == "virtual":
            return self.progress.seconds
        return time.monotonic() - self._started + self._offset

    def least_sure(self, number: int) -> list[tuple[DistributionKey, float]]:
        """The distributions whose error in the target may be the largest, by the bound."""
        settings = self.settings
        bounds = [
            (key, delta(self.evidence.counts(key)[0], settings.epsilon, "bonferroni"))
            for key in self.evidence.keys
        ]
        return heapq.nlargest(number, bounds, key=lambda pair: pair[1])

    def _end_episode(self) -> None:
        if self._episode_step == 0:
            raise StuckError("the problem begins in a state in which an episode is over already")
        self.progress.episodes += 1
        self.progress.successes += self._semantics.is_goal(self.state)
        self._begun = False

    def _point(self, what: str) -> None:
        progress = self.progress
        tests = sum(progress.executions.values()) - progress.steps
        self.watch(
            Point(self.seconds, progress.reward, progress.steps, progress.episodes, tests, what)
        )

    def _note(self, failure: Failure) -> None:
        self.progress.failed[failure.environment] += 1
        self._failed(failure)

    def _note_message(self, environment: str, message: str) -> None:
        self.progress.failed[environment] += 1
        self.on_message(f"environment `{environment}`: {message}")

    def on_message(self, message: str) -> None:
        """Told of what went wrong and is passed over."""
