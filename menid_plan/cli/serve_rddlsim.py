"""`menid serve rddlsim`: rounds in an environment for PROST, or another client of rddlsim."""

from __future__ import annotations

import json
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import click

from menid_plan.cli.common import load_both, setting_option
from menid_plan.cli.exporting import environment_spec, first_form, form_option
from menid_plan.cli.tasks import files_argument

if TYPE_CHECKING:
    from menid_plan.servers.play import Results
    from menid_plan.servers.wire import Wire


@click.command("rddlsim")
@files_argument
@click.option(
    "--run", "run_file", type=click.Path(exists=True, dir_okay=False), metavar="FILE.toml",
    help="Act in an environment of this run file; by default the domain is simulated.",
)  # fmt: skip
@click.option("--env", "name", metavar="NAME", help="The environment; by default the target.")
@setting_option
@click.option(
    "--horizon", type=click.IntRange(1, 1_000_000), metavar="H",
    help="How many steps a round takes; by default as the problem has it.",
)  # fmt: skip
@click.option("--rounds", type=click.IntRange(1), default=30, show_default=True, metavar="N")
@click.option(
    "--sessions", "number", type=click.IntRange(1), default=1, show_default=True, metavar="N",
    help="End after so many sessions.",
)  # fmt: skip
@click.option(
    "--port", type=click.IntRange(0, 65535), default=2323, show_default=True,
    help="The port on 127.0.0.1; 0: any that is free, which is told.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, metavar="S")
@click.option(
    "--time", "seconds", type=click.FloatRange(1, 1e6), default=1080.0, show_default=True,
    metavar="SECONDS", help="How long a session may take.",
)  # fmt: skip
@click.option(
    "--patience", type=click.FloatRange(0.01, 1e6), default=300.0, show_default=True,
    metavar="SECONDS", help="How long the client may take for a message.",
)  # fmt: skip
@form_option(
    ("lifted", "Rules as actions with parameters, or nothing."),
    ("grounded", "Every ground rule as an action without parameters."),
)
@click.option(
    "-o", "--output", "folder", metavar="DIR", type=click.Path(file_okay=False, path_type=Path),
    help="Write domain.rddl and instance.rddl there, for planners that read them themselves.",
)  # fmt: skip
def command(
    files: tuple[str, ...],
    run_file: str | None,
    name: str | None,
    settings: dict[str, float],
    horizon: int | None,
    rounds: int,
    number: int,
    port: int,
    seed: int,
    seconds: float,
    patience: float,
    form: str | None,
    folder: Path | None,
) -> None:
    """Play rounds with a client of rddlsim, and print what came of each session as JSON.

    The client is told the problem as `menid export rddl --dialect prost` writes it. Exits with 5 if a
    session ended early.
    """
    from menid_plan.cli.export_rddl import written_as
    from menid_plan.cli.exporting import write_texts
    from menid_plan.environments.seeds import seed_of
    from menid_plan.planning import Task
    from menid_plan.servers.listen import HOST, listening, sessions
    from menid_plan.servers.play import Player
    from menid_plan.servers.rddlsim import Session

    domain, problem = load_both(files)
    spec = environment_spec(domain, problem, run_file, name, settings, horizon)
    problem, steps = spec.problem, spec.problem.horizon
    assert steps is not None
    task = Task(domain, problem, spec.name, settings)
    made, texts, reason = first_form(
        [form] if form else ["lifted", "grounded"],
        lambda form: written_as(task, form, "prost", steps, stopping=False),
    )
    if reason:
        click.echo(f"menid: {made}, since {reason}", err=True)
    if folder is not None:
        texts_of = {"domain.rddl": texts.domain, "instance.rddl": texts.instance}
        write_texts(files, folder, texts_of, err=True)

    counted = count()

    def play(wire: Wire) -> Results:
        # What broke down in one session is built anew for the next.
        player = Player(spec, seed_of(seed, "session", next(counted)))
        try:
            return Session(wire, texts, player, rounds, seconds).run()
        finally:
            player.close()

    failed = False
    with listening(port) as server:
        click.echo(f"listening on {HOST}:{server.getsockname()[1]}", err=True)
        for results in sessions(server, number, patience, play):
            click.echo(json.dumps(results.summary(), indent=2))
            failed = failed or bool(results.failure)
    if failed:
        click.get_current_context().exit(5)
