"""`menid export`: a model in the languages of other planners."""

from __future__ import annotations

import click

from menid_plan.cli.groups import LazyGroup

_LANGUAGES = {
    "ppddl": "PPDDL: a domain and a problem.",
    "rddl": "RDDL: a domain and an instance, for PROST or pyRDDLGym.",
}


@click.group(
    "export", cls=LazyGroup, module="menid_plan.cli.export_", texts=_LANGUAGES, heading="Languages"
)
def command() -> None:
    """Write a model in the language of other planners."""
