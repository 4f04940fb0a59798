"""`menid plan`: let a planner of others act, and compare it with the best there is."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from menid_plan.cli.common import load_both, setting_option
from menid_plan.cli.exporting import environment_spec, first_form, form_option
from menid_plan.cli.tasks import files_argument

if TYPE_CHECKING:
    from menid_plan.servers.play import Results
    from menid_plan.servers.wire import Wire


@click.command("plan")
@files_argument
@click.option(
    "--with", "name", required=True, metavar="NAME",
    help="The planner: prost, or one that is declared.",
)  # fmt: skip
@click.option(
    "--planners", "declarations", metavar="FILE.toml",
    type=click.Path(exists=True, dir_okay=False, path_type=Path),
    help="Where planners are declared; by default the user's own file.",
)  # fmt: skip
@click.option(
    "--run", "run_file", type=click.Path(exists=True, dir_okay=False), metavar="FILE.toml",
    help="Act in an environment of this run file; by default the domain is simulated.",
)  # fmt: skip
@click.option(
    "--env", "environment", metavar="NAME", help="The environment; by default the target."
)
@setting_option
@click.option(
    "--horizon", type=click.IntRange(1, 1_000_000), metavar="H",
    help="How many steps a round takes; by default as the problem has it.",
)  # fmt: skip
@click.option("--rounds", type=click.IntRange(1), default=30, show_default=True, metavar="N")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, metavar="S")
@click.option(
    "--time", "seconds", type=click.FloatRange(1, 1e6), default=1080.0, show_default=True,
    metavar="SECONDS", help="How long the planner may take in all.",
)  # fmt: skip
@form_option(
    ("lifted", "Rules as actions with parameters, or nothing."),
    ("grounded", "Every ground rule as an action without parameters."),
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def command(
    files: tuple[str, ...],
    name: str,
    declarations: Path | None,
    run_file: str | None,
    environment: str | None,
    settings: dict[str, float],
    horizon: int | None,
    rounds: int,
    seed: int,
    seconds: float,
    form: str | None,
    as_json: bool,
) -> None:
    """Let a planner of others play rounds in an environment, and tell its mean reward.

    Beside it stands the best that the domain's numbers promise. Exits with 5 if the planner fails,
    with the last that it said.
    """
    from menid_plan.cli.export_rddl import written_as
    from menid_plan.planners.known import planner
    from menid_plan.planners.run import run
    from menid_plan.planning import Task
    from menid_plan.servers.play import Player
    from menid_plan.servers.rddlsim import Session

    chosen = planner(name, declarations)
    domain, problem = load_both(files)
    spec = environment_spec(domain, problem, run_file, environment, settings, horizon)
    problem, steps = spec.problem, spec.problem.horizon
    assert steps is not None
    task = Task(domain, problem, spec.name, settings)
    made, texts, reason = first_form(
        [form] if form else ["lifted", "grounded"],
        lambda form: written_as(task, form, "prost", steps, stopping=False),
    )
    if reason:
        click.echo(f"menid: {made}, since {reason}", err=True)

    def play(wire: Wire) -> Results:
        player = Player(spec, seed)
        try:
            return Session(wire, texts, player, rounds, seconds).run()
        finally:
            player.close()

    found = run(chosen, texts, play, seconds)
    best, why = _best(Task(domain, replace(problem, discount=None), spec.name, settings))
    summary: dict[str, Any] = found.results.summary() if found.results is not None else {}
    summary |= {"planner": name, "failure": found.failure, "best": best, "horizon": steps}
    if as_json:
        click.echo(json.dumps(summary, indent=2))
    elif summary.get("rounds"):
        error = "" if summary["error"] is None else f" +- {summary['error']:.4g}"
        goal = "" if problem.goal is None else f", {summary['goal_rate']:.0%} of them to the goal"
        click.echo(
            f"{name}: reward {summary['mean']:.6g}{error} in {summary['rounds']} rounds{goal}"
        )
        click.echo(f"best: {best:.6g}" if best is not None else f"best: not known: {why}")
    if found.failure:
        if found.output.strip():
            click.echo(found.output.rstrip(), err=True)
        click.echo(f"menid: {name} failed: {found.failure}", err=True)
        click.get_current_context().exit(5)


def _best(task: Any) -> tuple[float | None, str]:
    """The best mean reward by the domain's numbers, not discounted, or why it is not known."""
    from menid_plan.errors import MenidError

    try:
        task.build()
        return task.solve(task.solver("value-iteration"), "reward").value, ""
    except MenidError as error:
        return None, str(error)
