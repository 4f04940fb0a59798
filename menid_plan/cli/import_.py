"""`menid import`: models in the languages of other planners, as MENID."""

from __future__ import annotations

import click

from menid_plan.cli.groups import LazyGroup

_LANGUAGES = {
    "ppddl": "PPDDL: a domain and a problem.",
}


@click.group(
    "import", cls=LazyGroup, module="menid_plan.cli.import_", texts=_LANGUAGES, heading="Languages"
)
def command() -> None:
    """Translate a model from the language of other planners into MENID."""
