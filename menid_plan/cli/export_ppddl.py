"""`menid export ppddl`: domain.pddl and problem.pddl."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from menid_plan.cli.common import distinct_outputs
from menid_plan.cli.exporting import learned_option, load_learned
from menid_plan.cli.tasks import Display, TaskOptions, explore, task_options, tell_written
from menid_plan.files import replace_file

if TYPE_CHECKING:
    from menid_plan.cli.exporting import Learned
    from menid_plan.exchange.flat import NotExpressibleError
    from menid_plan.exchange.ppddl import Written
    from menid_plan.planning import Task

_FORMS = ("lifted", "grounded", "states")


@click.command("ppddl")
@task_options
@learned_option
@click.option(
    "--lifted", "form", flag_value="lifted",
    help="Rules as actions with parameters, or nothing.",
)  # fmt: skip
@click.option(
    "--grounded", "form", flag_value="grounded",
    help="Every ground rule as an action without parameters.",
)  # fmt: skip
@click.option(
    "--states", "form", flag_value="states",
    help="Every ground action as a list of what it does in each state that can be reached.",
)  # fmt: skip
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
    paths = [folder / "domain.pddl", folder / "problem.pddl"]
    distinct_outputs(files, folder)
    domain, problem, environment = load_learned(files, which.environment, learned)
    task = which.task(domain, problem)
    task.environment = environment or task.environment
    made, texts, reasons = _first(task, (form,) if form else _FORMS)
    folder.mkdir(exist_ok=True)
    distinct_outputs(files, *paths)
    for path, text in zip(paths, (texts.domain, texts.problem), strict=True):
        replace_file(path, text.encode())
    for reason in reasons:
        click.echo(f"menid: {made}, since {reason}", err=True)
    tell_written(paths, err=False)


def _first(task: Task, forms: tuple[str, ...]) -> tuple[str, Written, list[str]]:
    """The first form that can say all, its texts, and why those before could not."""
    from menid_plan.errors import LimitError
    from menid_plan.exchange.flat import NotExpressibleError

    reasons: list[str] = []
    last: NotExpressibleError | LimitError | None = None
    for form in forms:
        try:
            return _SHOWN[form], _written(task, form), reasons[:1]
        except (NotExpressibleError, LimitError) as error:
            last = error
            if str(error) not in reasons:
                reasons.append(str(error))
    assert last is not None
    if len(reasons) < 2:
        raise last
    raise NotExpressibleError("; ".join(reasons))


def _written(task: Task, form: str) -> Written:
    from menid_plan.exchange.grounded import grounded
    from menid_plan.exchange.lifted import lifted
    from menid_plan.exchange.ppddl import ppddl
    from menid_plan.exchange.ppddl_states import ppddl_states

    if form == "states":
        explore(task, Display())
        return ppddl_states(task.domain, task.problem, task.structure, task.mdp)
    make = lifted if form == "lifted" else grounded
    return ppddl(make(task.domain, task.problem, task.environment, task.params, task.noise))


_SHOWN = {"lifted": "lifted", "grounded": "grounded", "states": "state by state"}
