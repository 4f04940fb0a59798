"""An outcome bank: every action, executed so many times in every environment and every state."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice

from menid_plan.environments.interface import EnvironmentFailedError
from menid_plan.environments.pool import ExecutionFailedError, ExecutionFuture, Failure, Pool
from menid_plan.environments.runfile import Bound
from menid_plan.environments.seeds import seed_of
from menid_plan.errors import LimitError
from menid_plan.experience.attribution import Attributor
from menid_plan.experience.record import Experience
from menid_plan.experience.store import Store
from menid_plan.grounding.semantics import Semantics
from menid_plan.grounding.state import SINK, GroundAction, State, state_text

# Banks are for problems whose states can be counted on fingers.
MAX_STATES = 1000
# So many executions that fail, and none that does not: something is wrong with all of them.
HOPELESS = 10
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


def record(
    bound: Bound,
    store: Store,
    executions: int,
    seed: int = 0,
    workers: int = 1,
    progress: Callable[[Progress], None] = lambda _: None,
    failed: Callable[[Failure], None] = lambda _: None,
) -> Progress:
    """Record what is missing in the store; executions that fail each time are left out.

    What is recorded depends on the seed alone, not on the workers, nor on where it was interrupted.
    EnvironmentFailedError if nothing but failures comes.
    """
    target = bound.target.name
    wanted = list(jobs(bound, executions, seed))
    have = {_key(e.environment, target, e.action, e.number) for e in store}
    missing = [j for j in wanted if _key(j.environment, target, j.action, j.number) not in have]
    attributor = Attributor(bound.domain, bound.problem)
    specs = {spec.name: spec for spec in bound.environments}
    recorded, lost = len(wanted) - len(missing), 0
    before = recorded
    kept: list[Experience] = []
    last = time.monotonic()
    with Pool(specs.values(), workers, failed=failed) as pool:
        try:
            for job, future in _ahead(pool, missing):
                try:
                    execution = future.result()
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


def _ahead(pool: Pool, found: list[Job]) -> Iterator[tuple[Job, ExecutionFuture]]:
    """The jobs in their order, some of them under way before it is their turn."""
    rest = iter(found)

    def submitted(job: Job) -> tuple[Job, ExecutionFuture]:
        return job, pool.submit(job.environment, job.state, job.action, job.seed, job.number)

    waiting = deque(map(submitted, islice(rest, 4 * pool.workers)))
    while waiting:
        yield waiting.popleft()
        waiting.extend(map(submitted, islice(rest, 1)))
