"""From what is seen of the board to the atoms that hold, by one table of thresholds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from menid_plan.environments.hdd.engine import Pose

# In mm and degrees. A board is out of its bay when its middle is so far from its seat, or so high.
REMOVED_ASIDE, REMOVED_UP = 20.0, 4.0
# One that is still in is loose when it has moved, or leans, by more than this.
LOOSE_MOVED, LOOSE_TILT = 1.0, 2.0
TILTED, FLIPPED = 4.0, 120.0
DAMAGING = 40.0  # N, the sum of the forces on the board in one step of time


@dataclass(frozen=True, slots=True)
class Seen:
    """What is seen of the board at rest: lengths in mm from its seat, ``tilt`` in degrees.

    ``force``: the largest sum of contact forces on it so far, in N.
    """

    aside: float
    up: float
    tilt: float
    force: float = 0.0

    @classmethod
    def of(cls, pose: Pose, force: float = 0.0) -> Seen:
        """What a pose of the board shows; its seat is at the origin."""
        tilt = np.degrees(np.arccos(np.clip(pose.matrix[2, 2], -1, 1)))
        aside, up = np.hypot(*pose.position[:2]), pose.position[2]
        return cls(float(aside), float(up), float(tilt), force)

    @property
    def removed(self) -> bool:
        """It is out of the bay, on the table or free on top of the frame: as good as taken away."""
        return self.aside > REMOVED_ASIDE or self.up > REMOVED_UP

    @property
    def loose(self) -> bool:
        """It is in the bay, and has come off its seat."""
        moved = float(np.hypot(self.aside, self.up))
        return not self.removed and (moved > LOOSE_MOVED or self.tilt > LOOSE_TILT)


# What each predicate says of the board, and of which objects it speaks.
PREDICATES: dict[str, tuple[tuple[str, ...], Callable[[Seen], bool]]] = {
    "in": (("board", "bay"), lambda seen: not seen.removed),
    "loose": (("board",), lambda seen: seen.loose),
    "tilted": (("board",), lambda seen: not seen.removed and seen.tilt > TILTED),
    "flipped": (("board",), lambda seen: seen.tilt > FLIPPED),
    "on-table": (("board",), lambda seen: seen.removed),
    "damaged": (("board",), lambda seen: seen.force > DAMAGING),
}
