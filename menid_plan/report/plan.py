"""The best policy by what was learned: all its decisions where they are few, else the likeliest way."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import cast

from menid_plan.errors import LimitError, MeaningError
from menid_plan.exchange.drawing import Drawing, drawing_of
from menid_plan.grounding.state import SINK
from menid_plan.learning.counts import Evidence, learned_domain
from menid_plan.mdp.explore import Structure
from menid_plan.mdp.model import MDP
from menid_plan.model.domain import Problem
from menid_plan.planning import Task
from menid_plan.policy import known_value
from menid_plan.solving import Objective, Solution

# Past so many states the problem is not solved for a page.
MAX_STATES = 300_000
# Steps of the likeliest way that are shown.
MAX_STEPS = 20


@dataclass(frozen=True, slots=True)
class Step:
    """A step of the likeliest way: what is done, how probable the next state is, what changes.

    ``value`` is that of the state before; NaN where it is not known.
    """

    action: str
    value: float
    probability: float
    changes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Plan:
    """The best policy by what was learned.

    ``value`` (of the initial state) is NaN and ``action`` empty where nothing is best, or nothing is
    known. ``drawing`` has all decisions; where it has not, ``why`` says why not, and ``path`` is the
    likeliest way from the state ``start``, which ends as ``end`` says.
    """

    objective: str
    value: float = math.nan
    action: str = ""
    goal_probability: float | None = None
    states: int = 0
    why: str = ""
    drawing: Drawing | None = None
    start: tuple[str, ...] = ()
    path: tuple[Step, ...] = ()
    end: str = ""


def learned_plan(
    evidence: Evidence, problem: Problem, objective: str, params: Mapping[str, float]
) -> Plan:
    """Solve the problem by what was learned; ``objective`` is empty where it is the problem's own."""
    task = Task(
        learned_domain(evidence), problem, evidence.environments[0], params,
        max_states=MAX_STATES,
    )  # fmt: skip
    best = cast("Objective", objective or task.objective)
    try:
        task.explore()
        solution = task.solve(task.solver("value-iteration"), best)
    except (LimitError, MeaningError) as error:
        return Plan(best, why=str(error))
    row = int(solution.policy[solution.initial])
    if solution.status in ("unbounded", "infeasible") or row < 0:
        return Plan(best, states=task.structure.states, why=f"nothing is best ({solution.status})")
    chances = solution.goal_probability
    found = Plan(
        best, known_value(solution), str(task.action(row)),
        None if chances is None else float(chances[solution.initial]), task.structure.states,
    )  # fmt: skip
    try:
        return replace(found, drawing=drawing_of(task.structure, task.mdp, solution))
    except LimitError as error:
        found = replace(found, why=str(error))
    if task.mdp.horizon is not None and solution.steps is None:
        return found
    start = frozenset(problem.init) - task.structure.problem.always
    path, end = _likeliest(task, solution)
    return replace(found, start=tuple(sorted(map(str, start))), path=path, end=end)


def _likeliest(task: Task, solution: Solution) -> tuple[tuple[Step, ...], str]:
    """The steps from the initial state to the likeliest states that are new, and why they end."""
    mdp, number = task.mdp, task.mdp.initial
    been: set[int] = set()
    path: list[Step] = []
    while len(path) < MAX_STEPS:
        been.add(number)
        left = None if mdp.horizon is None else mdp.horizon - len(path)
        row = int(solution.policy[number])
        if solution.steps is not None and left is not None:
            row = solution.steps.row(number, left)
        if mdp.goal[number]:
            return tuple(path), "A goal is reached."
        if row < 0:
            return tuple(path), "There the episode ends."
        onward = {n: p for n, p in _leads_to(mdp, row).items() if p > 0.0 and n not in been}
        if not onward:
            return tuple(path), f"There {task.action(row)} leads to no other state."
        after = max(onward, key=lambda n: onward[n])
        value = solution.value_of(number) if left in (None, mdp.horizon) else math.nan
        changes = _changes(task.structure, number, after)
        path.append(Step(str(task.action(row)), value, onward[after], changes))
        number = after
    return tuple(path), "More steps are not shown."


def _leads_to(mdp: MDP, row: int) -> dict[int, float]:
    """The states to which a row leads, with their probabilities."""
    found: dict[int, float] = {}
    first, last = mdp.row_transition[row : row + 2].tolist()
    chances = mdp.row_probabilities(row).tolist()
    for state, chance in zip(mdp.next_state[first:last].tolist(), chances, strict=True):
        found[state] = found.get(state, 0.0) + chance
    return found


def _changes(structure: Structure, number: int, after: int) -> tuple[str, ...]:
    before, then = structure.state(number), structure.state(after)
    if before is SINK or then is SINK:
        return ("what no outcome describes",)
    return tuple(
        [f"- {atom}" for atom in sorted(map(str, before - then))]
        + [f"+ {atom}" for atom in sorted(map(str, then - before))]
    )
