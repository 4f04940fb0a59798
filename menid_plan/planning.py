"""From a domain and a problem to a solved MDP: grounding, exploring, filling, solving in a row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from menid_plan.grounding.ground import ground
from menid_plan.grounding.semantics import Noise
from menid_plan.grounding.state import SINK, GroundAction
from menid_plan.mdp.explore import MAX_STATES, Progress, Structure, explore
from menid_plan.mdp.model import MDP
from menid_plan.mdp.probabilities import written
from menid_plan.model.domain import Domain, Problem
from menid_plan.solving import Objective, Solution, Solver, load_solver, natural_objective


class Task:
    """A problem to be solved in one environment, with params set and noise read in one way."""

    def __init__(
        self,
        domain: Domain,
        problem: Problem,
        environment: str | None = None,
        params: Mapping[str, float] | None = None,
        noise: Noise = "stay",
        max_states: int = MAX_STATES,
    ) -> None:
        self.domain = domain
        self.problem = problem
        self.environment = environment or domain.target
        self.params = params or {}
        self.noise: Noise = noise
        self.max_states = max_states
        self.structure: Structure
        self.mdp: MDP

    def build(self, progress: Progress | None = None) -> MDP:
        """Ground, explore what happens in the environment, and fill in its probabilities."""
        compiled = ground(self.domain, self.problem, self.params)
        chances, happens = written(compiled, self.environment)
        self.structure = explore(
            compiled, happens, noise=self.noise, max_states=self.max_states, progress=progress
        )
        self.mdp = self.structure.fill(chances)
        return self.mdp

    @property
    def objective(self) -> Objective:
        """The objective that the problem has by itself."""
        discount = self.problem.discount
        return natural_objective(
            has_goal=self.problem.goal is not None,
            discount=None if discount == 1 else discount,
            horizon=self.problem.horizon,
            has_dead_end_reward=self.problem.dead_end_reward is not None,
        )

    @staticmethod
    def solver(name: str, **options: Any) -> Solver:
        """A solver with those of the options that it has."""
        kind = load_solver(name)
        known: set[str] = {f.name for f in fields(kind)} if is_dataclass(kind) else set()
        return kind(**{key: value for key, value in options.items() if key in known})

    @staticmethod
    def warm(solver: Solver) -> None:
        """Load what is compiled of a solver, on an MDP of one step."""
        one = np.zeros(1, np.int32)
        mdp = MDP(
            np.array([0, 1, 1]), one, np.ones(1), np.array([0, 1]), np.ones(1, np.int32),
            np.ones(1), np.array([False, True]), has_goal=True, discount=0.5,
        )  # fmt: skip
        solver.solve(mdp, "reward")

    def solve(self, solver: Solver, objective: str | None = None) -> Solution:
        """Solve what was built."""
        return solver.solve(self.mdp, objective or self.objective)  # type: ignore[arg-type]

    def action(self, row: int) -> GroundAction:
        """The ground action of a row."""
        return self.structure.problem.actions[int(self.mdp.row_action[row])]

    def policy_json(self, solution: Solution) -> dict[str, Any]:
        """The states that a policy reaches from the initial one, and its action in each."""
        mdp, policy = self.mdp, solution.policy
        seen, queue = {mdp.initial}, [mdp.initial]
        states = []
        for number in queue:
            row = int(policy[number])
            state = self.structure.state(number)
            if row < 0 or state is SINK:
                continue
            states.append(
                {"state": sorted(str(atom) for atom in state), "action": str(self.action(row))}
            )
            span = slice(int(mdp.row_transition[row]), int(mdp.row_transition[row + 1]))
            for after, chance in zip(mdp.next_state[span], mdp.probability[span], strict=True):
                if chance > 0 and int(after) not in seen:
                    seen.add(int(after))
                    queue.append(int(after))
        return {
            "domain": self.domain.name,
            "problem": self.problem.name,
            "environment": self.environment,
            "objective": solution.objective,
            "noise": self.noise,
            "states": states,
        }
