"""The drive on its table: a bay that stands still, and a board in it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from menid_plan.environments.hdd.cells import cells
from menid_plan.environments.hdd.engine import (
    GRAVITY,
    EngineSettings,
    Pose,
    Surface,
    Vector,
    World,
)
from menid_plan.environments.hdd.mesh import TriangleMesh
from menid_plan.environments.interface import EnvironmentFailedError

BOARD_MASS = 0.025  # kg
BOARD_INERTIA = (7.8, 21.0, 28.5)  # kg mm^2, of a plate of that mass with its parts
TABLE = -22.0  # the height of the table's top, in mm

GREEN, GREY, WOOD = (0.12, 0.50, 0.28, 1), (0.62, 0.65, 0.70, 1), (0.80, 0.74, 0.65, 1)
BLUE, BLACK = (0.16, 0.35, 0.75, 1), (0.12, 0.12, 0.13, 1)

# A board has come to rest when it moved less than this for so long, in mm/s, rad/s and seconds; what
# still moves then is watched for no longer than that.
STILL, STILL_TURN, STILL_FOR, LONGEST = 2.0, 0.05, 0.06, 1.0


@dataclass(frozen=True, slots=True)
class Physics:
    """What a scene is made with. ``friction`` and ``restitution`` are those between board and bay."""

    engine: EngineSettings = field(default_factory=EngineSettings)
    gravity: float = GRAVITY
    friction: float = 0.35
    restitution: float = 0.1


def level(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Pose:
    """A pose that is not turned."""
    return Pose(np.array([x, y, z]), np.array([0.0, 0.0, 0.0, 1.0]))


def turned(rotation: Rotation, position: Vector) -> Pose:
    """A pose from a rotation."""
    return Pose(position, rotation.as_quat())


def eased(share: Vector) -> Vector:
    """From 0 to 1, at rest at both ends."""
    share = np.clip(share, 0.0, 1.0)
    return share * share * (3 - 2 * share)


class BrokenDownError(EnvironmentFailedError):
    """A computation gives nothing of use; shorter steps of time may help."""


class Scene:
    """Board, bay and table in a world of their own."""

    def __init__(
        self,
        board: TriangleMesh,
        bay: TriangleMesh,
        physics: Physics,
        start: Pose,
        window: bool = False,
        drawn: bool = False,
        watched: bool = False,
        after_step: Callable[[Scene], None] | None = None,
    ) -> None:
        """``start`` is the board's pose before it settles.

        With ``watched`` the largest force on the board is kept, which takes time at every step;
        ``after_step`` is called after each.
        """
        self.physics = physics
        self.mesh = board
        self.world = World(physics.engine, physics.gravity, window, drawn)
        surface = Surface(physics.friction, physics.restitution)
        self.table = self.world.static_box(
            (300, 300, 10), (0, 0, TABLE - 10), Surface(0.5, 0.1), WOOD
        )
        self.bay = self.world.static_mesh(bay, surface, GREY)
        hulls = cells(board, physics.engine.margin)
        self.board = self.world.compound(
            hulls, board, start, BOARD_MASS, BOARD_INERTIA, Surface(), GREEN
        )
        self.watched = watched
        self.after_step = after_step
        self.peak_force = 0.0
        # How far the frame in which all of this is computed is turned, in rad: for pictures.
        self.frame_angle = 0.0
        self.began = math.inf  # when the action began, in s
        # How far it has come in the tool's motion, in s, if that is not the time since it began.
        self.reached: float | None = None

    def __enter__(self) -> Scene:
        return self

    def __exit__(self, *_: object) -> None:
        self.world.close()

    def step(self) -> None:
        """Let a step of time pass."""
        self.world.step()
        if self.watched:
            self.peak_force = max(self.peak_force, self.world.contact_force(self.board))
        if self.after_step is not None:
            self.after_step(self)

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        for _ in range(round(seconds / self.world.dt)):
            self.step()

    def rest(self) -> None:
        """Let time pass until the board has come to rest, or for a second."""
        step = self.world.dt
        still = 0.0
        for _ in range(round(LONGEST / step)):
            self.step()
            _, _, linear, angular = self.world.motion(self.board)
            moves = max(map(abs, linear)) > STILL or max(map(abs, angular)) > STILL_TURN
            still = 0.0 if moves else still + step
            if still >= STILL_FOR:
                break

    @property
    def pose(self) -> Pose:
        """Where the board is."""
        return self.world.pose(self.board)

    @property
    def tilt(self) -> float:
        """How far the board leans, in degrees: 0 when it lies flat, 180 upside down."""
        return float(np.degrees(np.arccos(np.clip(self.pose.matrix[2, 2], -1, 1))))
