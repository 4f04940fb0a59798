"""`menid init`: a domain and a problem to start from."""

from __future__ import annotations

import re
from importlib import resources
from pathlib import Path

import click

from menid_plan.language.grammar import lexer

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(-[A-Za-z0-9_]+)*", re.ASCII)


@click.command("init")
@click.argument("name")
@click.option(
    "-o", "--output", type=click.Path(file_okay=False, path_type=Path),
    help="The folder to write to; by default one called NAME.",
)  # fmt: skip
def command(name: str, output: Path | None) -> None:
    """Write a commented domain NAME and a problem for it that check cleanly.

    Writes domain.menid and problem.menid. Nothing that exists is overwritten.
    """
    if not _NAME.fullmatch(name) or name in lexer().reserved_words:
        raise click.UsageError(
            f"`{name}` can't be the name of a domain: use letters, digits, _ and inner hyphens, "
            "and none of the language's own words"
        )
    folder = output or Path(name)
    files = {
        folder / f"{kind}.menid": _template(kind).replace("NAME", name)
        for kind in ("domain", "problem")
    }
    for path in files:
        if path.exists():
            raise click.UsageError(f"{path} exists already; nothing was written")
    folder.mkdir(parents=True, exist_ok=True)
    for path, text in files.items():
        with path.open("x", encoding="utf-8", newline="\n") as file:
            file.write(text)
        click.echo(f"wrote {path}")
    click.echo(f"next: menid explain {folder / 'domain.menid'} {folder / 'problem.menid'}")


def _template(kind: str) -> str:
    return (resources.files("menid_plan.cli") / "templates" / f"{kind}.menid").read_text("utf-8")
