"""What value-iteration does for each objective, put together from its stages."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from menid_plan.mdp.model import MDP, Bools, Floats
from menid_plan.solving import Objective, Progress, Solution
from menid_solvers.bounds import Limits
from menid_solvers.goals import GoalStage, policy_rows, reach_goal
from menid_solvers.graph import Graph, lowest_rows, sure_reach
from menid_solvers.horizon import rows_of_states, solve_horizon
from menid_solvers.rewards import discounted_reward, total_reward
from menid_solvers.stage import Stage, gap_status

if TYPE_CHECKING:
    from menid_solvers.value_iteration import ValueIteration


def solve_objective(
    options: ValueIteration,
    mdp: MDP,
    objective: Objective,
    progress: Progress | None,
    start: Floats | None,
) -> Solution:
    """Solve an MDP for an objective."""
    limits = Limits(options.max_iterations, options.max_seconds, progress)
    rows = mdp.rows_of(~mdp.goal)  # an episode ends at a goal
    if mdp.horizon is not None:
        return solve_horizon(mdp, rows, objective, options.epsilon, limits, options.policy_bytes)
    known = ~rows_of_states(mdp, rows)
    if objective == "reward" and mdp.discount < 1.0:
        stage = discounted_reward(mdp, rows, known, options.epsilon, limits, start)
        return _solution(options, mdp, objective, stage, limits, None)
    graph = Graph(mdp, rows)
    if objective == "reward":
        stage = total_reward(
            mdp, graph, rows, mdp.row_reward, known, options.epsilon, limits, may_stay=True,
            start=start,
        )  # fmt: skip
        return _solution(options, mdp, objective, stage, limits, None)
    if objective == "steps":
        return _steps(options, mdp, graph, rows, limits, start)
    if objective == "goal-probability":
        reached = reach_goal(mdp, graph, rows, options.epsilon, limits, start)
        return _solution(options, mdp, objective, reached.stage, limits, _middle(reached.stage))
    return _goal_then_reward(options, mdp, graph, rows, limits, start)


def _steps(
    options: ValueIteration,
    mdp: MDP,
    graph: Graph,
    rows: Bools,
    limits: Limits,
    start: Floats | None,
) -> Solution:
    """The least expected number of steps among policies that reach the goal surely."""
    sure, sure_rows, _ = sure_reach(graph, rows, mdp.goal)
    sure_rows &= mdp.rows_of(sure)
    cost = np.full(mdp.rows, -1.0)
    stage = total_reward(
        mdp, graph, sure_rows, cost, mdp.goal | ~sure, options.epsilon, limits, may_stay=False,
        certain=True, start=None if start is None else -start,
    )  # fmt: skip
    lower, upper = -stage.upper, -stage.lower
    lower[~sure] = upper[~sure] = np.inf
    stage.policy[~sure] = lowest_rows(mdp, rows)[~sure]
    stage.lower, stage.upper = np.maximum(lower, 0.0), upper + 0.0
    if not sure[mdp.initial]:
        stage.status = "infeasible"
        stage.message = "no policy reaches the goal with probability 1"
    return _solution(options, mdp, "steps", stage, limits, sure.astype(np.float64))


def _goal_then_reward(
    options: ValueIteration,
    mdp: MDP,
    graph: Graph,
    rows: Bools,
    limits: Limits,
    start: Floats | None,
) -> Solution:
    """The highest probability of the goal, then the highest reward among the policies that have it."""
    reached = reach_goal(mdp, graph, rows, min(options.tie, options.epsilon), limits, steered=False)
    if reached.stage.status == "limit" and limits.reached:
        chance = _middle(reached.stage)
        stage = reached.stage
        open_states = ~(mdp.goal | reached.never)
        stage.lower = np.where(open_states, -np.inf, 0.0)
        stage.upper = np.where(open_states, np.inf, 0.0)
        return _solution(options, mdp, "goal-then-reward", stage, limits, chance)
    width = float(np.max(reached.stage.upper - reached.stage.lower, initial=0.0))
    if width > options.tie:  # which rows have the highest probability cannot be told
        stage, chance = reached.stage, _middle(reached.stage)
        stage.status = "limit"
        stage.message = (
            f"the goal's probability can be told within {width:.3g} only, so that rewards cannot "
            "decide between policies"
        )
        stage.lower = np.where(mdp.goal | reached.never, 0.0, -np.inf)
        stage.upper = np.where(mdp.goal | reached.never, 0.0, np.inf)
        return _solution(options, mdp, "goal-then-reward", stage, limits, chance)
    best = reached.best_rows(mdp, rows)
    ends = mdp.goal | reached.never
    if mdp.discount < 1.0:
        stage = discounted_reward(mdp, best, ends, options.epsilon, limits, start)
    else:
        stage = total_reward(
            mdp, graph, best, mdp.row_reward, ends, options.epsilon, limits, may_stay=False,
            certain=reached.settled, start=start,
        )  # fmt: skip
    stage.policy[reached.never] = reached.stage.policy[reached.never]
    missing = (stage.policy < 0) & ~mdp.goal
    stage.policy[missing] = reached.stage.policy[missing]
    chance = _policy_chance(options, mdp, graph, reached, stage, limits)
    return _solution(options, mdp, "goal-then-reward", stage, limits, chance)


def _policy_chance(
    options: ValueIteration,
    mdp: MDP,
    graph: Graph,
    reached: GoalStage,
    stage: Stage,
    limits: Limits,
) -> Floats:
    """The goal's probability under the stage's policy."""
    if reached.settled and mdp.discount == 1.0:
        return reached.sure.astype(np.float64)
    if limits.interrupted:  # whoever interrupts does not want to wait for this either
        return _middle(reached.stage)
    taken = policy_rows(mdp, stage)
    again = Limits(None, options.max_seconds, None, limits.started)
    return _middle(reach_goal(mdp, graph, taken, options.epsilon, again).stage)


def _middle(stage: Stage) -> Floats:
    return np.asarray((stage.lower + stage.upper) / 2)


def _solution(
    options: ValueIteration,
    mdp: MDP,
    objective: Objective,
    stage: Stage,
    limits: Limits,
    chance: Floats | None,
) -> Solution:
    gap_status(stage, mdp, options.epsilon)
    return Solution(
        status=stage.status,
        objective=objective,
        initial=mdp.initial,
        lower=stage.lower,
        upper=stage.upper,
        policy=stage.policy,
        iterations=limits.iterations,
        seconds=limits.seconds,
        goal_probability=chance if mdp.has_goal else None,
        message=stage.message,
    )
