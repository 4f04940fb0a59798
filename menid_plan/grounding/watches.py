"""Which conditions are worth a look in a state: those that watch a bit which is set.

A condition that demands some bits watches one of them, the one that the fewest others demand. Where
that bit is 0 the condition fails, and nobody looks at it. (The idea is that of the watched literals
of SAT solvers, Moskewicz et al. 2001.)
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

WORD = 64


@dataclass(frozen=True, slots=True, eq=False)
class Watches:
    """The conditions of some owners (rules of a problem, effects of outcomes) by watched bits.

    ``mask`` (uint64[owners, E]): the bits that are watched. ``group`` (int32[owners, E]): the group of
    a word's lowest watched bit; those of its next bits follow. ``first`` (int32[groups + 1]): offsets
    into ``item`` (int32), the numbers of the conditions. ``always`` (int32) and ``always_first``
    (int32[owners + 1]): those that watch nothing.
    """

    mask: NDArray[np.uint64]
    group: NDArray[np.int32]
    first: NDArray[np.int32]
    item: NDArray[np.int32]
    always: NDArray[np.int32]
    always_first: NDArray[np.int32]

    def arrays(self) -> tuple[NDArray[np.generic], ...]:
        """The arrays as the kernels take them."""
        return self.mask, self.group, self.first, self.item, self.always, self.always_first


def watches(owners: Sequence[Sequence[Sequence[int]]], words: int) -> Watches:
    """Choose what to watch: of each owner's conditions, in order, the bits that each demands."""
    demanded = Counter(bit for conditions in owners for bits in conditions for bit in set(bits))
    mask = np.zeros((len(owners), words), np.uint64)
    group = np.zeros((len(owners), words), np.int32)
    first, item, always, always_first = [0], list[int](), list[int](), [0]
    number = 0
    for owner, conditions in enumerate(owners):
        watching: dict[int, list[int]] = {}
        for bits in conditions:
            if bits:
                bit = min(bits, key=lambda bit: (demanded[bit], bit))
                watching.setdefault(bit, []).append(number)
            else:
                always.append(number)
            number += 1
        always_first.append(len(always))
        for bit in sorted(watching):
            word = bit // WORD
            if mask[owner, word] == 0:
                group[owner, word] = len(first) - 1
            mask[owner, word] |= np.uint64(1 << bit % WORD)
            item.extend(watching[bit])
            first.append(len(item))
    return Watches(
        mask, group, np.array(first, np.int32), np.array(item, np.int32),
        np.array(always, np.int32), np.array(always_first, np.int32),
    )  # fmt: skip
