"""`menid plan`: let a planner of others act, and compare it with the best there is."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from menid_plan.cli.common import load_both
from menid_plan.cli.export_rddl import FORMS, for_prost
from menid_plan.cli.exporting import form_option
from menid_plan.cli.serving import RoundOptions, round_options

if TYPE_CHECKING:
    from menid_plan.servers.play import Results
    from menid_plan.servers.wire import Wire


@click.command("plan")
@round_options
@click.option(
    "--with", "name", required=True, metavar="NAME",
    help="The planner: prost, or one that is declared.",
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
    """Let a planner of others play rounds in an environment, and tell its mean reward.

    Beside it stands the best that the domain's numbers promise. Exits with 5 if the planner fails,
    with the last that it said.
    """
    from menid_plan.planners.known import planner
    from menid_plan.planners.run import run
    from menid_plan.planning import Task
    from menid_plan.servers.play import Player
    from menid_plan.servers.rddlsim import Session

    chosen = planner(name, declarations)
    spec = play.spec(*load_both(files))
    texts = for_prost(spec, form)

    def session(wire: Wire) -> Results:
        player = Player(spec, play.seed)
        try:
            return Session(wire, texts, player, play.rounds, play.seconds).run()
        finally:
            player.close()

    found = run(chosen, texts, session, play.seconds)
    problem = replace(spec.problem, discount=None)
    best, why = _best(Task(spec.domain, problem, spec.name, dict(spec.params)))
    summary: dict[str, Any] = found.results.summary() if found.results is not None else {}
    summary |= {"planner": name, "failure": found.failure, "best": best, "horizon": problem.horizon}
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
