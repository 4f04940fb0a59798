"""`menid experiences`: what is in a store, and from a store to JSON lines and back."""

from __future__ import annotations

import json
import sys
from array import array
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from menid_plan.cli.common import (
    distinct_outputs,
    existing_file,
    json_option,
    load_both,
    print_plain,
    table,
)
from menid_plan.files import replacing

if TYPE_CHECKING:
    from menid_plan.experience.reading import StoreReader
    from menid_plan.experience.record import DistributionKey


@click.command("experiences", short_help="Show, export or import the experiences of a store.")
@click.argument("path", metavar="STORE", type=click.Path(path_type=Path))
@click.argument("problem_file", metavar="", required=False, type=existing_file)
@click.option(
    "--export", "target", metavar="FILE.jsonl", type=click.Path(dir_okay=False, allow_dash=True),
    help="Write the experiences as JSON lines; `-` is standard output.",
)  # fmt: skip
@click.option(
    "--import", "origin", metavar="FILE.jsonl", type=existing_file,
    help="Add the experiences of JSON lines, all or none; `-` is standard input.",
)  # fmt: skip
@click.option(
    "--domain", "domain_file", metavar="DOMAIN [PROBLEM]", type=existing_file,
    help="With --import, what a new store is for. An existing store must be for the same.",
)  # fmt: skip
@json_option
def command(
    path: Path,
    problem_file: str | None,
    target: str | None,
    origin: str | None,
    domain_file: str | None,
    as_json: bool,
) -> None:
    """Show what is in a store of experiences, by environment and by rule.

    STORE is a file, or the folder of a run. With --export, write it as JSON lines, one for each
    experience; with --import, add what such lines say. Lines that the store has already are left out.
    """
    from menid_plan.experience.store import Store

    if target is not None and origin is not None:
        raise click.UsageError("--export and --import do not go together")
    if problem_file is not None and domain_file is None:
        raise click.UsageError(
            f"`{problem_file}` is one argument too many; it stands after --domain"
        )
    if domain_file is not None and origin is None:
        raise click.UsageError("--domain goes with --import only")
    path = store_in(path)
    if origin is not None:
        read = [name for name in (origin, domain_file, problem_file) if name]
        distinct_outputs(read, *(Path(name) for name in files_of(path)[:1]))
        _import(path, origin, [f for f in (domain_file, problem_file) if f], as_json=as_json)
        return
    distinct_outputs(files_of(path), Path(target) if target not in (None, "-") else None)
    with Store.read(path) as store:
        if target is not None:
            _export(store, target)
        elif as_json:
            click.echo(json.dumps(_summary(store), indent=2))
        else:
            _show(_summary(store))


def store_in(path: Path) -> Path:
    """The store that a path leads to: itself, or where it is the folder of a run the store there."""
    if not path.is_dir():
        return path
    from menid_plan.learning.run import STORE

    return path / STORE


def files_of(store: Path) -> list[str]:
    """The files that make up a store while it is used, first the store; also where a link leads."""
    places = dict.fromkeys((store, store.resolve()))
    endings = ("", "-wal", "-shm", "-journal", ".lock")
    return [str(place.with_name(place.name + ending)) for place in places for ending in endings]


def _import(path: Path, origin: str, files: list[str], *, as_json: bool) -> None:
    from menid_plan.experience.lines import read_lines
    from menid_plan.experience.store import AlreadyThereError, Store, StoreInputError

    if not files and not path.exists():
        raise click.UsageError(
            f"there is no store `{path}`; a new one needs --domain DOMAIN PROBLEM"
        )
    fresh = not path.exists()
    name = "standard input" if origin == "-" else origin
    numbers = array("Q")  # of the lines with an experience

    def counted(lines: Iterable[bytes]) -> Iterable[bytes]:
        for number, line in enumerate(lines, start=1):
            if line.strip():
                numbers.append(number)
            yield line

    with click.open_file(origin, "rb") as stream:
        given = load_both(files) if files else None
        make = given is not None and (not path.exists() or path.stat().st_size == 0)
        store = Store.create(path, *given) if given and make else Store.resume(path)
        try:
            with store:
                if given is not None:
                    store.must_suit(*given)
                before = len(store)
                fresh = fresh and before == 0
                new = store.add(read_lines(counted(stream), store.domain, store.problem, name))
        except AlreadyThereError as error:
            line = f"`{name}`, line {numbers[error.index]}"
            raise StoreInputError(f"{line}: {error} (or a line before has)") from error
        except BaseException:
            if fresh:
                _remove(path)
            raise
    seen = len(numbers)
    if as_json:
        result = {"imported": new, "there_already": seen - new, "executions": before + new}
        click.echo(json.dumps(result, indent=2))
    else:
        rest = f", {seen - new} were there already" if seen > new else ""
        click.echo(f"imported {new} experience{'s' * (new != 1)}{rest}")


def _remove(path: Path) -> None:
    """Take away a store that came to nothing."""
    for name in ("", "-wal", "-shm", ".lock"):
        path.with_name(path.name + name).unlink(missing_ok=True)


def _export(store: StoreReader, target: str) -> None:
    from menid_plan.experience.lines import write_lines

    lines = write_lines(store.domain, store)
    if target == "-":
        for line in lines:
            click.echo(line, nl=False)
        return
    # The lines may be many, so they go straight into a file, which appears only when it is whole.
    with replacing(Path(target)) as stream:
        stream.writelines(line.encode() for line in lines)


def _summary(store: StoreReader) -> dict[str, Any]:
    """What is printed, by the keys of the JSON."""
    rules = {a.name: {r.name: r for r in a.rules} for a in store.domain.actions}
    places = {(a, r): i for i, (a, r) in enumerate((a, r) for a in rules for r in rules[a])}
    order = list(store.roles)

    def declared(pair: tuple[str, DistributionKey]) -> tuple[int, tuple[str, ...], int]:
        environment, key = pair
        return places[key.action, key.rule], key.values, order.index(environment)

    found = store.counts()
    counts = []
    for environment, key in sorted(found, key=declared):
        outcomes = rules[key.action][key.rule].outcomes
        counts.append(
            {
                "action": key.action,
                "rule": key.rule,
                "values": list(key.values),
                "environment": environment,
                "outcomes": {
                    o.name: n for o, n in zip(outcomes, found[environment, key], strict=True)
                },
            }
        )
    return {
        "store": str(store.path),
        "domain": store.domain.name,
        "problem": store.problem.name,
        "created": store.created,
        "seed": store.seed,
        "settings": store.settings,
        "environments": [
            {
                "environment": name,
                "role": store.roles[name],
                "executions": totals.executions,
                "seconds": totals.seconds,
                "reward": totals.reward if totals.rewarded else None,
                "rewarded": totals.rewarded,
                "explained": totals.explained,
                "noise": totals.noise,
                "unexplained": totals.unexplained,
            }
            for name, totals in store.totals().items()
        ],
        "rules": counts,
    }


def _show(summary: dict[str, Any]) -> None:
    from rich.console import Console

    seed = "" if summary["seed"] is None else f", seed {summary['seed']}"
    click.echo(f"domain {summary['domain']}, problem {summary['problem']}{seed}")
    console = Console(file=sys.stdout, highlight=False)
    with print_plain(console, sys.stdout):
        console.print()
        console.print(_environments(console, summary["environments"]))
        if summary["rules"]:
            console.print()
            console.print(_rules(console, summary["rules"]))


def _environments(console: Any, rows: list[dict[str, Any]]) -> Any:
    shown = table(console, gap=2)
    shown.add_column("environment")
    shown.add_column("role")
    for name in ("executions", "seconds", "reward", "explained", "noise", "unexplained"):
        shown.add_column(name, justify="right")
    for row in rows:
        reward = "" if row["reward"] is None else _number(row["reward"])
        shown.add_row(
            row["environment"], row["role"], str(row["executions"]), _number(row["seconds"]), reward,
            _number(row["explained"]), _number(row["noise"]), str(row["unexplained"]),
        )  # fmt: skip
    return shown


def _rules(console: Any, rows: list[dict[str, Any]]) -> Any:
    shown = table(console, gap=2)
    for name in ("rule", "environment", "outcomes"):
        shown.add_column(name)
    before = None
    for row in rows:
        per = f" for {', '.join(row['values'])}" if row["values"] else ""
        rule = f"{row['action']}.{row['rule']}{per}"
        outcomes = ", ".join(f"{name} {_number(count)}" for name, count in row["outcomes"].items())
        shown.add_row(rule if rule != before else "", row["environment"], outcomes)
        before = rule
    return shown


def _number(value: float) -> str:
    return f"{value:.10g}"
