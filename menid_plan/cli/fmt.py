"""`menid fmt`: the canonical layout, in place."""

from __future__ import annotations

import difflib
from pathlib import Path

import click

from menid_plan.cli.common import existing_file, report_diagnostics
from menid_plan.errors import LimitError
from menid_plan.files import replace_file
from menid_plan.language.files import MAX_BYTES, check_files, load
from menid_plan.language.layout import layout


@click.command("fmt")
@click.argument("files", nargs=-1, required=True, type=existing_file, metavar="FILE...")
@click.option("--check", is_flag=True, help="Write nothing; exit with 1 if a file would change.")
@click.option("--diff", is_flag=True, help="Write nothing; print what would change.")
@click.option("-q", "--quiet", is_flag=True, help="Do not name the files that change.")
@click.pass_context
def command(
    ctx: click.Context, files: tuple[str, ...], check: bool, diff: bool, quiet: bool
) -> None:
    """Bring files into the canonical layout, in place; `-` goes to standard output.

    Only white space changes: every word and comment stays. A file with errors is left as it is (exit
    code 3). A file keeps its kind of line ends.
    """
    changed = failed = False
    # Standard input can be read once, so all is read before anything is checked.
    before = {path: load(path) for path in dict.fromkeys(files)}
    results = check_files(list(before), contents=before)
    for (path, data), result in zip(before.items(), results, strict=True):
        errors = [d for d in result.diagnostics if d.is_error and d.code != "M213"]
        if errors:
            report_diagnostics(errors, err=True)
            click.echo(f"{path}: left as it is", err=True)
            failed = True
            continue
        after = _formatted(data)
        if len(after) > MAX_BYTES:
            raise LimitError(f"{path}: formatted it would be larger than {MAX_BYTES // 2**20} MiB")
        changed = changed or after != data
        if diff:
            click.echo(_diff(path, data, after), nl=False)
        elif path == "-" and not check:
            click.echo(after, nl=False)
        elif after != data:
            if not check:
                replace_file(Path(path), after)
            if not quiet:
                click.echo(f"{'would change' if check else 'formatted'} {path}", err=True)
    if failed:
        ctx.exit(3)
    if changed and (check or diff):
        ctx.exit(1)


def _formatted(data: bytes) -> bytes:
    assert len(data) <= MAX_BYTES
    text = data.decode("utf-8-sig")
    newline = "\r\n" if "\r\n" in text else "\n"
    formatted = layout(text.replace("\r\n", "\n").replace("\r", "\n"))
    return formatted.replace("\n", newline).encode("utf-8")


def _diff(path: str, before: bytes, after: bytes) -> str:
    lines = difflib.unified_diff(
        before.decode("utf-8-sig").splitlines(keepends=True),
        after.decode("utf-8").splitlines(keepends=True),
        path,
        f"{path} (formatted)",
    )
    return "".join(line if line.endswith("\n") else f"{line}\n" for line in lines)
