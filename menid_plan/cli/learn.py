"""`menid learn`: learn how often outcomes happen, by acting in several environments."""

from __future__ import annotations

import json
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from menid_plan.cli.common import (
    distinct_outputs,
    existing_file,
    json_option,
    load_both,
    setting_option,
)
from menid_plan.cli.tasks import tell_written
from menid_plan.files import replace_file
from menid_plan.interrupts import Interrupts
from menid_plan.learning.clock import clock_text

if TYPE_CHECKING:
    from collections.abc import Iterator

    from menid_plan.learning.counts import Evidence
    from menid_plan.learning.curve import Point
    from menid_plan.learning.run import Run

# Rules of which it is told what was learned.
_SHOWN = 10


@click.command("learn")
@click.argument("files", nargs=-1, required=True, type=existing_file, metavar="DOMAIN PROBLEM")
@click.option(
    "--run", "run_file", required=True, type=existing_file, metavar="FILE.toml",
    help="Which environments there are, and the settings of the run.",
)  # fmt: skip
@click.option(
    "-o", "--output", required=True, type=click.Path(file_okay=False, path_type=Path),
    metavar="RUNDIR", help="The folder that keeps the run.",
)  # fmt: skip
@click.option("--resume", is_flag=True, help="Go on with the run that is in RUNDIR.")
@setting_option
@click.option("--seed", type=click.IntRange(0), help="Everything random comes from it.")
@click.option("--test-time", type=click.FloatRange(0), metavar="T",
              help="Seconds for which an action is tested; 0 never tests.")  # fmt: skip
@click.option(
    "--allocate", type=click.Choice(["paper", "cheapest-first", "gain", "target-only"]),
    help="Where to act next; cheapest-first unless it is said.",
)  # fmt: skip
@click.option("--estimator", metavar="NAME", help="How counts of several environments are merged.")
@click.option("--m", type=click.FloatRange(0), help="The weight m of decreasing-m.")
@click.option("--solver", metavar="NAME", help="What chooses actions; thompson unless it is said.")
@click.option("--steps", type=click.IntRange(0), help="End after so many executions in the target.")
@click.option("--episodes", type=click.IntRange(0), help="End after so many episodes.")
@click.option("--hours", type=click.FloatRange(0), help="End after so many hours of the clock.")
@click.option("--workers", type=click.IntRange(0, 1024), metavar="N",
              help="Worker processes; 0 executes everything in this one.")  # fmt: skip
@click.option(
    "--curve", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE.png",
    help="Draw the learning curve when the run ends.",
)  # fmt: skip
@json_option
@click.pass_context
def command(
    ctx: click.Context,
    /,
    files: tuple[str, ...],
    run_file: str,
    output: Path,
    resume: bool,
    settings: dict[str, float],
    m: float | None,
    workers: int | None,
    curve: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Learn how often outcomes happen, acting in the target and testing elsewhere.

    RUNDIR gets the store experiences.sqlite, settings.json, events.jsonl, curve.csv and the domain
    with what was learned, learned.menid. Ctrl-C ends a run, which --resume goes on with; so does
    a run that was killed, and nothing is executed twice.
    """
    domain, problem = load_both(files)
    if curve is not None:
        from menid_plan import charts

        distinct_outputs([*files, run_file], curve)
        if curve.suffix.lower() != ".png":
            raise click.UsageError(f"--curve: {curve}: the file's ending must be .png")
        charts.require()
    from menid_plan.environments.printing import prints_to_stderr
    from menid_plan.environments.runfile import RunFileError, read_run_file
    from menid_plan.environments.settings import SettingError
    from menid_plan.learning.run import Run
    from menid_plan.learning.settings import LearnSettings

    read = read_run_file(run_file, {"learn": LearnSettings})
    learn = read.sections["learn"]
    assert isinstance(learn, LearnSettings)
    given = {key: value for key, value in options.items() if value is not None}
    if given.keys() & {"steps", "episodes", "hours"}:
        given = {"steps": None, "episodes": None, "hours": None, **given}
    if m is not None:
        given["estimator_options"] = {**learn.estimator_options, "m": m}
    table = read.workers if workers is None else replace(read.workers, number=workers)
    view = _View()
    interrupted = False
    interrupts = Interrupts()
    with prints_to_stderr(), interrupts:
        try:
            with interrupts.allowed():
                run = Run(
                    output, read.bind(domain, problem, settings), replace(learn, **given), table,
                    params=settings, resume=resume, watch=view.point, underway=view.point,
                    reported=view.reported, interrupts=interrupts,
                )  # fmt: skip
        except SettingError as error:
            if error.file:
                raise
            key = error.key if error.key.startswith("learn") else f"learn.{error.key}"
            raise RunFileError(run_file, [f"{key}: {error.message}"]) from error
        try:
            with view.shown(run):
                run.learn()
        except KeyboardInterrupt:
            interrupted = True
    if as_json:
        click.echo(json.dumps(_result(run), indent=2))
    else:
        _show(_result(run), run)
    if curve is not None:
        from menid_plan.learning.curve import curve_png

        replace_file(curve, curve_png(run.folder / "curve.csv"))
        tell_written([curve], err=as_json)
    if interrupted:
        click.echo("interrupted; --resume goes on with this run", err=True)
        ctx.exit(6)


def _result(run: Run) -> dict[str, Any]:
    """What came of a run, for JSON."""
    progress = run.loop.progress
    action, value, goal = run.best()
    return {
        "seconds": run.loop.clock.seconds,
        "reward": progress.reward,
        "steps": progress.steps,
        "episodes": progress.episodes,
        "successes": progress.successes,
        "unexplained": progress.unexplained,
        "environments": {
            spec.name: {
                "role": spec.role,
                "executions": progress.executions[spec.name],
                "seconds": progress.spent.get(spec.name, 0.0),
                "failed": run.failed.get(spec.name, 0),
            }
            for spec in run.bound.environments
        },
        "action": None if action is None else str(action),
        "value": value,
        "objective": run.planner.objective,
        "goal_probability": goal,
    }


def _show(result: dict[str, Any], run: Run) -> None:
    reached = ""
    if run.bound.problem.goal is not None:
        reached = f", {result['successes']} of them to the goal"
    click.echo(
        f"{_counted(result['steps'], 'step')} in {_counted(result['episodes'], 'episode')}{reached}; "
        f"reward {result['reward']:.6g} in {clock_text(result['seconds'])}"
    )
    for name, each in result["environments"].items():
        failed = f", {_counted(each['failed'], 'attempt')} failed" if each["failed"] else ""
        click.echo(
            f"  {name} ({each['role']}): {_counted(each['executions'], 'execution')}, "
            f"{clock_text(each['seconds'])}{failed}"
        )
    if result["unexplained"]:
        click.echo(f"  {_counted(result['unexplained'], 'execution')} that no rule explains")
    _show_learned(run.evidence)
    goal = ""
    # The reward of what reaches the goal as often as can be says little where that is not for sure.
    if result["objective"] == "goal-then-reward" and result["goal_probability"] is not None:
        goal = f", goal probability {result['goal_probability']:.6g}"
    click.echo(
        f"best first action by what was learned: {result['action'] or 'none'}, "
        f"{result['objective']} {result['value']:.6g}{goal}"
    )
    click.echo(f"wrote {run.folder / 'learned.menid'}")


def _show_learned(evidence: Evidence) -> None:
    """What was learned of the rules that were executed in the target, the most executed first."""
    tried = [key for key in evidence.keys if evidence.counts(key)[0].any()]
    tried.sort(key=lambda key: -evidence.counts(key)[0].sum())
    if tried:
        click.echo(f"learned of what was executed in {evidence.environments[0]}:")
    for key in tried[:_SHOWN]:
        names = [outcome.name for outcome in evidence.rule(key).outcomes]
        estimate = zip(names, evidence.answer(key).tolist(), strict=True)
        counts = zip(evidence.environments, evidence.counts(key).sum(axis=1).tolist(), strict=True)
        click.echo(
            f"  {key}: {', '.join(f'{name} {round(p, 3):g}' for name, p in estimate)} "
            f"(seen: {', '.join(f'{name} {n:.6g}' for name, n in counts)})"
        )
    if len(tried) > _SHOWN:
        click.echo(f"  and of {len(tried) - _SHOWN} more: `menid estimate` shows all")


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _which(run: Run) -> str:
    """Which clock it is, where that is not the one on the wall."""
    return " on the virtual clock" if run.settings.clock == "virtual" else ""


class _View:
    """Tells how a run goes: a table that is drawn anew on a terminal, else a line now and then."""

    # Seconds from one line to the next.
    EVERY = 5.0
    LEAST_SURE = 5
    # On a terminal of fewer columns than that, some of the table's are left out.
    WIDE = 60
    # Failures that are told; the rest is in events.jsonl.
    FAILURES = 10

    def __init__(self) -> None:
        self._run: Run | None = None
        self._live: Any = None
        self._next = time.monotonic() + self.EVERY
        self._failures = 0

    @contextmanager
    def shown(self, run: Run) -> Iterator[None]:
        """While the run goes on."""
        self._run = run
        if sys.stderr is None or not sys.stderr.isatty():
            yield
            return
        from rich.console import Console
        from rich.live import Live

        self._next = 0.0
        console = Console(stderr=True)
        with Live(console=console, transient=True, auto_refresh=False) as self._live:
            yield
        self._live = None

    def reported(self, message: str) -> None:
        """An execution failed."""
        self._failures += 1
        if self._failures > self.FAILURES:
            return
        if self._failures == self.FAILURES:
            message += "\n(further failures are told in events.jsonl only)"
        if self._live is not None:
            self._live.console.print(message, markup=False, highlight=False)
        else:
            click.echo(message, err=True)

    def point(self, point: Point) -> None:
        """A point of the curve."""
        now = time.monotonic()
        if now < self._next or self._run is None:
            return
        if self._live is not None:
            self._next = now + 0.2
            self._live.update(self._table(self._run, point, self._live.console.width), refresh=True)
            return
        self._next = now + self.EVERY
        executions = self._run.loop.progress.executions
        done = ", ".join(
            f"{spec.name} {executions[spec.name]}" for spec in self._run.bound.environments
        )
        click.echo(
            f"{clock_text(point.seconds)}{_which(self._run)}: reward {point.reward:.6g}, "
            f"{_counted(point.steps, 'step')}, {_counted(point.episodes, 'episode')}; "
            f"executions: {done}",
            err=True,
        )

    def _table(self, run: Run, point: Point, width: int) -> Any:
        from rich.console import Group
        from rich.table import Table
        from rich.text import Text

        progress = run.loop.progress
        again = "" if run.loop.executions.replay.over else "  (going through what was done before)"
        head = (
            f"{clock_text(point.seconds)}{_which(run)}  reward {point.reward:.6g}  "
            f"{_counted(point.steps, 'step')}  "
            f"{_counted(point.episodes, 'episode')}{again}"
        )
        columns = {
            "environment": [spec.name for spec in run.bound.environments],
            "role": [spec.role for spec in run.bound.environments],
            "executions": [str(progress.executions[s.name]) for s in run.bound.environments],
            "time": [clock_text(progress.spent.get(s.name, 0.0)) for s in run.bound.environments],
            "failed": [str(run.failed.get(spec.name, 0)) for spec in run.bound.environments],
        }
        if width < self.WIDE:
            del columns["role"]
            if not any(run.failed.values()):
                del columns["failed"]
            if width < self.WIDE * 3 // 4:
                columns["done"] = columns.pop("executions")
        where = Table(box=None)
        for name in columns:
            where.add_column(name, overflow="fold", no_wrap=name != "environment")
        for row in zip(*columns.values(), strict=True):
            where.add_row(*row)
        unsure = Table(box=None)
        unsure.add_column("least sure in the target", overflow="fold")
        unsure.add_column("delta", no_wrap=True)
        for key, error in run.loop.least_sure(self.LEAST_SURE):
            unsure.add_row(Text(str(key)), f"{error:.3f}")
        return Group(Text(head), where, unsure)
