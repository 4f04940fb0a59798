"""The best policy by what was learned: all its decisions where they are few, else the likeliest way."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

from menid_plan.errors import LimitError, MeaningError
from menid_plan.exchange.drawing import Drawing, drawing_of
from menid_plan.grounding.state import SINK
from menid_plan.learning.counts import Evidence, learned_domain
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
    known; ``why`` says so. ``drawing`` has all decisions, or ``path`` the likeliest way, from the
    state ``start`` to ``end``.
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
        return Plan(best, states=task.structure.states, why=f"no policy is best: {solution.status}")
    chances = solution.goal_probability
    drawing, why, start, path, end = None, "", (), (), ""
    try:
        drawing = drawing_of(task.structure, task.mdp, solution)
    except LimitError as error:
        why = str(error)
        start, path, end = _likeliest(task, solution)
    return Plan(
        best, known_value(solution), str(task.action(row)),
        None if chances is None else float(chances[solution.initial]), task.structure.states,
        why, drawing, start, path, end,
    )  # fmt: skip


def _likeliest(task: Task, solution: Solution) -> tuple[tuple[str, ...], tuple[Step, ...], str]:
    """The initial state, the steps by the likeliest outcomes that lead on, and where they end."""
    structure, mdp = task.structure, task.mdp
    number, path, been = mdp.initial, [], set[int]()
    always = structure.problem.always
    start = frozenset(task.problem.init) - always
    while True:
        been.add(number)
        left = None if mdp.horizon is None else mdp.horizon - len(path)
        if mdp.goal[number]:
            return _atoms(start), tuple(path), "a goal"
        row = int(solution.policy[number])
        if solution.steps is not None and left is not None:
            row = solution.steps.row(number, left)
        if row < 0:
            return _atoms(start), tuple(path), "the end of the episode"
        if len(path) == MAX_STEPS:
            return _atoms(start), tuple(path), "and so on"
        chances: dict[int, float] = {}
        first, last = mdp.row_transition[row : row + 2].tolist()
        for next_, p in zip(
            mdp.next_state[first:last].tolist(), mdp.row_probabilities(row), strict=True
        ):
            chances[next_] = chances.get(next_, 0.0) + float(p)
        onward = {state: p for state, p in chances.items() if state not in been and p > 0.0}
        value = solution.value_of(number) if left in (None, mdp.horizon) else math.nan
        if not onward:
            step = Step(str(task.action(row)), value, sum(chances.values()), ())
            return _atoms(start), (*path, step), "a state that was come to before"
        next_ = max(onward, key=lambda state: onward[state])
        before, after = structure.state(number), structure.state(next_)
        changes: tuple[str, ...] = ("the sink of what no outcome describes",)
        if before is not SINK and after is not SINK:
            changes = tuple(
                [f"- {atom}" for atom in sorted(map(str, before - after))]
                + [f"+ {atom}" for atom in sorted(map(str, after - before))]
            )
        path.append(Step(str(task.action(row)), value, onward[next_], changes))
        number = next_


def _atoms(atoms: frozenset[Any]) -> tuple[str, ...]:
    return tuple(sorted(map(str, atoms)))
