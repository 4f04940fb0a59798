"""A group of commands, each loaded when it is called."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from keyword import iskeyword
from typing import Any

import click


class LazyGroup(click.Group):
    """``commands`` tells for each name what is said of it; the module MODULE + NAME holds it.

    The module has the function ``command``; a dash in the name is an underscore there, and a word of
    Python's has an underscore behind it.
    """

    def __init__(
        self, *args: Any, module: str, texts: Mapping[str, str], heading: str = "Commands",
        **others: Any,
    ) -> None:  # fmt: skip
        super().__init__(*args, **others)
        self._module = module
        self._texts = texts
        self._heading = heading

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        """The names, sorted."""
        return sorted(self._texts)

    def get_command(
        self,
        ctx: click.Context,  # noqa: ARG002
        cmd_name: str,
    ) -> click.Command | None:
        """The command of that name, loaded now."""
        if cmd_name not in self._texts:
            return None
        name = f"{cmd_name}_" if iskeyword(cmd_name) else cmd_name.replace("-", "_")
        found = importlib.import_module(self._module + name).command
        assert isinstance(found, click.Command)
        return found

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands without loading them."""
        with formatter.section(self._heading):
            formatter.write_dl([(name, self._texts[name]) for name in self.list_commands(ctx)])
