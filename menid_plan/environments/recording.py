"""An outcome bank: every action, executed so many times in every environment and every state."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass
from itertools import islice

from menid_plan.environments.interface import CannotResetError, EnvironmentFailedError
from menid_plan.environments.pool import ExecutionFailedError, ExecutionFuture, Failure, Pool
from menid_plan.environments.runfile import Bound
from menid_plan.environments.seeds import seed_of
from menid_plan.environments.settings import differences
from menid_plan.errors import LimitError
from menid_plan.experience.attribution import Attributor
from menid_plan.experience.record import Experience
from menid_plan.experience.schema import StoreInputError
from menid_plan.experience.store import Store
from menid_plan.grounding.semantics import Semantics
from menid_plan.grounding.state import SINK, GroundAction, State, state_text

# Banks are for problems whose states can be counted on fingers.
MAX_STATES = 1000
# So many executions that fail, and none that does not: something is wrong with all of them.
HOPELESS = 10
# Executions of one recording, which would take weeks.
MAX_EXECUTIONS = 5_000_000
# Seconds after which what was seen is written down.
_KEPT_AFTER = 1.0


@dataclass(frozen=True, slots=True)
class Job:
    """One execution to be recorded; ``number`` is that of its experience."""

    environment: str
    state: State
    action: GroundAction
    seed: int
    number: int


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a recording is: executions that are recorded, of how many, and those that failed."""

    recorded: int
    wanted: int
    failed: int


def situations(bound: Bound) -> list[tuple[State, GroundAction]]:
    """Every state that the rules can lead to, with every action that applies there.

    They come in the order in which they are found from the initial state. LimitError if there are more
    than 1000 states.
    """
    semantics = Semantics(bound.domain, bound.problem)
    found: dict[State, None] = {semantics.initial_state: None}
    waiting = deque(found)
    pairs = []
    while waiting:
        state = waiting.popleft()
        if semantics.is_final(state):
            continue
        for action, covering in semantics.applicable(state):
            pairs.append((state, action))
            for outcome in covering.rule.outcomes:
                after = semantics.successor(covering, outcome, state)
                if after is not SINK and after not in found:
                    found[after] = None
                    waiting.append(after)
        if len(found) > MAX_STATES:
            raise LimitError(
                f"problem `{bound.problem.name}` has more than {MAX_STATES} states: to execute every"
                " action in each of them would take too long"
            )
    return pairs


def jobs(bound: Bound, executions: int, seed: int) -> Iterator[Job]:
    """The executions in their order; with more of them, the first ones stay the same."""
    pairs = situations(bound)
    steps = 0
    tests: dict[tuple[str, GroundAction], int] = {}
    for k in range(executions):
        for spec in bound.environments:
            for state, action in pairs:
                if spec is bound.target:
                    number, steps = steps, steps + 1
                else:
                    number = tests.get((spec.name, action), 0)
                    tests[spec.name, action] = number + 1
                drawn = seed_of(seed, "record", spec.name, state_text(state), str(action), k)
                yield Job(spec.name, state, action, drawn, number)


def must_go_on_with(store: Store, bound: Bound) -> None:
    """Raise StoreInputError for the store of a learning run, or one of other environments."""
    if "learn" in store.settings:
        raise StoreInputError(f"`{store.path}` is the store of a learning run: choose another file")
    before = store.settings.get("environments")
    for key, there, here in differences(before, bound.described()) if before else ():
        raise StoreInputError(
            f"`{store.path}` was recorded with {key} = {there}, and this one has {here}: choose"
            " another file, or the run file that it was recorded with"
        )


def record(
    bound: Bound,
    store: Store,
    executions: int,
    seed: int = 0,
    workers: int = 1,
    progress: Callable[[Progress], None] = lambda _: None,
    failed: Callable[[Failure], None] = lambda _: None,
    left_out: Callable[[str], None] = lambda _: None,
) -> Progress:
    """Record what is missing in the store; executions that fail each time are left out.

    So are states that an environment can't be put into: ``left_out`` is told of each, in words. What
    is recorded depends on the seed alone, not on the workers, nor on where it was interrupted.
    EnvironmentFailedError if nothing but failures comes, StoreInputError if the store has other
    executions than those that belong there, LimitError if there are too many.
    """
    target = bound.target.name
    number = len(situations(bound)) * len(bound.environments) * executions
    if number > MAX_EXECUTIONS:
        raise LimitError(
            f"there are {number} executions to be recorded; at most {MAX_EXECUTIONS} are"
        )
    wanted = list(jobs(bound, executions, seed))
    have = {_key(e.environment, target, e.action, e.number): e for e in store}
    missing = []
    for job in wanted:
        there = have.get(_key(job.environment, target, job.action, job.number))
        if there is None:
            missing.append(job)
        elif (there.state, there.action, there.seed) != (job.state, job.action, job.seed):
            raise StoreInputError(
                f"`{store.path}` has another execution {job.number} of `{there.action}` in"
                f" `{job.environment}` than a recording has there: choose another file"
            )
    attributor = Attributor(bound.domain, bound.problem)
    specs = {spec.name: spec for spec in bound.environments}
    recorded, lost = len(wanted) - len(missing), 0
    before = recorded
    kept: list[Experience] = []
    last = time.monotonic()
    unreachable: set[tuple[str, State]] = set()
    with Pool(specs.values(), workers, failed=failed) as pool:
        try:
            for job, future in _ahead(pool, missing, unreachable):
                try:
                    if future is None:
                        lost += 1
                        continue
                    execution = future.result()
                except CannotResetError as error:
                    lost += 1
                    if (job.environment, job.state) not in unreachable:
                        unreachable.add((job.environment, job.state))
                        left_out(
                            f"nothing is recorded of the state `{state_text(job.state)}` in"
                            f" `{job.environment}`: {error}"
                        )
                    if job.state == frozenset(bound.problem.init):
                        raise
                except ExecutionFailedError as error:
                    lost += 1
                    if lost == min(HOPELESS, len(missing)) and recorded == before:
                        raise EnvironmentFailedError(
                            f"the first {lost} executions all failed; last: {error}"
                        ) from error
                else:
                    recorded += 1
                    assert execution.duration is not None  # sessions see to that
                    kept.append(
                        Experience(
                            job.environment, job.state, job.action, execution.state, execution.reward,
                            execution.duration, job.seed, time.time(),
                            attributor.explain(job.state, job.action, execution.state), job.number,
                        )
                    )  # fmt: skip
                if time.monotonic() - last > _KEPT_AFTER:
                    store.add(kept)
                    kept.clear()
                    last = time.monotonic()
                    progress(Progress(recorded, len(wanted), lost))
        finally:
            store.add(kept)
    found = Progress(recorded, len(wanted), lost)
    progress(found)
    return found


def _key(
    environment: str, target: str, action: GroundAction, number: int
) -> tuple[str, GroundAction | None, int]:
    """What tells an experience of a store from all others."""
    return environment, None if environment == target else action, number


def _ahead(
    pool: Pool, found: list[Job], unreachable: Container[tuple[str, State]]
) -> Iterator[tuple[Job, ExecutionFuture | None]]:
    """The jobs in their order, some under way before it is their turn; None: it is in no such state."""
    rest = iter(found)

    def submitted(job: Job) -> tuple[Job, ExecutionFuture | None]:
        if (job.environment, job.state) in unreachable:
            return job, None
        return job, pool.submit(job.environment, job.state, job.action, job.seed, job.number)

    waiting = deque(map(submitted, islice(rest, 4 * pool.workers)))
    while waiting:
        yield waiting.popleft()
        waiting.extend(map(submitted, islice(rest, 1)))
