"""`menid export rddl`: domain.rddl and instance.rddl."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from menid_plan.cli.common import distinct_outputs
from menid_plan.cli.exporting import (
    form_option,
    goal_reward_option,
    in_form,
    learned_option,
    load_learned,
    with_goal_reward,
    write_texts,
)
from menid_plan.cli.serving import task_of
from menid_plan.cli.tasks import TaskOptions, task_options

if TYPE_CHECKING:
    from menid_plan.cli.exporting import Learned
    from menid_plan.environments.registry import EnvironmentSpec
    from menid_plan.exchange.rddl import Dialect, Written
    from menid_plan.planning import Task

FORMS = (
    ("lifted", "Rules as actions with parameters, or nothing."),
    ("grounded", "Every ground rule as an action without parameters."),
)


@click.command("rddl")
@task_options
@learned_option
@click.option(
    "--dialect", type=click.Choice(["prost", "pyrddlgym"]), default="prost", show_default=True,
    help="For PROST, where a step takes two, or for pyRDDLGym alone.",
)  # fmt: skip
@click.option(
    "--horizon", type=click.IntRange(1, 1_000_000), metavar="H",
    help="How many steps are taken; by default as the problem has it.",
)  # fmt: skip
@goal_reward_option
@click.option(
    "--stopping", is_flag=True,
    help="Say the discount as a chance that a step is the last, for planners that ignore it.",
)  # fmt: skip
@form_option(*FORMS)
@click.option(
    "-o", "--output", "folder", required=True, metavar="DIR",
    type=click.Path(file_okay=False, path_type=Path),
    help="The folder for domain.rddl and instance.rddl.",
)  # fmt: skip
def command(
    files: tuple[str, ...],
    which: TaskOptions,
    learned: Learned,
    dialect: Dialect,
    horizon: int | None,
    goal_reward: float | None,
    stopping: bool,
    form: str | None,
    folder: Path,
) -> None:
    """Write a problem as RDDL, with the probabilities of one environment.

    They are non-fluents of the instance, which can be changed there. Lifted where that can be said,
    else grounded, which is told. Exits with 4 for what neither can say.
    """
    distinct_outputs(files, folder)
    domain, problem, environment = load_learned(files, which.environment, learned)
    problem = with_goal_reward(problem, goal_reward)
    problem = replace(problem, horizon=horizon or problem.horizon)
    task = which.task(domain, problem)
    task.environment = environment or task.environment
    texts = _in_first_form(task, form, dialect, stopping=stopping)
    write_texts(files, folder, {"domain.rddl": texts.domain, "instance.rddl": texts.instance})


def for_prost(spec: EnvironmentSpec, form: str | None) -> Written:
    """The RDDL of what is played in an environment, in two phases."""
    return _in_first_form(task_of(spec), form, "prost", stopping=False)


def _in_first_form(task: Task, form: str | None, dialect: Dialect, *, stopping: bool) -> Written:
    from menid_plan.texts import RDDL_FORMS, rddl_text

    horizon = task.problem.horizon
    if horizon is None:
        raise click.UsageError(
            f"problem `{task.problem.name}` has no horizon, and RDDL must have one: give --horizon"
        )

    def write(form: str) -> Written:
        return rddl_text(task, form, dialect, horizon, stopping=stopping)

    return in_form(form, RDDL_FORMS, write, "RDDL")
