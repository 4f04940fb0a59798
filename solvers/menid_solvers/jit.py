"""Compiling kernels: the one place that imports numba, and only once something is solved."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias, TypeVar, cast

import numba
import numpy as np
from numpy.typing import NDArray

# Indices that cannot be negative cost compiled code no test; so do loops over uint64.
Naturals: TypeAlias = NDArray[np.uint32]

_Kernel = TypeVar("_Kernel", bound=Callable[..., object])


def kernel(signature: str) -> Callable[[_Kernel], _Kernel]:
    """Compile a function for one signature, when its module is imported, or load it from the cache.

    One signature, so that nothing is ever compiled in the middle of a run; sums may be reordered
    (the bounds' allowance for rounding holds in any order), infinities keep their meaning.
    """
    decorator = numba.njit(
        signature, cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"}
    )
    return cast("Callable[[_Kernel], _Kernel]", decorator)
