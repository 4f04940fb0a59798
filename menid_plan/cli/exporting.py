"""What the exports share: the probabilities that a store of experiences teaches."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from menid_plan.cli.common import load_both
from menid_plan.cli.tasks import gathered

if TYPE_CHECKING:
    from menid_plan.model.domain import Domain, Problem


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
