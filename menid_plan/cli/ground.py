"""`menid ground`: how large a problem is, and its explicit model in files of other tools."""

from __future__ import annotations

import json
import resource
import time
from pathlib import Path
from typing import Any

import click

from menid_plan.cli.common import json_option, load_both, setting_option
from menid_plan.cli.tasks import Display, files_argument, max_states_option, tell_written
from menid_plan.errors import LimitError


@click.command("ground")
@files_argument
@click.option(
    "--env", "environment", metavar="NAME", help="The environment; by default the target."
)
@setting_option
@click.option(
    "--noise", type=click.Choice(["stay", "sink"]), default="stay", show_default=True,
    help="Where the noise outcome leads: nowhere, or to an absorbing state.",
)  # fmt: skip
@max_states_option
@click.option(
    "-o", "--output", type=click.Path(path_type=Path),
    help="Write the model: NAME.drn as DRN, else NAME.tra, .sta, .lab, .srew, .trew.",
)  # fmt: skip
@json_option
def command(
    files: tuple[str, ...],
    environment: str | None,
    settings: dict[str, float],
    noise: str,
    max_states: int,
    output: Path | None,
    as_json: bool,
) -> None:
    """Ground a problem and explore its reachable states.

    One file may hold both DOMAIN and PROBLEM, and a domain is also looked for beside its problem; `-`
    is standard input.

    Prints the number of facts, ground rules, states, transitions and dead ends, and what it took.
    """
    if output is not None and not output.name:
        raise click.UsageError(f"`{output}` is no name of a file")
    domain, problem = load_both(files)
    start = time.perf_counter()
    from menid_plan.exchange.explicit import write_drn, write_prism
    from menid_plan.grounding.ground import ground
    from menid_plan.mdp.explore import explore
    from menid_plan.mdp.probabilities import written

    startup = time.perf_counter() - start
    compiled = ground(domain, problem, settings)
    chances, happens = written(compiled, environment or domain.target)
    display = Display()
    try:
        with display.during("exploring"):
            structure = explore(
                compiled, happens, noise="sink" if noise == "sink" else "stay",
                max_states=max_states, progress=display.exploring,
            )  # fmt: skip
    except KeyboardInterrupt:
        raise LimitError(f"interrupted while exploring: {display.found}") from None
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
    paths: list[Path] = []
    if output is not None:
        mdp = structure.fill(chances)
        if output.suffix == ".drn":
            write_drn(structure, mdp, output)
            paths = [output]
        else:
            paths = write_prism(structure, mdp, output)
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
