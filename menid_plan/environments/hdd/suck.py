"""A suction cup is put on the board, lifts it, carries it aside, and lets go.

The cup is a model of its seal: a ring of one-sided springs and dampers presses on the board, and what
air comes in where the lip does not reach the surface weakens the vacuum. The lip meets the surface of
the mesh itself, with its holes and its parts, not the hulls that the board has for contacts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from menid_plan.environments.hdd.engine import Pose
from menid_plan.environments.hdd.geometry import THICKNESS
from menid_plan.environments.hdd.hand import STEADY, Hand
from menid_plan.environments.hdd.mesh import Points, TriangleMesh
from menid_plan.environments.hdd.scene import BLACK, BOARD_MASS, Scene, eased, level

RADIUS = 14.0  # mm
LIP = 24  # points on the lip
STIFFNESS = 0.3  # N/mm, of the whole lip
DAMPING = 0.7  # of critical, for the board's mass on it
PRELOAD = 1.5  # mm, how far the hand presses the lip down
FLEXIBLE = 0.9  # mm, a gap that the lip closes by itself
LEAK = 12.0  # mm^2 of opening that halve the vacuum
SHEAR = 0.6  # friction between lip and board
SAMPLES = ((3.0, 8), (6.0, 12), (9.0, 18), (12.0, 24))  # rings under the cup that look for holes
ARC = 2 * np.pi * RADIUS / LIP
SPRING = STIFFNESS / LIP
CLEARANCE = 4.0  # mm above the board where the cup begins

LOST = 4.0  # mm: a lip that is nowhere nearer has let go of the board
BESIDE = 2.0  # mm, how far a point of the lip is open that meets nothing

LOWER, HOLD, LIFT, CARRY = 0.1, 0.1, 0.5, 0.5  # seconds
CUP = 25.0  # mm, how tall it is in pictures
HEIGHT, ASIDE = 40.0, -130.0  # mm: how far up, and how far along y


@dataclass(frozen=True, slots=True)
class Suck:
    """The cup's middle at ``x``, ``y`` (mm), and its ``pressure`` in Pa against the atmosphere's."""

    x: float
    y: float
    pressure: float

    def at(self, time: float) -> Pose:
        """The pose that the hand aims at for the cup's lip, so many seconds after it began."""
        way = _way(time)
        return level(self.x, self.y + way[1], THICKNESS + way[2])

    @property
    def duration(self) -> float:
        """How long the motion takes, in seconds."""
        return LOWER + HOLD + LIFT + CARRY


def heights(mesh: TriangleMesh, points: Points) -> Points:
    """How high the upper side of a mesh is over points (n, 2); -inf where there is nothing."""
    a, b, c = mesh.corners.transpose(1, 0, 2)
    # Twice the area of each triangle seen from above; only those that face up count.
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    up = area > 1e-12
    low, high = points.min(axis=0), points.max(axis=0)
    corners = mesh.corners[:, :, :2]
    up &= (corners.max(axis=1) >= low).all(axis=1) & (corners.min(axis=1) <= high).all(axis=1)
    a, b, c, area = a[up], b[up], c[up], area[up]
    x, y = points[:, None, 0], points[:, None, 1]

    def weight(p: Points, q: Points) -> Points:
        turned = (q[:, 0] - p[:, 0]) * (y - p[:, 1]) - (q[:, 1] - p[:, 1]) * (x - p[:, 0])
        share: Points = turned / area
        return share

    weights = weight(b, c), weight(c, a), weight(a, b)
    inside = (weights[0] >= 0) & (weights[1] >= 0) & (weights[2] >= 0)
    z = weights[0] * a[:, 2] + weights[1] * b[:, 2] + weights[2] * c[:, 2]
    found: Points = np.where(inside, z, -np.inf).max(axis=1, initial=-np.inf)
    return found


def ring(radius: float, number: int) -> Points:
    """Points on a circle: (n, 2)."""
    angles = 2 * np.pi * np.arange(number) / number
    return radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def hole_area(mesh: TriangleMesh, middle: Points) -> float:
    """How large the holes under the cup are, in mm^2: counted on rings."""
    total, inner = 0.0, 0.0
    for radius, number in SAMPLES:
        outer = min(radius + 1.5, RADIUS)
        missing = np.isinf(heights(mesh, middle + ring(radius, number))).mean()
        total += float(missing) * np.pi * (outer**2 - inner**2)
        inner = outer
    return total


@dataclass(frozen=True, slots=True)
class Grip:
    """Where the lip met the board when the cup came down, and what it is made of.

    ``rest``: the lip's points in the world, (n, 2) in mm; ``anchors``: where they met the surface, in
    the board's frame, (n, 3); ``touching``: which of them met any; ``top``: the height of the highest;
    ``middle``: the cup's middle on the surface, in the board's frame; ``holes``: the area of the holes
    under it in mm^2; ``suction`` in N with a perfect seal; ``damping`` of a point in N s/mm.
    """

    rest: Points
    anchors: Points
    touching: NDArray[np.bool_]
    top: float
    middle: Points
    holes: float
    suction: float
    damping: float

    def forces(self, scene: Scene, hand: Points, speed: Points) -> tuple[Points, Points, bool]:
        """The force (N) and torque (N mm) on the board, and whether the lip still holds it.

        ``hand``: how far the cup has moved aside (x, y) and how high it is over ``top``; ``speed`` in
        mm/s.
        """
        pose = scene.pose
        linear, angular = scene.world.velocity(scene.board)
        matrix = pose.matrix
        arms = self.anchors @ matrix.T
        points = pose.position + arms
        motion = speed - linear - _cross(angular, arms)
        gap = np.where(self.touching, self.top + hand[2] - points[:, 2], np.inf)
        opening = float(np.maximum(gap - FLEXIBLE, 0)[self.touching].sum() * ARC)
        opening += self.holes + float((~self.touching).sum()) * ARC * BESIDE
        pull = self.suction / (1 + (opening / LEAK) ** 2) * matrix[:, 2]
        # The lip only pushes: down, and aside by friction.
        pressed = -SPRING * gap - self.damping * motion[:, 2]
        pressed = np.where((gap < 0) & (pressed > 0), pressed, 0.0)
        force = np.empty((LIP, 3))
        force[:, :2] = (
            SPRING * (self.rest + hand[:2] - points[:, :2]) + self.damping * motion[:, :2]
        )
        force[~self.touching] = 0.0
        most = SHEAR * float(pressed.sum())
        size = float(np.hypot(*force[:, :2].sum(axis=0)))
        if size > most:
            force[:, :2] *= most / size
        force[:, 2] = -pressed
        torque = _cross(arms, force).sum(axis=0) + _cross(matrix @ self.middle, pull)
        return force.sum(axis=0) + pull, torque, bool((gap < LOST).any())


def gripped(scene: Scene, action: Suck) -> Grip:
    """Let the cup come down on the board where it is."""
    pose, mesh = scene.pose, scene.mesh
    back = pose.matrix.T
    at = np.array([action.x, action.y, 0.0])
    rest = ring(RADIUS, LIP) + at[:2]
    own = (np.column_stack([rest, np.zeros(LIP)]) - pose.position) @ back.T
    middle = back @ (at - pose.position)
    surface = heights(mesh, own[:, :2])
    touching = np.isfinite(surface)
    anchors = np.column_stack([own[:, :2], np.where(touching, surface, 0.0)])
    tops = pose.position[2] + (anchors @ pose.matrix.T)[touching, 2]
    surfaces = surface[touching]
    middle[2] = float(np.median(surfaces)) if len(surfaces) else 0.0
    critical = 2 * np.sqrt(1000 * STIFFNESS * BOARD_MASS) / 1000  # N s/mm
    return Grip(
        rest, anchors, touching, float(tops.max(initial=pose.position[2])), middle,
        hole_area(mesh, middle[:2]), abs(action.pressure) * 1e-6 * np.pi * RADIUS**2,
        DAMPING * critical / LIP,
    )  # fmt: skip


def suck(scene: Scene, action: Suck, hand: Hand = STEADY) -> None:
    """Carry the action out in a scene."""
    world = scene.world
    grip = gripped(scene, action)
    cup = world.ghost(RADIUS, CUP, BLACK) if world.drawn else None
    step = world.dt

    def cup_at(time: float) -> Points:
        return _way(time / hand.stretch) + hand.way(time)

    for number in range(round(action.duration * hand.stretch / step)):
        time = number * step
        now, later = cup_at(time), cup_at(time + step)
        force, torque, holds = grip.forces(scene, now, (later - now) / step)
        if time > (LOWER + HOLD) * hand.stretch and not holds:
            break
        world.push(scene.board, force, scene.pose.position)
        world.twist(scene.board, torque)
        if cup is not None:
            at = np.array([action.x, action.y, grip.top + CUP / 2]) + now
            world.place(cup, level(*at))
        scene.step()
    scene.rest()


def _way(time: float) -> Points:
    """How far aside the cup is (x, y), and how high over the board's top at the start, in mm."""
    down = eased(time / LOWER)
    up = eased((time - LOWER - HOLD) / LIFT)
    aside = eased((time - LOWER - HOLD - LIFT) / CARRY)
    height = CLEARANCE - (CLEARANCE + PRELOAD) * down + HEIGHT * up
    return np.array([0.0, ASIDE * aside, height])


def _cross(a: Points, b: Points) -> Points:
    """The cross product along the last axis; NumPy's own takes five times as long for so few."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)
