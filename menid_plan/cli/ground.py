"""`menid ground`: how large a problem is, and its explicit model in files of other tools."""

from __future__ import annotations

import json
import resource
import time
from pathlib import Path
from typing import Any

import click

from menid_plan.cli.common import distinct_outputs, json_option, load_both
from menid_plan.cli.tasks import Display, TaskOptions, explore, task_options, tell_written


@click.command("ground")
@task_options
@click.option(
    "-o", "--output", type=click.Path(path_type=Path),
    help="Write the model: NAME.drn as DRN, else NAME.tra, .sta, .lab, .srew, .trew.",
)  # fmt: skip
@json_option
def command(
    files: tuple[str, ...],
    which: TaskOptions,
    output: Path | None,
    as_json: bool,
) -> None:
    """Ground a problem and explore its reachable states.

    One file may hold both DOMAIN and PROBLEM, and a domain is also looked for beside its problem; `-`
    is standard input.

    Prints the number of facts, ground rules, states, transitions and dead ends, and what it took.
    """
    if output is not None and (not output.name or output.is_dir()):
        raise click.UsageError(f"`{output}` is no name of a file")
    domain, problem = load_both(files)
    start = time.perf_counter()
    from menid_plan.exchange.explicit import model_paths, write_model
    from menid_plan.mdp.explore import warm

    paths = [] if output is None else model_paths(output)
    distinct_outputs(files, *paths)
    task = which.task(domain, problem)
    display = Display()
    with display.during("starting"):
        warm()
    startup = time.perf_counter() - start
    explore(task, display)
    structure, compiled = task.structure, task.structure.problem
    result: dict[str, Any] = {
        "facts": len(compiled.facts),
        "rules": len(compiled.rules),
        "actions": len(compiled.actions),
        "states": structure.states,
        "rows": len(structure.row_rule),
        "transitions": len(structure.next_state),
        "goals": int(structure.goal.sum()),
        "dead_ends": int(structure.dead_end.sum()),
        "seconds": {"startup": startup, "ground": compiled.seconds, "explore": structure.seconds},
        "megabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }
    if output is not None:
        write_model(structure, task.mdp, output)
    if as_json:
        click.echo(json.dumps(result, indent=2))
        tell_written(paths, err=True)
        return
    for name in ("facts", "rules", "actions", "states", "rows", "transitions", "goals"):
        click.echo(f"{name:12} {result[name]}")
    click.echo(f"{'dead ends':12} {result['dead_ends']}")
    seconds = ", ".join(f"{name} {value:.2f} s" for name, value in result["seconds"].items())
    click.echo(f"{'time':12} {seconds}")
    click.echo(f"{'memory':12} {result['megabytes']:.0f} MB")
    tell_written(paths, err=False)
