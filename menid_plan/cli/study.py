"""`menid study`: the studies of the paper and of this project, each loaded when it is called."""

from __future__ import annotations

import importlib

import click

# The module menid_plan.cli.study_NAME holds the function `command`.
_STUDIES = {
    "delta": "The delta bound and the true error as the sample grows.",
}


class _LazyStudies(click.Group):
    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002
        return sorted(_STUDIES)

    def get_command(
        self,
        ctx: click.Context,  # noqa: ARG002
        cmd_name: str,
    ) -> click.Command | None:
        if cmd_name not in _STUDIES:
            return None
        module = f"menid_plan.cli.study_{cmd_name.replace('-', '_')}"
        found = importlib.import_module(module).command
        assert isinstance(found, click.Command)
        return found

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Studies"):
            formatter.write_dl([(name, _STUDIES[name]) for name in self.list_commands(ctx)])


@click.group("study", cls=_LazyStudies)
def command() -> None:
    """Run a study: a table, a figure, and what they show."""
