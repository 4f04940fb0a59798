"""What the stages of a solve hand on: bounds and a policy over the states of an MDP."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from menid_plan.mdp.model import MDP, Bools, Floats, SmallInts
from menid_plan.solving import Status
from menid_solvers.bound_kernels import GIVE_UP
from menid_solvers.bounds import Limits, enclose
from menid_solvers.core import Core
from menid_solvers.graph import Graph, lowest_rows


@dataclass(slots=True, eq=False)
class Stage:
    """Bounds (float64[n]) and a policy (int32[n], -1 for none) so far.

    ``cause`` says why bounds that were not stopped early may be wide all the same.
    """

    lower: Floats
    upper: Floats
    policy: SmallInts
    status: Status = "solved"
    message: str = ""
    cause: str = ""

    @classmethod
    def known(cls, mdp: MDP, value: Floats, rows: Bools) -> Stage:
        """Of states whose value is known; the policy takes the lowest of the rows that count."""
        return cls(value.copy(), value.copy(), lowest_rows(mdp, rows))


def solve_core(
    mdp: MDP,
    core: Core,
    stage: Stage,
    epsilon: float,
    limits: Limits,
    *,
    lowest: float,
    highest: float,
    start: Floats | None = None,
    graph: Graph | None = None,
    inside: Bools | None = None,
) -> None:
    """Solve a core's equations and write the bounds and the policy into the stage.

    ``graph`` and ``inside`` (bool[r]) are needed where end components were merged: their states
    steer to the one whose row leaves, or stay.
    """
    if core.unknowns == 0:
        return
    states = np.flatnonzero(core.unknown >= 0)
    unknown = core.unknown[states]
    guess = None
    if start is not None:
        guess = np.zeros(core.unknowns)
        guess[unknown] = np.nan_to_num(start[states], posinf=0.0, neginf=0.0)
    answer = enclose(
        core, epsilon, limits, lowest=lowest, highest=highest, start=guess,
        watch=int(core.unknown[mdp.initial]),
    )  # fmt: skip
    stage.lower[states] = answer.lo[unknown]
    stage.upper[states] = answer.hi[unknown]
    if not answer.complete:
        stage.status = "limit"
        stage.message = limits.reason
    elif answer.given_up:
        stage.cause = f"states that are seldom left were given up after {GIVE_UP} sweeps"
    chosen = answer.policy
    row = np.where(chosen >= 0, core.source[np.maximum(chosen, 0)], -1) if len(
        core.source
    ) else np.full(core.unknowns, -1)  # fmt: skip
    if inside is None or graph is None or not bool(inside.any()):
        stage.policy[states] = row[unknown]
        return
    row_state = mdp.row_state
    owner = np.where(row >= 0, row_state[row], -1)
    owns = (owner[unknown] == states) & (row[unknown] >= 0)
    target = np.zeros(mdp.states, np.bool_)
    target[states[owns]] = True
    stay = lowest_rows(mdp, inside)
    stage.policy[states] = np.where(owns, row[unknown], stay[states])
    of_row = core.unknown[row_state]
    leaving = inside & (row[of_row] >= 0) & (of_row >= 0)
    graph.steer(leaving, target, stage.policy)


def gap_status(stage: Stage, mdp: MDP, epsilon: float) -> None:
    """Say ``limit`` if the initial state's bounds are wider than epsilon."""
    overflow = bool(np.isnan(stage.lower[mdp.initial]) or np.isnan(stage.upper[mdp.initial]))
    # What overflowed says nothing.
    stage.lower = np.nan_to_num(stage.lower, nan=-np.inf, posinf=np.inf, neginf=-np.inf)
    stage.upper = np.nan_to_num(stage.upper, nan=np.inf, posinf=np.inf, neginf=-np.inf)
    low, high = stage.lower[mdp.initial], stage.upper[mdp.initial]
    if stage.status == "solved" and low != high and not high - low <= epsilon:
        rounding = f"double precision cannot bring them within {epsilon:g} here"
        cause = "numbers are too large for doubles" if overflow else stage.cause or rounding
        stage.status = "limit"
        stage.message = f"the bounds are {high - low:.3g} apart; {cause}"
