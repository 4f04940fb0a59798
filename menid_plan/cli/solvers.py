"""`menid solvers`: which solvers are installed, what each promises and needs."""

from __future__ import annotations

import inspect
import json
from dataclasses import MISSING, fields, is_dataclass
from typing import Any

import click

from menid_plan.cli.common import installed, json_option


@click.command("solvers")
@click.argument("name", required=False)
@json_option
def command(name: str | None, as_json: bool) -> None:
    """List the installed solvers, or tell all about one: what it does, and its options."""
    from menid_plan.solving import load_solver, solver_entry_points

    names = [name] if name else sorted(solver_entry_points())
    found = [_described(each, load_solver(each)) for each in names]
    if as_json:
        click.echo(json.dumps({"solvers": found}, indent=2))
    elif name:
        _show(found[0])
    else:
        width = max((len(each["name"]) for each in found), default=0)
        for each in found:
            click.echo(f"{each['name']:{width}}  {each['promise']}")
            click.echo(f"{'':{width}}  {_kind(each)}{_needs(each)}")


def _described(name: str, kind: type[Any]) -> dict[str, Any]:
    needs = kind.needs
    return {
        "name": name,
        "promise": kind.promise,
        "solves": hasattr(kind, "solve"),
        "acts": hasattr(kind, "policy"),
        "asked": hasattr(kind, "choose"),
        "needs": needs,
        "available": not needs or installed(needs),
        "about": inspect.getdoc(kind) or "",
        "options": _options(kind),
    }


def _options(kind: type[Any]) -> dict[str, Any]:
    """The options with their defaults."""
    if not is_dataclass(kind):
        return {}
    return {f.name: None if f.default is MISSING else f.default for f in fields(kind) if f.init}


def _kind(solver: dict[str, Any]) -> str:
    words = ["solves"] if solver["solves"] else []
    words += ["acts step by step"] if solver["acts"] else []
    words += ["is asked for each action by `menid learn`"] if solver["asked"] else []
    return " and ".join(words)


def _needs(solver: dict[str, Any]) -> str:
    if not solver["needs"]:
        return ""
    return f"; needs {solver['needs']}" + (
        "" if solver["available"] else ", which is not installed"
    )


def _show(solver: dict[str, Any]) -> None:
    click.echo(f"{solver['name']}: {solver['promise']}")
    click.echo(f"{_kind(solver)}{_needs(solver)}\n\n{solver['about'].replace('``', '`')}\n")
    if solver["options"]:
        where = "by --option NAME=VALUE of solve and simulate"
        if solver["asked"]:
            where = "in `solver_options` of a run file"
        click.echo(f"options, to be set {where}:")
    width = max((len(option) for option in solver["options"]), default=0)
    for option, default in solver["options"].items():
        click.echo(f"  {option:{width}}  {'none' if default is None else default}")
