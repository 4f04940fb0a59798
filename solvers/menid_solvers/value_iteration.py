"""The solver ``value-iteration``: certified bounds for every objective."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from menid_plan.mdp.model import MDP, Floats
from menid_plan.solving import Objective, Progress, Solution
from menid_solvers.options import demand_at_least, demand_positive, demand_share


@dataclass(frozen=True, slots=True)
class ValueIteration:
    """Sound value iteration, block by block; `menid_solvers.bounds` says how and why.

    ``epsilon``: how far apart the bounds may be (in units of the reward, or as a probability).
    ``max_iterations`` (sweeps) and ``max_seconds`` end it early, with status ``limit``.
    ``tie``: how exactly goal probabilities between 0 and 1 are told apart before rewards decide.
    ``policy_bytes``: how much memory the policy of a finite horizon may take.
    """

    name: ClassVar[str] = "value-iteration"
    promise: ClassVar[str] = "bounds that enclose the optimum, at most epsilon apart when solved"
    needs: ClassVar[str] = ""

    epsilon: float = 1e-6
    max_iterations: int | None = None
    max_seconds: float | None = None
    tie: float = 1e-9
    policy_bytes: int = 2**28

    def __post_init__(self) -> None:
        demand_positive(epsilon=self.epsilon)
        demand_share(tie=self.tie)
        demand_at_least(
            0, max_iterations=self.max_iterations, max_seconds=self.max_seconds,
            policy_bytes=self.policy_bytes,
        )  # fmt: skip

    def solve(
        self,
        mdp: MDP,
        objective: Objective,
        *,
        progress: Progress | None = None,
        start: Floats | None = None,
    ) -> Solution:
        """Solve for an objective; ``start`` (float64[n]) is a guess of the values, to save time."""
        from menid_solvers.objectives import solve_objective

        return solve_objective(self, mdp, objective, progress, start)


__all__ = ["ValueIteration"]
