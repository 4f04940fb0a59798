"""From a domain and a problem to a solved MDP: grounding, exploring, filling, solving in a row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, cast

import numpy as np

from menid_plan.errors import MenidError
from menid_plan.grounding.ground import ground
from menid_plan.grounding.semantics import Noise
from menid_plan.grounding.state import GroundAction
from menid_plan.mdp.explore import MAX_STATES, Structure, explore
from menid_plan.mdp.model import MDP, Floats
from menid_plan.mdp.probabilities import written
from menid_plan.mdp.search import Progress
from menid_plan.model.domain import Domain, Problem
from menid_plan.policy import Policy, policy_of
from menid_plan.simulation import Simulator
from menid_plan.solving import (
    AskedSolver,
    Belief,
    Objective,
    OnlinePolicy,
    OnlineSolver,
    Solution,
    Solver,
    UnsupportedError,
    load_solver,
    natural_objective,
)
from menid_plan.solving import Progress as SolverProgress


class OptionError(MenidError):
    """A solver does not have an option, or not with that value."""

    exit_code = 2


@dataclass(frozen=True, slots=True, eq=False)
class Certain:
    """The belief of who knows the probabilities (float64, one for each slot)."""

    chances: Floats

    def mean(self) -> Floats:
        """The probabilities."""
        return self.chances

    def sample(self, rng: np.random.Generator) -> Floats:  # noqa: ARG002
        """The probabilities: there is nothing to be drawn."""
        return self.chances


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
        self.chances: Floats
        self._mdp: MDP | None = None

    def build(self, progress: Progress | None = None) -> MDP:
        """Ground, explore what happens in the environment, and fill in its probabilities."""
        self.explore(progress)
        return self.mdp

    def explore(self, progress: Progress | None = None) -> Structure:
        """Ground, and explore what happens in the environment."""
        compiled = ground(self.domain, self.problem, self.params)
        self.chances, happens = written(compiled, self.environment)
        self.structure = explore(
            compiled, happens, noise=self.noise, max_states=self.max_states, progress=progress
        )
        self._mdp = None
        return self.structure

    @property
    def mdp(self) -> MDP:
        """What was explored, with the probabilities of the environment; filled in when first asked."""
        if self._mdp is None:
            self._mdp = self.structure.fill(self.chances)
        return self._mdp

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
        """A solver with some options; those that are None are left to it.

        Raises OptionError for an option that it does not have or a value that it refuses,
        UnsupportedError for a solver that makes no plan but decides when it is asked.
        """
        made = made_solver(name, options)
        if not hasattr(made, "solve"):
            raise UnsupportedError(
                _for_learning(name)
                if hasattr(made, "choose")
                else f"the solver `{name}` decides step by step, and has no policy to be shown"
            )
        return cast("Solver", made)

    @staticmethod
    def online_solver(name: str, **options: Any) -> OnlineSolver:
        """A solver that decides when it is asked, with some options; see `solver`."""
        made = made_solver(name, options)
        if not hasattr(made, "policy"):
            raise UnsupportedError(
                _for_learning(name)
                if hasattr(made, "choose")
                else f"the solver `{name}` does not decide step by step"
            )
        return cast("OnlineSolver", made)

    @staticmethod
    def warm(solver: Solver) -> None:
        """Load what is compiled of a solver, on an MDP of one step."""
        one = np.zeros(1, np.int32)
        mdp = MDP(
            np.array([0, 1, 1]), one, np.ones(1), np.array([0, 1], np.int32), one + 1,
            np.array([0, 1]), np.ones(1), one, np.array([False, True]), has_goal=True, discount=0.5,
        )  # fmt: skip
        solver.solve(mdp, "reward")

    def solve(
        self,
        solver: Solver,
        objective: Objective | None = None,
        progress: SolverProgress | None = None,
    ) -> Solution:
        """Solve what was built."""
        return solver.solve(self.mdp, objective or self.objective, progress=progress)

    def action(self, row: int) -> GroundAction:
        """The ground action of a row."""
        return self.structure.action(row)

    def policy(self, solution: Solution) -> Policy:
        """The states that a solution reaches from the initial one, and what it does in each."""
        return policy_of(
            self.structure, self.mdp, solution, self.environment, self.params, self.noise
        )

    def online_policy(
        self, solver: OnlineSolver, rng: np.random.Generator, objective: Objective | None = None
    ) -> OnlinePolicy:
        """What an online solver does if it knows the probabilities that were filled in."""
        belief = Belief(self.structure.fill, Certain(self.chances), objective or self.objective)
        return solver.policy(belief, rng)

    def simulator(self) -> Simulator:
        """Draws episodes of what was built."""
        return Simulator(self.structure, self.mdp)


def _for_learning(name: str) -> str:
    return (
        f"the solver `{name}` is asked for actions by `menid learn` alone; `menid plan` lets planners"
        " of others play"
    )


def made_solver(name: str, options: Mapping[str, Any]) -> Solver | OnlineSolver | AskedSolver:
    """A solver of any kind by its name, with the options that are not None; raises OptionError."""
    kind = load_solver(name)
    given = {key: value for key, value in options.items() if value is not None}
    known: set[str] = {f.name for f in fields(kind) if f.init} if is_dataclass(kind) else set()
    for key in given:
        if key not in known:
            raise OptionError(f"the solver `{name}` has no option --{key.replace('_', '-')}")
    try:
        return kind(**given)
    except ValueError as error:
        raise OptionError(f"the solver `{name}`: {error}") from error
