"""`menid solve`: the best policy, with bounds on its value."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from menid_plan.cli.common import distinct_outputs, json_option, load_both, opened
from menid_plan.cli.tasks import (
    Display,
    SolvingOptions,
    TaskOptions,
    explore,
    number_json,
    number_text,
    solve,
    solving_options,
    task_options,
    tell_written,
)
from menid_plan.errors import MenidError
from menid_plan.files import replace_file

if TYPE_CHECKING:
    from menid_plan.planning import Task
    from menid_plan.solving import Solution

_file = click.Path(dir_okay=False, path_type=Path)

# Where rewards have no bound, or the objective can't be met.
_NOTHING_BEST = ("unbounded", "infeasible")


@click.command("solve")
@task_options
@solving_options
@click.option("--solver", "name", default="value-iteration", show_default=True, metavar="NAME")
@click.option(
    "-o", "--output", type=_file,
    help="Write the policy there, as JSON: the states that it reaches, and what it does in them.",
)  # fmt: skip
@click.option(
    "--dot", type=_file, help="Draw what the policy does there, as a graph in the DOT language."
)
@click.option("--png", type=_file, help="Draw what the policy does there, as an image.")
@json_option
@click.pass_context
def command(
    ctx: click.Context,
    files: tuple[str, ...],
    which: TaskOptions,
    how: SolvingOptions,
    name: str,
    output: Path | None,
    dot: Path | None,
    png: Path | None,
    as_json: bool,
) -> None:
    """Find the best policy for an environment, and enclose its value.

    One file may hold both DOMAIN and PROBLEM, and a domain is also looked for beside its problem; `-`
    is standard input.

    Exits with 1 if the best value is infinite (unbounded rewards, or an objective that can't be met),
    with 6 if the solver stopped early or was interrupted; the bounds are true all the same.
    """
    domain, problem = load_both(files)
    begin = time.perf_counter()
    from menid_plan.mdp.explore import warm

    distinct_outputs(files, output, dot, png)
    task = which.task(domain, problem)
    solver = task.solver(name, **how.of_solver(name))
    display = Display()
    with display.during("starting"):
        warm()
        task.warm(solver)
    startup = time.perf_counter() - begin
    explore(task, display)
    solution = solve(task, solver, how.objective, display)
    paths: list[Path] = []
    failure = None
    try:  # files first: who reads our output may leave early
        paths.extend(_written(task, solution, output, dot, png))
    except (MenidError, OSError) as error:
        failure = error
    if as_json:
        click.echo(json.dumps(_result(task, solution, startup), indent=2))
    else:
        _show(task, solution, startup)
    tell_written(paths, err=as_json)
    if failure is not None:
        raise failure
    if solution.status in _NOTHING_BEST:
        ctx.exit(1)
    if solution.status == "limit":
        ctx.exit(6)


def _seconds(task: Task, solution: Solution, startup: float) -> dict[str, float]:
    return {
        "startup": startup,
        "ground": task.structure.problem.seconds,
        "explore": task.structure.seconds,
        "solve": solution.seconds,
    }


def _action(task: Task, solution: Solution) -> str | None:
    """The best first action; None where nothing is best, or it is not known."""
    if solution.status in _NOTHING_BEST:
        return None
    chosen = int(solution.policy[solution.initial])
    return None if chosen < 0 else str(task.action(chosen))


def _goal(solution: Solution) -> float | None:
    """The probability of the goal under the best policy, if it is known and there is a goal."""
    chances = solution.goal_probability
    if chances is None or solution.status != "solved":
        return None
    return float(chances[solution.initial])


def _result(task: Task, solution: Solution, startup: float) -> dict[str, Any]:
    """What is printed, by the keys of the JSON."""
    from menid_plan.policy import known_value

    first, goal = solution.initial, _goal(solution)
    return {
        "status": solution.status,
        "objective": solution.objective,
        "value": number_json(known_value(solution)),
        "lower": number_json(float(solution.lower[first])),
        "upper": number_json(float(solution.upper[first])),
        "goal_probability": None if goal is None else number_json(goal),
        "states": task.structure.states,
        "transitions": len(task.structure.next_state),
        "iterations": solution.iterations,
        "seconds": _seconds(task, solution, startup),
        "action": _action(task, solution),
    }


def _written(
    task: Task, solution: Solution, output: Path | None, dot: Path | None, png: Path | None
) -> Iterator[Path]:
    """Write the files that are asked for; gives each when it is there."""
    why = ""
    if solution.status in _NOTHING_BEST:
        why = "no policy is the best"
    elif solution.status == "limit" and _action(task, solution) is None:
        why = "nothing is known of a policy"
    for path in (output, dot, png):
        if path is not None and why:
            click.echo(f"{path} was not written: {why}", err=True)
    if why:
        return
    if output is not None:
        from menid_plan.policy_file import policy_text

        with opened(output) as stream:
            stream.write(policy_text(task.policy(solution)))
        yield output
    if dot is None and png is None:
        return
    from menid_plan.exchange.drawing import dot_text, drawing_of

    drawing = drawing_of(task.structure, task.mdp, solution)
    if dot is not None:
        with opened(dot) as stream:
            stream.write(dot_text(drawing))
        yield dot
    if png is not None:
        from menid_plan.exchange.picture import png_bytes

        replace_file(png, png_bytes(drawing))
        yield png


def _show(task: Task, solution: Solution, startup: float) -> None:
    from menid_plan.policy import known_value

    first, goal = solution.initial, _goal(solution)
    status = f"{solution.status}: {solution.message}" if solution.message else solution.status
    low, high = float(solution.lower[first]), float(solution.upper[first])
    click.echo(f"status            {status}")
    click.echo(f"objective         {solution.objective}")
    click.echo(
        f"value             {number_text(known_value(solution))}, "
        f"between {number_text(low)} and {number_text(high)}"
    )
    if goal is not None:
        click.echo(f"goal probability  {number_text(goal, '.6g')}")
    click.echo(f"first action      {_action(task, solution) or 'none'}")
    structure = task.structure
    click.echo(
        f"size              {structure.states} states, {len(structure.next_state)} transitions"
    )
    spans = _seconds(task, solution, startup).items()
    seconds = ", ".join(f"{name} {value:.2f} s" for name, value in spans)
    click.echo(f"time              {seconds}, {solution.iterations} iterations")
