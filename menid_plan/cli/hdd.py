"""`menid hdd`: what belongs to the hard-drive scenes alone."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

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
@click.pass_context
def command(ctx: click.Context) -> None:
    """Make meshes of the hard drive, and record what its scenes do."""
    ctx.with_resource(_plain_warnings())


@contextmanager
def _plain_warnings() -> Iterator[None]:
    """Print what the cache warns of as a line for the user, without the line of our source."""
    with warnings.catch_warnings():
        usual = warnings.showwarning

        def show(
            message: Warning | str, category: type[Warning], filename: str, lineno: int,
            file: TextIO | None = None, line: str | None = None,
        ) -> None:  # fmt: skip
            if category is UserWarning:
                click.echo(f"menid: warning: {message}", err=True)
            else:
                usual(message, category, filename, lineno, file, line)

        warnings.showwarning = show
        warnings.filterwarnings("default", module=r"menid_plan\.environments\.hdd\.cache")
        yield
