"""`menid plan`: let a planner of others act, and compare it with the best there is."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from menid_plan.cli.common import load_both
from menid_plan.cli.export_ppddl import FORMS, in_first_form
from menid_plan.cli.export_rddl import for_prost
from menid_plan.cli.exporting import form_option
from menid_plan.cli.serve_mdpsim import TURNS
from menid_plan.cli.serving import RoundOptions, round_options

if TYPE_CHECKING:
    from menid_plan.environments.registry import EnvironmentSpec
    from menid_plan.servers.play import Player, Results
    from menid_plan.servers.wire import Wire

    _Session = tuple[dict[str, str], Callable[[Wire, Player], Results]]


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

    chosen = planner(name, declarations)
    spec = play.spec(*load_both(files))
    texts, session = (_in_ppddl if chosen.protocol == "mdpsim" else _in_rddl)(spec, play, form)

    def begin(wire: Wire) -> Results:
        player = Player(spec, play.seed)
        try:
            return session(wire, player)
        finally:
            player.close()

    found = run(chosen, texts, begin, play.seconds)
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


def _in_rddl(spec: EnvironmentSpec, play: RoundOptions, form: str | None) -> _Session:
    """The files of a planner that reads RDDL, and what it is played with."""
    from menid_plan.servers.rddlsim import Session

    if form == "states":
        raise click.UsageError("--states: this planner reads RDDL, which is lifted or grounded")
    texts = for_prost(spec, form)
    return {"domain.rddl": texts.domain, "instance.rddl": texts.instance}, (
        lambda wire, player: Session(wire, texts, player, play.rounds, play.seconds).run()
    )


def _in_ppddl(spec: EnvironmentSpec, play: RoundOptions, form: str | None) -> _Session:
    """The files of a planner that reads PPDDL, and what it is played with."""
    from menid_plan.planning import Task
    from menid_plan.servers.mdpsim import Session

    texts = in_first_form(Task(spec.domain, spec.problem, spec.name, dict(spec.params)), form)
    turns = spec.problem.horizon or TURNS
    return {"domain.pddl": texts.domain, "problem.pddl": texts.problem}, (
        lambda wire, player: Session(wire, texts, player, play.rounds, turns, play.seconds).run()
    )


def _best(task: Any) -> tuple[float | None, str]:
    """The best mean reward by the domain's numbers, not discounted, or why it is not known."""
    from menid_plan.errors import MenidError

    try:
        task.build()
        value = task.solve(task.solver("value-iteration"), "reward").value
        return (value, "") if math.isfinite(value) else (None, "it has no bound")
    except MenidError as error:
        return None, str(error)
