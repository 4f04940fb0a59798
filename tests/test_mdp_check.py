"""The checker of MDPs: every fault is found and named."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from menid_plan.errors import MeaningError
from menid_plan.mdp.check import check, faults
from solver_reference import build

SOUND = build([[(-1, [(0.5, 1), (0.5, 0)]), (2, [(1, 2)])], [], [(0, [(1, 0)])]], [1])


def test_a_sound_one_is_handed_back() -> None:
    assert check(SOUND) is SOUND
    assert faults(build([[], []])) == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind_probability": np.array([0.5, 0.4, 1, 1])}, "kind 0 do not sum to 1"),
        ({"kind_probability": np.array([1.5, -0.5, 1, 1])}, "probability 0 is not between"),
        ({"kind_probability": np.array([np.nan, 0.5, 1, 1])}, "probability 0 is not between"),
        (
            {"kind_probability": np.array([0.5, 0.5, 1])},
            "`kind_first` must run from 0 to the number of probabilities, 3",
        ),
        (
            {"kind_probability": np.ones(8)[::2]},
            "`kind_probability` must lie in memory without gaps",
        ),
        (
            {"kind_probability": np.ones(4, np.float32)},
            "`kind_probability` must be an array of float64",
        ),
        ({"next_state": np.array([1, 0, 7, 0], np.int32)}, "transition 2 leads to none"),
        ({"next_state": np.array([1, 0, -1, 0], np.int32)}, "transition 2 leads to none"),
        ({"row_reward": np.array([0, np.inf, 0])}, "row 1 has a reward that is not finite"),
        ({"row_reward": np.zeros(2)}, "`row_reward` has 2 entries instead of 3"),
        ({"state_row": np.array([0, 2, 1, 3])}, "`state_row` must not fall, as it does after 1"),
        ({"state_row": np.array([1, 2, 2, 3])}, "`state_row` must run from 0"),
        ({"state_row": np.array([0, 2, 2, 4])}, "the number of rows, 3"),
        ({"row_transition": np.array([0, 2, 2, 4], np.int32)}, "row 1 has no transition"),
        ({"row_transition": np.array([0, 2, 4], np.int32)}, "`row_transition` must have 4 entries"),
        ({"row_transition": np.array([0, 1, 3, 4], np.int32)}, "row 0 has not as many transitions"),
        (
            {"row_kind": np.array([0, 1, 3], np.int32)},
            "`row_kind` has entries that are none of the 3",
        ),
        ({"kind_first": np.array([0, 2, 4])}, "`kind_first` must have 4 entries"),
        ({"goal": np.zeros(2, np.bool_)}, "`goal` has 2 entries instead of 3"),
        ({"has_goal": False}, "states are goals, and the problem has none"),
        ({"initial": 3}, "the initial state is 3"),
        ({"discount": 1.5}, "the discount is 1.5"),
        ({"discount": float("nan")}, "the discount is nan"),
        ({"horizon": -1}, "the horizon is -1"),
    ],
)
def test_every_fault_has_a_name(change: dict[str, Any], message: str) -> None:
    broken = replace(SOUND, **change)
    assert any(message in fault for fault in faults(broken)), faults(broken)
    with pytest.raises(MeaningError, match="this is no MDP"):
        check(broken)
