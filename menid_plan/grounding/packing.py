"""Where the words of a state keep its facts: a bit for each, or a number for a group of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from menid_plan.grounding.exclusive import Group
from menid_plan.model.formulas import GroundAtom

WORD = 64


class Place(NamedTuple):
    """A fact holds where ``word & mask == value`` for the word of that number."""

    word: int
    mask: int
    value: int


class Field(NamedTuple):
    """Some bits of a word that tell which fact of a group holds: 1 for its first, 0 for none."""

    word: int
    shift: int
    width: int

    @property
    def mask(self) -> int:
        """Its bits."""
        return (1 << self.width) - 1 << self.shift


@dataclass(slots=True, eq=False)
class Layout:
    """Facts in words; those of exclusive groups, of which at most one holds, as numbers in fields.

    ``single`` are the others by their bits; ``places[f]`` is where a fact is, ``code[f]`` its field and
    its number there, if it is in one.
    """

    facts: tuple[GroundAtom, ...]
    groups: Sequence[Group] = ()
    words: int = 1
    bits: int = 0
    single: tuple[GroundAtom, ...] = ()
    places: dict[GroundAtom, Place] = field(default_factory=dict)
    fields: list[Field] = field(default_factory=list)
    code: dict[GroundAtom, tuple[int, int]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for number, group in enumerate(self.groups):
            self.code.update((atom, (number, i)) for i, atom in enumerate(group, start=1))
        self.single = tuple(atom for atom in self.facts if atom not in self.code)
        for number, atom in enumerate(self.single):
            word, bit = divmod(number, WORD)
            self.places[atom] = Place(word, 1 << bit, 1 << bit)
        used = [WORD] * (len(self.single) // WORD) + [len(self.single) % WORD]
        for group in self.groups:
            width = len(group).bit_length()
            fitting = (word for word, bits in enumerate(used) if bits + width <= WORD)
            word = next(fitting, len(used))
            if word == len(used):
                used.append(0)
            place = Field(word, used[word], width)
            used[word] += width
            self.fields.append(place)
            for code, atom in enumerate(group, start=1):
                self.places[atom] = Place(word, place.mask, code << place.shift)
        self.words = max(1, len(used) - (used[-1] == 0))
        self.bits = sum(used)

    def pack(self, state: Iterable[GroundAtom]) -> NDArray[np.uint64] | None:
        """Facts as words; None if two of them exclude each other. KeyError for what is no fact."""
        words = [0] * self.words
        for atom in state:
            word, mask, value = self.places[atom]
            if words[word] & mask:
                return None
            words[word] |= value
        return np.array(words, np.uint64)

    def unpack(self, words: NDArray[np.uint64]) -> list[GroundAtom]:
        """The facts that hold in some words."""
        found = []
        given = words.tolist()
        for group, (word, shift, width) in zip(self.groups, self.fields, strict=True):
            code = given[word] >> shift & (1 << width) - 1
            if code:
                found.append(group[code - 1])
        for index in range(-(-len(self.single) // WORD)):
            bits = given[index] & (1 << min(WORD, len(self.single) - index * WORD)) - 1
            while bits:
                low = bits & -bits
                found.append(self.single[index * WORD + low.bit_length() - 1])
                bits ^= low
        return found
