"""`menid serve rddlsim`: rounds in an environment for PROST, or another client of rddlsim."""

from __future__ import annotations

from pathlib import Path

import click

from menid_plan.cli.common import load_both
from menid_plan.cli.export_rddl import FORMS, for_prost
from menid_plan.cli.exporting import form_option, write_texts
from menid_plan.cli.serving import RoundOptions, ServerOptions, round_options, server_options


@click.command("rddlsim")
@round_options
@server_options
@form_option(*FORMS)
@click.option(
    "-o", "--output", "folder", metavar="DIR", type=click.Path(file_okay=False, path_type=Path),
    help="Write domain.rddl and instance.rddl there, for planners that read them themselves.",
)  # fmt: skip
def command(
    files: tuple[str, ...],
    play: RoundOptions,
    server: ServerOptions,
    form: str | None,
    folder: Path | None,
) -> None:
    """Play rounds with a client of rddlsim, and print what came of each session as JSON.

    The client is told the problem as `menid export rddl --dialect prost` writes it. Exits with 5 if a
    session ended early.
    """
    from menid_plan.planners.games import rddl_game

    spec = play.spec(*load_both(files))
    game = rddl_game(for_prost(spec, form), play.rounds, play.seconds)
    if folder is not None:
        write_texts(files, folder, game.files, err=True)
    server.serve(spec, play.seed, game.play)
