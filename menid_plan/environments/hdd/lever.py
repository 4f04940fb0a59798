"""A lever goes in under the board's edge, prises it up, and turns it out over the far edge."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from menid_plan.environments.hdd.engine import Surface, Vector
from menid_plan.environments.hdd.geometry import CLEARANCE, SLOT_FLOOR, WALL
from menid_plan.environments.hdd.hand import STEADY, Hand, Path
from menid_plan.environments.hdd.scene import BLUE, Scene, eased

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

    def path(self, times: Vector) -> Path:
        """The poses of the blade's tip that the hand aims at, so many seconds after it began."""
        depth = DEPTH + self.deeper
        part = eased(times / INSERT)
        along, height, pitch = START + (depth - START) * part, np.full_like(times, LEVEL), 0 * times
        # Prising turns it about the outer edge of the slot's floor.
        pivot_x, pivot_z = -(CLEARANCE + WALL), SLOT_FLOOR
        turned = np.radians(PRY * eased((times - INSERT) / RAISE))
        c, s = np.cos(turned), np.sin(turned)
        reach, rise = depth - pivot_x, LEVEL - pivot_z
        prising = times > INSERT
        along = np.where(prising, pivot_x + c * reach - s * rise, along)
        height = np.where(prising, pivot_z + s * reach + c * rise, height)
        pitch = np.degrees(turned)
        # Then its tip runs about the far edge of the board.
        last = times > INSERT + RAISE
        radius = np.hypot(self.far - along, height)
        first = np.degrees(np.arctan2(height, self.far - along))
        share = eased((times - INSERT - RAISE) / ARC)
        angle = np.radians(first + (TURN - first) * share)
        shove = eased((times - INSERT - RAISE - ARC) / SHOVE)
        back = eased((times - INSERT - RAISE - ARC - SHOVE) / WITHDRAW)
        along = np.where(last, self.far - radius * np.cos(angle) + PUSH * (shove - 2 * back), along)
        height = np.where(last, radius * np.sin(angle) + 20.0 * back, height)
        pitch += 30.0 * share
        # From the way in to the world.
        zero = 0 * times
        yaw = Rotation.from_euler("z", self.direction, degrees=True)
        at = yaw.apply(np.stack([along, zero + self.across, height + self.above], axis=1))
        turns = (
            Rotation.from_euler("z", self.askew)
            * yaw
            * Rotation.from_euler("y", -pitch[:, None], degrees=True)
        )
        return Path(at + np.array([self.x, self.y, 0.0]), turns.as_quat())

    @property
    def duration(self) -> float:
        """How long the motion takes, in seconds."""
        return INSERT + RAISE + ARC + SHOVE + WITHDRAW


def lever(scene: Scene, action: Lever, hand: Hand = STEADY) -> None:
    """Carry the action out in a scene."""
    world = scene.world
    planned = action.duration * hand.stretch
    times: Vector = world.dt * np.arange(round(planned / world.dt) + 1.0)
    path = hand.led(action.path(times / hand.stretch), times)
    start = path[0]
    tool = world.box(
        (TIP / 2, WIDTH / 2, HEIGHT / 2), start.position, MASS, Surface(1.0, 0.1), BLUE,
        offset=(-TIP / 2, 0, 0), turn=start.turn,
        seen=((LENGTH / 2, WIDTH / 2, HEIGHT / 2), (-LENGTH / 2, 0, 0)), inertia=INERTIA,
        held=True,
    )  # fmt: skip
    held = world.hold(tool, start, action.force)

    def follow(knots: Iterable[int], force: float) -> None:
        for k in knots:
            world.move(held, path[k], force)
            scene.reached = float(times[k])
            scene.step()

    gentle = min(GENTLE, action.force)
    inside = round(INSERT * hand.stretch / world.dt)
    follow(range(inside), gentle)
    missed = world.pose(tool).position - path[inside].position
    if np.linalg.norm(missed) < REACHED:
        follow(range(inside, len(times) - 1), action.force)
    else:  # the hand feels that the lever did not go in, and takes it back
        number = round(WITHDRAW * hand.stretch / world.dt)
        back = np.linspace(inside, 0, number, endpoint=False).round().astype(int)
        follow(back, gentle)
    scene.rest()
