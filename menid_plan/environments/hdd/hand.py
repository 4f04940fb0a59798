"""What leads a tool: the hand of nobody, or that of an arm."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from menid_plan.environments.hdd.engine import Pose, Vector

Rows = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Poses one after the other: ``positions`` (n, 3) in mm, and ``turns``, quaternions (n, 4)."""

    positions: Rows
    turns: Rows

    def __getitem__(self, number: int) -> Pose:
        return Pose(self.positions[number], self.turns[number])

    def __iter__(self) -> Iterator[Pose]:
        return map(Pose, self.positions, self.turns)


@dataclass(frozen=True, slots=True, eq=False)
class Hand:
    """It takes ``stretch`` times as long as planned, and strays from its path.

    ``strays`` gives how far at a time in seconds: (6,), the way in mm and the turn in rad, about axes
    of the world.
    """

    stretch: float = 1.0
    strays: CubicSpline | None = None

    def ways(self, times: Vector) -> Rows:
        """How far it is off its path at times in seconds, in mm: (n, 3)."""
        off: Rows = np.zeros((len(times), 3)) if self.strays is None else self.strays(times)[:, :3]
        return off

    def led(self, path: Path, times: Vector) -> Path:
        """Where a tool is that is to follow a path, at times in seconds."""
        if self.strays is None:
            return path
        off = self.strays(times)
        turns = Rotation.from_rotvec(off[:, 3:]) * Rotation.from_quat(path.turns)
        return Path(path.positions + off[:, :3], turns.as_quat())


STEADY = Hand()
