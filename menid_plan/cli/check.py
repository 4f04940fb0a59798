"""`menid check`: every error of the files, in one run."""

from __future__ import annotations

import json

import click

from menid_plan.cli.common import existing_file, json_option, report_diagnostics
from menid_plan.language.check import CheckResult
from menid_plan.language.files import check_files


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
    if as_json:
        diagnostics = [d.as_json() for r in results for d in r.diagnostics]
        click.echo(json.dumps({"files": list(files), "diagnostics": diagnostics}, indent=2))
    else:
        for path, result in zip(files, results, strict=True):
            report_diagnostics(result.diagnostics)
            if not quiet:
                click.echo(f"{path}: {_summary(result)}")
    if any(r.has_errors for r in results):
        ctx.exit(3)


def _summary(result: CheckResult) -> str:
    errors = sum(d.is_error for d in result.diagnostics)
    if errors:
        return f"{errors} error{'s' if errors > 1 else ''}"
    parts = []
    if result.domain is not None:
        rules = sum(len(action.rules) for action in result.domain.actions)
        actions = len(result.domain.actions)
        parts.append(f"domain {result.domain.name} ({actions} actions, {rules} rules)")
    if result.problem is not None:
        parts.append(f"problem {result.problem.name} ({len(result.problem.objects)} objects)")
    return f"ok: {', '.join(parts) or 'nothing declared'}"
