"""A Panda arm that leads the tools: what it can reach, how fast, and how far it strays.

Its shape and its limits are those that Franka Emika publishes for the Panda (Franka Control Interface
documentation, "Robot and interface specifications"). The arm itself touches nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from menid_plan.environments.hdd.engine import Pose, Vector
from menid_plan.environments.hdd.hand import Hand, Path
from menid_plan.environments.hdd.lever import LENGTH, WIDTH, Lever
from menid_plan.environments.hdd.scene import TABLE, Scene, turned
from menid_plan.environments.hdd.shake import DURATION, PIVOT, Shake
from menid_plan.environments.hdd.suck import CUP, RADIUS, Suck
from menid_plan.environments.interface import EnvironmentFailedError

Matrices = NDArray[np.float64]

# The joints after Craig (1989), one row each: the distance and the twist to the axis before, and the
# offset along the joint's own axis, in mm and radians. The last row leads to the fingers' tips.
SHAPE = np.array(
    [
        [0.0, 0.0, 333.0], [0.0, -np.pi / 2, 0.0], [0.0, np.pi / 2, 316.0], [82.5, np.pi / 2, 0.0],
        [-82.5, -np.pi / 2, 384.0], [0.0, np.pi / 2, 0.0], [88.0, np.pi / 2, 0.0],
        [0.0, 0.0, 107.0 + 103.4],
    ]
)  # fmt: skip
# How the hand is turned on the flange.
HAND = -np.pi / 4
LOWEST = np.array([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973])  # rad
HIGHEST = np.array([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])
SPEED = np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61])  # rad/s
ACCELERATION = np.array([15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0])  # rad/s^2
HOME = np.array([0.0, -0.4, 0.0, -2.3, 0.0, 2.0, 0.785])  # where the search for a reach begins

PEDESTAL = 60.0  # mm that the arm's foot stands over the table
AWAY = 520.0  # mm from the foot to the middle of the drive
# Degrees that the hand points down, when it holds a level lever and otherwise. The first is so much
# that it stays clear of the table when the lever points up.
BACK, DOWN = 130.0, 90.0
GRIP, HELD = (0.0, -40.0, -10.0), 10.0  # mm: where it holds a drive that it shakes, and how wide

KNOT = 0.02  # s between two poses that are solved for
RADIAN = 200.0  # mm: how much a turn counts beside a way when a pose is solved for
STIFF = 0.01  # what keeps the elbow from drifting: mm for each radian
# An arm that stays further off, or bends further than its limits, can't reach something.
OFF, OFF_TURNED = 0.5, 0.01  # mm, rad
TREMBLE = 0.05  # s: how quickly the joints' errors change


def frames(joints: Vector) -> Matrices:
    """Where the seven joints and the fingers' tips are, seen from the foot: (8, 4, 4), in mm."""
    found = np.empty((8, 4, 4))
    last = np.eye(4)
    for k, ((a, alpha, d), theta) in enumerate(zip(SHAPE, [*joints, HAND], strict=True)):
        ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        last = last @ np.array(
            [
                [ct, -st, 0.0, a],
                [st * ca, ct * ca, -sa, -sa * d],
                [st * sa, ct * sa, ca, ca * d],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
        found[k] = last
    return found


def jacobian(joints: Vector) -> Matrices:
    """How the tips move (mm) and turn (rad, about the foot's axes) with each joint: (6, 7)."""
    placed = frames(joints)
    axes, at = placed[:7, :3, 2], placed[:7, :3, 3]
    return np.vstack([np.cross(axes, placed[7, :3, 3] - at).T, axes.T])


def solved(aim: Pose, start: Vector, first: bool) -> Vector:
    """Joints near the start (7,) that bring the tips to a pose, seen from the foot.

    The ``first`` of a motion is sought within the joints' limits; the next ones, where that is not
    needed, in a tenth of the time. EnvironmentFailedError if the arm can't reach it.
    """
    wanted = aim.matrix

    def error(joints: Vector) -> Vector:
        tips = frames(joints)[7]
        turn = Rotation.from_matrix(wanted @ tips[:3, :3].T).as_rotvec()
        return np.concatenate([aim.position - tips[:3, 3], RADIAN * turn, STIFF * (start - joints)])

    def slope(joints: Vector) -> Matrices:
        moved = jacobian(joints)
        moved[3:] *= RADIAN
        return -np.vstack([moved, STIFF * np.eye(7)])

    if first:
        found = least_squares(error, start, slope, bounds=(LOWEST, HIGHEST)).x
    else:
        found = least_squares(error, start, slope, method="lm").x
    left = error(found)
    if (
        np.linalg.norm(left[:3]) > OFF
        or np.linalg.norm(left[3:6]) > RADIAN * OFF_TURNED
        or (found < LOWEST).any()
        or (found > HIGHEST).any()
    ):
        raise EnvironmentFailedError("the arm can't reach so far")
    joints: Vector = found
    return joints


@dataclass(frozen=True, slots=True)
class Task:
    """What the arm is to do: the poses of a tool, so many knots apart, and how the hand holds it.

    ``grip``: the fingers' tips seen from the tool; ``side``: from where the arm reaches, in degrees
    about the drive; ``open``: how far each finger is, in mm.
    """

    tool: Path
    grip: Pose
    side: float
    open: float

    @classmethod
    def of(cls, action: Lever | Shake | Suck) -> Task:
        """What an action asks of the arm."""
        if isinstance(action, Lever):
            path = action.path(_knots(action.duration))
            return cls(
                path,
                _held(BACK, (-LENGTH, 0.0, 0.0)),
                action.direction + 180.0,
                WIDTH / 2,
            )
        if isinstance(action, Suck):
            path = action.path(_knots(action.duration))
            return cls(path, _held(DOWN, (0.0, 0.0, CUP), turn=90.0), -90.0, RADIUS)
        turns = Rotation.from_rotvec(
            [[action.angles(time)[0], 0.0, 0.0] for time in _knots(DURATION)]
        )
        path = Path(PIVOT - turns.apply(PIVOT), turns.as_quat())
        return cls(path, _held(DOWN, GRIP, turn=90.0), -90.0, HELD)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """How the arm does it: ``joints`` (n, 7) in rad at ``times`` (n,) in s, from its ``foot``.

    It takes ``stretch`` times as long as was asked for. ``drift`` (n, 6, 7): how the tool moves (mm)
    and turns (rad, about axes of the world) with each joint.
    """

    task: Task
    foot: Pose
    times: Vector
    joints: Matrices
    stretch: float
    drift: Matrices

    @classmethod
    def of(cls, task: Task) -> Motion:
        """The motion for a task, as fast as the joints can go; EnvironmentFailedError if none can.

        All of it is slowed down alike until no joint is too fast (Hollerbach 1984).
        """
        facing = Rotation.from_euler("z", task.side + 180.0, degrees=True)
        foot = turned(facing, np.array([0.0, 0.0, TABLE + PEDESTAL]) - facing.apply([AWAY, 0, 0]))
        joints: list[Vector] = []
        drift: list[Matrices] = []
        last = HOME
        for pose in task.tool:
            turn = Rotation.from_quat(pose.turn)
            hand = turned(
                facing.inv() * turn * Rotation.from_quat(task.grip.turn),
                facing.inv().apply(pose.outside(task.grip.position) - foot.position),
            )
            last = solved(hand, last, first=not joints)
            joints.append(last)
            moved = jacobian(last)
            ways, turns = facing.apply(moved[:3].T), facing.apply(moved[3:].T)
            arm = turn.apply(-task.grip.position)
            drift.append(np.vstack([(ways + np.cross(turns, arm)).T, turns.T]))
        times: Vector = KNOT * np.arange(len(joints), dtype=float)
        curve = CubicSpline(times, joints)
        speed = (np.abs(curve(times, 1)) / SPEED).max()
        acceleration = (np.abs(curve(times, 2)) / ACCELERATION).max()
        stretch = max(1.0, float(speed), float(np.sqrt(acceleration)))
        return cls(task, foot, stretch * times, np.array(joints), stretch, np.array(drift))

    def hand(self, jerk: float, rng: np.random.Generator) -> Hand:
        """The hand that leads the tool; its joints err by so much (standard deviation, in rad)."""
        marks = np.arange(0.0, self.times[-1] + 4 * TREMBLE, TREMBLE)
        errors = CubicSpline(marks, jerk * rng.standard_normal((len(marks), 7)))(self.times)
        return Hand(
            self.stretch, CubicSpline(self.times, np.einsum("nij,nj->ni", self.drift, errors))
        )

    def show(self, scene: Scene, arm: int, stand: int) -> None:
        """Bend an arm in a scene as it is now, and put it and what it stands on where they belong."""
        world = scene.world
        reached = world.time - scene.began if scene.reached is None else scene.reached
        now = np.clip(reached, 0.0, self.times[-1])
        world.bend(arm, CubicSpline(self.times, self.joints)(now), self.task.open)
        # A drive that is shaken stands still in its own frame.
        back = Rotation.from_euler("x", -scene.frame_angle)
        turn = back * Rotation.from_quat(self.foot.turn)
        at = PIVOT + back.apply(self.foot.position - PIVOT)
        world.stand(arm, turned(turn, at))
        world.place(stand, turned(turn, at - turn.apply([0.0, 0.0, PEDESTAL / 2])))


def _knots(duration: float) -> Vector:
    found: Vector = np.arange(0.0, duration + KNOT, KNOT)
    return found


def _held(down: float, at: Sequence[float], turn: float = 0.0) -> Pose:
    """A hand that points so far down, turned about the upright axis, in degrees."""
    # The hand's own z axis points out of it, its fingers open along y, and x is its upper side.
    rotation = Rotation.from_euler("ZYZ", [turn, 90.0 + down, 180.0], degrees=True)
    return turned(rotation, np.array(at))
