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

from menid_plan.cli.common import existing_file, json_option, load_both, setting_option

if TYPE_CHECKING:
    from collections.abc import Iterator

    from menid_plan.learning.loop import Point
    from menid_plan.learning.run import Run


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
@click.option("--estimator", metavar="NAME", help="How counts of several environments are merged.")
@click.option("--solver", metavar="NAME", help="What chooses actions; thompson unless it is said.")
@click.option("--steps", type=click.IntRange(0), help="End after so many executions in the target.")
@click.option("--episodes", type=click.IntRange(0), help="End after so many episodes.")
@click.option("--hours", type=click.FloatRange(0), help="End after so many hours of the clock.")
@click.option("--workers", type=click.IntRange(0), metavar="N",
              help="Worker processes; 0 executes everything in this one.")  # fmt: skip
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
    workers: int | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Learn how often outcomes happen, acting in the target and testing elsewhere.

    RUNDIR gets the store experiences.sqlite, settings.json, events.jsonl, curve.csv and the domain
    with what was learned, learned.menid. Ctrl-C ends a run, which --resume goes on with; so does
    a run that was killed, and nothing is executed twice.
    """
    domain, problem = load_both(files)
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
    try:
        learn = replace(learn, **given)
    except SettingError as error:
        raise RunFileError(run_file, [f"learn.{error}"]) from error
    table = read.workers if workers is None else replace(read.workers, number=workers)
    bound = read.bind(domain, problem, settings)
    view = _View()
    run = Run(
        output, bound, learn, table, params=settings, resume=resume, watch=view.point,
        failed=view.failed,
    )  # fmt: skip
    view.run = run
    interrupted = False
    try:
        with view.shown():
            run.learn()
    except KeyboardInterrupt:
        interrupted = True
    result = _result(run)
    if as_json:
        click.echo(json.dumps(result, indent=2))
    else:
        _show(result, run)
    if interrupted:
        click.echo("interrupted; --resume goes on with this run", err=True)
        ctx.exit(6)


def _result(run: Run) -> dict[str, Any]:
    """What came of a run, for JSON."""
    progress = run.loop.progress
    best = _best(run)
    return {
        "seconds": run.loop.seconds,
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
                "failed": progress.failed[spec.name],
            }
            for spec in run.bound.environments
        },
        **best,
    }


def _best(run: Run) -> dict[str, Any]:
    """The best first action by what was learned, and what it is worth."""
    action, value = run.planner.best()
    return {
        "action": None if action is None else str(action),
        "value": value,
        "objective": run.planner.objective,
    }


def _show(result: dict[str, Any], run: Run) -> None:
    click.echo(
        f"{result['steps']} steps, {result['episodes']} episodes of which {result['successes']} "
        f"came to the goal, reward {result['reward']:.6g} in {_clock(result['seconds'])}"
    )
    for name, each in result["environments"].items():
        failed = f", {each['failed']} failed" if each["failed"] else ""
        click.echo(
            f"  {name} ({each['role']}): {each['executions']} executions, "
            f"{_clock(each['seconds'])}{failed}"
        )
    if result["unexplained"]:
        click.echo(f"  {result['unexplained']} executions that no rule explains")
    value = result["value"]
    click.echo(
        f"best first action by what was learned: {result['action'] or 'none'}, "
        f"{result['objective']} {value:.6g}"
    )
    click.echo(f"wrote {run.folder / 'learned.menid'}")


def _clock(seconds: float) -> str:
    hours, rest = divmod(round(seconds), 3600)
    minutes, rest = divmod(rest, 60)
    return f"{hours}:{minutes:02}:{rest:02}"


class _View:
    """Tells how a run goes: a table that is drawn anew on a terminal, else a line now and then."""

    EVERY = 5.0
    LEAST_SURE = 5

    def __init__(self) -> None:
        self.run: Run | None = None
        self._live: Any = None
        self._next = time.monotonic() + 1.0

    @contextmanager
    def shown(self) -> Iterator[None]:
        """While the run goes on."""
        if sys.stderr is None or not sys.stderr.isatty():
            yield
            return
        from rich.console import Console
        from rich.live import Live

        console = Console(stderr=True)
        with Live(console=console, transient=True, auto_refresh=False) as self._live:
            yield

    def failed(self, message: str) -> None:
        """An execution failed."""
        if self._live is not None:
            self._live.console.print(message, markup=False, highlight=False)
        else:
            click.echo(message, err=True)

    def point(self, point: Point) -> None:
        """A point of the curve."""
        now = time.monotonic()
        if now < self._next or self.run is None:
            return
        if self._live is not None:
            self._next = now + 0.2
            self._live.update(self._table(point), refresh=True)
            return
        self._next = now + self.EVERY
        spent = ", ".join(
            f"{name} {number}" for name, number in self.run.loop.progress.executions.items()
        )
        click.echo(
            f"{_clock(point.seconds)}: reward {point.reward:.6g}, {point.steps} steps, "
            f"{point.episodes} episodes; executions: {spent}",
            err=True,
        )

    def _table(self, point: Point) -> Any:
        from rich.console import Group
        from rich.table import Table

        assert self.run is not None
        run, progress = self.run, self.run.loop.progress
        head = (
            f"{_clock(point.seconds)}  reward {point.reward:.6g}  {point.steps} steps  "
            f"{point.episodes} episodes"
        )
        where = Table("environment", "role", "executions", "time", "failed", box=None)
        for spec in run.bound.environments:
            where.add_row(
                spec.name, spec.role, str(progress.executions[spec.name]),
                _clock(progress.spent.get(spec.name, 0.0)), str(progress.failed[spec.name]),
            )  # fmt: skip
        unsure = Table("least sure", "delta in the target", box=None)
        for key, error in run.loop.least_sure(self.LEAST_SURE):
            unsure.add_row(str(key), f"{error:.3f}")
        return Group(head, where, unsure)
