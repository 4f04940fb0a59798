"""Numba, typed: the one place that knows it is untyped."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

_Function = TypeVar("_Function", bound=Callable[..., Any])


def compiled(function: _Function) -> _Function:
    """Compile a function on its first call, and keep the result between runs."""
    return cast("_Function", numba.njit(cache=True, nogil=True)(function))


def inlined(function: _Function) -> _Function:
    """Compile a function into those that call it: a call hands every field of every array over."""
    return cast("_Function", numba.njit(inline="always", nogil=True)(function))
