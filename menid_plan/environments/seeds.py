"""Seeds that follow from the seed of a run."""

from __future__ import annotations

import hashlib
import json


def seed_of(run: int, *parts: str | int) -> int:
    """A seed for one execution, 0 <= seed < 2**53, from the run's and what the execution is.

    For example ``seed_of(run, environment, str(action), number)``. Different arguments give seeds that
    have nothing to do with each other (the first 53 bits of a SHA-256), the same on every machine.
    """
    text = json.dumps([run, *parts])
    return int.from_bytes(hashlib.sha256(text.encode("utf-8")).digest()[:8], "big") >> 11
