"""What leads a tool: the hand of nobody, or that of an arm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from menid_plan.environments.hdd.engine import Pose, Vector
from menid_plan.environments.hdd.scene import turned


@dataclass(frozen=True, slots=True, eq=False)
class Hand:
    """It takes ``stretch`` times as long as planned, and strays from its path.

    ``strays`` gives how far at a time in seconds: (6,), the way in mm and the turn in rad, about axes
    of the world.
    """

    stretch: float = 1.0
    strays: CubicSpline | None = None

    def way(self, time: float) -> Vector:
        """How far it is off its path, in mm: (3,)."""
        off: Vector = np.zeros(3) if self.strays is None else self.strays(time)[:3]
        return off

    def led(self, pose: Pose, time: float) -> Pose:
        """Where a tool is that is to be at a pose, at a time in seconds."""
        if self.strays is None:
            return pose
        off = self.strays(time)
        turn = Rotation.from_rotvec(off[3:]) * Rotation.from_quat(pose.turn)
        return turned(turn, pose.position + off[:3])


STEADY = Hand()
