"""The kernel of backward induction; see `menid_solvers.horizon`."""

from __future__ import annotations

import numpy as np

from menid_plan.compiled import kernel
from menid_plan.mdp.model import Bools, Floats, Ints, SmallInts


@kernel(
    "b1(i8[::1], i4[::1], i4[::1], i4[::1], i8[::1], f8[::1], b1[::1], f8[::1], f8, b1,"
    " f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], i4[::1])"
)
def step_back(
    state_row: Ints,
    row_transition: SmallInts,
    next_state: SmallInts,
    row_kind: SmallInts,
    kind_first: Ints,
    kind_probability: Floats,
    active: Bools,
    reward: Floats,
    discount: float,
    goal_first: bool,
    value: Floats,
    reached: Floats,
    best_reached: Floats,
    new_value: Floats,
    new_reached: Floats,
    new_best_reached: Floats,
    policy: SmallInts,
) -> bool:
    """Values with one step more to go, and the lowest best row of each state.

    ``reached`` is the goal's probability under the policy and ``best_reached`` the highest there is;
    with ``goal_first`` rows are compared by that before the value. True if nothing changed.
    """
    same = True
    for s in range(len(state_row) - 1):
        chosen = -1
        best = -np.inf
        best_chance = 0.0
        chance_of_chosen = 0.0
        if goal_first:
            for r in range(state_row[s], state_row[s + 1]):
                if active[r]:
                    chance = 0.0
                    begin, end = np.uint64(row_transition[r]), np.uint64(row_transition[r + 1])
                    of_kind = np.uint64(kind_first[row_kind[r]]) - begin
                    for e in range(begin, end):
                        chance += kind_probability[of_kind + e] * best_reached[next_state[e]]
                    best_chance = max(best_chance, chance)
        for r in range(state_row[s], state_row[s + 1]):
            if not active[r]:
                continue
            total = reward[r]
            chance = 0.0
            best_of_row = 0.0
            begin, end = np.uint64(row_transition[r]), np.uint64(row_transition[r + 1])
            of_kind = np.uint64(kind_first[row_kind[r]]) - begin
            for e in range(begin, end):
                p = kind_probability[of_kind + e]
                if p > 0.0:
                    t = next_state[e]
                    total += discount * p * value[t]
                    chance += p * reached[t]
                    best_of_row += p * best_reached[t]
            if goal_first and best_of_row < best_chance - 1e-12:
                continue
            if chosen < 0 or total > best:
                chosen = r
                best = total
                chance_of_chosen = chance
        policy[s] = chosen
        if chosen < 0:
            new_value[s] = value[s]
            new_reached[s] = reached[s]
            new_best_reached[s] = best_reached[s]
            continue
        if goal_first and best_chance == 0.0:
            best = 0.0
        same = same and best == value[s] and chance_of_chosen == reached[s]
        same = same and best_chance == best_reached[s]
        new_value[s] = best
        new_reached[s] = chance_of_chosen
        new_best_reached[s] = best_chance
    return same
