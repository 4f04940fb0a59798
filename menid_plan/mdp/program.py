"""Kernels that compute derived bits: of 64 states at once, one bit of a word for each of them.

What a condition comes to in 64 states is then one operation on words for each of its literals, however
the states differ (bit slicing, Biham 1997).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from menid_plan.compiled import kernel

LANES = 64
PLANES = 32  # binary digits of a count


@kernel()
def transpose(a: Any) -> None:
    """Turn 64 words of 64 bits about their diagonal (Warren, Hacker's Delight, 2002)."""
    j = 32
    m = np.uint64(0x00000000FFFFFFFF)
    while j != 0:
        shift = np.uint64(j)
        k = 0
        while k < 64:
            t = ((a[k] >> shift) ^ a[k + j]) & m
            a[k] ^= t << shift
            a[k + j] ^= t
            k = (k + j + 1) & ~j
        j >>= 1
        m ^= m << np.uint64(j)


@kernel()
def counted(
    begin: int, end: int, number: int, exactly: bool, literal: Any, sliced: Any, planes: Any,
) -> Any:  # fmt: skip
    """In which lanes so many, or at least so many, of some literals hold."""
    width = 1
    while (end - begin) >> width != 0 or number >> width != 0:
        width += 1
    for p in range(width):
        planes[p] = 0
    for i in range(begin, end):
        carry = sliced[literal[i, 0]] ^ literal[i, 1]
        for p in range(width):
            if carry == 0:
                break
            digit = planes[p]
            planes[p] = digit ^ carry
            carry &= digit
    equal = ~np.uint64(0)
    more = np.uint64(0)
    for k in range(width):
        p = width - 1 - k
        if number >> p & 1:
            equal &= planes[p]
        else:
            more |= equal & planes[p]
            equal &= ~planes[p]
    return equal if exactly else equal | more


@kernel()
def extend_block(
    states: Any, first: int, count: int, words: int, ops: Any, literal: Any, segments: Any,
    sliced: Any, column: Any, planes: Any, block: Any,
) -> None:  # fmt: skip
    """Write the extended words of up to 64 states to the rows of block.

    An operation's bit follows those of the state, in order. Segments that loop are computed until
    nothing changes; of their operations only derived atoms (kind 3) begin as false and count.
    """
    for w in range(words):
        for lane in range(LANES):
            column[lane] = states[first + lane, w] if lane < count else np.uint64(0)
            block[lane, w] = column[lane]
        transpose(column)
        for bit in range(LANES):
            sliced[64 * w + bit] = column[bit]
    base = 64 * words
    for bit in range(base, len(sliced)):
        sliced[bit] = 0
    for segment in range(len(segments) - 1):
        again = True
        while again:
            changed = np.uint64(0)
            for op in range(segments[segment, 1], segments[segment + 1, 1]):
                kind = ops[op, 0]
                begin, end = ops[op, 2], ops[op + 1, 2]
                if kind == 0 or kind == 3:
                    found = ~np.uint64(0)
                    for i in range(begin, end):
                        found &= sliced[literal[i, 0]] ^ literal[i, 1]
                    if kind == 3:
                        changed |= found ^ sliced[base + op]
                else:
                    found = counted(begin, end, ops[op, 1], kind == 1, literal, sliced, planes)
                sliced[base + op] = found
            again = changed != 0 and segments[segment, 0] != 0
    for w in range(words, block.shape[1]):
        for bit in range(LANES):
            column[bit] = sliced[64 * w + bit]
        transpose(column)
        for lane in range(count):
            block[lane, w] = column[lane]
