"""`menid simulate`: what a policy earns in episodes that are drawn at random."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from menid_plan.cli.common import json_option, load_both
from menid_plan.cli.tasks import (
    Display,
    SolvingOptions,
    TaskOptions,
    explore,
    number_json,
    number_text,
    solve,
    solving_options,
    task_options,
)
from menid_plan.errors import LimitError
from menid_plan.interrupts import Interrupts

if TYPE_CHECKING:
    import numpy as np

    from menid_plan.model.domain import Domain, Problem
    from menid_plan.planning import Task
    from menid_plan.policy import Policy
    from menid_plan.simulation import Chooser, Episodes, Estimate, Simulator
    from menid_plan.solving import Objective, Solution

_WIDTH = 80

# What the value of each objective is the expectation of.
_COMPARED = {
    "reward": "the mean return",
    "goal-then-reward": "the mean return until the goal is out of reach",
    "goal-probability": "the goal rate",
    "steps": "the mean number of steps",
}


@dataclass(frozen=True, slots=True)
class _Plan:
    """Where the actions come from; ``solution`` is None unless a solver made one beforehand.

    ``policy`` is that of a file, and ``differs`` says in what the task is another than that for which
    it was made: how it was, and how it is.
    """

    choose: Chooser
    text: str
    objective: Objective
    solution: Solution | None = None
    policy: Policy | None = None
    differs: Mapping[str, tuple[str, str]] = field(default_factory=dict)


@click.command("simulate")
@task_options
@solving_options
@click.option(
    "--policy", "source", required=True, metavar="FILE|SOLVER",
    help="A policy that `menid solve -o` wrote, or the name of a solver.",
)  # fmt: skip
@click.option("--episodes", type=click.IntRange(1), default=1000, show_default=True, metavar="N")
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, metavar="S",
    help="The same seed gives the same episodes.",
)  # fmt: skip
@click.option(
    "--max-steps", type=click.IntRange(1), metavar="N",
    help="Cut episodes off after so many steps; by default after 10000, or where discounting "
    "leaves less than a millionth.",
)  # fmt: skip
@click.option("--trace", is_flag=True, help="Print every episode step by step.")
@json_option
@click.pass_context
def command(
    ctx: click.Context,
    files: tuple[str, ...],
    which: TaskOptions,
    how: SolvingOptions,
    source: str,
    episodes: int,
    seed: int,
    max_steps: int | None,
    trace: bool,
    as_json: bool,
) -> None:
    """Draw episodes under a policy, and print what they earn on average.

    One file may hold both DOMAIN and PROBLEM, and a domain is also looked for beside its problem; `-`
    is standard input.

    With a policy from a file, the environment, the params, the noise and the objective are by default
    those for which it was made. Exits with 1 if a solver finds no policy.
    """
    domain, problem = load_both(files)
    import numpy as np

    policy = None
    options: dict[str, Any] = {}
    if _is_solver(source):
        options = how.of_solver(source)
    else:
        for name, value in {**how.common, "option": how.written or None}.items():
            if value is not None:
                option = name.replace("_", "-")
                raise click.UsageError(f"--{option} is for a solver; `{source}` is a file")
        policy = _read(source, domain, problem)
        which = replace(
            which, environment=which.environment or policy.environment,
            settings={**policy.params, **which.settings}, noise=which.noise or policy.noise,
        )  # fmt: skip
    task = which.task(domain, problem)
    rng = np.random.default_rng(seed)
    display = Display()
    if policy is not None:
        explore(task, display)
        plan = _of_file(task, policy, source, how.objective)
    else:
        plan = _of_solver(task, source, how.objective, options, rng, display)
    solution = plan.solution
    if solution is not None and float(solution.lower[solution.initial]) == math.inf:
        # Of rewards without bound, or a goal that is never sure; where all is lost any policy will do.
        click.echo(f"menid: {solution.status}: {solution.message}", err=True)
        ctx.exit(1)
    simulator = task.simulator()
    drawn = _run(simulator, plan, episodes, rng, max_steps, display, trace=trace)
    if as_json:
        click.echo(json.dumps(_result(task, plan, drawn, seed), indent=2))
    else:
        if trace:
            for line in _traces_text(task, drawn):
                click.echo(line)
        for name, text in _summary(task, plan, drawn, seed):
            for line in _wrapped(f"{name:13}", text, 13):
                click.echo(line)
    if drawn.interrupted:
        raise LimitError(f"interrupted after {drawn.max_steps} steps of every episode")


def _is_solver(source: str) -> bool:
    from menid_plan.solving import solver_entry_points

    return source in solver_entry_points()


def _read(source: str, domain: Domain, problem: Problem) -> Policy:
    from menid_plan.policy_file import read_policy
    from menid_plan.solving import solver_entry_points

    path = Path(source)
    if not path.exists() and "." not in path.name and "/" not in source:
        known = ", ".join(sorted(solver_entry_points())) or "none"
        raise click.UsageError(
            f"`{source}` is neither a file nor a solver; the solvers are: {known}"
        )
    return read_policy(path.read_bytes(), domain, problem, source)


def _of_file(task: Task, policy: Policy, source: str, objective: Objective | None) -> _Plan:
    from menid_plan.policy import file_chooser

    wanted = objective or policy.objective
    early = "; its solver stopped early" if policy.status == "limit" else ""
    text = f"{source}, for {policy.objective}{early}"
    return _Plan(
        file_chooser(policy, task.simulator(), source), text, wanted, policy=policy,
        differs=_differences(task, policy, wanted),
    )  # fmt: skip


def _differences(task: Task, policy: Policy, objective: Objective) -> dict[str, tuple[str, str]]:
    """In what a task is another than the one that a policy was made for: how it was, how it is."""
    from menid_plan.model.domain import param_values

    made = param_values(task.domain, task.problem, policy.params)
    now = param_values(task.domain, task.problem, task.params)
    pairs = {
        "environment": (policy.environment, task.environment),
        "noise": (policy.noise, task.noise),
        "objective": (policy.objective, objective),
        **{f"param {name}": (str(made[name]), str(now[name])) for name in task.params},
    }
    return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}


def _of_solver(
    task: Task,
    name: str,
    objective: Objective | None,
    options: dict[str, Any],
    rng: np.random.Generator,
    display: Display,
) -> _Plan:
    from menid_plan.simulation import chooser, online
    from menid_plan.solving import load_solver

    wanted = objective or task.objective
    if not hasattr(load_solver(name), "solve"):
        deciding = task.online_solver(name, **options)
        explore(task, display)
        policy = online(task.online_policy(deciding, rng, wanted))
        return _Plan(policy, f"{name}, for {wanted}, decides step by step", wanted)
    solver = task.solver(name, **options)
    explore(task, display)
    solution = solve(task, solver, wanted, display)
    steps = task.mdp.horizon
    if steps and solution.steps is None and solution.status == "solved":
        why = solution.message or "it gives none for the steps of a horizon"
        raise LimitError(f"the solver `{name}` has no policy to simulate: {why}")
    early = f"; it stopped early: {solution.message}" if solution.status == "limit" else ""
    return _Plan(chooser(solution), f"{name}, for {wanted}{early}", wanted, solution)


def _run(
    simulator: Simulator,
    plan: _Plan,
    episodes: int,
    rng: np.random.Generator,
    max_steps: int | None,
    display: Display,
    *,
    trace: bool,
) -> Episodes:
    interrupts = Interrupts()

    def told(steps: int, running: int) -> None:
        display.simulating(steps, running)
        interrupts.check()

    with interrupts, display.during("simulating"):
        return simulator.run(
            plan.choose, episodes, rng, max_steps=max_steps, trace=trace, progress=told,
            hopeless="goal-then-reward" in (plan.objective, plan.policy and plan.policy.objective),
        )  # fmt: skip


def _shown(estimate: Estimate) -> str:
    if math.isnan(estimate.error):
        return f"{estimate.mean:.6g}"
    return f"{estimate.mean:.6g} +- {estimate.error:.2g}"


def _result(task: Task, plan: _Plan, drawn: Episodes, seed: int) -> dict[str, Any]:
    """What is printed, by the keys of the JSON."""
    from menid_plan.policy import known_value
    from menid_plan.simulation import Estimate

    returns, rate = Estimate.of(drawn.returns), Estimate.of(drawn.goal)
    compared = drawn.of_objective(plan.objective)
    solution, policy = plan.solution, plan.policy
    by = policy or solution
    result: dict[str, Any] = {
        "episodes": len(drawn.returns),
        "mean": returns.mean,
        "standard_error": number_json(returns.error),
        "goal_rate": rate.mean if task.mdp.has_goal else None,
        "goal_rate_error": number_json(rate.error) if task.mdp.has_goal else None,
        "steps": float(drawn.steps.mean()),
        "cut": int(drawn.cut.sum()),
        "max_steps": drawn.max_steps,
        "seed": seed,
        "environment": task.environment,
        "objective": plan.objective,
        "objective_mean": compared.mean,
        "objective_error": number_json(compared.error),
        "value": None if solution is None else number_json(known_value(solution)),
        "policy_value": None if policy is None else number_json(policy.value),
        "policy_lower": None if policy is None else number_json(policy.lower),
        "policy_upper": None if policy is None else number_json(policy.upper),
        "policy_status": None if by is None else by.status,
        "differs": {name: {"made": made, "now": now} for name, (made, now) in plan.differs.items()},
    }
    if drawn.traces is not None:
        result["traces"] = [list(_steps(task, drawn, i)) for i in range(len(drawn.returns))]
    return result


def _summary(task: Task, plan: _Plan, drawn: Episodes, seed: int) -> Iterator[tuple[str, str]]:
    from menid_plan.policy import known_value
    from menid_plan.simulation import Estimate

    discount = task.mdp.discount
    kind = "" if discount == 1.0 else f", discounted by {discount:g}"
    yield "policy", plan.text
    yield "environment", task.environment
    yield "episodes", f"{len(drawn.returns)}, seed {seed}"
    yield "mean return", f"{_shown(Estimate.of(drawn.returns))}{kind}"
    if plan.objective == "goal-then-reward":
        yield "", f"{_shown(drawn.of_objective(plan.objective))} until the goal is out of reach"
    if task.mdp.has_goal:
        yield "goal rate", _shown(Estimate.of(drawn.goal))
    yield "steps", _shown(Estimate.of(drawn.steps))
    yield "cut", _cut(task, drawn)
    solution, policy = plan.solution, plan.policy
    if solution is not None:
        value, first = known_value(solution), solution.initial
        bounds = float(solution.lower[first]), float(solution.upper[first])
        yield "value", _value("the solver", solution.objective, value, bounds, drawn)
    if policy is not None:
        bounds = policy.lower, policy.upper
        yield "value", _value("the file", policy.objective, policy.value, bounds, drawn)
    if plan.differs:
        was = "; ".join(f"{name} {made}, here {now}" for name, (made, now) in plan.differs.items())
        # The value is compared by the objective that it is for.
        rightly = (
            "" if plan.differs.keys() == {"objective"} else ". So the mean may rightly be another"
        )
        yield "differs", f"the policy was made for {was}{rightly}"


def _cut(task: Task, drawn: Episodes) -> str:
    number = int(drawn.cut.sum())
    if number == 0:
        return "none"
    text = f"{number} after {drawn.max_steps} steps"
    if math.isfinite(drawn.lacking):
        text += f"; what is left out of each is at most {drawn.lacking:.2g}"
    else:
        text += "; what they would still earn is left out"
    return text + (", and counts as no goal" if task.mdp.has_goal else "")


def _value(
    who: str, objective: Objective, value: float, bounds: tuple[float, float], drawn: Episodes
) -> str:
    """What a policy is said to be worth, and how far the mean is from that."""
    text = f"{number_text(value, '.6g')} by {who}, for {_COMPARED[objective]}"
    if math.isnan(value):
        return f"{text}, but between {bounds[0]:g} and {bounds[1]:g}"
    estimate = drawn.of_objective(objective)
    if math.isinf(value) or math.isnan(estimate.error):
        return text
    if estimate.error == 0.0:
        return f"{text}; every episode gives {estimate.mean:.6g}"
    away = abs(estimate.mean - value) / estimate.error
    return f"{text}, which is {away:.1f} standard errors away"


# ----------------------------------------------------------------------------------------- traces


def _steps(task: Task, drawn: Episodes, episode: int) -> Iterator[dict[str, Any]]:
    """The steps of an episode, as the JSON has them."""
    from menid_plan.grounding.state import SINK

    traces, structure, mdp = drawn.traces, task.structure, task.mdp
    assert traces is not None
    problem = structure.problem
    before = structure.state(mdp.initial)
    span = slice(int(traces.first[episode]), int(traces.first[episode + 1]))
    columns = (traces.row[span], traces.transition[span], traces.reward[span])
    for row, transition, reward in zip(*(c.tolist() for c in columns), strict=True):
        number = int(structure.row_rule[row])
        rule = problem.rules[number]
        distribution = problem.distributions[problem.rule_distribution[number]]
        slot = int(structure.slot(transition))
        after = structure.state(int(mdp.next_state[transition]))
        assert before is not SINK
        arrived = before if after is SINK else after
        yield {
            "action": str(rule.action),
            "rule": rule.rule.name,
            "binding": dict(rule.binding),
            "outcome": rule.rule.outcomes[slot - distribution.start].name,
            "reward": reward,
            "added": sorted(str(atom) for atom in arrived - before),
            "deleted": sorted(str(atom) for atom in before - arrived),
            "ends": _end(task, int(mdp.next_state[transition])),
        }
        before = after


def _end(task: Task, state: int) -> str:
    """What a state ends an episode as; empty if it does not."""
    if task.mdp.goal[state]:
        return "goal"
    if state == task.structure.sink:
        return "sink"
    return "dead end" if task.structure.dead_end[state] else ""


def _traces_text(task: Task, drawn: Episodes) -> Iterator[str]:
    structure = task.structure
    always = structure.problem.always
    start = task.structure.problem.unpack(structure.words[task.mdp.initial]) - always
    shown = ", ".join(sorted(map(str, start))) or "none of what may change holds"
    for episode in range(len(drawn.returns)):
        yield from _wrapped(f"episode {episode + 1}: ", shown)
        number, end = 0, _end(task, task.mdp.initial)
        for number, step in enumerate(_steps(task, drawn, episode), start=1):
            binding = ", ".join(f"{name} = {value}" for name, value in step["binding"].items())
            rule = step["rule"] + (f" ({binding})" if binding else "")
            yield from _wrapped(f"{number:4}  ", f"{step['action']}, by rule {rule}")
            changes = [f"- {a}" for a in step["deleted"]] + [f"+ {a}" for a in step["added"]]
            text = f"{step['outcome']}, reward {step['reward']:g}: "
            end = step["ends"]
            if end == "sink":
                changes = ["falls into the sink"]
            yield from _wrapped("      ", text + (", ".join(changes) or "nothing changes"))
        ending = _ending(drawn, episode, number, end)
        yield f"      {ending}, return {drawn.returns[episode]:g}"
        yield ""


def _ending(drawn: Episodes, episode: int, steps: int, end: str) -> str:
    """How an episode ended."""
    count = f"{steps} step{'s' * (steps != 1)}"
    if drawn.cut[episode]:
        return f"cut off after {count}"
    if end:
        return f"in {'a' if end == 'dead end' else 'the'} {end} after {count}"
    return f"at the horizon after {count}"


def _wrapped(head: str, text: str, indent: int = 10) -> list[str]:
    return textwrap.wrap(
        text, _WIDTH, initial_indent=head, subsequent_indent=" " * indent,
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip
