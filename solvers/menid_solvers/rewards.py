"""The reward stage: discounted, and in total; see `menid_solvers.end_components` for the latter."""

from __future__ import annotations

import numpy as np

from menid_plan.mdp.model import MDP, Bools, Floats
from menid_solvers.bounds import Limits
from menid_solvers.core import build_core
from menid_solvers.end_components import Endings, tell_endings
from menid_solvers.graph import Graph, sure_reach
from menid_solvers.stage import Stage, solve_core


def discounted_reward(
    mdp: MDP, rows: Bools, known: Bools, epsilon: float, limits: Limits, start: Floats | None
) -> Stage:
    """The best discounted sum of rewards by the given rows (bool[r]); known states are worth 0."""
    zero = np.zeros(mdp.states)
    stage = Stage.known(mdp, zero, rows & False)
    core = build_core(
        mdp, rows=rows, reward=mdp.row_reward, discount=mdp.discount, known=known, known_value=zero
    )
    sums = 1.0 / (1.0 - mdp.discount) * (1.0 + 1e-12)
    solve_core(
        mdp, core, stage, epsilon, limits, start=start,
        lowest=min(0.0, float(np.min(mdp.row_reward, initial=0.0, where=rows)) * sums),
        highest=max(0.0, float(np.max(mdp.row_reward, initial=0.0, where=rows)) * sums),
    )  # fmt: skip
    return stage


def total_reward(
    mdp: MDP,
    graph: Graph,
    rows: Bools,
    reward: Floats,
    known: Bools,
    epsilon: float,
    limits: Limits,
    *,
    may_stay: bool,
    certain: bool = False,
    start: Floats | None,
) -> Stage:
    """The best total of rewards (float64[r]) by the given rows; known states are worth 0.

    ``certain``: the rows lead to known states surely if one wants. Without ``may_stay`` only
    policies count that end in known states with probability 1. Values are inf where the total has no
    upper bound, and -inf where every policy loses without end.
    """
    endings = tell_endings(mdp, graph, rows, reward)
    ends = known | endings.growing | endings.open
    if may_stay:
        ends = ends | (endings.merged >= 0)
    if certain and not bool(endings.growing.any() or endings.open.any()):
        fine = np.ones(mdp.states, np.bool_)
    else:
        fine, _, _ = sure_reach(graph, rows, ends)
    kept = rows.copy()
    graph.without(kept, ~fine)
    if may_stay:  # staying needs its rows, whatever else they were kept for
        kept |= endings.inside & mdp.rows_of(fine)
    endless = graph.reaching(kept, endings.growing & fine) & ~known
    doubtful = graph.reaching(rows, endings.open) & ~known
    both_signs = graph.reaching(rows, endings.growing) & ~fine & ~doubtful
    doubtful |= both_signs
    if not may_stay:
        endless |= graph.reaching(kept, endings.growing)
    value = np.where(endless, np.inf, np.where(fine, 0.0, -np.inf))
    stage = Stage.known(mdp, value, rows)
    stage.policy[known] = -1
    settled = known | endless | ~fine | doubtful
    _finite(
        mdp, graph, kept, endings, settled, stage, epsilon, limits, may_stay=may_stay, start=start
    )
    stage.lower[doubtful], stage.upper[doubtful] = -np.inf, np.inf
    if endless[mdp.initial] and not doubtful[mdp.initial]:
        stage.status = "unbounded"
        stage.message = "rewards can be collected for ever: the sum has no upper bound"
    elif both_signs[mdp.initial]:
        stage.status = "limit"
        stage.message = "rewards may add up for ever, and losses too: their sum has no meaning"
    elif doubtful[mdp.initial]:
        stage.status = "limit"
        stage.message = "cannot tell whether rewards that nearly cancel add up for ever"
    return stage


def _finite(
    mdp: MDP,
    graph: Graph,
    rows: Bools,
    endings: Endings,
    settled: Bools,
    stage: Stage,
    epsilon: float,
    limits: Limits,
    *,
    may_stay: bool,
    start: Floats | None,
) -> None:
    """Solve for the states that are not settled; rows (bool[r]) from them lead to no doom."""
    counts = rows & mdp.rows_of(~settled)
    merged = np.where(settled, np.int32(-1), endings.merged)
    inside = endings.inside & counts
    pays = bool(np.any(counts & (endings.reward > 0.0)))
    costs = bool(np.any(counts & (endings.reward < 0.0)))
    number = int(merged.max(initial=-1)) + 1
    shift = endings.potential
    stops = [np.full(number, -np.inf)]
    if may_stay and number:
        free = np.flatnonzero(merged >= 0)
        most, least = np.full(number, -np.inf), np.full(number, np.inf)
        np.maximum.at(most, merged[free], shift[free])
        np.minimum.at(least, merged[free], shift[free])
        stops = (
            [-most] if bool(np.all(most[merged[free]] == least[merged[free]])) else [-least, -most]
        )
    plain = not bool(shift.any())
    for stop in stops:  # where rewards cancel, the sum of staying swings between two values
        core = build_core(
            mdp, rows=counts, reward=endings.reward, discount=1.0, known=settled,
            known_value=np.zeros(mdp.states), merged=merged, inside=inside, stop=stop,
        )  # fmt: skip
        upper = stage.upper.copy()
        solve_core(
            mdp, core, stage, epsilon, limits, start=start, graph=graph, inside=inside,
            lowest=0.0 if plain and not costs else -np.inf,
            highest=0.0 if plain and not pays else np.inf,
        )  # fmt: skip
        if stop is not stops[0]:
            width = upper[mdp.initial] - stage.lower[mdp.initial]
            if width > 2.0 * (stage.upper[mdp.initial] - stage.lower[mdp.initial]):
                stage.cause = (
                    "where rewards of both signs cancel for ever their sum swings, and has no limit"
                )
            stage.upper = upper
    if not plain:
        solved = ~settled
        size = np.abs(shift) * 4e-16
        stage.lower[solved] += shift[solved] - size[solved]
        stage.upper[solved] += shift[solved] + size[solved]
