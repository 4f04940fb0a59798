"""Which conditions are worth a look in a state: those that watch what holds there.

A condition that demands some bits, or numbers in fields, watches one of them, the one that the fewest
others demand. Where it is not so the condition fails, and nobody looks at it. (The idea is that of the
watched literals of SAT solvers, Moskewicz et al. 2001.)
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from menid_plan.grounding.packing import WORD, Field

SPARSE = 8  # numbers of a field for each condition on it, from which on it is not watched


class Demand(NamedTuple):
    """A bit that has to be set, or (``field`` 0 or more) the number that a field has to hold."""

    number: int
    field: int = -1


@dataclass(frozen=True, slots=True, eq=False)
class Watches:
    """The conditions of some owners (rules of a problem, effects of outcomes) by what they watch.

    ``mask`` (uint64[owners, E]): the bits that are watched. ``group`` (uint32[owners, E]): the group of
    a word's lowest watched bit; those of its next bits follow. ``field_group`` (int32[owners, fields]):
    the group of a field's number 0, those of the next numbers follow; -1 where it is not watched.
    ``first`` (uint32[groups + 1]): offsets into ``item`` (uint32), the numbers of the conditions.
    ``always`` (uint32) and ``always_first`` (uint32[owners + 1]): those that watch nothing.
    """

    mask: NDArray[np.uint64]
    group: NDArray[np.uint32]
    field_group: NDArray[np.int32]
    first: NDArray[np.uint32]
    item: NDArray[np.uint32]
    always: NDArray[np.uint32]
    always_first: NDArray[np.uint32]

    def arrays(self) -> tuple[NDArray[np.generic], ...]:
        """The arrays as the kernels take them."""
        return (
            self.mask, self.group, self.field_group, self.first, self.item, self.always,
            self.always_first,
        )  # fmt: skip


def watches(
    owners: Sequence[Sequence[Sequence[Demand]]], words: int, fields: Sequence[Field]
) -> Watches:
    """Choose what to watch: of each owner's conditions, in order, what each demands."""
    demanded = Counter(one for conditions in owners for demands in conditions for one in {*demands})
    mask = np.zeros((len(owners), words), np.uint64)
    group = np.zeros((len(owners), words), np.uint32)
    field_group = np.full((len(owners), len(fields)), -1, np.int32)
    first, item, always, always_first = [0], list[int](), list[int](), [0]
    number = 0
    for owner, conditions in enumerate(owners):
        watching: dict[Demand, list[int]] = {}
        for demands in conditions:
            if demands:
                rarest = min(demands, key=lambda one: (demanded[one], one))
                watching.setdefault(rarest, []).append(number)
            else:
                always.append(number)
            number += 1
        watched = {one.field: 1 << fields[one.field].width for one in watching if one.field >= 0}
        for index, codes in sorted(watched.items()):
            few = [one for one in watching if one.field == index]
            if SPARSE * sum(len(watching[one]) for one in few) < codes:  # a group for each is much
                always.extend(number for one in few for number in watching.pop(one))
                del watched[index]
        always_first.append(len(always))
        for bit in sorted(one.number for one in watching if one.field < 0):
            word = bit // WORD
            if mask[owner, word] == 0:
                group[owner, word] = len(first) - 1
            mask[owner, word] |= np.uint64(1 << bit % WORD)
            item.extend(watching[Demand(bit)])
            first.append(len(item))
        for index, codes in watched.items():
            field_group[owner, index] = len(first) - 1
            for code in range(codes):
                item.extend(watching.get(Demand(code, index), ()))
                first.append(len(item))
    return Watches(
        mask, group, field_group, np.array(first, np.uint32), np.array(item, np.uint32),
        np.array(always, np.uint32), np.array(always_first, np.uint32),
    )  # fmt: skip
