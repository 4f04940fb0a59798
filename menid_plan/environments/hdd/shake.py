"""The drive is shaken to and fro about an axis beside it, until the board jumps out.

The scene is computed in the frame that turns with the drive, so that the bay stands still: a bay that
moves would throw the board about by the errors of its contacts. The board gets what mechanics adds in
such a frame: turned gravity, and the Euler, centrifugal and Coriolis forces.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from menid_plan.environments.hdd.hand import STEADY, Hand
from menid_plan.environments.hdd.scene import BOARD_INERTIA, BOARD_MASS, Scene

PIVOT = np.array([0.0, -150.0, 0.0])  # mm: a point of the axis, which runs along the drive
FREQUENCY = 10.0  # Hz
DURATION = 1.0  # s
RAMP = 0.15  # s, over which the amplitude grows at the beginning and falls at the end
# Where the drive is thrown with more than this share of gravity, the board leaves its seat and comes
# back at half a metre per second: it would sink into the bay if the steps were not shorter.
LOOSE, FINER = 0.9, 4
OUT = 25.0  # mm: a board so far from its seat will not come back


@dataclass(frozen=True, slots=True)
class Shake:
    """``degrees`` to each side, ``frequency`` in Hz."""

    degrees: float
    frequency: float = FREQUENCY

    def angles(self, time: float) -> tuple[float, float, float]:
        """The angle of the drive (rad), its rate and its acceleration, at a time in seconds."""
        # The envelope is eased, so that the rate begins at 0; its derivatives are kept.
        amplitude = math.radians(self.degrees)
        omega = 2 * math.pi * self.frequency
        envelope, slope, bend = _envelope(time)
        s, c = math.sin(omega * time), math.cos(omega * time)
        return (
            amplitude * envelope * s,
            amplitude * (slope * s + envelope * omega * c),
            amplitude * (bend * s + 2 * slope * omega * c - envelope * omega**2 * s),
        )


def _envelope(time: float) -> tuple[float, float, float]:
    """The share of the amplitude at a time, with its first and second derivatives."""
    for share, sign in ((time / RAMP, 1.0), ((DURATION - time) / RAMP, -1.0)):
        if share <= 0:
            return 0.0, 0.0, 0.0
        if share < 1:  # 10 s^3 - 15 s^4 + 6 s^5: smooth to the second derivative
            s2 = share * share
            value = s2 * share * (10 - 15 * share + 6 * s2)
            first = 30 * s2 * (1 - share) ** 2 / RAMP
            second = 60 * share * (1 - share) * (1 - 2 * share) / RAMP**2
            return value, sign * first, second
    return 1.0, 0.0, 0.0


def shake(scene: Scene, action: Shake, hand: Hand = STEADY) -> None:
    """Carry the action out in a scene; what the hand strays is nothing beside the shaking."""
    world = scene.world
    usual = world.dt
    gravity = scene.physics.gravity
    fastest = 2 * np.pi * action.frequency / hand.stretch
    peak = np.radians(action.degrees) * fastest**2 * np.linalg.norm(PIVOT)
    if peak > LOOSE * gravity:
        world.set_step(usual / FINER)
    step = world.dt
    inertia = BOARD_INERTIA
    _, pivot_y, pivot_z = PIVOT.tolist()
    for number in range(round(DURATION * hand.stretch / step)):
        angle, rate, acceleration = action.angles(number * step / hand.stretch)
        rate, acceleration = rate / hand.stretch, acceleration / hand.stretch**2
        at, (qx, qy, qz, qw), (_, vy, vz), _ = world.motion(scene.board)
        # What is added in mm/s^2: turned gravity, Euler, centrifugal and Coriolis, about the x axis.
        y, z = at[1] - pivot_y, at[2] - pivot_z
        added_y = -gravity * math.sin(angle) + acceleration * z + rate**2 * y + 2 * rate * vz
        added_z = gravity * (1 - math.cos(angle)) - acceleration * y + rate**2 * z - 2 * rate * vy
        # The inertia tensor times the x axis: each of the body's axes by its part along x.
        a = 1 - 2 * (qy * qy + qz * qz)
        b = 2 * (qx * qy - qz * qw)
        c = 2 * (qx * qz + qy * qw)
        along, across, up = inertia[0] * a, inertia[1] * b, inertia[2] * c
        second = 2 * (qx * qy + qz * qw), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qx * qw)
        third = 2 * (qx * qz - qy * qw), 2 * (qy * qz + qx * qw), 1 - 2 * (qx * qx + qy * qy)
        turning = (
            along * a + across * b + up * c,
            along * second[0] + across * second[1] + up * second[2],
            along * third[0] + across * third[1] + up * third[2],
        )
        mass = BOARD_MASS / 1000
        torque = [-acceleration * t / 1000 for t in turning]
        world.push(scene.board, at, (0.0, mass * added_y, mass * added_z), torque)
        scene.frame_angle = angle
        scene.step()
        if max(abs(at[0]), abs(at[1])) > OUT:
            break
    scene.frame_angle = 0.0
    world.set_step(usual)
    scene.rest()
