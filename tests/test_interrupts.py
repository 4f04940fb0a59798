"""Signals: raised where nothing is left half done, and never lost."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import pytest

from learning_runs import Scripted, ScriptedEnvironment, bound, run_of, stored
from menid_plan.environments.interface import Execution
from menid_plan.environments.registry import Place
from menid_plan.grounding.state import GroundAction
from menid_plan.interrupts import Interrupts

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals")


@pytest.fixture(autouse=True)
def usual_handlers() -> Iterator[None]:
    """Whatever runs the tests may have its own."""
    usual = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
    before = {each: signal.signal(each, handler) for each, handler in usual.items()}
    yield
    for each, handler in before.items():
        signal.signal(each, handler)


@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM])
def test_the_first_waits_for_a_check_and_the_second_does_not(kind: signal.Signals) -> None:
    before = signal.getsignal(kind)
    with Interrupts() as interrupts:
        interrupts.check()
        signal.raise_signal(kind)
        with pytest.raises(KeyboardInterrupt):
            interrupts.check()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(kind)
    assert signal.getsignal(kind) is before


def test_where_they_are_allowed_they_come_at_once() -> None:
    with Interrupts() as interrupts:
        with interrupts.allowed():
            with interrupts.allowed():
                pass
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
        # One that was lost on its way is raised at the next place.
        with pytest.raises(KeyboardInterrupt), interrupts.allowed():
            raise AssertionError


def test_entered_again_within() -> None:
    interrupts = Interrupts()
    with interrupts:
        with interrupts:
            pass
        signal.raise_signal(signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt):
            interrupts.check()
    assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_handlers_of_the_program_stay() -> None:
    seen = []
    signal.signal(signal.SIGTERM, lambda *_: seen.append("mine"))
    with Interrupts() as interrupts:
        signal.raise_signal(signal.SIGTERM)
        interrupts.check()
    assert seen == ["mine"]


def test_other_threads_change_nothing() -> None:
    faults = []

    def enter() -> None:
        try:
            with Interrupts() as interrupts:
                assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
                interrupts.check()
        except BaseException as error:
            faults.append(error)

    thread = threading.Thread(target=enter)
    thread.start()
    thread.join()
    assert not faults


@dataclass(frozen=True)
class Deaf(Scripted):
    """Gets a signal within its third execution, and clears whatever that raises."""

    name: ClassVar[str] = "deaf"

    def build(self, place: Place) -> DeafEnvironment:
        return DeafEnvironment(self, place.name)


class DeafEnvironment(ScriptedEnvironment):
    def execute(self, action: GroundAction) -> Execution:
        if sum(not line.endswith(" reset") for line in self._lines()) == 2:
            with suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGTERM)
        return super().execute(action)


@pytest.mark.parametrize("repeatable", [True, False])
def test_a_run_notices_a_signal_that_was_lost(tmp_path: Path, *, repeatable: bool) -> None:
    diary = str(tmp_path / "diary")
    target: Any = Deaf(diary, ("sticks",), repeatable=repeatable)
    run = run_of(tmp_path / "run", bound(target, {}), steps=10, test_time=0)
    with pytest.raises(KeyboardInterrupt):
        run.learn()
    assert run.loop.progress.steps == 3  # what was under way is not lost
    assert len(stored(tmp_path / "run")) == 3
    assert (tmp_path / "run" / "learned.menid").exists()
