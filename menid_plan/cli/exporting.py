"""What the exports share: probabilities that a store teaches, forms of a model, and two files."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import click

from menid_plan.cli.common import distinct_outputs, load_both
from menid_plan.cli.tasks import gathered, tell_written
from menid_plan.files import replace_file

if TYPE_CHECKING:
    from menid_plan.model.domain import Domain, Problem


class _Renaming(Protocol):
    @property
    def renamed(self) -> Mapping[str, str]: ...


_Text = TypeVar("_Text", bound=_Renaming)


@dataclass(frozen=True, slots=True)
class Learned:
    """A store (or the folder of a run), and the estimator that is asked; None if not given."""

    store: Path | None
    estimator: str | None


def learned_option(function: Any) -> Any:
    """The options --store and --estimator, which the command gets as ``learned``."""
    return gathered(
        function, "learned", Learned,
        click.option("--store", type=click.Path(exists=True, path_type=Path), metavar="STORE",
                     help="With what a store of experiences, or the folder of a run, teaches."),
        click.option("--estimator", metavar="NAME",
                     help="How its counts are merged; as in the run if left out."),
    )  # fmt: skip


def load_learned(
    files: tuple[str, ...], environment: str | None, learned: Learned
) -> tuple[Domain, Problem, str | None]:
    """Domain, problem, and the environment whose probabilities count (None: the target).

    With a store, the domain has what was learned, and the environment is the target of the run.
    """
    domain, problem = load_both(files)
    if learned.store is None:
        if learned.estimator is not None:
            raise click.UsageError("--estimator needs --store: it merges the counts of a store")
        return domain, problem, environment
    from menid_plan.cli.evidence import evidence_of
    from menid_plan.cli.experiences import store_in
    from menid_plan.learning.counts import learned_domain

    evidence, roles = evidence_of(
        domain, files[0], store_in(learned.store), learned.estimator, None, None
    )
    target = evidence.environments[0]
    if environment not in (None, target):
        raise click.UsageError(
            f"--env: what a store teaches is about the target of its run, `{target}`"
        )
    return learned_domain(evidence, roles), problem, target


goal_reward_option = click.option(
    "--goal-reward", type=float, metavar="R",
    help="What reaching the goal pays, in place of what the problem says.",
)  # fmt: skip


def with_goal_reward(problem: Problem, reward: float | None) -> Problem:
    """A problem whose goal pays so much; None leaves it as it is."""
    from menid_plan.model.expressions import Number

    if reward is None:
        return problem
    if not math.isfinite(reward):
        raise click.UsageError(f"--goal-reward: {reward} is not a finite number")
    if problem.goal is None:
        raise click.UsageError(f"--goal-reward: problem `{problem.name}` has no goal")
    return replace(problem, goal_reward=Number(reward))


def form_option(*forms: tuple[str, str]) -> Callable[[Any], Any]:
    """An option for each form of a model; the command gets its name, or None, as ``form``."""

    def decorate(function: Any) -> Any:
        for name, text in reversed(forms):
            function = click.option(f"--{name}", "form", flag_value=name, help=text)(function)
        return function

    return decorate


def in_form(
    form: str | None, forms: Sequence[str], write: Callable[[str], _Text], language: str
) -> _Text:
    """What is written in a form, or if it is None, in the first of those in which all can be said.

    Tells if it is another than the first, and which names had to be changed.
    """
    from menid_plan.texts import first_form

    found = first_form([form] if form else forms, write)
    if found.reason:
        called = "state by state" if found.form == "states" else found.form
        click.echo(f"menid: {called}, since {found.reason}", err=True)
    if found.written.renamed:
        listed = ", ".join(f"`{old}` to `{new}`" for new, old in found.written.renamed.items())
        click.echo(f"menid: renamed, since {language} has other uses for them: {listed}", err=True)
    return found.written


def write_texts(
    files: Iterable[str], folder: Path, texts: Mapping[str, str], *, err: bool = False
) -> None:
    """Write files into a folder, unless one of them was read, and tell so (``err``: there)."""
    folder.mkdir(exist_ok=True)
    paths = [folder / name for name in texts]
    distinct_outputs(files, *paths)
    for path, text in zip(paths, texts.values(), strict=True):
        replace_file(path, text.encode())
    tell_written(paths, err=err)
