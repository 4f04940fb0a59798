"""`menid serve mdpsim`: rounds in an environment for planners that read PPDDL."""

from __future__ import annotations

from pathlib import Path

import click

from menid_plan.cli.common import load_both
from menid_plan.cli.export_ppddl import FORMS, in_first_form
from menid_plan.cli.exporting import form_option, write_texts
from menid_plan.cli.serving import (
    RoundOptions,
    ServerOptions,
    round_options,
    server_options,
    task_of,
)

TURNS = 1000  # actions of a round of a problem without a horizon


@click.command("mdpsim")
@round_options
@server_options
@form_option(*FORMS)
@click.option(
    "-o", "--output", "folder", metavar="DIR", required=True,
    type=click.Path(file_okay=False, path_type=Path),
    help="The folder for domain.pddl and problem.pddl, which the planner reads.",
)  # fmt: skip
def command(
    files: tuple[str, ...],
    play: RoundOptions,
    server: ServerOptions,
    form: str | None,
    folder: Path,
) -> None:
    """Play rounds with a client of mdpsim, and print what came of each session as JSON.

    A round ends at a goal, at a dead end, or after as many actions as the horizon has steps: 1000, if
    there is none. Exits with 5 if a session ended early.
    """
    from menid_plan.planners.games import ppddl_game

    spec = play.spec(*load_both(files))
    game = ppddl_game(
        in_first_form(task_of(spec), form), play.rounds, spec.problem.horizon or TURNS, play.seconds
    )
    write_texts(files, folder, game.files, err=True)
    server.serve(spec, play.seed, game.play)
