"""The executions of a learning run: from the store what was done before, the rest done and stored."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import wait
from contextlib import nullcontext, suppress

from menid_plan.environments.interface import (
    CannotResetError,
    EnvironmentFailedError,
    Execution,
)
from menid_plan.environments.pool import ExecutionFuture, Failure, Pool
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.runfile import Bound, WorkersTable
from menid_plan.environments.seeds import seed_of
from menid_plan.environments.session import Session, without_name
from menid_plan.errors import MenidError
from menid_plan.experience.attribution import Attributor
from menid_plan.experience.record import DistributionKey, Experience
from menid_plan.experience.store import Store
from menid_plan.grounding.state import GroundAction, State, state_text
from menid_plan.interrupts import Interrupts
from menid_plan.learning.counts import Evidence
from menid_plan.learning.events import Events, Reason
from menid_plan.learning.replay import Replay

# Seconds for which tests may be held back before they are stored: what a kill costs at most, beside
# the executions that are under way.
SAVE_EVERY = 1.0

# Seconds after which an interrupt is noticed while workers execute something.
_NOTICED = 0.1


class BrokenOffError(MenidError):
    """The target is not where the run has left it: a new episode has to begin."""


class Executions:
    """Executes actions in the target and in the tests, each execution with a seed of its own.

    Test k of an action in an environment has the seed (run, environment, action, k), step k in the
    target (run, target, k); so the same is seen in any number of workers. Results are taken in order
    of k, surplus ones are dropped. ``reported`` is told of each attempt that failed, from any
    thread. ``tests`` says whether there will be tests: without, no test environment is touched.
    ``interrupts`` are answered between two executions, and while one is under way.
    """

    def __init__(
        self,
        bound: Bound,
        seed: int,
        attributor: Attributor,
        evidence: Evidence,
        store: Store,
        events: Events,
        workers: WorkersTable,
        *,
        tests: bool = True,
        interrupts: Interrupts | None = None,
        reported: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.replay = Replay(store, store.path)
        self.failed = events.failed
        self.limits = events.limits
        self._bound = bound
        self._target = bound.target
        self._seed = seed
        self._attributor = attributor
        self._evidence = evidence
        self._store = store
        self._events = events
        self._reported = reported
        self._interrupts = interrupts or Interrupts()
        self._tested: Counter[tuple[str, GroundAction]] = Counter()
        self._unsaved: list[Experience] = []
        self._saved_at = time.monotonic()
        self._session: Session | None = None
        self._in_place = False
        self._repeatable: bool | None = None
        specs = (bound.target, *(bound.tests if tests else ()))
        self._pool = Pool(specs, workers.number, workers.scheduler or None, self._note)

    def close(self) -> None:
        """Store what is not stored yet, end the workers and let go of the target."""
        try:
            self.save()
        finally:
            self._pool.close()
            self._leave()

    def decided(self, number: int, ask: Callable[[], GroundAction | None]) -> GroundAction | None:
        """Decision ``number`` of someone who is asked: what it was before, else the answer, noted."""
        if number in self._events.decisions:
            return self._events.decisions[number]
        self._interrupts.check()
        with self._interrupts.allowed():
            action = ask()
        self._events.write("decided", number=number, action=action)
        return action

    # ------------------------------------------------------------------------------------- tests

    def tests(
        self, spec: EnvironmentSpec, state: State, action: GroundAction
    ) -> Generator[Experience | None, None, None]:
        """One test of an action in a state after the other; None for one that was given up.

        It comes to an end only where the environment can't be put into that state. Some are under way
        ahead of time where there are workers; whoever stops leaves those. To be closed.
        """
        ahead: deque[ExecutionFuture] = deque()
        try:
            while True:
                self._interrupts.check()
                number = self._tested[spec.name, action]
                given_up = self._events.given_up(spec.name, action, number)
                found = None
                if given_up is None:
                    seed = self._test_seed(spec, action, number)
                    found = self.replay.take(spec.name, state, action, number, seed)
                if given_up is None and found is None:
                    while len(ahead) < self._pool.workers:
                        ahead.append(self._submit_test(spec, state, action, number + len(ahead)))
                    found, given_up = self._result(spec, ahead.popleft())
                self._tested[spec.name, action] += 1
                if given_up == "cannot-reset":
                    return
                yield found
        finally:
            for future in ahead:
                future.cancel()

    def _test_seed(self, spec: EnvironmentSpec, action: GroundAction, number: int) -> int:
        return seed_of(self._seed, spec.name, str(action), number)

    def _submit_test(
        self, spec: EnvironmentSpec, state: State, action: GroundAction, number: int
    ) -> ExecutionFuture:
        seed = self._test_seed(spec, action, number)
        return self._submit(spec, state, action, seed, number)

    def _submit(
        self, spec: EnvironmentSpec, state: State, action: GroundAction, seed: int, number: int
    ) -> ExecutionFuture:
        with self._interrupts.allowed() if self._pool.in_place else nullcontext():
            return self._pool.submit(spec.name, state, action, seed, number)

    def _executed(self, future: ExecutionFuture) -> Execution:
        while not wait([future], _NOTICED).done:
            self._interrupts.check()
        return future.result()

    def _result(
        self, spec: EnvironmentSpec, future: ExecutionFuture
    ) -> tuple[Experience | None, Reason | None]:
        """What a test gave, or why it gave nothing."""
        task, number = future.task, future.number
        try:
            execution = self._executed(future)
        except EnvironmentFailedError as error:
            self.save()  # what came before must be stored before it is known what comes after
            impossible = isinstance(error, CannotResetError)
            reason: Reason = "cannot-reset" if impossible else "failed"
            if impossible:  # of attempts that failed the pool has told
                self._count_failure(
                    spec.name,
                    f"environment `{spec.name}`, `{task.action}`: "
                    f"{without_name(str(error), spec.name)}",
                )
            self._events.write(
                "given up", environment=spec.name, action=str(task.action), number=number,
                reason=reason,
            )  # fmt: skip
            return None, reason
        assert task.state is not None
        experience = self._experience(spec, task.state, task.action, execution, task.seed, number)
        self._unsaved.append(experience)
        if time.monotonic() - self._saved_at > SAVE_EVERY:
            self.save()
        return experience, None

    def save(self) -> None:
        """Store the tests that were held back."""
        if self._unsaved:
            self._store.add(self._unsaved)
            self._unsaved.clear()
        self._saved_at = time.monotonic()

    # ------------------------------------------------------------------------------------ target

    def begin(self, first: State, number: int) -> State:
        """Put the target into the first state of an episode, in which step ``number`` comes next.

        ``first`` is that of the problem; a target that can't be put into it begins in one of its own.
        """
        if self.replay.next is not None:
            return self.replay.next.state
        if self._is_repeatable():
            return first
        self._in_place = True
        seed = seed_of(self._seed, self._target.name, "reset", number)
        target = self._open_target()
        with self._interrupts.allowed():
            return target.reset(None, seed)

    def step(self, state: State, action: GroundAction, number: int) -> Experience:
        """Execute an action in the target, as step ``number`` of the run; it is stored at once.

        Raises EnvironmentFailedError if that fails, and BrokenOffError.
        """
        spec = self._target
        seed = seed_of(self._seed, spec.name, number)
        if self._events.was_broken_off(number):
            raise BrokenOffError
        found = self.replay.take(spec.name, state, action, number, seed)
        if found is not None:
            return found
        self._interrupts.check()
        if self._is_repeatable():
            execution = self._executed(self._submit(spec, state, action, seed, number))
        else:
            with self._interrupts.allowed():
                self._put_back(state, number)
                execution = self._open_target().execute(action)
        found = self._experience(spec, state, action, execution, seed, number)
        self._store.add([found])
        return found

    def _is_repeatable(self) -> bool:
        """Whether the target can be put into any state, and does the same with the same seed.

        Then each step is executed from its own state and seed, in a worker. Any other target goes on
        from where it is, in this process, and is reset at the beginning of an episode only.
        """
        if self._repeatable is None:
            capabilities = self._open_target().capabilities
            self._repeatable = capabilities.reset_to_any and capabilities.repeatable
            if self._repeatable:
                self._leave()
        return self._repeatable

    def _put_back(self, state: State, number: int) -> None:
        """See that the target is in the state where the run has left it."""
        session = self._open_target()
        if not self._in_place and session.capabilities.reset_to_any:
            session.reset(state, seed_of(self._seed, self._target.name, "resume", number))
        try:
            found = state_text(session.state())
        except EnvironmentFailedError as error:
            if self._in_place:
                raise
            found = f"nobody knows which ({error})"  # some can't tell before they are reset
        if found != state_text(state):
            self._events.write("broken off", step=number)
            self._reported(
                f"environment `{self._target.name}` is in another state than that in which the run "
                f"has left it, {state_text(state)}: {found}; a new episode begins"
            )
            raise BrokenOffError
        self._in_place = True

    def _open_target(self) -> Session:
        if self._session is None:
            with self._interrupts.allowed():
                self._session = self._target.open()
        return self._session

    def _leave(self) -> None:
        if self._session is not None:
            session, self._session = self._session, None
            with suppress(Exception, SystemExit):  # nothing depends on it any more
                session.close()

    # ----------------------------------------------------------------------------------- the rest

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
            row = self._evidence.environments.index(spec.name)
            return [float(count) + 1.0 for count in self._evidence.counts(key)[row]]

        explanation = self._attributor.explain(state, action, execution.state, chances)
        assert execution.duration is not None  # sessions see to that
        return Experience(
            spec.name, state, action, execution.state, execution.reward, execution.duration, seed,
            time.time(), explanation, number,
        )  # fmt: skip

    def _note(self, failure: Failure) -> None:
        """An attempt failed; called from any thread, one at a time."""
        self._count_failure(failure.environment, str(failure))

    def _count_failure(self, environment: str, message: str) -> None:
        self.failed[environment] += 1
        self._events.write("failure", environment=environment, message=message)
        self._reported(message)
