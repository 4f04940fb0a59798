"""A lever goes in under the board's edge, prises it up, and turns it out over the far edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from menid_plan.environments.hdd.engine import Pose, Surface
from menid_plan.environments.hdd.geometry import CLEARANCE, SLOT_FLOOR, WALL
from menid_plan.environments.hdd.hand import STEADY, Hand
from menid_plan.environments.hdd.scene import BLUE, Scene, eased, turned

WIDTH, HEIGHT, LENGTH = 7.0, 1.0, 80.0  # mm
TIP = 30.0  # how much of it touches anything
MASS = 0.2  # kg
INERTIA = (10.0, 400.0, 400.0)  # kg mm^2 about the tip
FORCE = 30.0  # N, what the hand that holds it can do

GENTLE = 10.0  # N, what it does while the lever goes in
REACHED = 1.5  # mm: a lever that stays further from where it should be did not go in

START = -28.0  # where its tip begins, in mm before the board's edge
DEPTH = 3.0  # how far it goes in under the board
LEVEL = -1.15  # the height of its middle when it goes in
PRY, TURN = 28.0, 75.0  # degrees
PUSH = 30.0  # mm
# How long each part of the motion takes, in seconds.
INSERT, RAISE, ARC, SHOVE, WITHDRAW = 0.25, 0.25, 0.6, 0.2, 0.2


@dataclass(frozen=True, slots=True)
class Lever:
    """Where a lever goes in: at ``x``, ``y`` on the board's edge; ``direction`` (degrees): the way in.

    ``across``, ``above``, ``deeper`` (mm) and ``askew`` (rad) are how far the hand errs.
    """

    x: float
    y: float
    direction: float
    across: float = 0.0
    above: float = 0.0
    deeper: float = 0.0
    askew: float = 0.0
    force: float = FORCE

    @property
    def far(self) -> float:
        """How far the board's other edge is, in mm."""
        angle = np.radians(self.direction)
        return float(2 * abs(self.x * np.cos(angle) + self.y * np.sin(angle)))

    def pose(self, along: float, height: float, pitch: float) -> Pose:
        """The pose of the blade whose tip is so far in and so high (mm), pitched up (degrees)."""
        yaw = Rotation.from_euler("z", self.direction, degrees=True)
        at = yaw.apply([along, self.across, 0]) + np.array([self.x, self.y, height + self.above])
        turn = (
            Rotation.from_euler("z", self.askew)
            * yaw
            * Rotation.from_euler("y", -pitch, degrees=True)
        )
        return turned(turn, at)

    def at(self, time: float) -> Pose:
        """The pose that the hand aims at, so many seconds after it began."""
        depth = DEPTH + self.deeper
        part = eased(time / INSERT)
        if time <= INSERT:
            return self.pose(START + (depth - START) * part, LEVEL, 0.0)
        # Prising turns it about the outer edge of the slot's floor.
        pivot_x, pivot_z = -(CLEARANCE + WALL), SLOT_FLOOR
        pitch = PRY * eased((time - INSERT) / RAISE)
        c, s = np.cos(np.radians(pitch)), np.sin(np.radians(pitch))
        reach, rise = depth - pivot_x, LEVEL - pivot_z
        along, height = pivot_x + c * reach - s * rise, pivot_z + s * reach + c * rise
        if time <= INSERT + RAISE:
            return self.pose(along, height, pitch)
        # Then its tip runs about the far edge of the board.
        radius = np.hypot(self.far - along, height)
        first = np.degrees(np.arctan2(height, self.far - along))
        share = eased((time - INSERT - RAISE) / ARC)
        angle = np.radians(first + (TURN - first) * share)
        along, height = self.far - radius * np.cos(angle), radius * np.sin(angle)
        pitch += 30.0 * share
        shove = eased((time - INSERT - RAISE - ARC) / SHOVE)
        back = eased((time - INSERT - RAISE - ARC - SHOVE) / WITHDRAW)
        return self.pose(along + PUSH * (shove - 2 * back), height + 20.0 * back, pitch)

    @property
    def duration(self) -> float:
        """How long the motion takes, in seconds."""
        return INSERT + RAISE + ARC + SHOVE + WITHDRAW


def lever(scene: Scene, action: Lever, hand: Hand = STEADY) -> None:
    """Carry the action out in a scene."""
    world = scene.world
    start = hand.led(action.at(0.0), 0.0)
    tool = world.box(
        (TIP / 2, WIDTH / 2, HEIGHT / 2), start.position, MASS, Surface(1.0, 0.1), BLUE,
        offset=(-TIP / 2, 0, 0), turn=start.turn,
        seen=((LENGTH / 2, WIDTH / 2, HEIGHT / 2), (-LENGTH / 2, 0, 0)), inertia=INERTIA,
        held=True,
    )  # fmt: skip
    held = world.hold(tool, start, action.force)
    step = world.dt / hand.stretch  # of the motion as it was planned

    def follow(begin: float, end: float, force: float) -> None:
        for number in range(round(begin / step), round(end / step)):
            world.move(held, hand.led(action.at(number * step), number * world.dt), force)
            scene.step()

    gentle = min(GENTLE, action.force)
    follow(0.0, INSERT, gentle)
    aim = hand.led(action.at(INSERT), INSERT * hand.stretch)
    missed = world.pose(tool).position - aim.position
    if np.linalg.norm(missed) < REACHED:
        follow(INSERT, action.duration, action.force)
    else:  # the hand feels that the lever did not go in, and takes it back
        for number in range(round(WITHDRAW / step)):
            world.move(held, action.at(INSERT - number * step * INSERT / WITHDRAW), gentle)
            scene.step()
    scene.rest()
