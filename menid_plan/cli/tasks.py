"""What `solve`, `simulate` and `ground` share: options, progress, work that can be stopped, numbers."""

from __future__ import annotations

import functools
import math
import sys
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import click

from menid_plan.cli.common import existing_file, setting_option
from menid_plan.errors import LimitError
from menid_plan.interrupts import Interrupts

if TYPE_CHECKING:
    from menid_plan.grounding.semantics import Noise
    from menid_plan.model.domain import Domain, Problem
    from menid_plan.planning import Task
    from menid_plan.solving import Objective, Solution, Solver

FILES = "[DOMAIN] PROBLEM"

OBJECTIVES = ("reward", "goal-then-reward", "goal-probability", "steps")

_Command = TypeVar("_Command", bound=Callable[..., Any])


def finite(
    _context: click.Context, _parameter: click.Parameter, value: float | None
) -> float | None:
    """See that the value of an option is finite."""
    if value is not None and not math.isfinite(value):
        raise click.BadParameter(f"{value} is not a finite number")
    return value


def _pairs(
    _context: click.Context, _parameter: click.Parameter, values: tuple[str, ...]
) -> dict[str, str]:
    found = {}
    for text in values:
        name, equals, value = text.partition("=")
        if not (name.strip() and equals):
            raise click.BadParameter(f"`{text}` is not of the form NAME=VALUE")
        if name.strip() in found:
            raise click.BadParameter(f"`{name.strip()}` is set twice")
        found[name.strip()] = value.strip()
    return found


@dataclass(frozen=True, slots=True)
class TaskOptions:
    """Which task it is, beside its domain and problem; None stands for what is usual."""

    environment: str | None
    settings: dict[str, float]
    noise: Noise | None
    max_states: int

    def task(self, domain: Domain, problem: Problem) -> Task:
        """The task of a domain and a problem."""
        from menid_plan.planning import Task

        noise = self.noise or "stay"
        return Task(domain, problem, self.environment, self.settings, noise, self.max_states)


@dataclass(frozen=True, slots=True)
class SolvingOptions:
    """What is best, and how it is found; ``written`` are the solver's options by --option."""

    objective: Objective | None
    epsilon: float | None
    max_iterations: int | None
    max_seconds: float | None
    written: dict[str, str]

    @property
    def common(self) -> dict[str, Any]:
        """The options that every solver has."""
        names = ("epsilon", "max_iterations", "max_seconds")
        return {name: getattr(self, name) for name in names}

    def of_solver(self, name: str) -> dict[str, Any]:
        """The options of a solver, None where they are not given; see `solver_options`."""
        return solver_options(name, self.written, **self.common)


def files_argument(function: _Command) -> _Command:
    """The argument DOMAIN PROBLEM."""
    argument = click.argument("files", nargs=-1, required=True, type=existing_file, metavar=FILES)
    return argument(function)


def task_options(function: _Command) -> _Command:
    """DOMAIN PROBLEM, and options that the command gets as ``which``, TaskOptions."""
    return gathered(
        function, "which", TaskOptions,
        files_argument,
        click.option("--env", "environment", metavar="NAME",
                     help="The environment; by default the target."),
        setting_option,
        click.option("--noise", type=click.Choice(["stay", "sink"]), show_default="stay",
                     help="Where the noise outcome leads: nowhere, or to an absorbing state."),
        click.option("--max-states", type=click.IntRange(1), default=50_000_000, show_default=True,
                     metavar="N",
                     help="Stop where more states than that can be reached. They are counted after "
                     "every stretch of some thousand, so that a few more may have been found by "
                     "then."),
    )  # fmt: skip


def solving_options(function: _Command) -> _Command:
    """Options that the command gets as ``how``, SolvingOptions."""
    positive = click.FloatRange(0, min_open=True)
    return gathered(
        function, "how", SolvingOptions,
        click.option("--objective", type=click.Choice(OBJECTIVES),
                     help="What is best; by default as the problem has it."),
        click.option("--epsilon", type=positive, callback=finite, show_default="1e-6",
                     help="How far apart the bounds may be."),
        click.option("--max-iterations", type=click.IntRange(1), metavar="N",
                     help="Stop solving after so many iterations of the solver."),
        click.option("--max-seconds", type=positive, callback=finite, metavar="S",
                     help="Stop solving after so many seconds."),
        click.option("--option", "written", multiple=True, callback=_pairs, metavar="NAME=VALUE",
                     help="Set an option of the solver, as `menid solvers` lists them; may be given "
                     "more than once."),
    )  # fmt: skip


def gathered(function: _Command, name: str, kind: type, *options: Callable[[Any], Any]) -> _Command:
    """A command with these options, of which it gets those that are fields of ``kind`` in one."""

    @functools.wraps(function)
    def gathering(*arguments: Any, **given: Any) -> Any:
        made = kind(**{field.name: given.pop(field.name) for field in fields(kind)})
        return function(*arguments, **given, **{name: made})

    command: Any = gathering
    for option in reversed(options):
        command = option(command)
    return cast("_Command", command)


def solver_options(name: str, written: dict[str, str], **common: Any) -> dict[str, Any]:
    """The options of a solver: ``common`` are those of the command (None: not given).

    ``written`` are those of --option; OptionError if the solver has none of that name, or one for
    another kind of value.
    """
    from menid_plan.planning import OptionError
    from menid_plan.solving import load_solver

    if not written:
        return common
    kind = load_solver(name)
    known: list[str] = [f.name for f in fields(kind) if f.init] if is_dataclass(kind) else []
    try:
        kinds = get_type_hints(kind)
    except NameError:  # types that a package imports for its type checker alone
        kinds = {}
    for key, text in written.items():
        field = key.replace("-", "_")
        if field not in known:
            raise OptionError(
                f"the solver `{name}` has no option `{key}`; its options: "
                + (", ".join(known) or "none")
            )
        if common.get(field) is not None:
            raise OptionError(f"`{key}` is set twice, by --option and by --{key.replace('_', '-')}")
        try:
            common[field] = _read_value(text, kinds.get(field))
        except ValueError as error:
            raise OptionError(f"the solver `{name}`, option `{key}`: {error}") from None
    return common


def _read_value(text: str, hint: Any) -> Any:
    """The value of an option by its type: of a union, the first that fits."""
    readers: dict[type, Callable[[str], Any]] = {bool: _truth, int: int, float: _number, str: str}
    names = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
    union = get_origin(hint) in (Union, UnionType)
    kinds = [kind for kind in readers if kind in (get_args(hint) if union else (hint,))]
    for kind in kinds:
        try:
            return readers[kind](text)
        except ValueError:
            continue
    wanted = " or ".join(names[kind] for kind in kinds) or "nothing that can be written on the line"
    raise ValueError(f"`{text}` is not what it takes, which is {wanted}")


def _truth(text: str) -> bool:
    if text.lower() not in ("true", "false"):
        raise ValueError(text)
    return text.lower() == "true"


def _number(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(text)
    return number


def number_text(value: float, form: str = "") -> str:
    """A number that may be infinite, or (as NaN) not known."""
    return "not known" if math.isnan(value) else format(value, form)


def number_json(value: float) -> float | None:
    """The same for JSON, which has no infinite numbers: the status tells which one it is."""
    return value if math.isfinite(value) else None


def tell_written(paths: Iterable[Path], *, err: bool) -> None:
    """Say which files were written; on standard error (``err``) if the output is JSON."""
    for path in paths:
        click.echo(f"wrote {path}", err=err)


class Display:
    """Tells on standard error how far the work is.

    On a terminal that is one line which is written anew, even while nothing new is known (kernels
    are compiled, a sweep is long), and cleared in the end; elsewhere a line every few seconds, if it
    takes that long.
    """

    FIRST = 5.0
    EVERY = 5.0
    STILL = 0.5  # on a terminal: after so long without news the time is written anew

    def __init__(self) -> None:
        self.terminal = sys.stderr is not None and sys.stderr.isatty()
        self.found = "nothing was explored"
        self._begin = time.perf_counter()
        self._next = self._begin + (0.2 if self.terminal else self.FIRST)
        self._shown = False
        self._text = ""
        self._line = threading.Lock()
        self._ended = threading.Event()
        self._ticker: threading.Thread | None = None

    def during(self, stage: str) -> Display:
        """To be entered: what is shown on a terminal until more is known."""
        self._text = stage
        return self

    def __enter__(self) -> Display:
        if self.terminal:
            self._ended.clear()
            self._ticker = threading.Thread(target=self._tick, daemon=True)
            self._ticker.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._ticker is not None:
            self._ended.set()
            self._ticker.join()
            self._ticker = None
        if self._shown:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
            self._shown = False

    def exploring(self, states: int, expanded: int, transitions: int) -> None:
        """The progress of a search for states."""
        self.found = f"{states} states found, {expanded} expanded, {transitions} transitions"
        self._tell(f"exploring: {self.found}")

    def solving(self, iterations: int, lower: float, upper: float) -> None:
        """The progress of a solver."""
        bounds = ""
        if math.isfinite(lower) or math.isfinite(upper):
            bounds = f", value between {lower:.6g} and {upper:.6g}"
        self._tell(f"solving: {iterations} iterations{bounds}")

    def simulating(self, steps: int, running: int) -> None:
        """The progress of episodes that are drawn side by side."""
        self._tell(f"simulating: {steps} steps, {running} episodes go on")

    def _tell(self, text: str) -> None:
        now = time.perf_counter()
        self._text = text
        if now < self._next:
            return
        if self.terminal:
            self._write(now)
        else:
            self._next = now + self.EVERY
            click.echo(self._timed(now), err=True)

    def _tick(self) -> None:
        while not self._ended.wait(self.STILL):
            now = time.perf_counter()
            if self._text and now > self._next + self.STILL:
                self._write(now)

    def _write(self, now: float) -> None:
        with self._line:
            self._shown = True
            self._next = now + 0.1
            print(f"\r\x1b[K{self._timed(now)[:79]}", end="", file=sys.stderr, flush=True)

    def _timed(self, now: float) -> str:
        return f"{self._text}, {now - self._begin:.1f} s"


def explore(task: Task, display: Display) -> None:
    """Ground and explore; LimitError says how far it came if it is interrupted."""
    interrupts = Interrupts()

    def told(*found: int) -> None:
        display.exploring(*found)
        interrupts.check()

    try:
        # Nothing is kept of what is under way, so that it may break off anywhere.
        with interrupts, display.during("grounding"), interrupts.allowed():
            task.explore(told)
    except KeyboardInterrupt:
        raise LimitError(f"interrupted while exploring: {display.found}") from None


def solve(task: Task, solver: Solver, objective: Objective | None, display: Display) -> Solution:
    """Solve; if it is interrupted the solution is what is known by then.

    Where the best value is -inf the status is ``infeasible``, as it is for endless ``steps``.
    """
    begin = time.perf_counter()
    interrupts = Interrupts()

    def told(iterations: int, lower: float, upper: float) -> None:
        display.solving(iterations, lower, upper)
        interrupts.check()

    try:
        with interrupts, display.during("solving"):
            solution = task.solve(solver, objective, told)
    except KeyboardInterrupt:  # a solver that can say more catches it itself
        import numpy as np

        from menid_plan.solving import Solution

        states = task.mdp.states
        return Solution(
            "limit", objective or task.objective, task.mdp.initial, np.full(states, -np.inf),
            np.full(states, np.inf), np.full(states, -1, np.int32), 0,
            time.perf_counter() - begin, message="interrupted before anything was known",
        )  # fmt: skip
    if solution.status == "solved" and float(solution.upper[solution.initial]) == -math.inf:
        # All policies are as bad, so that none was found: that is no answer to go by.
        why = "every policy loses rewards for ever: the sum has no lower bound"
        return replace(solution, status="infeasible", message=why)
    return solution
