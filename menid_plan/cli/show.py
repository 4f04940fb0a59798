"""`menid show`: what files declare, each rule as a table of outcomes by environments."""

from __future__ import annotations

import json
from pathlib import Path

import click
from rich.console import Console

from menid_plan.cli.common import (
    checked,
    existing_file,
    json_option,
    opened,
    output_option,
    print_plain,
)
from menid_plan.cli.show_json import domain_json, problem_json
from menid_plan.cli.show_text import show_domain, show_problem


@click.command("show")
@click.argument("files", nargs=-1, required=True, type=existing_file, metavar="FILE [FILE]")
@json_option
@output_option
def command(files: tuple[str, ...], as_json: bool, output: Path | None) -> None:
    """Show what a domain or a problem declares, each rule as a table.

    A cell is the probability of an outcome in an environment; in parentheses, how often it was
    observed there.
    """
    results = checked(files)
    domain = next((r.domain for r in results if r.domain is not None), None)
    problem = next((r.problem for r in results if r.problem is not None), None)
    with opened(output) as stream:
        if as_json:
            shown = {
                "domain": domain_json(domain) if domain else None,
                "problem": problem_json(problem) if problem else None,
            }
            stream.write(json.dumps(shown, indent=2) + "\n")
            return
        console = Console(file=stream, highlight=False)
        with print_plain(console, stream):
            if domain is not None:
                show_domain(domain, console)
            if domain is not None and problem is not None:
                console.print()
            if problem is not None:
                show_problem(problem, console)
