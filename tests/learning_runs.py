"""Small runs of the learning loop for tests: scripted environments, and runs without a folder's CLI.

Scripts stand in this module, so that kinds can be pickled on their way to workers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import menid_plan
from menid_plan.environments.interface import (
    CannotResetError,
    Capabilities,
    EnvironmentFailedError,
    Execution,
)
from menid_plan.environments.registry import EnvironmentSpec, Place
from menid_plan.environments.runfile import Bound, WorkersTable
from menid_plan.environments.simulated import Simulated, SimulatedEnvironment
from menid_plan.experience.record import Experience
from menid_plan.experience.store import Store
from menid_plan.grounding.state import GroundAction, State
from menid_plan.learning.run import Run
from menid_plan.learning.settings import LearnSettings
from menid_plan.model.domain import Problem
from menid_plan.model.formulas import GroundAtom

# A goal two presses away. Levers of one kind, so that what is learned of one is not of the other.
LEVERS = """\
domain levers
type lever
environment bench : target
environment model : test
environment sketch : test
predicate ready
predicate done
predicate broken
action pull(l: lever) cost 1 {
  rule dry per l {
    when not ready and not broken
    outcomes bench model sketch {
      moves:  0.6 0.8 0.5  ready
      sticks: 0.3 0.2 0.5  nothing
      noise:  0.1 0.0 0.0
    }
  }
}
action finish cost 1 {
  rule ready {
    when ready and not broken
    outcomes bench model sketch {
      works:  0.9 0.9 0.9  done
      breaks: 0.1 0.1 0.1  broken
    }
  }
}
problem task for levers
object left, right: lever
goal done reward 10
discount 0.9
"""

DOCUMENT = menid_plan.parse(LEVERS)
assert DOCUMENT.domain is not None
assert DOCUMENT.problem is not None
DOMAIN, PROBLEM = DOCUMENT.domain, DOCUMENT.problem
ONE_LEVER = replace(PROBLEM, objects=PROBLEM.objects[:1])

READY, DONE, BROKEN = GroundAtom("ready"), GroundAtom("done"), GroundAtom("broken")
LEFT, RIGHT = GroundAction("pull", ("left",)), GroundAction("pull", ("right",))
FINISH = GroundAction("finish")
EMPTY: State = frozenset()


@dataclass(frozen=True)
class Scripted:
    """Gives outcomes by their names, in order, and notes in a file what is asked of it.

    ``script`` has for each execution, over all copies, what happens: ``moves``, ``sticks``, ``odd``
    (what no outcome describes), ``works``, ``breaks``, ``fail``, ``cannot-reset``, ``nan``,
    ``unknown``; the last one goes on for ever.
    """

    name: ClassVar[str] = "scripted"
    promise: ClassVar[str] = "does what is written"
    needs: ClassVar[str] = ""

    diary: str
    script: tuple[str, ...]
    duration: float = 1.0
    anywhere: bool = True
    repeatable: bool = True
    start: State = EMPTY
    reward: float | None = None

    def build(self, place: Place) -> ScriptedEnvironment:
        return ScriptedEnvironment(self, place.name)


class ScriptedEnvironment:
    def __init__(self, settings: Scripted, name: str) -> None:
        self.settings = settings
        self.name = name
        self.atoms = settings.start

    @property
    def capabilities(self) -> Capabilities:
        return Capabilities(self.settings.anywhere, self.settings.repeatable)

    def reset(self, state: State | None, seed: int) -> State:
        if self._next() == "cannot-reset":
            self._note("cannot-reset")
            raise CannotResetError("the door is locked")
        if state is None or not self.settings.anywhere:
            self._note("reset")
        self.atoms = self.settings.start if state is None else state
        return self.atoms

    def execute(self, action: GroundAction) -> Execution:
        what = self._next()
        self._note(f"{action} {what}")
        match what:
            case "moves":
                self.atoms |= {READY}
            case "works":
                self.atoms |= {DONE}
            case "breaks":
                self.atoms |= {BROKEN}
            case "odd":
                self.atoms |= {READY, BROKEN}
            case "fail":
                raise EnvironmentFailedError("the gripper is stuck")
            case "nan":
                return Execution(self.atoms, float("nan"), 1.0)
            case "unknown":
                return Execution(self.atoms | {GroundAtom("lost")}, None, 1.0)
        return Execution(self.atoms, self.settings.reward, self.settings.duration)

    def _lines(self) -> list[str]:
        path = Path(self.settings.diary)
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        return [line for line in lines if line.startswith(f"{self.name} ")]

    def _next(self) -> str:
        done = [line for line in self._lines() if not line.endswith(" reset")]
        script = self.settings.script
        return script[min(len(done), len(script) - 1)]

    def _note(self, text: str) -> None:
        with Path(self.settings.diary).open("a", encoding="utf-8") as file:
            file.write(f"{self.name} {text}\n")

    def state(self) -> State:
        return self.atoms

    def close(self) -> None:
        pass


@dataclass(frozen=True)
class Journey:
    """Execution n leads to the n-th state, whatever is done."""

    name: ClassVar[str] = "journey"
    promise: ClassVar[str] = "goes where it goes"
    needs: ClassVar[str] = ""

    states: tuple[State, ...]

    def build(self, place: Place) -> JourneyEnvironment:
        return JourneyEnvironment(self.states, frozenset(place.problem.init))


class JourneyEnvironment:
    capabilities = Capabilities(repeatable=False)

    def __init__(self, states: Sequence[State], first: State) -> None:
        self.coming, self.first = iter(states), first
        self.atoms = first

    def reset(self, state: State | None, seed: int) -> State:
        self.atoms = self.first if state is None else state
        return self.atoms

    def execute(self, action: GroundAction) -> Execution:
        self.atoms = next(self.coming)
        return Execution(self.atoms, None, 1.0)

    def state(self) -> State:
        return self.atoms

    def close(self) -> None:
        pass


@dataclass(frozen=True)
class Untouchable:
    """An environment that nobody may build."""

    name: ClassVar[str] = "untouchable"
    promise: ClassVar[str] = "is left alone"
    needs: ClassVar[str] = ""

    def build(self, place: Place) -> ScriptedEnvironment:
        raise AssertionError("it was to be left alone")


@dataclass(frozen=True)
class Counting:
    """A simulated environment that notes each execution in a file."""

    name: ClassVar[str] = "counting"
    promise: ClassVar[str] = "counts"
    needs: ClassVar[str] = ""

    diary: str
    duration: float = 1.0

    def build(self, place: Place) -> CountingEnvironment:
        return CountingEnvironment(Simulated(duration=self.duration).build(place), place.name, self)


class CountingEnvironment:
    def __init__(self, inner: SimulatedEnvironment, name: str, settings: Counting) -> None:
        self.inner, self.name, self.settings = inner, name, settings
        self.seed = 0
        self.capabilities = inner.capabilities
        self.state, self.close = inner.state, inner.close

    def reset(self, state: State | None, seed: int) -> State:
        self.seed = seed
        return self.inner.reset(state, seed)

    def execute(self, action: GroundAction) -> Execution:
        with Path(self.settings.diary).open("a", encoding="utf-8") as file:
            file.write(f"{self.name} {action} {self.seed}\n")
        return self.inner.execute(action)


def bound(
    target: Any,
    tests: Mapping[str, Any],
    durations: Mapping[str, float] | None = None,
    problem: Problem = PROBLEM,
    **more: Any,
) -> Bound:
    """The levers' environments: the target's kind and those of some tests."""
    times = durations or {}
    return Bound(
        DOMAIN,
        problem,
        EnvironmentSpec("bench", target, DOMAIN, problem, "target", duration=times.get("bench")),
        tuple(
            EnvironmentSpec(name, kind, DOMAIN, problem, duration=times.get(name), **more)
            for name, kind in tests.items()
        ),
    )


def run_of(folder: Path, environments: Bound, *, workers: int = 0, **options: Any) -> Run:
    """A run in a folder; options that are settings of the loop are taken as such."""
    others = {k: options.pop(k) for k in ("resume", "watch", "reported") if k in options}
    settings = LearnSettings(**{"solver": "value-iteration", "hours": None, **options})
    return Run(folder, environments, settings, WorkersTable(workers), **others)


def stored(folder: Path) -> list[Experience]:
    """What a store holds, without the times at which executions ended."""
    with Store.read(folder / "experiences.sqlite") as store:
        return [replace(experience, when=0.0) for experience in store]


def told(experiences: Sequence[Experience]) -> list[str]:
    """Experiences in short, as `Scripted` writes them but for the outcome, which is explained."""
    lines = []
    for each in experiences:
        assert each.explanation is not None
        names = (
            ["moves", "sticks", "noise"] if each.action != FINISH else ["works", "breaks", "noise"]
        )
        shares = zip(names, each.explanation.weights, strict=True)
        (outcome,) = [name for name, weight in shares if weight == 1.0]
        lines.append(f"{each.environment} {each.action} {outcome}")
    return lines
