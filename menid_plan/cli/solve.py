"""`menid solve`: the best policy, with bounds on its value."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from menid_plan.cli.common import distinct_outputs, json_option, load_both, opened, replace_file
from menid_plan.cli.tasks import Display, build, solve, task_options
from menid_plan.errors import MenidError

if TYPE_CHECKING:
    from menid_plan.planning import Task
    from menid_plan.solving import Objective, Solution

_file = click.Path(dir_okay=False, path_type=Path)


@click.command("solve")
@task_options
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
    environment: str | None,
    settings: dict[str, float],
    noise: str | None,
    objective: Objective | None,
    name: str,
    epsilon: float | None,
    max_iterations: int | None,
    max_seconds: float | None,
    max_states: int,
    output: Path | None,
    dot: Path | None,
    png: Path | None,
    as_json: bool,
) -> None:
    """Find the best policy for an environment, and enclose its value.

    Exits with 1 if the value is unbounded or the objective can't be met, with 6 if the solver stopped
    early or was interrupted; the bounds are true all the same.
    """
    domain, problem = load_both(files)
    begin = time.perf_counter()
    from menid_plan.mdp.explore import warm
    from menid_plan.planning import Task

    distinct_outputs(files, output, dot, png)
    task = Task(
        domain, problem, environment, settings, "sink" if noise == "sink" else "stay", max_states
    )
    solver = task.solver(
        name, epsilon=epsilon, max_iterations=max_iterations, max_seconds=max_seconds
    )
    warm()
    task.warm(solver)
    startup = time.perf_counter() - begin
    display = Display()
    build(task, display)
    solution = solve(task, solver, objective, display)
    result = _result(task, solution, startup)
    failure = None
    try:  # files first: who reads our output may leave early
        _write(task, solution, output, dot, png)
    except (MenidError, OSError) as error:
        failure = error
    if as_json:
        click.echo(json.dumps(result, indent=2))
    else:
        _show(result, solution.message)
    if failure is not None:
        raise failure
    if solution.status in ("unbounded", "infeasible"):
        ctx.exit(1)
    if solution.status == "limit":
        ctx.exit(6)


def _result(task: Task, solution: Solution, startup: float) -> dict[str, Any]:
    """What is printed, by the keys of the JSON."""
    from menid_plan.policy import known_value
    from menid_plan.policy_file import number_json

    first = solution.initial
    chosen = int(solution.policy[first])
    goal = solution.goal_probability
    return {
        "status": solution.status,
        "objective": solution.objective,
        "value": number_json(known_value(solution)),
        "lower": number_json(float(solution.lower[first])),
        "upper": number_json(float(solution.upper[first])),
        "goal_probability": None if goal is None else float(goal[first]),
        "states": task.structure.states,
        "transitions": len(task.structure.next_state),
        "iterations": solution.iterations,
        "seconds": {
            "startup": startup,
            "ground": task.structure.problem.seconds,
            "explore": task.structure.seconds,
            "solve": solution.seconds,
        },
        "action": None if chosen < 0 else str(task.action(chosen)),
    }


def _write(
    task: Task, solution: Solution, output: Path | None, dot: Path | None, png: Path | None
) -> None:
    if output is not None:
        from menid_plan.policy_file import policy_text

        with opened(output) as stream:
            stream.write(policy_text(task.policy(solution)))
    if dot is None and png is None:
        return
    from menid_plan.exchange.drawing import dot_text, drawing_of

    drawing = drawing_of(task.structure, task.mdp, solution)
    if dot is not None:
        with opened(dot) as stream:
            stream.write(dot_text(drawing))
    if png is not None:
        from menid_plan.exchange.picture import png_bytes

        replace_file(png, png_bytes(drawing))


def _show(result: dict[str, Any], message: str) -> None:
    status = f"{result['status']}: {message}" if message else result["status"]
    value = "not known" if result["value"] is None else result["value"]
    click.echo(f"status            {status}")
    click.echo(f"objective         {result['objective']}")
    click.echo(f"value             {value}, between {result['lower']} and {result['upper']}")
    if result["goal_probability"] is not None:
        click.echo(f"goal probability  {result['goal_probability']:.6g}")
    click.echo(f"first action      {result['action'] or 'none'}")
    click.echo(f"size              {result['states']} states, {result['transitions']} transitions")
    seconds = ", ".join(f"{name} {value:.2f} s" for name, value in result["seconds"].items())
    click.echo(f"time              {seconds}, {result['iterations']} iterations")
