"""The stage of reaching the goal: how probably, by which rows, and in which states surely.

Certain answers (0 and 1) come from the graph alone; between them, interval iteration with the end
components merged (Haddad and Monmege 2018).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from menid_plan.mdp.model import MDP, Bools, Floats
from menid_solvers import row_kernels as kernels
from menid_solvers.bounds import Limits
from menid_solvers.core import build_core
from menid_solvers.graph import Graph, end_components, sure_reach
from menid_solvers.stage import Stage, solve_core


@dataclass(frozen=True, slots=True, eq=False)
class GoalStage:
    """Bounds on the goal's probability, and (bool[n]) where it is 1 and 0 for certain.

    ``sure_rows`` (bool[r]) are the rows that stay where it is 1.
    """

    stage: Stage
    sure: Bools
    never: Bools
    sure_rows: Bools

    @property
    def settled(self) -> bool:
        """Whether the probability is 0 or 1 everywhere."""
        return bool(np.all(self.sure | self.never))

    def best_rows(self, mdp: MDP, rows: Bools) -> Bools:
        """The rows (bool[r]) that may belong to a policy of the highest probability.

        Exact where the probability is 0 or 1; elsewhere those whose upper bound is not below the
        state's lower bound.
        """
        if self.settled:
            return self.sure_rows
        between = rows & mdp.rows_of(~(self.sure | self.never))
        expected = np.zeros(mdp.rows)
        kernels.expect(*mdp.graph, between, self.stage.upper, expected)
        good: Bools = expected >= np.repeat(self.stage.lower, np.diff(mdp.state_row)) - 1e-14
        return self.sure_rows | (between & good)


def reach_goal(
    mdp: MDP,
    graph: Graph,
    rows: Bools,
    epsilon: float,
    limits: Limits,
    start: Floats | None = None,
    *,
    steered: bool = True,
) -> GoalStage:
    """The highest probability of reaching the goal by the given rows (bool[r]).

    Without ``steered`` the policy need not come to the goal where that is sure.
    """
    goal = mdp.goal
    sure, sure_rows, possible = sure_reach(graph, rows, goal)
    settled = sure | ~possible
    sure_rows &= mdp.rows_of(sure)
    stage = Stage.known(mdp, sure.astype(np.float64), rows)
    stage.policy[goal] = -1
    if steered:
        graph.steer(sure_rows, goal, stage.policy)
    if not bool(settled.all()):
        between = rows & mdp.rows_of(~settled)
        merged, inside = end_components(graph, between)
        core = build_core(
            mdp, rows=between, reward=np.zeros(mdp.rows), discount=1.0, known=settled,
            known_value=sure.astype(np.float64), merged=merged, inside=inside,
        )  # fmt: skip
        solve_core(
            mdp, core, stage, epsilon, limits, lowest=0.0, highest=1.0, start=start,
            graph=graph, inside=inside,
        )  # fmt: skip
    return GoalStage(stage, sure, ~possible, sure_rows)


def policy_rows(mdp: MDP, stage: Stage) -> Bools:
    """The rows (bool[r]) that a stage's policy takes."""
    taken = np.zeros(mdp.rows, np.bool_)
    taken[stage.policy[stage.policy >= 0]] = True
    return taken
