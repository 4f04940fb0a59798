"""`menid solve`: the best policy, with bounds on its value."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import click

from menid_plan.cli.common import (
    existing_file,
    json_option,
    load_both,
    opened,
    setting_option,
)

_OBJECTIVES = ("reward", "goal-then-reward", "goal-probability", "steps")


@click.command("solve")
@click.argument("files", nargs=-1, required=True, type=existing_file, metavar="DOMAIN PROBLEM")
@click.option(
    "--env", "environment", metavar="NAME", help="The environment; by default the target."
)
@setting_option
@click.option(
    "--noise", type=click.Choice(["stay", "sink"]), default="stay", show_default=True,
    help="Where the noise outcome leads: nowhere, or to an absorbing state.",
)  # fmt: skip
@click.option(
    "--objective", type=click.Choice(_OBJECTIVES),
    help="What is best; by default as the problem has it.",
)  # fmt: skip
@click.option("--solver", "name", default="value-iteration", show_default=True, metavar="NAME")
@click.option(
    "--epsilon", type=click.FloatRange(0, min_open=True), default=1e-6, show_default=True,
    help="How far apart the bounds may be.",
)  # fmt: skip
@click.option("--max-states", type=click.IntRange(1), default=50_000_000, show_default=True)
@click.option(
    "-o", "--output", type=click.Path(dir_okay=False, path_type=Path),
    help="Write the policy there, as JSON: the states that it reaches, and what it does in them.",
)  # fmt: skip
@json_option
@click.pass_context
def command(
    ctx: click.Context,
    files: tuple[str, ...],
    environment: str | None,
    settings: dict[str, float],
    noise: str,
    objective: str | None,
    name: str,
    epsilon: float,
    max_states: int,
    output: Path | None,
    as_json: bool,
) -> None:
    """Find the best policy for an environment, and enclose its value.

    Exits with 1 if the value is unbounded or the objective can't be met, with 6 if the solver stopped
    early; the bounds are true all the same.
    """
    domain, problem = load_both(files)
    begin = time.perf_counter()
    from menid_plan.mdp.explore import warm
    from menid_plan.planning import Task

    task = Task(
        domain, problem, environment, settings, "sink" if noise == "sink" else "stay", max_states
    )
    solver = task.solver(name, epsilon=epsilon)
    warm()
    task.warm(solver)
    startup = time.perf_counter() - begin
    task.build(_progress)
    solution = task.solve(solver, objective)
    structure = task.structure
    chosen = int(solution.policy[0])
    goal = solution.goal_probability
    result: dict[str, Any] = {
        "status": solution.status,
        "objective": solution.objective,
        "value": _number(solution.value),
        "lower": _number(float(solution.lower[0])),
        "upper": _number(float(solution.upper[0])),
        "goal_probability": None if goal is None else float(goal[0]),
        "states": structure.states,
        "transitions": len(structure.next_state),
        "iterations": solution.iterations,
        "seconds": {
            "startup": startup,
            "ground": structure.problem.seconds,
            "explore": structure.seconds,
            "solve": solution.seconds,
        },
        "action": None if chosen < 0 else str(task.action(chosen)),
    }
    if output is not None:
        with opened(output) as stream:
            json.dump(task.policy_json(solution), stream, indent=1)
    if as_json:
        click.echo(json.dumps(result, indent=2))
    else:
        _show(result, solution.message)
    if solution.status in ("unbounded", "infeasible"):
        ctx.exit(1)
    if solution.status == "limit":
        ctx.exit(6)


def _number(value: float) -> float | str:
    """A float as JSON can hold it: infinities as words."""
    return value if abs(value) != float("inf") else ("inf" if value > 0 else "-inf")


def _show(result: dict[str, Any], message: str) -> None:
    status = f"{result['status']}: {message}" if message else result["status"]
    click.echo(f"status            {status}")
    click.echo(f"objective         {result['objective']}")
    click.echo(
        f"value             {result['value']}, between {result['lower']} and {result['upper']}"
    )
    if result["goal_probability"] is not None:
        click.echo(f"goal probability  {result['goal_probability']:.6g}")
    click.echo(f"first action      {result['action'] or 'none'}")
    click.echo(f"size              {result['states']} states, {result['transitions']} transitions")
    seconds = ", ".join(f"{name} {value:.2f} s" for name, value in result["seconds"].items())
    click.echo(f"time              {seconds}, {result['iterations']} iterations")


def _progress(states: int, expanded: int, transitions: int) -> None:
    if sys.stderr.isatty():
        text = f"\r{states} states found, {expanded} expanded, {transitions} transitions "
        click.echo(text, err=True, nl=False)
