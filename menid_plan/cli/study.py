"""`menid study`: the studies of the paper and of this project, each loaded when it is called."""

from __future__ import annotations

import click

from menid_plan.cli.groups import LazyGroup

_STUDIES = {
    "allocation": "Where to act: tests and executions weighed up, or as in the paper.",
    "delta": "The delta bound and the true error as the sample grows.",
    "estimators": "Error of every estimator, and reward by it: whom to believe.",
    "learning": "Reward with simulations and without, as in the paper's experiments.",
    "mesh": "What the quality of meshes does to times and outcomes in the hard-drive scenes.",
}


@click.group(
    "study", cls=LazyGroup, module="menid_plan.cli.study_", texts=_STUDIES, heading="Studies"
)
def command() -> None:
    """Run a study: a table, a figure, and what they show."""
