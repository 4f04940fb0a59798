"""`menid export ppddl`: domain.pddl and problem.pddl."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from menid_plan.cli.common import distinct_outputs
from menid_plan.cli.exporting import (
    form_option,
    in_form,
    learned_option,
    load_learned,
    write_texts,
)
from menid_plan.cli.tasks import Display, TaskOptions, explore, task_options

if TYPE_CHECKING:
    from menid_plan.cli.exporting import Learned
    from menid_plan.exchange.ppddl import Written
    from menid_plan.planning import Task

FORMS = (
    ("lifted", "Rules as actions with parameters, or nothing."),
    ("grounded", "Every ground rule as an action without parameters."),
    ("states", "Every ground action as a list of what it does in each state that can be reached."),
)


@click.command("ppddl")
@task_options
@learned_option
@form_option(*FORMS)
@click.option(
    "-o", "--output", "folder", required=True, metavar="DIR",
    type=click.Path(file_okay=False, path_type=Path),
    help="The folder for domain.pddl and problem.pddl.",
)  # fmt: skip
def command(
    files: tuple[str, ...],
    which: TaskOptions,
    learned: Learned,
    form: str | None,
    folder: Path,
) -> None:
    """Write a problem as PPDDL, with the probabilities of one environment.

    Lifted where that can be said, else grounded, else state by state, which is told. Exits with 4 for
    what none of these can say.
    """
    distinct_outputs(files, folder)
    domain, problem, environment = load_learned(files, which.environment, learned)
    task = which.task(domain, problem)
    task.environment = environment or task.environment
    texts = in_first_form(task, form)
    write_texts(files, folder, {"domain.pddl": texts.domain, "problem.pddl": texts.problem})


def in_first_form(task: Task, form: str | None) -> Written:
    """The PPDDL of a task in a form, or in the first that can say all, which is told."""
    from menid_plan.texts import PPDDL_FORMS, ppddl_text

    def write(form: str) -> Written:
        return ppddl_text(task, form, lambda task: explore(task, Display()))

    texts = in_form(form, PPDDL_FORMS, write, "PPDDL")
    if texts.rounded:
        listed = ", ".join(f"{old} to {new}" for old, new in texts.rounded.items())
        click.echo(f"menid: rounded, since readers have 32 bits for a number: {listed}", err=True)
    return texts
