"""`menid import ppddl`: from PPDDL files to domain.menid and problem.menid."""

from __future__ import annotations

from pathlib import Path

import click

from menid_plan.cli.common import distinct_outputs, existing_file, report_diagnostics
from menid_plan.cli.tasks import tell_written
from menid_plan.errors import InputError
from menid_plan.files import replace_file


@click.command("ppddl")
@click.argument("files", nargs=-1, required=True, type=existing_file, metavar="DOMAIN [PROBLEM]")
@click.option("--problem", metavar="NAME", help="Which problem, if the files hold several.")
@click.option(
    "-o", "--output", "folder", required=True, metavar="DIR",
    type=click.Path(file_okay=False, path_type=Path),
    help="The folder for domain.menid and problem.menid.",
)  # fmt: skip
def command(files: tuple[str, ...], problem: str | None, folder: Path) -> None:
    """Translate a PPDDL domain and problem, in one file or in two, into MENID."""
    from menid_plan.language.files import decode, load, parse_text, shown_name
    from menid_plan.language.write import write
    from menid_plan.ppddl.menid import menid
    from menid_plan.ppddl.read import read
    from menid_plan.ppddl.tables import TooLargeError

    paths = [folder / "domain.menid", folder / "problem.menid"]
    distinct_outputs(files, folder)
    sources, wrong = [], []
    for name in files:
        source, diagnostics = decode(load(name), shown_name(name))
        sources.append(source)
        wrong += diagnostics
    result = read(sources, problem and problem.lower())
    diagnostics = [*wrong, *result.diagnostics]
    if any(each.is_error for each in diagnostics):
        raise InputError(diagnostics)
    report_diagnostics(diagnostics, err=True)
    assert result.domain is not None
    assert result.problem is not None
    try:
        domain, made, _ = menid(result.domain, result.problem)
    except TooLargeError as error:
        raise InputError([error.diagnostic]) from error
    texts = [write(domain), write(made)]
    # What is written can be read: a fault of ours is better told here than in the next command.
    parse_text(texts[1], parse_text(texts[0]).domain)
    folder.mkdir(exist_ok=True)
    distinct_outputs(files, *paths)
    for path, text in zip(paths, texts, strict=True):
        replace_file(path, text.encode())
    tell_written(paths, err=False)
