"""A ground problem as arrays, as the compiled kernels read it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from menid_plan.grounding.watches import Watches


@dataclass(frozen=True, slots=True, eq=False)
class Tables:
    """The arrays of a ground problem, as the compiled kernels read them.

    Ranges are by offsets: those of item i are ``start[i]`` to ``start[i + 1]``. What a search looks
    up for each step is unsigned, so that nothing need be done for numbers below 0.

    Entries (of cubes and counts): ``entry_word`` uint32, ``entry_mask`` and ``entry_value`` uint64.
    Operations of the program, each of which sets the next bit behind those of the state: ``op_kind``
    uint8 (0: all literals hold, 1: so many hold, 2: at least so many, 3: all hold, of a derived atom),
    ``op_number``, ``op_literals`` (offsets). Literals: ``literal_bit``, ``literal_flip`` (uint64, all
    ones for the negation). Segments of the program: ``segment_ops`` (offsets), ``segment_loops`` uint8
    (repeat until nothing changes).
    Rules: ``rule_entries``, ``rule_outcomes`` (offsets), ``rule_action``. Outcomes:
    ``outcome_slot``, ``outcome_noise`` uint8, ``outcome_delete`` and ``outcome_add`` (uint64[., W],
    what it does unconditionally), ``outcome_effects`` (offsets, of the others). Conditional effects:
    ``effect_entries``, ``effect_changes`` (offsets). Changes: ``change_word``, ``change_delete``,
    ``change_add``. Fields (see `menid_plan.grounding.packing`): ``field_word``, ``field_shift`` and
    ``field_mask`` (uint64; the mask of what is shifted down). Watches (see
    `menid_plan.grounding.watches`): ``rule_watch`` for the rules, ``effect_watch`` for the conditional
    effects of each outcome. Rewards of states: ``reward_entries`` (offsets), ``reward_value`` float64.
    The cube of the goal: ``goal_entries`` (two offsets; equal to -1 without a goal).
    """

    words: int
    extended_words: int
    entry_word: NDArray[np.uint32]
    entry_mask: NDArray[np.uint64]
    entry_value: NDArray[np.uint64]
    op_kind: NDArray[np.uint8]
    op_number: NDArray[np.int32]
    op_literals: NDArray[np.int32]
    literal_bit: NDArray[np.int32]
    literal_flip: NDArray[np.uint64]
    segment_ops: NDArray[np.int32]
    segment_loops: NDArray[np.uint8]
    rule_entries: NDArray[np.uint32]
    rule_outcomes: NDArray[np.uint32]
    rule_action: NDArray[np.int32]
    outcome_slot: NDArray[np.int32]
    outcome_noise: NDArray[np.uint8]
    outcome_delete: NDArray[np.uint64]
    outcome_add: NDArray[np.uint64]
    outcome_effects: NDArray[np.uint32]
    effect_entries: NDArray[np.uint32]
    effect_changes: NDArray[np.uint32]
    change_word: NDArray[np.uint32]
    change_delete: NDArray[np.uint64]
    change_add: NDArray[np.uint64]
    reward_entries: NDArray[np.uint32]
    reward_value: NDArray[np.float64]
    goal_entries: NDArray[np.int32]
    field_word: NDArray[np.uint32]
    field_shift: NDArray[np.uint64]
    field_mask: NDArray[np.uint64]
    rule_watch: Watches
    effect_watch: Watches


_TYPES: dict[str, type[np.generic]] = {  # others int32
    "op_kind": np.uint8, "segment_loops": np.uint8, "outcome_noise": np.uint8,
    "literal_flip": np.uint64, "change_delete": np.uint64, "change_add": np.uint64,
    "reward_value": np.float64, "rule_entries": np.uint32, "rule_outcomes": np.uint32,
    "outcome_effects": np.uint32, "effect_entries": np.uint32, "effect_changes": np.uint32,
    "change_word": np.uint32, "reward_entries": np.uint32,
}  # fmt: skip


class Columns:
    """Tables as lists, on their way to arrays."""

    def __init__(self) -> None:
        names = set(Tables.__dataclass_fields__) - {
            "words", "extended_words", "entry_word", "entry_mask", "entry_value", "goal_entries",
            "outcome_delete", "outcome_add", "field_word", "field_shift", "field_mask", "rule_watch",
            "effect_watch",
        }  # fmt: skip
        self._lists: dict[str, list[float]] = {name: [] for name in sorted(names)}

    def start(self, name: str, offset: int) -> None:
        """Begin a table of offsets."""
        self._lists[name].append(offset)

    def add(self, **values: float) -> None:
        """Append a value to each of some tables."""
        for name, value in values.items():
            self._lists[name].append(value)

    def last(self, name: str) -> float | None:
        """The last value of a table; None if it is empty."""
        return self._lists[name][-1] if self._lists[name] else None

    def drop(self, *names: str) -> None:
        """Take the last value of each of some tables away."""
        for name in names:
            self._lists[name].pop()

    def arrays(self) -> dict[str, Any]:
        """The tables as arrays of their types."""
        return {
            name: np.array(values, _TYPES.get(name, np.int32))
            for name, values in self._lists.items()
        }
