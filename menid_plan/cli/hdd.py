"""`menid hdd`: what belongs to the hard-drive scenes alone."""

from __future__ import annotations

import click

from menid_plan.cli.groups import LazyGroup

_COMMANDS = {
    "mesh": "Write a part at a quality, and what was checked of it.",
    "record": "Record an outcome bank: every action in every environment.",
}


@click.group("hdd", cls=LazyGroup, module="menid_plan.cli.hdd_", texts=_COMMANDS)
def command() -> None:
    """Make meshes of the hard drive, and record what its scenes do."""
