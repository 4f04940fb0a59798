"""`menid plan`: let a planner act in an environment, and compare it with the best there is."""

from __future__ import annotations

import json
import math
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from menid_plan.cli.common import load_both
from menid_plan.cli.export_ppddl import FORMS, in_first_form
from menid_plan.cli.export_rddl import for_prost
from menid_plan.cli.exporting import form_option
from menid_plan.cli.serve_mdpsim import TURNS
from menid_plan.cli.serving import RoundOptions, round_options, task_of
from menid_plan.interrupts import tidied_up

if TYPE_CHECKING:
    from menid_plan.environments.registry import EnvironmentSpec
    from menid_plan.planners.known import Planner
    from menid_plan.planners.run import Run
    from menid_plan.planning import Task
    from menid_plan.solving import Objective, Solver


@click.command("plan")
@round_options
@click.option(
    "--with", "name", required=True, metavar="NAME",
    help="The planner: prost, mdpsim-client, one that is declared, or a solver of `menid solvers`.",
)  # fmt: skip
@click.option(
    "--planners", "declarations", metavar="FILE.toml",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Where planners are declared; by default the user's own file.",
)  # fmt: skip
@form_option(*FORMS)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def command(
    files: tuple[str, ...],
    name: str,
    declarations: Path | None,
    play: RoundOptions,
    form: str | None,
    as_json: bool,
) -> None:
    """Let a planner of others, or a solver, play rounds in an environment, and tell its mean reward.

    Beside it stands the best that the domain's numbers promise. Exits with 5 if the planner fails,
    with the last that it said.
    """
    from menid_plan.planners.known import UnknownPlannerError, planner
    from menid_plan.planning import Task
    from menid_plan.solving import solver_entry_points

    objective: Objective = "reward"  # all that the protocols know of
    try:
        chosen = planner(name, declarations)
    except UnknownPlannerError as fault:
        if name not in solver_entry_points():
            raise click.UsageError(f"--with: {fault}") from fault
        if form is not None:
            raise click.UsageError(
                f"--{form}: the solver `{name}` reads no exported files"
            ) from fault
        solver = Task.solver(name)
        spec = play.spec(*load_both(files))
        objective = task_of(spec).objective
        found = _by_solver(name, solver, spec, play)
    else:
        spec = play.spec(*load_both(files))
        found = _by_others(chosen, spec, play, form)
    problem = replace(spec.problem, discount=None)
    best, why = _best(task_of(replace(spec, problem=problem)), objective)
    summary: dict[str, Any] = found.results.summary() if found.results is not None else {}
    summary |= {
        "planner": name, "failure": found.failure, "best": best, "objective": objective,
        "horizon": problem.horizon,
    }  # fmt: skip
    if as_json:
        click.echo(json.dumps(summary, indent=2))
    elif summary.get("rounds"):
        error = "" if summary["error"] is None else f" +- {summary['error']:.4g}"
        goal = "" if problem.goal is None else f", {summary['goal_rate']:.0%} of them to the goal"
        click.echo(
            f"{name}: reward {summary['mean']:.6g}{error} in {summary['rounds']} rounds{goal}"
        )
        discounted = spec.problem.discount not in (None, 1)
        plainly = f"{objective}, not discounted" if discounted else objective
        click.echo(
            f"best {plainly}, by the domain: {f'not known: {why}' if best is None else f'{best:.6g}'}"
        )
    if found.failure:
        if found.output.strip():
            click.echo(found.output.rstrip(), err=True)
        click.echo(f"menid: {name} failed: {found.failure}", err=True)
        click.get_current_context().exit(5)


def _by_others(chosen: Planner, spec: EnvironmentSpec, play: RoundOptions, form: str | None) -> Run:
    """What comes of a planner of others that plays."""
    from menid_plan.planners.games import ppddl_game, rddl_game
    from menid_plan.planners.run import run
    from menid_plan.servers.play import Player

    if chosen.protocol == "mdpsim":
        turns = spec.problem.horizon or TURNS
        game = ppddl_game(in_first_form(task_of(spec), form), play.rounds, turns, play.seconds)
    elif form == "states":
        raise click.UsageError("--states: this planner reads RDDL, which is lifted or grounded")
    else:
        game = rddl_game(for_prost(spec, form), play.rounds, play.seconds)
    with tidied_up(), closing(Player(spec, play.seed)) as player:
        return run(chosen, game.files, lambda wire: game.play(wire, player), play.seconds)


def _by_solver(name: str, solver: Solver, spec: EnvironmentSpec, play: RoundOptions) -> Run:
    """What comes of a policy that a solver makes."""
    from menid_plan.planners.own import Decider
    from menid_plan.planners.own import play as played
    from menid_plan.planners.run import Run
    from menid_plan.servers.play import Player

    decider = Decider(task_of(spec), solver)
    # What can't be solved is told before anything is played.
    decider.action(frozenset(spec.problem.init), spec.problem.horizon)
    turns = spec.problem.horizon or TURNS
    with tidied_up(), closing(Player(spec, play.seed)) as player:
        results = played(decider, name, player, play.rounds, turns, play.seconds)
    return Run(results, results.failure, "")


def _best(task: Task, objective: Objective) -> tuple[float | None, str]:
    """The best that the domain's numbers promise, not discounted, or why it is not known."""
    from menid_plan.errors import MenidError

    try:
        task.build()
        value = task.solve(task.solver("value-iteration"), objective).value
        return (value, "") if math.isfinite(value) else (None, "it has no bound")
    except MenidError as error:
        return None, str(error)
