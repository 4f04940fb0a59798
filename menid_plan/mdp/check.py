"""Whether the arrays of an MDP are what the solvers take them for."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from menid_plan.errors import MeaningError
from menid_plan.mdp.model import MDP

_TYPES = {
    "state_row": np.int64, "row_kind": np.int32, "row_reward": np.float64,
    "row_transition": np.int32, "next_state": np.int32, "kind_first": np.int64,
    "kind_probability": np.float64, "kind_action": np.int32, "goal": np.bool_,
}  # fmt: skip


def faults(mdp: MDP, tolerance: float = 1e-9) -> list[str]:
    """What is wrong with an MDP, in words, each with the first place; empty if it is sound.

    A kind's probabilities may miss 1 by ``tolerance``. Later questions are not asked where an earlier
    fault leaves them without meaning.
    """
    found = _wrong_arrays(mdp)
    if found:
        return found
    found = _wrong_offsets(mdp)
    if not 0 <= mdp.initial < mdp.states:
        found.append(f"the initial state is {mdp.initial}, and there are {mdp.states} states")
    if not 0.0 <= mdp.discount <= 1.0:
        found.append(f"the discount is {mdp.discount}, not between 0 and 1")
    if mdp.horizon is not None and mdp.horizon < 0:
        found.append(f"the horizon is {mdp.horizon}")
    if bool(mdp.goal.any()) and not mdp.has_goal:
        found.append("states are goals, and the problem has none")
    if found:
        return found
    _first(found, ~np.isfinite(mdp.row_reward), "row {} has a reward that is not finite")
    outside = (mdp.next_state < 0) | (mdp.next_state >= mdp.states)
    _first(found, outside, f"transition {{}} leads to none of the {mdp.states} states")
    chances = mdp.kind_probability
    used = np.zeros(len(mdp.kind_action), np.bool_)
    used[mdp.row_kind] = True
    wrong = ~((chances >= 0.0) & (chances <= 1.0 + tolerance))
    wrong &= np.repeat(used, np.diff(mdp.kind_first))
    _first(found, wrong, "probability {} is not between 0 and 1")
    if not wrong.any() and used.any():
        sums = np.add.reduceat(np.append(chances, 0.0), mdp.kind_first[:-1])
        missed = used & (np.abs(sums - 1.0) > tolerance)
        _first(found, missed, "the probabilities of kind {} do not sum to 1")
    return found


def check(mdp: MDP) -> MDP:
    """The MDP itself; MeaningError with all its faults if it has any."""
    found = faults(mdp)
    if found:
        raise MeaningError("this is no MDP: " + "; ".join(found))
    return mdp


def _wrong_arrays(mdp: MDP) -> list[str]:
    found = []
    for name, wanted in _TYPES.items():
        array = getattr(mdp, name)
        if not isinstance(array, np.ndarray) or array.dtype != wanted or array.ndim != 1:
            found.append(f"`{name}` must be an array of {np.dtype(wanted)} with one dimension")
        elif not array.flags.c_contiguous:
            found.append(f"`{name}` must lie in memory without gaps")
    return found


def _wrong_offsets(mdp: MDP) -> list[str]:
    found = []
    for name, offsets, number, things in (
        ("state_row", mdp.state_row, mdp.rows, "rows"),
        ("row_transition", mdp.row_transition, mdp.transitions, "transitions"),
        ("kind_first", mdp.kind_first, len(mdp.kind_probability), "probabilities"),
    ):
        if len(offsets) == 0 or offsets[0] != 0 or offsets[-1] != number:
            found.append(f"`{name}` must run from 0 to the number of {things}, {number}")
        elif bool(np.any(np.diff(offsets) < 0)):
            found.append(f"`{name}` must not fall, as it does after {np.diff(offsets).argmin()}")
    if len(mdp.row_transition) != mdp.rows + 1:
        found.append(f"`row_transition` must have {mdp.rows + 1} entries, one more than rows")
    elif not found and bool(np.any(np.diff(mdp.row_transition) == 0)):
        found.append(f"row {np.diff(mdp.row_transition).argmin()} has no transition")
    kinds = len(mdp.kind_action)
    if len(mdp.kind_first) != kinds + 1:
        found.append(f"`kind_first` must have {kinds + 1} entries, one more than kinds")
    elif bool(np.any((mdp.row_kind < 0) | (mdp.row_kind >= kinds))):
        found.append(f"`row_kind` has entries that are none of the {kinds} kinds")
    elif not found:
        widths = np.diff(mdp.kind_first)[mdp.row_kind] != np.diff(mdp.row_transition)
        _first(found, widths, "row {} has not as many transitions as its kind has probabilities")
    for name, array, number in (
        ("row_reward", mdp.row_reward, mdp.rows),
        ("goal", mdp.goal, mdp.states),
    ):
        if len(array) != number:
            found.append(f"`{name}` has {len(array)} entries instead of {number}")
    return found


def _first(found: list[str], wrong: NDArray[np.bool_], text: str) -> None:
    if wrong.any():
        found.append(text.format(int(wrong.argmax())))
