"""Which action to execute next: the model that the beliefs make, solved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import cast

import numpy as np

from menid_plan.grounding.ground import GroundProblem, ground
from menid_plan.grounding.state import GroundAction, State
from menid_plan.learning.counts import Evidence, SlotBelief
from menid_plan.mdp.distance import goal_distance
from menid_plan.mdp.explore import MAX_STATES, Structure, explore
from menid_plan.mdp.model import MDP, Floats, Ints
from menid_plan.model.domain import Domain, Problem
from menid_plan.solving import (
    AskedSolver,
    Belief,
    Objective,
    OnlinePolicy,
    OnlineSolver,
    Solution,
    Solver,
    load_solver,
)

# Models that are kept, the problem's own and those of states that it does not contain.
MAX_MODELS = 8


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
        solver: Solver | OnlineSolver | AskedSolver,
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
        """The action to take in a state, with so many steps left if there is a horizon.

        None where the solver knows none: at the end of an episode, or where the objective asks for
        what no action can do.
        """
        model, number = self._model(state)
        if self.is_asked:
            return self._asked(model, state, left)
        row = model.row(number, left)
        return None if row < 0 else model.action(row)

    def _asked(self, model: _Model, state: State, left: int | None) -> GroundAction | None:
        """What someone else chooses by the rules, with probabilities as they are believed."""
        solver = cast("AskedSolver", self.solver)
        domain = model.posterior.domain(self.rng if solver.draw else None)
        problem = replace(self.problem, init=tuple(sorted(state)), horizon=left)
        return solver.choose(domain, problem, self.params)

    @property
    def is_asked(self) -> bool:
        """Whether someone else is asked, who may answer in another way the next time."""
        return hasattr(self.solver, "choose")

    def best(self) -> tuple[GroundAction | None, float, float | None]:
        """The best first action of the problem by what was learned, its value, and the goal's chance.

        The last is the probability of the goal, None where the objective is another one than
        goal-then-reward. Where nothing was seen, what the domain gives counts; see `learned_domain`.
        """
        model, number = self._model(frozenset(self.problem.init))
        solution = model.solved(model.posterior.learned())
        row, chances = _row(solution, number, None), solution.goal_probability
        action = None if row < 0 else model.action(row)
        if self.objective != "goal-then-reward" or chances is None:
            return action, solution.value, None
        return action, solution.value, float(chances[number])

    @property
    def structure(self) -> Structure:
        """That of the problem itself, from its initial state."""
        return self._model(frozenset(self.problem.init))[0].structure

    def number(self, state: State) -> int | None:
        """The number of a state in `structure`; None if it is not there."""
        return self._model(frozenset(self.problem.init))[0].number(state)

    def learned(self) -> None:
        """Beliefs have changed."""
        for model in self._models:
            model.stale = True

    def certainty(self, state: State, left: int | None, draws: int) -> float:
        """How often the action that is best most often is the best, in so many drawn models."""
        model, number = self._model(state)
        return model.certainty(number, left, draws)

    def is_hopeless(self, state: State, left: int | None = None) -> bool:
        """Whether nothing counts any more: the objective is about a goal that is out of reach.

        That is so if no outcomes at all lead there in the steps that are left.
        """
        if self.objective == "reward":
            return False
        model, number = self._model(state)
        distance = int(model.goal_distance[number])
        return distance > (model.structure.states if left is None else left)

    def _model(self, state: State) -> tuple[_Model, int]:
        """A model that contains a state, and the state's number in it."""
        for model in self._models:
            number = model.number(state)
            if number is not None:
                return model, number
        problem = self.problem
        if state != frozenset(problem.init):
            problem = replace(problem, init=tuple(sorted(state)))
        compiled = ground(self.domain, problem, self.params)
        structure = explore(compiled, max_states=self.max_states)
        if len(self._models) == MAX_MODELS:
            del self._models[1]  # the first one, nearly always the problem's own, stays
        self._models.append(_Model(self, compiled, structure))
        return self._models[-1], 0


class _Model:
    """A structure and its policy."""

    def __init__(self, planner: Planner, compiled: GroundProblem, structure: Structure) -> None:
        self.planner = planner
        self.structure = structure
        self.posterior = SlotBelief(planner.evidence, compiled)
        self.stale = True
        self._left: int | None = None
        self._online: OnlinePolicy | None = None
        self._solution: Solution | None = None
        self._numbers = {
            structure.words[number].tobytes(): number
            for number in range(structure.states)
            if number != structure.sink
        }

    def number(self, state: State) -> int | None:
        """The number of a state; None if it was not explored."""
        words = self.structure.problem.pack(state)
        return None if words is None else self._numbers.get(words.tobytes())

    def action(self, row: int) -> GroundAction:
        """The action of a row."""
        return self.structure.action(row)

    def row(self, number: int, left: int | None) -> int:
        """The row to take in a state."""
        if hasattr(self.planner.solver, "policy"):
            return self._asked(number, left)
        if self.stale or self._solution is None:
            self._solution = self.solved(self.posterior.mean())
            self.stale = False
        if left is not None and self._solution.steps is None:  # it would have been too large
            return _row(self.solved(self.posterior.mean(), left), number, left)
        return _row(self._solution, number, left)

    def _asked(self, number: int, left: int | None) -> int:
        """The row that an online solver takes. It is asked about the steps that are left."""
        if self._online is None:
            belief = Belief(self._fill, self.posterior, self.planner.objective)
            self._online = cast("OnlineSolver", self.planner.solver).policy(
                belief, self.planner.rng
            )
        if (self.stale or left != self._left) and hasattr(self._online, "learned"):
            self._online.learned()
        self.stale, self._left = False, left
        return int(self._online.action(number))

    def _fill(self, probabilities: Floats) -> MDP:
        mdp = self.structure.fill(probabilities)
        return mdp if self._left is None else replace(mdp, horizon=self._left)

    def solved(self, probabilities: Floats, left: int | None = None) -> Solution:
        """The model with these probabilities solved, for its horizon or the steps that are left."""
        mdp = self.structure.fill(probabilities)
        if left is not None:
            mdp = replace(mdp, horizon=left)
        start = None
        if self._solution is not None and mdp.horizon is None:
            middle = (self._solution.lower + self._solution.upper) / 2
            start = np.nan_to_num(middle, posinf=0.0, neginf=0.0)
        solver = self.planner.solver
        if not hasattr(solver, "solve"):  # one that only acts: any that solves tells what is best
            solver = load_solver("value-iteration")()
        return cast("Solver", solver).solve(mdp, self.planner.objective, start=start)

    def certainty(self, number: int, left: int | None, draws: int) -> float:
        """How often the most frequent action is the best, over drawn models."""
        rows = [
            _row(self.solved(self.posterior.sample(self.planner.rng), left), number, left)
            for _ in range(draws)
        ]
        return float(np.unique(rows, return_counts=True)[1].max() / draws)

    @cached_property
    def goal_distance(self) -> Ints:
        """The least number of steps to a goal (int64[n]), whatever outcomes it takes."""
        slots = self.structure.problem.slots
        return goal_distance(self.structure.fill(np.ones(slots)))


def _row(solution: Solution, number: int, left: int | None) -> int:
    if solution.steps is not None:
        return solution.steps.row(number, solution.steps.horizon if left is None else left)
    return int(solution.policy[number])
