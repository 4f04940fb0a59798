"""What the stages of a solve hand on: bounds and a policy over the states of an MDP."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from menid_plan.mdp.model import MDP, Bools, Floats, SmallInts
from menid_plan.solving import Status
from menid_solvers import row_kernels as kernels
from menid_solvers.bounds import Limits, enclose
from menid_solvers.core import Core
from menid_solvers.graph import Predecessors


@dataclass(slots=True, eq=False)
class Stage:
    """Bounds (float64[n]) and a policy (int32[n], -1 for none) so far."""

    lower: Floats
    upper: Floats
    policy: SmallInts
    status: Status = "solved"
    message: str = ""

    @classmethod
    def known(cls, mdp: MDP, value: Floats, rows: Bools) -> Stage:
        """Of states whose value is known; the policy takes the lowest of the rows that count."""
        return cls(value.copy(), value.copy(), lowest_rows(mdp, rows))


def lowest_rows(mdp: MDP, rows: Bools) -> SmallInts:
    """The lowest row that counts (bool[r]) of each state, -1 if there is none (int32[n])."""
    counting = np.flatnonzero(rows)
    policy = np.full(mdp.states, -1, np.int32)
    states = np.searchsorted(mdp.state_row, counting, side="right") - 1
    policy[states[::-1]] = counting[::-1]
    return policy


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
    back: Predecessors | None = None,
    inside: Bools | None = None,
) -> None:
    """Solve a core's equations and write the bounds and the policy into the stage.

    ``back`` and ``inside`` (bool[r]) are needed where end components were merged: their states
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
    chosen = answer.policy
    row = np.where(chosen >= 0, core.source[np.maximum(chosen, 0)], -1) if len(
        core.source
    ) else np.full(core.unknowns, -1)  # fmt: skip
    if inside is None or back is None:
        stage.policy[states] = row[unknown]
        return
    owner = np.where(row >= 0, back.row_state[row], -1)
    owns = (owner[unknown] == states) & (row[unknown] >= 0)
    target = np.zeros(mdp.states, np.bool_)
    target[states[owns]] = True
    stay = lowest_rows(mdp, inside)
    stage.policy[states] = np.where(owns, row[unknown], stay[states])
    leaving = (
        inside & (row[core.unknown[back.row_state]] >= 0) & (core.unknown[back.row_state] >= 0)
    )
    kernels.steer(
        mdp.state_row, mdp.row_transition, mdp.next_state, mdp.probability,
        back.first, back.row, back.row_state, leaving, target, stage.policy,
        np.empty(mdp.states, np.int32), np.empty(mdp.states, np.int32),
    )  # fmt: skip


def gap_status(stage: Stage, mdp: MDP, epsilon: float) -> None:
    """Say ``limit`` if the initial state's bounds are wider than epsilon."""
    low, high = stage.lower[mdp.initial], stage.upper[mdp.initial]
    if stage.status == "solved" and low != high and not high - low <= epsilon:
        stage.status = "limit"
        stage.message = (
            f"the bounds are {high - low:.3g} apart; double precision cannot bring them within "
            f"{epsilon:g} here"
        )
