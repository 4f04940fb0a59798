"""A ground problem as arrays, as the compiled kernels read it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from menid_plan.grounding.watches import Watches

_Number = TypeVar("_Number", np.int32, np.uint32, np.uint64)


@dataclass(frozen=True, slots=True, eq=False)
class Tables:
    """The arrays of a ground problem, as the compiled kernels read them.

    What is looked up together is a row of one array, so that it comes from memory together. Ranges are
    by offsets: those of row i go from its own to that of row i + 1; the last row only ends them.

    ``entry`` (uint64[., 3]): word, mask and value. Operations of the program, each of which sets the
    next bit behind those of the state: ``op`` (int32[., 3]) has the kind (0: all literals hold, 1: so
    many hold, 2: at least so many, 3: all hold, of a derived atom), the number, and the first literal.
    ``literal`` (uint64[., 2]): a bit, and what turns it (all ones for the negation). ``segment``
    (int32[., 2]) of the program: whether it repeats until nothing changes, and the first operation.
    ``rule`` (uint32[., 3]): the first entry, the first outcome and its slot, which those of the next
    outcomes follow; ``rule_action`` int32; ``slot_noise`` (bool): whether a slot's outcome is noise.
    ``outcome_change`` (uint64[., 2, W]): what an outcome deletes and adds unconditionally;
    ``outcome_effects`` (uint32): the first of its conditional effects. Of these ``effect``
    (uint32[., 2]) has the first entry and the first change; ``change`` (uint64[., 3]) has the word,
    what to delete, what to add.
    ``field`` (uint64[., 3], see `menid_plan.grounding.packing`): word, shift, and the mask of what is
    shifted down. Watches (see `menid_plan.grounding.watches`): ``rule_watch`` for the rules,
    ``effect_watch`` for the conditional effects of each outcome. Rewards of states:
    ``reward_entries`` (uint32 offsets), ``reward_value`` float64. The cube of the goal:
    ``goal_entries`` (int32, two offsets; both -1 without a goal).
    """

    words: int
    extended_words: int
    entry: NDArray[np.uint64]
    op: NDArray[np.int32]
    literal: NDArray[np.uint64]
    segment: NDArray[np.int32]
    rule: NDArray[np.uint32]
    rule_action: NDArray[np.int32]
    slot_noise: NDArray[np.bool_]
    outcome_change: NDArray[np.uint64]
    outcome_effects: NDArray[np.uint32]
    effect: NDArray[np.uint32]
    change: NDArray[np.uint64]
    field: NDArray[np.uint64]
    rule_watch: Watches
    effect_watch: Watches
    reward_entries: NDArray[np.uint32]
    reward_value: NDArray[np.float64]
    goal_entries: NDArray[np.int32]

    @property
    def rules(self) -> int:
        """How many rules there are."""
        return len(self.rule_action)

    @property
    def outcomes(self) -> int:
        """How many outcomes all rules have."""
        return len(self.outcome_change)


def rows(width: int, values: Iterable[tuple[int, ...]], kind: type[_Number]) -> NDArray[_Number]:
    """Rows of so many numbers as an array, even if there are none."""
    return np.array(list(values), kind).reshape(-1, width)
