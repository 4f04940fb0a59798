"""A suction cup is put on the board, lifts it, carries it aside, and lets go.

The cup is a model of its seal: a ring of one-sided springs and dampers presses on the board, and what
air comes in where the lip does not reach the surface weakens the vacuum. The lip meets the surface of
the mesh itself, with its holes and its parts, not the hulls that the board has for contacts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from menid_plan.compiled import kernel
from menid_plan.environments.hdd.geometry import THICKNESS
from menid_plan.environments.hdd.hand import STEADY, Hand, Path
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

    def path(self, times: Points) -> Path:
        """The poses that the hand aims at for the cup's lip, so many seconds after it began."""
        at = _way(times) + np.array([self.x, self.y, THICKNESS])
        return Path(at, np.tile([0.0, 0.0, 0.0, 1.0], (len(times), 1)))

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


class Cup(Protocol):
    """What meets the board, and is led by the hand."""

    def forces(self, now: Points, found: Points) -> bool:
        """Write the force (N) and torque (N mm) on the board, (6,); whether the lip still holds it.

        ``now`` (19,): the board's position (mm), quaternion, velocity (mm/s) and turning (rad/s), how
        far the cup has moved aside (x, y), how high its lip would be over the highest point that it
        met, and its velocity.
        """

    def show(self, scene: Scene, hand: Sequence[float]) -> None:
        """Show the cup in a scene that is drawn; ``hand``: how far it has moved, as in `forces`."""


@dataclass(frozen=True, slots=True, eq=False)
class Grip:
    """Where the lip met the board when the cup came down, and what it is made of.

    ``lip``: a row for each point, (n, 6): where it is in the world (x, y) and where it met the
    surface, in the board's frame, in mm, and 1 if it met any. ``numbers``, (7,): the cup's middle on
    the surface, in the board's frame; the height of the highest point that it touches; the area of the
    holes under it in mm^2; the suction in N with a perfect seal; the damping of a point in N s/mm.
    ``seen``: what stands for the cup in pictures.
    """

    lip: Points
    numbers: Points
    seen: int | None

    def forces(self, now: Points, found: Points) -> bool:
        """As `Cup.forces`."""
        return bool(_press(self.lip, self.numbers, now, found))

    def show(self, scene: Scene, hand: Sequence[float]) -> None:
        """As `Cup.show`."""
        if self.seen is not None:
            x, y = self.lip[:, :2].mean(axis=0)
            z = self.numbers[3] + CUP / 2
            scene.world.place(self.seen, level(x + hand[0], y + hand[1], z + hand[2]))


@kernel("b1(f8[:,::1], f8[::1], f8[::1], f8[::1])")
def _press(lip: Points, numbers: Points, now: Points, found: Points) -> bool:
    """The force and the torque of the lip and of the vacuum on the board where it is."""
    top, holes, suction, damping = numbers[3], numbers[4], numbers[5], numbers[6]
    qx, qy, qz, qw = now[3], now[4], now[5], now[6]
    xx, xy, xz = 1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qz * qw), 2 * (qx * qz + qy * qw)
    yx, yy, yz = 2 * (qx * qy + qz * qw), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qx * qw)
    zx, zy, zz = 2 * (qx * qz - qy * qw), 2 * (qy * qz + qx * qw), 1 - 2 * (qx * qx + qy * qy)
    opening = holes
    pressed = 0.0
    aside_x = 0.0
    aside_y = 0.0
    holds = False
    # First what the lip does upright, which bounds its friction; then what friction does aside.
    for side in range(2):
        share = 0.0
        if side == 1:
            size = np.sqrt(aside_x * aside_x + aside_y * aside_y)
            share = 1.0 if size <= SHEAR * pressed else SHEAR * pressed / size
            opening_share = opening / LEAK
            pull = suction / (1.0 + opening_share * opening_share)
            found[0] = share * aside_x + pull * xz
            found[1] = share * aside_y + pull * yz
            found[2] = -pressed + pull * zz
            x = xx * numbers[0] + xy * numbers[1] + xz * numbers[2]
            y = yx * numbers[0] + yy * numbers[1] + yz * numbers[2]
            z = zx * numbers[0] + zy * numbers[1] + zz * numbers[2]
            found[3] = pull * (y * zz - z * yz)
            found[4] = pull * (z * xz - x * zz)
            found[5] = pull * (x * yz - y * xz)
        for k in range(LIP):
            if lip[k, 5] == 0.0:
                if side == 0:
                    opening += ARC * BESIDE
                continue
            a, b, c = lip[k, 2], lip[k, 3], lip[k, 4]
            x = xx * a + xy * b + xz * c
            y = yx * a + yy * b + yz * c
            z = zx * a + zy * b + zz * c
            gap = top + now[15] - now[2] - z
            slip = now[18] - now[9] - (now[10] * y - now[11] * x)
            # The lip only pushes: down, and aside by friction.
            down = -SPRING * gap - damping * slip if gap < 0.0 else 0.0
            down = max(down, 0.0)
            slip = now[16] - now[7] - (now[11] * z - now[12] * y)
            force_x = SPRING * (lip[k, 0] + now[13] - now[0] - x) + damping * slip
            slip = now[17] - now[8] - (now[12] * x - now[10] * z)
            force_y = SPRING * (lip[k, 1] + now[14] - now[1] - y) + damping * slip
            if side == 0:
                opening += max(gap - FLEXIBLE, 0.0) * ARC
                pressed += down
                aside_x += force_x
                aside_y += force_y
                holds = holds or gap < LOST
            else:
                force_x *= share
                force_y *= share
                found[3] += -y * down - z * force_y
                found[4] += z * force_x + x * down
                found[5] += x * force_y - y * force_x
    return holds


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
    top = float(tops.max(initial=pose.position[2]))
    suction = abs(action.pressure) * 1e-6 * np.pi * RADIUS**2
    holes, damping = hole_area(mesh, middle[:2]), DAMPING * critical / LIP
    return Grip(
        np.column_stack([rest, anchors, touching]),
        np.array([*middle, top, holes, suction, damping]),
        scene.world.ghost(RADIUS, CUP, BLACK) if scene.world.drawn else None,
    )


def suck(
    scene: Scene,
    action: Suck,
    hand: Hand = STEADY,
    cup: Callable[[Scene, Suck], Cup] = gripped,
) -> None:
    """Carry the action out in a scene, with the model of a seal or another cup."""
    world = scene.world
    usual = world.dt
    grip = cup(scene, action)  # which may ask for shorter steps
    step = world.dt

    times: Points = step * np.arange(round(action.duration * hand.stretch / step) + 1.0)
    way = _way(times / hand.stretch) + hand.ways(times)
    speeds = np.diff(way, axis=0) / step
    found = np.empty(6)
    for number, (now, speed) in enumerate(zip(way[:-1].tolist(), speeds.tolist(), strict=True)):
        at, turn, linear, angular = world.motion(scene.board)
        holds = grip.forces(np.array([*at, *turn, *linear, *angular, *now, *speed]), found)
        if times[number] > (LOWER + HOLD) * hand.stretch and not holds:
            break
        force = found.tolist()
        world.push(scene.board, at, force[:3], force[3:])
        if world.drawn:
            grip.show(scene, now)
        scene.step()
    world.set_step(usual)
    scene.rest()


def _way(times: Points) -> Points:
    """How far aside the cup is (x, y), and how high over the board at the start, in mm: (n, 3)."""
    down = eased(times / LOWER)
    up = eased((times - LOWER - HOLD) / LIFT)
    aside = eased((times - LOWER - HOLD - LIFT) / CARRY)
    height = CLEARANCE - (CLEARANCE + PRELOAD) * down + HEIGHT * up
    return np.stack([0.0 * aside, ASIDE * aside, height], axis=-1)
