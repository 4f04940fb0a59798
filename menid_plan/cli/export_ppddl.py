"""`menid export ppddl`: domain.pddl and problem.pddl."""

from __future__ import annotations

from pathlib import Path

import click

from menid_plan.cli.common import distinct_outputs, load_both
from menid_plan.cli.tasks import Display, TaskOptions, explore, task_options, tell_written
from menid_plan.files import replace_file


@click.command("ppddl")
@task_options
@click.option(
    "-o", "--output", "folder", required=True, metavar="DIR",
    type=click.Path(file_okay=False, path_type=Path),
    help="The folder for domain.pddl and problem.pddl.",
)  # fmt: skip
def command(files: tuple[str, ...], which: TaskOptions, folder: Path) -> None:
    """Write a problem as PPDDL, with the probabilities of one environment.

    State by state, for problems with up to 20,000 transitions. Exits with 4 for names that PPDDL can't
    have.
    """
    from menid_plan.exchange.ppddl import ppddl

    paths = [folder / "domain.pddl", folder / "problem.pddl"]
    distinct_outputs(files, folder)
    domain, problem = load_both(files)
    task = which.task(domain, problem)
    explore(task, Display())
    texts = ppddl(domain, problem, task.structure, task.mdp)
    folder.mkdir(exist_ok=True)
    distinct_outputs(files, *paths)
    for path, text in zip(paths, texts, strict=True):
        replace_file(path, text.encode())
    tell_written(paths, err=False)
