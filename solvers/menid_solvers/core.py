"""The equations that remain of an MDP and an objective once its graph has been dealt with.

With unknowns x (one for each state, or for each end component that was merged into one), rows i of
unknown u, and entries k of row i::

    x[u] = max(floor[u], max over i of  constant[i] + sum over k of weight[k] * x[target[k]])

Loops of a row to its own unknown are solved for, the discount is multiplied into the weights, and
what leads to a known value is in the constant. Rows of one kind that lead to as many unknowns have the
same weights, and share them. Unknowns are numbered
by *blocks* (strongly connected components) such that a block refers to itself and earlier ones, and
within a block the state found last comes first, since values flow back from the end.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from menid_plan.mdp.model import MDP, Bools, Floats, Ints, Naturals, SmallInts
from menid_plan.memory import demand
from menid_solvers import core_kernels as kernels
from menid_solvers.graph import components

Rows: TypeAlias = tuple[Ints, SmallInts, Naturals, SmallInts, Floats, Floats, Floats]


@dataclass(frozen=True, slots=True, eq=False)
class Core:
    """The equations. See the module; with u unknowns, i rows, k entries, b blocks and n states.

    ::

    first_row     int64[u + 1]     constant        float64[i]
    first_entry   int32[i + 1]     target          uint32[k]
    block_first   int64[b + 1]
    row_weight    int32[i]         where the weights of a row begin in `weight` (float64); before them
                                   stands what it leaks, 1 - their sum
    floor         float64[u]       what ending at once pays, -inf where one cannot
    source        int32[i]         the row of the MDP
    unknown       int32[n]         of a state; -1 where the value is known
    depth         int32[b]         blocks of several unknowns on the longest way from here
    """

    first_row: Ints
    first_entry: SmallInts
    target: Naturals
    row_weight: SmallInts
    weight: Floats
    constant: Floats
    floor: Floats
    source: SmallInts
    unknown: SmallInts
    block_first: Ints
    depth: SmallInts
    longest: int
    discount: float

    @property
    def unknowns(self) -> int:
        """How many unknowns there are."""
        return len(self.floor)

    @property
    def blocks(self) -> int:
        """How many blocks there are."""
        return len(self.depth)

    def rows(self) -> Rows:
        """The arrays that the sweeps read, in the order of their parameters."""
        return (
            self.first_row, self.first_entry, self.target, self.row_weight, self.weight,
            self.constant, self.floor,
        )  # fmt: skip


def build_core(
    mdp: MDP,
    *,
    rows: Bools,
    reward: Floats,
    discount: float,
    known: Bools,
    known_value: Floats,
    merged: SmallInts | None = None,
    inside: Bools | None = None,
    stop: Floats | None = None,
) -> Core:
    """The equations of an MDP restricted to some rows (bool[r]).

    ``known`` (bool[n]) says where the value is ``known_value``; ``merged`` (int32[n], -1 for none)
    which end component a state is in that becomes one unknown, ``inside`` (bool[r]) which rows stay
    inside such a component (they are left out), and ``stop`` (float64, by component) what staying
    in it forever is worth, -inf if that is not allowed.
    """
    n = mdp.states
    size = f"to solve {n} states with {mdp.transitions} transitions"
    weights = len(mdp.kind_probability)
    demand(4.0 * mdp.transitions + 28.0 * mdp.rows + 80.0 * n + 8.0 * weights, size)
    number, component = components(mdp, rows)
    if merged is None:
        merged = np.full(n, -1, np.int32)
    unknown = np.empty(n, np.int32)
    member = np.empty(n, np.int32)
    member_first = np.empty(n + 1, np.int64)
    block_first = np.empty(number + 1, np.int64)
    unknowns, blocks = kernels.number_unknowns(
        component, number, known, merged, unknown, member, member_first, block_first,
        np.empty(number + 1, np.int64), np.empty(n, np.int32), np.empty(n, np.int32),
    )  # fmt: skip
    counts = rows if inside is None else rows & ~inside
    first_row = np.empty(unknowns + 1, np.int64)
    # Memory that is not written to is not taken: there is room for the worst case.
    first_entry = np.empty(mdp.rows + 1, np.int32)
    source = np.empty(mdp.rows, np.int32)
    constant = np.empty(mdp.rows)
    target = np.empty(mdp.transitions, np.uint32)
    row_weight = np.empty(mdp.rows, np.int32)
    weight = np.empty(mdp.transitions + mdp.rows)
    kinds = len(mdp.kind_action)
    depth = np.zeros(blocks, np.int32)
    row_number, entries, weights, longest = kernels.compile_rows(
        *mdp.graph, counts, reward, known_value, discount, unknown, member, member_first,
        block_first, blocks, first_row, first_entry, source, constant, target, row_weight, weight,
        depth, np.empty(unknowns, np.int32), np.empty(unknowns, np.int64), np.empty(kinds, np.int64),
        np.empty(kinds, np.int32),
    )  # fmt: skip
    floor = np.full(unknowns, -np.inf)
    if stop is not None:
        where = merged >= 0
        where &= ~known
        floor[unknown[where]] = stop[merged[where]]
    return Core(
        first_row=first_row,
        first_entry=first_entry[: row_number + 1],
        target=target[:entries],
        row_weight=row_weight[:row_number],
        weight=weight[:weights],
        constant=constant[:row_number],
        floor=floor,
        source=source[:row_number],
        unknown=unknown,
        block_first=block_first[: blocks + 1],
        depth=depth,
        longest=longest,
        discount=discount,
    )
