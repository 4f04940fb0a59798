"""What `solve` and `simulate` share: options, progress on standard error, work that can be stopped."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import click

from menid_plan.cli.common import existing_file, setting_option
from menid_plan.errors import LimitError

if TYPE_CHECKING:
    from menid_plan.planning import Task
    from menid_plan.solving import Objective, Solution, Solver

OBJECTIVES = ("reward", "goal-then-reward", "goal-probability", "steps")

_Command = TypeVar("_Command", bound=Callable[..., Any])


def _finite(
    _context: click.Context, _parameter: click.Parameter, value: float | None
) -> float | None:
    if value is not None and not math.isfinite(value):
        raise click.BadParameter(f"{value} is not a finite number")
    return value


def task_options(function: _Command) -> _Command:
    """DOMAIN PROBLEM, and the options of which task it is and how it is solved."""
    positive = click.FloatRange(0, min_open=True)
    for decorate in (
        click.option("--max-states", type=click.IntRange(1), default=50_000_000, show_default=True,
                     help="Stop where more states than that can be reached."),
        click.option("--max-seconds", type=positive, callback=_finite, metavar="S",
                     help="Stop solving after so many seconds."),
        click.option("--max-iterations", type=click.IntRange(1), metavar="N",
                     help="Stop solving after so many iterations of the solver."),
        click.option("--epsilon", type=positive, callback=_finite, show_default="1e-6",
                     help="How far apart the bounds may be."),
        click.option("--objective", type=click.Choice(OBJECTIVES),
                     help="What is best; by default as the problem has it."),
        click.option("--noise", type=click.Choice(["stay", "sink"]), show_default="stay",
                     help="Where the noise outcome leads: nowhere, or to an absorbing state."),
        setting_option,
        click.option("--env", "environment", metavar="NAME",
                     help="The environment; by default the target."),
        click.argument("files", nargs=-1, required=True, type=existing_file,
                       metavar="DOMAIN PROBLEM"),
    ):  # fmt: skip
        function = decorate(function)
    return function


class Display:
    """Tells on standard error how far the work is.

    On a terminal that is one line which is written anew, and cleared in the end; elsewhere a line
    every few seconds, if it takes that long.
    """

    FIRST = 5.0
    EVERY = 5.0

    def __init__(self) -> None:
        self.terminal = sys.stderr is not None and sys.stderr.isatty()
        self.found = "nothing was explored"
        self._begin = time.perf_counter()
        self._next = self._begin + (0.2 if self.terminal else self.FIRST)
        self._shown = False

    def __enter__(self) -> Display:
        return self

    def __exit__(self, *_: object) -> None:
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

    def _tell(self, text: str) -> None:
        now = time.perf_counter()
        if now < self._next:
            return
        text = f"{text}, {now - self._begin:.1f} s"
        if self.terminal:
            self._shown = True
            self._next = now + 0.1
            print(f"\r\x1b[K{text[:79]}", end="", file=sys.stderr, flush=True)
        else:
            self._next = now + self.EVERY
            click.echo(text, err=True)


def build(task: Task, display: Display) -> None:
    """Ground and explore; LimitError says how far it came if it is interrupted."""
    try:
        with display:
            task.build(display.exploring)
    except KeyboardInterrupt:
        raise LimitError(f"interrupted while exploring: {display.found}") from None


def solve(task: Task, solver: Solver, objective: Objective | None, display: Display) -> Solution:
    """Solve; if it is interrupted the solution is what is known by then."""
    begin = time.perf_counter()
    try:
        with display:
            return task.solve(solver, objective, display.solving)
    except KeyboardInterrupt:  # a solver that can say more catches it itself
        import numpy as np

        from menid_plan.solving import Solution

        states = task.mdp.states
        return Solution(
            "limit", objective or task.objective, task.mdp.initial, np.full(states, -np.inf),
            np.full(states, np.inf), np.full(states, -1, np.int32), 0,
            time.perf_counter() - begin, message="interrupted before anything was known",
        )  # fmt: skip
