"""`menid hdd`: what belongs to the hard-drive scenes alone."""

from __future__ import annotations

import importlib

import click

# The module menid_plan.cli.hdd_NAME holds the function `command`.
_COMMANDS = {
    "mesh": "Write a part at a quality, and what was checked of it.",
    "record": "Record an outcome bank: every action in every environment.",
}


class _LazyCommands(click.Group):
    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        return sorted(_COMMANDS)

    def get_command(
        self,
        ctx: click.Context,  # noqa: ARG002
        cmd_name: str,
    ) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return None
        found = importlib.import_module(f"menid_plan.cli.hdd_{cmd_name}").command
        assert isinstance(found, click.Command)
        return found

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, _COMMANDS[name]) for name in self.list_commands(ctx)])


@click.group("hdd", cls=_LazyCommands)
def command() -> None:
    """Make meshes of the hard drive, and record what its scenes do."""
