"""Which action to execute next: the model that the beliefs make, solved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import cast

import numpy as np

from menid_plan.grounding.ground import GroundProblem, ground
from menid_plan.grounding.state import GroundAction, State
from menid_plan.learning.counts import Evidence, SlotBelief
from menid_plan.mdp.explore import MAX_STATES, Structure, explore
from menid_plan.mdp.model import Floats
from menid_plan.model.domain import Domain, Problem
from menid_plan.solving import (
    Belief,
    Objective,
    OnlinePolicy,
    OnlineSolver,
    Solution,
    Solver,
    load_solver,
)


class Planner:
    """Chooses actions by what is believed, with any solver.

    The problem is grounded and explored once, with every outcome taken for possible, and refilled as
    beliefs change. A state that this does not contain (an environment may do what the domain does not
    foresee) starts a model of its own.
    """

    def __init__(
        self,
        domain: Domain,
        problem: Problem,
        evidence: Evidence,
        solver: Solver | OnlineSolver,
        objective: Objective,
        rng: np.random.Generator,
        params: Mapping[str, float] | None = None,
        max_states: int = MAX_STATES,
    ) -> None:
        self.domain = domain
        self.problem = problem
        self.evidence = evidence
        self.solver = solver
        self.objective = objective
        self.rng = rng
        self.params = params or {}
        self.max_states = max_states
        self._models: list[_Model] = []

    def decide(self, state: State, left: int | None = None) -> GroundAction | None:
        """The action to take in a state, with so many steps left if there is a horizon."""
        model, number = self._model(state)
        row = model.row(number, left)
        return None if row < 0 else model.action(row)

    def best(self) -> tuple[GroundAction | None, float]:
        """The best first action of the problem by the estimates, and the objective's value."""
        model, number = self._model(frozenset(self.problem.init))
        solution = model.solved(model.posterior.mean())
        row = _row(solution, number, None)
        middle = float(solution.lower[number] + solution.upper[number]) / 2
        return (None if row < 0 else model.action(row)), middle

    def learned(self) -> None:
        """Beliefs have changed."""
        for model in self._models:
            model.stale = True

    def certainty(self, state: State, draws: int) -> float:
        """How often the first action is the most frequent one, if so many models are drawn."""
        model, number = self._model(state)
        return model.certainty(number, draws)

    def _model(self, state: State) -> tuple[_Model, int]:
        for model in self._models:
            number = model.number(state)
            if number is not None:
                return model, number
        problem = self.problem
        if state != frozenset(problem.init):
            problem = replace(problem, init=tuple(sorted(state)))
        compiled = ground(self.domain, problem, self.params)
        structure = explore(compiled, max_states=self.max_states)
        self._models.append(_Model(self, compiled, structure))
        return self._model(state)


class _Model:
    """A structure and its policy."""

    def __init__(self, planner: Planner, compiled: GroundProblem, structure: Structure) -> None:
        self.planner = planner
        self.structure = structure
        self.posterior = SlotBelief(planner.evidence, compiled)
        self.stale = True
        self._online: OnlinePolicy | None = None
        self._solution: Solution | None = None
        self._numbers = {
            structure.words[number].tobytes(): number
            for number in range(structure.states)
            if number != structure.sink
        }
        self._facts = frozenset(compiled.facts)

    def number(self, state: State) -> int | None:
        """The number of a state; None if it was not explored."""
        compiled = self.structure.problem
        if state - self._facts != compiled.always:
            return None
        return self._numbers.get(compiled.pack(state).tobytes())

    def action(self, row: int) -> GroundAction:
        """The action of a row."""
        return self.structure.problem.actions[int(self.structure.row_action[row])]

    def row(self, number: int, left: int | None) -> int:
        """The row to take in a state."""
        solver = self.planner.solver
        if hasattr(solver, "policy"):
            if self._online is None:
                belief = Belief(self.structure.fill, self.posterior, self.planner.objective)
                self._online = solver.policy(belief, self.planner.rng)
            if self.stale and hasattr(self._online, "learned"):
                self._online.learned()
            self.stale = False
            return int(self._online.action(number))
        if self.stale or self._solution is None:
            self._solution = self.solved(self.posterior.mean())
            self.stale = False
        return _row(self._solution, number, left)

    def solved(self, probabilities: Floats) -> Solution:
        """The model with these probabilities, solved."""
        mdp = self.structure.fill(probabilities)
        start = None
        if self._solution is not None and mdp.horizon is None:
            middle = (self._solution.lower + self._solution.upper) / 2
            start = np.nan_to_num(middle, posinf=0.0, neginf=0.0)
        solver = self.planner.solver
        if not hasattr(solver, "solve"):  # one that only acts: any that solves tells what is best
            solver = load_solver("value-iteration")()
        return cast("Solver", solver).solve(mdp, self.planner.objective, start=start)

    def certainty(self, number: int, draws: int) -> float:
        """How often the most frequent first action is the best, over drawn models."""
        rows = [
            _row(self.solved(self.posterior.sample(self.planner.rng)), number, None)
            for _ in range(draws)
        ]
        return float(np.unique(rows, return_counts=True)[1].max() / draws)


def _row(solution: Solution, number: int, left: int | None) -> int:
    if solution.steps is not None:
        return solution.steps.row(number, solution.steps.horizon if left is None else left)
    return int(solution.policy[number])
