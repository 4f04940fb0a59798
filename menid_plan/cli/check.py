"""`menid check`: every error of the files, in one run."""

from __future__ import annotations

import json

import click

from menid_plan.cli.common import existing_file, json_option, report_diagnostics
from menid_plan.language.check import CheckResult
from menid_plan.language.files import check_files, shown_name
from menid_plan.language.report import counted


@click.command("check")
@click.argument("files", nargs=-1, required=True, type=existing_file, metavar="FILE...")
@json_option
@click.option("-q", "--quiet", is_flag=True, help="Print errors and warnings alone.")
@click.pass_context
def command(ctx: click.Context, files: tuple[str, ...], as_json: bool, quiet: bool) -> None:
    """Report every error in domain and problem files; exit with 3 if there is one.

    The domain of a problem is looked for among the FILEs, then beside it (domain.menid, or a file
    that declares that name).
    """
    results = check_files(files)
    names = [shown_name(path) for path in files]
    if as_json:
        diagnostics = [d.as_json() for r in results for d in r.diagnostics]
        click.echo(json.dumps({"files": names, "diagnostics": diagnostics}, indent=2))
    else:
        for path, result in zip(names, results, strict=True):
            report_diagnostics(result.diagnostics)
            if not quiet:
                click.echo(f"{path}: {_summary(result)}")
    if any(r.has_errors for r in results):
        ctx.exit(3)


def _summary(result: CheckResult) -> str:
    errors = sum(d.is_error for d in result.diagnostics)
    if errors:
        return counted(errors, "error")
    parts = []
    if result.domain is not None:
        rules = counted(sum(len(action.rules) for action in result.domain.actions), "rule")
        actions = counted(len(result.domain.actions), "action")
        parts.append(f"domain {result.domain.name} ({actions}, {rules})")
    if result.problem is not None:
        objects = counted(len(result.problem.objects), "object")
        parts.append(f"problem {result.problem.name} ({objects})")
    return f"ok: {', '.join(parts) or 'nothing declared'}"
