"""`menid render`: pictures of an execution."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, cast

import click

from menid_plan.cli.common import distinct_outputs, environment_of, load_both
from menid_plan.files import replace_file
from menid_plan.grounding.semantics import Semantics
from menid_plan.grounding.state import GroundAction, State, state_text
from menid_plan.language.ground import read_action, read_state
from menid_plan.model.domain import Domain, Problem

if TYPE_CHECKING:
    from menid_plan.environments.hdd.environment import HddEnvironment


@click.command("render")
@click.argument("given", nargs=-1, required=True, metavar="DOMAIN PROBLEM ACTION")
@click.option(
    "--best", is_flag=True,
    help="In place of ACTION: the one that is best by the domain's numbers.",
)  # fmt: skip
@click.option(
    "--run", "run_file", required=True, metavar="FILE.toml",
    type=click.Path(exists=True, dir_okay=False),
    help="The run file that names the environments.",
)  # fmt: skip
@click.option("--env", "name", metavar="NAME", help="The environment; by default the target.")
@click.option(
    "--state", "state", metavar="ATOMS",
    help="The state, as in \"in(board, tray), loose(board)\"; by default that of `init`.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(0, 2**53 - 1), default=0, show_default=True)
@click.option(
    "-o", "--output", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE",
    help="Where to write it: .gif, .mp4, or .png with six pictures.",
)  # fmt: skip
@click.option("--gui", is_flag=True, help="Show it in PyBullet's window.")
def command(
    given: tuple[str, ...],
    best: bool,
    run_file: str,
    name: str | None,
    state: str | None,
    seed: int,
    output: Path | None,
    gui: bool,
) -> None:
    """Execute ACTION, such as "lever(n7)", in an environment with something to be seen.

    With --best in place of ACTION, the one that is best by the domain's numbers for the environment.
    The same seed gives the same pictures, and the state in which the execution ends is printed.
    """
    from menid_plan.environments.hdd.kind import Hdd
    from menid_plan.environments.interface import EnvironmentFailedError
    from menid_plan.environments.runfile import read_run_file

    kind = output.suffix.lower().removeprefix(".") if output else ""
    if output is None and not gui:
        raise click.UsageError("say where to write it (-o), or --gui to look at it")
    if output is not None and kind not in ("gif", "mp4", "png"):
        raise click.UsageError(f"{output}: the file's ending must be .gif, .mp4 or .png")
    files = given if best else given[:-1]
    if not files or (not best and Path(given[-1]).is_file()):
        raise click.UsageError("give DOMAIN, PROBLEM and ACTION, or --best in place of an action")
    if best and "(" in given[-1] and not Path(given[-1]).exists():
        raise click.UsageError(f"--best stands in place of an action: leave out `{given[-1]}`")
    for file in files:
        if file != "-" and not Path(file).is_file():
            raise click.UsageError(f"there is no file `{file}`")
    distinct_outputs([*files, run_file], output)
    domain, problem = load_both(files)
    start = None if state is None else read_state(state, domain, problem, "--state")
    bound = read_run_file(run_file).bind(domain, problem)
    spec = environment_of(bound, run_file, name)
    if not isinstance(spec.kind, Hdd):
        raise EnvironmentFailedError(
            f"environment `{spec.name}` of kind `{spec.kind.name}` has nothing to be seen; those of"
            " kind `hdd` have"
        )
    if best:
        chosen = _best(domain, problem, spec.name, start)
    else:
        chosen = GroundAction(*read_action(given[-1], domain, problem, "ACTION"))
    semantics = Semantics(domain, problem)
    if all(chosen != each for each, _ in semantics.applicable(start or semantics.initial_state)):
        click.echo(
            f"menid: by the domain's rules `{chosen}` does not apply in that state", err=True
        )
    environment = cast("HddEnvironment", spec.build())
    from menid_plan.environments.hdd import film

    if output is None:
        after = film.shown(environment, chosen, start, seed)
    else:
        found = film.film(environment, chosen, start, seed)
        replace_file(output, film.encoded(found, kind))
        after = found.state
        click.echo(f"wrote {output}", err=True)
    click.echo(f"{chosen}: {state_text(after)}")


def _best(domain: Domain, problem: Problem, environment: str, state: State | None) -> GroundAction:
    """The action to begin with, by the domain's numbers for an environment."""
    from menid_plan.planning import Task

    task = Task(domain, problem, environment)
    task.build()
    policy = task.policy(task.solve(task.solver("value-iteration")))
    found = policy.action(frozenset(problem.init) if state is None else state, problem.horizon)
    if found is None:
        raise click.UsageError("--best: no action is the best in that state")
    click.echo(f"the best action in {environment}: {found}", err=True)
    return found
