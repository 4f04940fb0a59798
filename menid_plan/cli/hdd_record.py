"""`menid hdd record`: an outcome bank, made in parallel and gone on with."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from menid_plan.cli.common import existing_file, load_both

if TYPE_CHECKING:
    from menid_plan.environments.recording import Progress


@click.command("record")
@click.argument("files", nargs=-1, required=True, type=existing_file, metavar="DOMAIN PROBLEM")
@click.option(
    "--run", "run_file", required=True, metavar="FILE.toml",
    type=click.Path(exists=True, dir_okay=False),
    help="The run file that names the environments.",
)  # fmt: skip
@click.option(
    "--executions", type=click.IntRange(1), required=True, metavar="N",
    help="How often each action is executed in each environment and state.",
)  # fmt: skip
@click.option(
    "-o", "--output", "path", required=True, metavar="STORE",
    type=click.Path(dir_okay=False, path_type=Path),
    help="The store of the experiences; one that is there is gone on with.",
)  # fmt: skip
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, metavar="S",
    help="The same seed records the same.",
)  # fmt: skip
def command(files: tuple[str, ...], run_file: str, executions: int, path: Path, seed: int) -> None:
    """Execute every action so many times, in every environment of a run file and in every state.

    The kind `recorded` replays what was recorded. A recording that was interrupted, or that is to have
    more executions, goes on where it was.
    """
    from menid_plan.environments.recording import must_go_on_with, record
    from menid_plan.environments.runfile import read_run_file
    from menid_plan.experience.store import Store

    domain, problem = load_both(files)
    run = read_run_file(run_file)
    bound = run.bind(domain, problem)
    if not path.parent.is_dir():
        raise click.UsageError(f"{path}: there is no folder {path.parent}")

    def told(now: Progress) -> None:
        failures = f", {now.failed} failed" if now.failed else ""
        click.echo(f"{now.recorded} of {now.wanted} executions{failures}", err=True)

    with Store.create(
        path,
        bound.domain,
        bound.problem,
        settings={"executions": executions, "environments": bound.described()},
        seed=seed,
        resume=True,
    ) as store:
        must_go_on_with(store, bound)
        if store.seed != seed:
            raise click.UsageError(f"{path} was recorded with --seed {store.seed}: go on with it")
        try:
            found = record(
                bound, store, executions, seed, run.workers.number, told,
                lambda failure: click.echo(str(failure), err=True),
                lambda message: click.echo(f"menid: {message}", err=True),
            )  # fmt: skip
        except KeyboardInterrupt:
            click.echo("menid: the same command goes on where this one was interrupted", err=True)
            raise
        there = sum(1 for _ in store)
    left = f"; {found.failed} failed each time and are left out" if found.failed else ""
    click.echo(f"{path}: {there} executions{left}")
