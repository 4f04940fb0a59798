"""Checks an environment against its protocol, for those who write their own."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import count
from typing import Literal

from menid_plan.environments.interface import (
    CannotResetError,
    Capabilities,
    EnvironmentFailedError,
    Execution,
    NotRecordedError,
)
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.session import Session
from menid_plan.environments.settings import SettingError
from menid_plan.errors import MeaningError, MenidError
from menid_plan.experience.attribution import Attributor
from menid_plan.grounding.state import GroundAction, State, state_text

Verdict = Literal["pass", "fail", "skip"]

# How many states are visited unless the caller says otherwise, and how many faults are told at most
# for each thing that is looked at.
MAX_STATES = 10
MAX_FAULTS = 5


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at, whether it is right, and what was found."""

    about: str
    verdict: Verdict
    details: tuple[str, ...] = ()


@dataclass(slots=True)
class Tally:
    """What the executions of one action gave.

    ``outcomes`` counts by rule and outcome, as the domain explains them; ``unexplained`` are
    executions that no rule covers. ``seconds`` is the sum of the durations.
    """

    action: str
    executions: int = 0
    failures: int = 0
    seconds: float = 0.0
    outcomes: Counter[str] = field(default_factory=Counter)
    unexplained: int = 0


@dataclass(frozen=True, slots=True)
class Report:
    """What was found out about an environment."""

    environment: str
    kind: str
    capabilities: Capabilities | None
    findings: tuple[Finding, ...]
    tallies: tuple[Tally, ...]
    states: int

    @property
    def is_right(self) -> bool:
        """Whether nothing is wrong."""
        return all(finding.verdict != "fail" for finding in self.findings)


def check(
    spec: EnvironmentSpec,
    executions: int = 5,
    seed: int = 0,
    states: int = MAX_STATES,
    progress: Callable[[str], None] = lambda _: None,
) -> Report:
    """Build an environment, use it and see whether it keeps to the protocol.

    In its first state and some that are reached from there, ``states`` at most, every action that
    applies is executed ``executions`` times, each with a seed of its own that follows from ``seed``;
    then some again with the same seed. Never raises what the environment does wrong.
    """
    return _Check(spec, executions, seed, states, progress).report()


class _Check:
    def __init__(
        self,
        spec: EnvironmentSpec,
        executions: int,
        seed: int,
        states: int,
        progress: Callable[[str], None],
    ) -> None:
        self.spec, self.executions, self.seed, self.progress = spec, executions, seed, progress
        self.most = states
        self.seeds = count(seed)
        self.attributor = Attributor(spec.domain, spec.problem, spec.params)
        self.findings: list[Finding] = []
        self.faults: dict[str, list[str]] = {}
        self.tallies: dict[str, Tally] = {}
        self.absent: dict[str, None] = {}
        self.visited: dict[State, None] = {}
        self.capabilities: Capabilities | None = None

    def report(self) -> Report:
        self.progress("starting it")
        begin = time.perf_counter()
        try:
            session = self.spec.open()
            self.capabilities = session.capabilities
        except (EnvironmentFailedError, SettingError) as error:
            self._find("it starts", str(error))
        else:
            self._find("it starts", passed=f"in {time.perf_counter() - begin:.2g} s")
            try:
                self._use(session)
            finally:
                self._closes(session)
        declared = [action.name for action in self.spec.domain.actions]
        return Report(
            self.spec.name, self.spec.kind.name, self.capabilities, tuple(self.findings),
            tuple(
                self.tallies[name]
                for name in declared
                if name in self.tallies and self.tallies[name].executions
            ),
            len(self.visited),
        )  # fmt: skip

    def _find(self, about: str, *faults: str, passed: str = "") -> None:
        if faults:
            self.findings.append(Finding(about, "fail", faults[:MAX_FAULTS]))
        else:
            self.findings.append(Finding(about, "pass", (passed,) if passed else ()))

    def _skip(self, about: str, *why: str) -> None:
        self.findings.append(Finding(about, "skip", why))

    # ------------------------------------------------------------------------------------ in use

    def _use(self, session: Session) -> None:
        self.progress("resetting it")
        first = self._first_state(session)
        if first is None:
            return
        self._given_state(session)
        tried = list(self._try_actions(session, first))
        if not self.tallies and not self.faults:
            self._find("its actions can be executed", f"none applies in {state_text(first)}")
            return
        total = sum(tally.executions for tally in self.tallies.values())
        for about in (
            "its actions can be executed", "it can be put into states that it reached",
            "`state()` is the state that the execution ended in",
        ):  # fmt: skip
            self._find(about, *self.faults.get(about, ()), passed=f"{total} executions")
        if self.absent:
            more = len(self.absent) - MAX_FAULTS
            self._skip(
                "everything was recorded", *list(self.absent)[:MAX_FAULTS],
                *([f"and {more} more"] if more > 0 else ()),
            )  # fmt: skip
        self._repeats(session, tried)

    def _first_state(self, session: Session) -> State | None:
        about = "it has a first state"
        try:
            first = session.reset(None, self.seed)
            again = session.state()
        except MenidError as error:
            self._find(about, str(error))
            return None
        if again != first:
            self._find(about, f"`reset` says {state_text(first)}; `state()` {state_text(again)}")
            return None
        self._find(about, passed=_short(first))
        return first

    def _given_state(self, session: Session) -> None:
        about = "it can be put into the problem's initial state"
        initial = self.attributor.semantics.initial_state
        try:
            session.reset(initial, self.seed)
        except CannotResetError as error:
            if session.capabilities.reset_to_any:
                self._find(about, str(error))
            else:
                self._skip(about, "it says that it can't be put into any state")
        except MenidError as error:
            self._find(about, str(error))
        else:
            self._find(about)

    def _try_actions(
        self, session: Session, first: State
    ) -> Iterator[tuple[State | None, GroundAction, int, Execution]]:
        """Execute every action in some states; what came of it.

        The state is None for the first one of an environment that can't be put into any.
        """
        anywhere = session.capabilities.reset_to_any
        waiting = [first]
        while waiting and len(self.visited) < self.most:
            state = waiting.pop(0)
            if state in self.visited:
                continue
            self.visited[state] = None
            try:
                applicable = self.attributor.semantics.applicable(state)
            except MenidError as error:
                self._fault("its actions can be executed", str(error))
                continue
            for action, _ in applicable:
                self.progress(f"executing {action}")
                tally = self.tallies.setdefault(action.action, Tally(action.action))
                for _ in range(self.executions):
                    start = state if anywhere else None
                    seed = next(self.seeds)
                    found = self._execute(session, start, action, seed, tally)
                    if found is not None:
                        if anywhere:
                            waiting.append(found.state)
                        yield start, action, seed, found

    def _execute(
        self, session: Session, start: State | None, action: GroundAction, seed: int, tally: Tally
    ) -> Execution | None:
        tally.executions += 1
        try:
            before = session.reset(start, seed)
        except MenidError as error:
            tally.failures += 1
            self._fault("it can be put into states that it reached", str(error))
            return None
        try:
            found = session.execute(action)
            after = session.state()
        except NotRecordedError:
            tally.executions -= 1
            self.absent[f"`{action}` in the state {_short(before)}"] = None
            return None
        except MenidError as error:
            tally.failures += 1
            self._fault("its actions can be executed", str(error))
            return None
        if after != found.state:
            self._fault(
                "`state()` is the state that the execution ended in",
                f"`{action}` ends in {state_text(found.state)}; `state()` is {state_text(after)}",
            )
        assert found.duration is not None
        tally.seconds += found.duration
        self._explain(tally, before, action, found)
        return found

    def _explain(self, tally: Tally, before: State, action: GroundAction, found: Execution) -> None:
        try:
            explanation = self.attributor.explain(before, action, found.state)
        except MeaningError as error:  # two rules cover a state that it came to by itself
            self._fault("its actions can be executed", str(error))
            return
        if explanation is None:
            tally.unexplained += 1
            return
        covering = self.attributor.covering(before, action)
        assert covering is not None
        # Outcomes that can't be told apart stand together.
        names = [
            outcome.name
            for outcome, weight in zip(covering.rule.outcomes, explanation.weights, strict=True)
            if weight > 0
        ]
        tally.outcomes[f"{covering.rule.name}.{'|'.join(names)}"] += 1

    def _repeats(
        self, session: Session, tried: list[tuple[State | None, GroundAction, int, Execution]]
    ) -> None:
        about = "with the same seed it does the same"
        if not session.capabilities.repeatable:
            self._skip(about, "it says that it does not")
            return
        faults = []
        # One for each action and state; the last first, so that the order is another one.
        distinct = {(state, action): (seed, found) for state, action, seed, found in tried}
        for (state, action), (seed, found) in reversed(distinct.items()):
            self.progress(f"repeating {action}")
            try:
                session.reset(state, seed)
                again = session.execute(action)
            except MenidError as error:
                faults.append(str(error))
                continue
            if again.state != found.state or again.reward != found.reward:
                faults.append(
                    f"`{action}` with seed {seed} once led to {_short(found.state)} "
                    f"(reward {found.reward}), then to {_short(again.state)} "
                    f"(reward {again.reward})"
                )
        self._find(about, *faults, passed=f"{len(distinct)} executions")

    def _closes(self, session: Session) -> None:
        self.progress("closing it")
        try:
            session.close()
            session.close()
        except Exception as error:  # an environment may raise anything
            self._find("it can be closed twice", f"{type(error).__name__}: {error}")
        else:
            self._find("it can be closed twice")

    def _fault(self, about: str, fault: str) -> None:
        faults = self.faults.setdefault(about, [])
        if fault not in faults:
            faults.append(fault)


def _short(state: State, width: int = 200) -> str:
    text = state_text(state)
    return text if len(text) <= width else f"{text[:width]}… ({len(state)} atoms)"
