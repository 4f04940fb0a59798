"""`menid explain`: which actions apply in a state, why or why not, and what they lead to."""

from __future__ import annotations

import json
from pathlib import Path

import click
from rich.console import Console

from menid_plan.cli.common import (
    existing_file,
    json_option,
    load_both,
    opened,
    output_option,
    print_plain,
)
from menid_plan.cli.explain_text import show_action, show_state
from menid_plan.errors import InputError
from menid_plan.grounding.explain import explain
from menid_plan.grounding.semantics import Semantics
from menid_plan.grounding.state import GroundAction
from menid_plan.language.ground import read_action, read_state
from menid_plan.source import Diagnostic

# Steps of evaluation for one answer: a few seconds' worth.
_WORK_LIMIT = 2_000_000


@click.command("explain")
@click.argument(
    "arguments", nargs=-1, required=True, metavar="DOMAIN PROBLEM [ACTION...]", type=str
)
@click.option(
    "--state", "state_text", metavar="ATOMS",
    help="The state, as in \"in(board, tray), loose(board)\"; by default that of `init`.",
)  # fmt: skip
@click.option("-v", "--verbose", is_flag=True, help="List actions that do not apply, however many.")
@json_option
@output_option
@click.pass_context
def command(
    ctx: click.Context,
    arguments: tuple[str, ...],
    state_text: str | None,
    verbose: bool,
    as_json: bool,
    output: Path | None,
) -> None:
    """Show which actions apply in a state, and why or why not.

    With an ACTION such as "lever(n1)": for each of its rules, what its references name, which part
    of its condition fails, and, for the rule that covers, what each outcome changes and pays.

    Exits with 3 if two rules of an action cover the state.
    """
    files, actions = _split(arguments)
    domain, problem = load_both(files)
    semantics = Semantics(domain, problem, work_limit=_WORK_LIMIT)
    state = semantics.initial_state
    if state_text is not None:
        state = read_state(state_text, domain, problem, "--state")
    chosen: list[GroundAction] = []
    wrong: list[Diagnostic] = []
    for text in actions:
        try:
            chosen.append(GroundAction(*read_action(text, domain, problem, "ACTION")))
        except InputError as error:
            wrong.extend(error.diagnostics)
    if wrong:
        raise InputError(wrong)
    explanation = explain(semantics, state, chosen or None)
    with opened(output) as stream:
        if as_json:
            stream.write(json.dumps(explanation.as_json(), indent=2) + "\n")
        else:
            console = Console(file=stream, highlight=False)
            with print_plain(console, stream):
                show_state(explanation, console, list_actions=not chosen, verbose=verbose)
                for action in explanation.actions if chosen else ():
                    console.print()
                    show_action(action, console)
    if any(action.conflict for action in explanation.actions):
        ctx.exit(3)  # two rules that cover one state are an error of the domain


def _split(arguments: tuple[str, ...]) -> tuple[list[str], list[str]]:
    """Files come first: `-`, or what exists or looks like one; the rest are actions."""
    files: list[str] = []
    for argument in arguments:
        is_file = argument == "-" or argument.endswith(".menid") or Path(argument).is_file()
        if not is_file or len(files) == 2:
            break
        files.append(argument)
    if not files:
        raise click.UsageError(f"`{arguments[0]}` is no file; give DOMAIN PROBLEM [ACTION...]")
    for file in files:
        existing_file.convert(file, None, None)
    return files, list(arguments[len(files) :])
