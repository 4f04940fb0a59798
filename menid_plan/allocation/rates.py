"""The highest reward by the second of episodes that follow one another: compiled.

An episode begins in one state and ends where nothing applies, or after so many steps; then the next
one begins. The policy with the highest ratio of expected reward to expected time is that which is
best where each second costs as much as this ratio is (Dinkelbach 1967): policies for a price, and the
price that a policy earns, are found in turn.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from menid_plan.compiled import kernel

# Prices that are tried; three are enough as a rule.
ROUNDS = 20


@kernel()
def best_for_price(
    state_row: Any, row_transition: Any, next_state: Any, row_kind: Any, kind_first: Any,
    kind_probability: Any, row_reward: Any, row_seconds: Any, price: float, value: Any, policy: Any,
) -> None:  # fmt: skip
    """Write the policy (i4[horizon, states], by the steps that are left less one; -1: none).

    ``value`` [horizon + 1, states] is the reward less the price of the time, with so many steps left.
    """
    states = len(state_row) - 1
    for state in range(states):
        value[0, state] = 0.0
    for step in range(len(policy)):
        for state in range(states):
            best, chosen = 0.0, -1
            for row in range(state_row[state], state_row[state + 1]):
                worth = row_reward[row] - price * row_seconds[row]
                begin, end = np.uint64(row_transition[row]), np.uint64(row_transition[row + 1])
                of_kind = np.uint64(kind_first[row_kind[row]]) - begin
                for entry in range(begin, end):
                    worth += kind_probability[of_kind + entry] * value[step, next_state[entry]]
                if chosen < 0 or worth > best:
                    best, chosen = worth, row
            value[step + 1, state] = best
            policy[step, state] = chosen


@kernel()
def earned(
    row_transition: Any, next_state: Any, row_kind: Any, kind_first: Any, kind_probability: Any,
    row_reward: Any, row_seconds: Any, initial: int, policy: Any, reached: Any, visits: Any,
) -> tuple[float, float]:  # fmt: skip
    """Expected reward and time of an episode with a policy; how often states are visited in it.

    ``reached`` [2, states] is space to work in, ``visits`` [states] is written.
    """
    states = policy.shape[1]
    for state in range(states):
        reached[0, state] = 0.0
        reached[1, state] = 0.0
        visits[state] = 0.0
    reached[0, initial] = 1.0
    reward, seconds = 0.0, 0.0
    here = 0
    for left in range(len(policy) - 1, -1, -1):
        for state in range(states):
            chance = reached[here, state]
            reached[here, state] = 0.0
            row = policy[left, state]
            if chance == 0.0 or row < 0:
                continue
            visits[state] += chance
            reward += chance * row_reward[row]
            seconds += chance * row_seconds[row]
            begin, end = np.uint64(row_transition[row]), np.uint64(row_transition[row + 1])
            of_kind = np.uint64(kind_first[row_kind[row]]) - begin
            for entry in range(begin, end):
                reached[1 - here, next_state[entry]] += chance * kind_probability[of_kind + entry]
        here = 1 - here
    return reward, seconds


@kernel(
    "UniTuple(f8, 2)(i8[::1], i4[::1], i4[::1], i4[::1], i8[::1], f8[::1], f8[::1], f8[::1], i8, f8,"
    " f8[:, ::1], i4[:, ::1], f8[:, ::1], f8[::1])"
)
def best_rate(
    state_row: Any, row_transition: Any, next_state: Any, row_kind: Any, kind_first: Any,
    kind_probability: Any, row_reward: Any, row_seconds: Any, initial: int, price: float,
    value: Any, policy: Any, reached: Any, visits: Any,
) -> tuple[float, float]:  # fmt: skip
    """The highest reward a second, and the seconds that an episode then takes; see above.

    ``price`` is a guess of it. ``visits`` are those of an episode.
    """
    seconds = 0.0
    for _ in range(ROUNDS):
        best_for_price(
            state_row, row_transition, next_state, row_kind, kind_first, kind_probability, row_reward,
            row_seconds, price, value, policy,
        )  # fmt: skip
        reward, seconds = earned(
            row_transition, next_state, row_kind, kind_first, kind_probability, row_reward,
            row_seconds, initial, policy, reached, visits,
        )  # fmt: skip
        if seconds <= 0.0:
            break
        last, price = price, reward / seconds
        if abs(price - last) <= 1e-9 * max(1.0, abs(price)):
            break
    return price, seconds
