"""`menid env`: which kinds of environments there are, and whether one keeps to the protocol."""

from __future__ import annotations

import inspect
import json
from dataclasses import MISSING, asdict, fields, is_dataclass
from typing import TYPE_CHECKING, Any

import click

from menid_plan.cli.common import (
    existing_file,
    installed,
    json_option,
    load_both,
    print_plain,
    setting_option,
)

if TYPE_CHECKING:
    from menid_plan.environments.check import Report
    from menid_plan.environments.registry import Kind


@click.group("env")
def command() -> None:
    """Environments: where actions are executed."""


# ------------------------------------------------------------------------------------ menid env list


@command.command("list")
@click.argument("kind", required=False)
@json_option
def list_kinds(kind: str | None, as_json: bool) -> None:
    """List the kinds of environments that a run file can name, or tell all about one."""
    from menid_plan.environments.registry import kind_entry_points, load_kind

    names = [kind] if kind else sorted(kind_entry_points())
    found = [_described(name, load_kind(name)) for name in names]
    if as_json:
        click.echo(json.dumps({"kinds": found}, indent=2))
        return
    width = max((len(each["name"]) for each in found), default=0)
    for each in found:
        click.echo(f"{each['name']:{width}}  {each['promise']}{_needs(each)}")
    if kind:
        _show(found[0])


def _described(name: str, kind: type[Kind]) -> dict[str, Any]:
    return {
        "name": name,
        "promise": kind.promise,
        "needs": kind.needs,
        "available": not kind.needs or installed(kind.needs),
        "about": inspect.getdoc(kind) or "",
        "settings": {f.name: _setting(f) for f in fields(kind) if f.init},  # type: ignore[arg-type]
    }


def _setting(field: Any) -> dict[str, Any]:
    required = field.default is MISSING and field.default_factory is MISSING
    default = None if field.default is MISSING else field.default
    if not required and field.default is MISSING:
        default = field.default_factory()
    if is_dataclass(default) and not isinstance(default, type):
        default = asdict(default)
    return {"type": str(field.type), "required": required, "default": default}


def _needs(kind: dict[str, Any]) -> str:
    if not kind["needs"]:
        return ""
    return f" (needs {kind['needs']}{'' if kind['available'] else ', which is not installed'})"


def _show(kind: dict[str, Any]) -> None:
    click.echo(f"\n{kind['about'].replace('``', '`')}\n")
    width = max((len(name) for name in kind["settings"]), default=0)
    for name, setting in kind["settings"].items():
        default = "required" if setting["required"] else json.dumps(setting["default"])
        click.echo(f"  {name:{width}}  {setting['type']}, {default}")


# ----------------------------------------------------------------------------------- menid env check


@command.command("check")
@click.argument("files", nargs=-1, required=True, type=existing_file, metavar="DOMAIN PROBLEM")
@click.option(
    "--run",
    "run_file",
    required=True,
    metavar="FILE.toml",
    type=click.Path(exists=True, dir_okay=False),
    help="The run file that names the environments.",
)
@click.option(
    "--env",
    "names",
    multiple=True,
    metavar="NAME",
    help="Check that environment; may be given more than once. By default all.",
)
@click.option(
    "--executions",
    type=click.IntRange(1),
    default=5,
    show_default=True,
    metavar="N",
    help="Executions of each action in each state.",
)
@click.option(
    "--states",
    type=click.IntRange(1),
    default=10,
    show_default=True,
    metavar="N",
    help="Visit so many states at most.",
)
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="What the seeds of the executions follow from.",
)
@setting_option
@json_option
@click.pass_context
def check_environments(
    ctx: click.Context,
    files: tuple[str, ...],
    run_file: str,
    names: tuple[str, ...],
    executions: int,
    states: int,
    seed: int,
    settings: dict[str, float],
    as_json: bool,
) -> None:
    """Use an environment, and tell where it does not keep to the protocol.

    Exits with 1 if something is wrong with one.
    """
    from menid_plan.environments.check import check
    from menid_plan.environments.printing import prints_to_stderr
    from menid_plan.environments.runfile import read_run_file

    domain, problem = load_both(files)
    bound = read_run_file(run_file).bind(domain, problem, settings)
    known = {spec.name: spec for spec in bound.environments}
    for name in names:
        if name not in known:
            raise click.UsageError(f"`{run_file}` has no environment `{name}`: {', '.join(known)}")
    with prints_to_stderr():
        reports = [
            check(known[name], executions, seed, states) for name in dict.fromkeys(names or known)
        ]
    if as_json:
        click.echo(json.dumps({"environments": [_as_json(r) for r in reports]}, indent=2))
    else:
        for index, report in enumerate(reports):
            if index:
                click.echo()
            _show_report(report)
    if not all(report.is_right for report in reports):
        ctx.exit(1)


def _show_report(report: Report) -> None:
    import sys

    from rich.console import Console

    from menid_plan.cli.common import table

    click.echo(f"{report.environment}: {report.kind}")
    if report.capabilities is not None and report.capabilities.note:
        click.echo(f"  {report.capabilities.note}")
    for finding in report.findings:
        rest = f": {finding.details[0]}" if len(finding.details) == 1 else ""
        click.echo(f"  {finding.verdict.upper():4}  {finding.about}{rest}")
        for detail in finding.details if not rest else ():
            click.echo(f"          {detail}")
    if not report.tallies:
        return
    click.echo()
    console = Console(file=sys.stdout, highlight=False)
    shown = table(console, gap=2)
    for column in ("  action", "executions", "mean s"):
        shown.add_column(column, justify="left" if column == "  action" else "right")
    shown.add_column("what the domain sees in them")
    for tally in report.tallies:
        done = tally.executions - tally.failures
        seen = [f"{name} {count}" for name, count in sorted(tally.outcomes.items())]
        if tally.unexplained:
            seen.append(f"unexplained {tally.unexplained}")
        if tally.failures:
            seen.append(f"failed {tally.failures}")
        mean = f"{tally.seconds / done:.3g}" if done else "-"
        shown.add_row(f"  {tally.action}", str(tally.executions), mean, ", ".join(seen))
    with print_plain(console, sys.stdout):
        console.print(shown)


def _as_json(report: Report) -> dict[str, Any]:
    able = report.capabilities
    return {
        "environment": report.environment,
        "kind": report.kind,
        "right": report.is_right,
        "note": able.note if able else "",
        "capabilities": None if able is None else {
            "reset_to_any": able.reset_to_any,
            "repeatable": able.repeatable,
            "parallel": able.parallel,
        },
        "states": report.states,
        "findings": [
            {"about": f.about, "verdict": f.verdict, "details": list(f.details)}
            for f in report.findings
        ],
        "actions": [
            {
                "action": t.action,
                "executions": t.executions,
                "failures": t.failures,
                "seconds": t.seconds,
                "outcomes": dict(sorted(t.outcomes.items())),
                "unexplained": t.unexplained,
            }
            for t in report.tallies
        ],
    }  # fmt: skip
