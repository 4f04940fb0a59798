"""Looks options over: whoever writes a value that cannot be meant is told so at once."""

from __future__ import annotations

import math


def demand_positive(**options: float | None) -> None:
    """ValueError unless each option is a finite number above 0, or None."""
    for name, value in options.items():
        if value is not None and not 0.0 < value < math.inf:
            raise ValueError(f"{name} must be above 0 and finite, not {value}")


def demand_at_least(least: int, **options: float | None) -> None:
    """ValueError unless each option is at least so much and finite, or None."""
    for name, value in options.items():
        if value is not None and not least <= value < math.inf:
            raise ValueError(f"{name} must be at least {least} and finite, not {value}")


def demand_share(**options: float) -> None:
    """ValueError unless each option lies between 0 and 1, without them."""
    for name, value in options.items():
        if not 0.0 < value < 1.0:
            raise ValueError(f"{name} must be between 0 and 1, not {value}")
