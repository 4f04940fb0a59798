"""The board and the bay of a hard drive, made by constructive solid geometry.

No scan of a drive comes with the project, so the two parts are designed here, in millimetres: x along
the drive, y across it, z upwards; the board's underside is at z = 0 when it is seated, its centre at
x = y = 0. The exact shapes are refined to as many vertices as a scan has, and displaced along their
normals by noise with the spectrum of one.

What decides whether a lever frees the board is written in `SLOTS`: features of less than a
millimetre, which meshes of a low quality lose.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, JoinType, Manifold, OpType
from scipy.ndimage import gaussian_filter, map_coordinates

from menid_plan.environments.hdd.mesh import Points, TriangleMesh

LENGTH, WIDTH, THICKNESS = 100.0, 60.0, 1.6
CLEARANCE = 0.7  # between the board and the wall around it
WALL = 10.0
RIM = 2.2  # how high the wall stands above the board's underside
LEDGE = 5.0  # how wide the board rests on the bay
DEPTH = 12.0  # of the cavity under the board
BOTTOM = -22.0
SLOT_FLOOR = -1.8
SILL = (-2.4, -1.6)  # from where to where a threshold stands, before the board's edge
SLOT_REACH = 3.5  # how far a slot goes in under the board

# Vertices of a scan: what qualities are measured against.
FULL_VERTICES = {"board": 331_000, "bay": 518_300}


@dataclass(frozen=True, slots=True)
class Slot:
    """An opening in the wall through which a lever reaches under the board's edge.

    ``x``, ``y``: where its middle meets the edge of the seated board; ``direction``: the way in, in
    degrees; ``floor``: the height of its floor; ``sill``: how high a threshold stands on it (0: none).
    All lengths in mm.
    """

    name: str
    x: float
    y: float
    direction: float
    width: float
    sill: float = 0.0
    floor: float = SLOT_FLOOR


# A lever is 7 mm wide and 1 mm thick, and comes in 0.15 mm above the floor of a slot as it should be.
SLOTS = (
    Slot("n1", -40, -30, 90, 11.0, floor=-2.1),
    Slot("n3", -8, -30, 90, 8.0),
    Slot("n4", 8, -30, 90, 12.0, sill=0.50),
    Slot("n6", 40, -30, 90, 9.0, sill=0.30),
    Slot("n8", 50, -7.5, 180, 14.0, floor=-2.1),
    Slot("n9", 50, 7.5, 180, 8.2),
    Slot("n11", 40, 30, 270, 12.0, sill=0.95),
    Slot("n13", 8, 30, 270, 13.0, sill=0.45),
    Slot("n14", -8, 30, 270, 8.6, sill=0.25),
    Slot("n16", -40, 30, 270, 7.8),
    Slot("n18", -50, 7.5, 0, 10.0, floor=-2.1),
    Slot("n20", -50, -22.5, 0, 9.0, sill=0.40),
)


def box(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float) -> Manifold:
    """A box from its extents along the axes."""
    return Manifold.cube([x1 - x0, y1 - y0, z1 - z0]).translate([x0, y0, z0])


def rounded(length: float, width: float, radius: float, z0: float, z1: float) -> Manifold:
    """A plate around the origin with rounded corners."""
    flat = CrossSection.square([length - 2 * radius, width - 2 * radius], center=True)
    flat = flat.offset(radius, JoinType.Round, circular_segments=8)
    return Manifold.extrude(flat, z1 - z0).translate([0, 0, z0])


def pin(x: float, y: float, radius: float, z0: float, z1: float, sides: int = 8) -> Manifold:
    """An upright cylinder."""
    return Manifold.cylinder(z1 - z0, radius, circular_segments=sides).translate([x, y, z0])


def board() -> Manifold:
    """The printed circuit board: its parts hang under it, where the cavity is."""
    plate = rounded(LENGTH, WIDTH, 2.0, 0.0, THICKNESS)
    cuts = [pin(x, y, 1.75, -1, THICKNESS + 1) for x in (-45.5, 45.5) for y in (-25.5, 25.5)]
    cuts += [pin(-16.0, 24.0, 1.75, -1, THICKNESS + 1), pin(15.0, -24.0, 1.75, -1, THICKNESS + 1)]
    # Notches, for the screws of the bay and for the connector of the motor.
    cuts += [box(-51, -46, -4, 2, -1, 3), box(47, 51, -1.5, 1.5, -1, 3)]
    cuts += [box(-28, -22, 27.5, 31, -1, 3), box(27, 33, -31, -28, -1, 3)]
    rng = np.random.default_rng(20)
    parts = []
    chips = ((-22, 8, 14, 14, 1.4), (6, 10, 20, 12, 1.2), (28, 8, 10, 16, 1.0),
             (-30, -14, 9, 7, 1.8), (2, -12, 16, 8, 0.9), (27, -13, 12, 9, 1.6))  # fmt: skip
    taken: list[tuple[float, float, float, float]] = []
    for x, y, dx, dy, dz in chips:
        parts.append(part_at(x, y, dx, dy, dz))
        taken.append((x, y, dx / 2, dy / 2))
    while len(parts) < 136:
        at_x, at_y = rng.uniform(-42, 42), rng.uniform(-22, 22)
        long, wide = rng.choice([0.8, 1.0, 1.6, 2.0]), rng.choice([0.5, 0.8, 1.25])
        if any(abs(at_x - x) < dx + long and abs(at_y - y) < dy + wide for x, y, dx, dy in taken):
            continue
        taken.append((at_x, at_y, long / 2, wide / 2))
        parts.append(part_at(at_x, at_y, long, wide, rng.uniform(0.4, 0.9)))
    # The shell of a connector stands on the upper side, near the left edge.
    shell = box(-49, -42, 10, 22, THICKNESS - 0.2, THICKNESS + 3.2)
    shell -= box(-50, -43, 10.8, 21.2, THICKNESS + 0.6, THICKNESS + 2.4)
    return Manifold.batch_boolean([plate, *cuts], OpType.Subtract) + Manifold.batch_boolean(
        [shell, *parts], OpType.Add
    )


def part_at(x: float, y: float, length: float, width: float, height: float) -> Manifold:
    """A part that hangs under the board, let a little into it."""
    return box(x - length / 2, x + length / 2, y - width / 2, y + width / 2, -height, 0.2)


def bay() -> Manifold:
    """The frame that the board is seated in."""
    outer_x, outer_y = LENGTH / 2 + CLEARANCE + WALL, WIDTH / 2 + CLEARANCE + WALL
    body = rounded(2 * outer_x, 2 * outer_y, 4.0, BOTTOM, RIM)
    pocket = rounded(LENGTH + 2 * CLEARANCE, WIDTH + 2 * CLEARANCE, 2.5, 0.0, RIM + 1)
    cavity = rounded(LENGTH - 2 * LEDGE, WIDTH - 2 * LEDGE, 3.0, -DEPTH, 1.0)
    cuts, parts = [pocket, cavity], []
    for slot in SLOTS:
        cut, added = _slot(slot)
        cuts.append(cut)
        parts += added
    # Posts and ribs in the cavity: they hold nothing, but a frame that is cast has them, and a mesh of
    # few vertices has to leave something out.
    for x in np.linspace(-40, 40, 7):
        parts += [pin(x, y, 1.6, -DEPTH - 1, -7.0) for y in np.linspace(-20, 20, 4)]
    parts += [box(x - 0.6, x + 0.6, -25.2, 25.2, -DEPTH - 1, -9.0) for x in (-15.0, 15.0)]
    return Manifold.batch_boolean(
        [Manifold.batch_boolean([body, *cuts], OpType.Subtract), *parts], OpType.Add
    )


def _slot(slot: Slot) -> tuple[Manifold, list[Manifold]]:
    """What a slot takes away from the bay, and what stands in it: in its own frame, x the way in."""
    half = slot.width / 2
    cut = box(-WALL - CLEARANCE - 1, SLOT_REACH, -half, half, slot.floor, RIM + 1)
    parts = []
    if slot.sill:
        x0, x1 = SILL
        low, high = slot.floor - 0.2, slot.floor + slot.sill
        parts.append(box(x0, x1, -half - 0.2, half + 0.2, low, high))

    def placed(shape: Manifold) -> Manifold:
        return shape.rotate([0, 0, slot.direction]).translate([slot.x, slot.y, 0])

    return placed(cut), [placed(part) for part in parts]


SHAPES: dict[str, Callable[[], Manifold]] = {"board": board, "bay": bay}

# The surface of a scan: how far (mm) it strays from the true one, and over what length (mm).
ROUGHNESS = ((0.040, 14.0), (0.025, 2.0))
WHITE = 0.006


def scan(part: str) -> TriangleMesh:
    """A part as a scan at full resolution would have it: the same every time."""
    refined = _refined(SHAPES[part](), FULL_VERTICES[part])
    found = refined.to_mesh()
    exact = TriangleMesh(
        found.vert_properties[:, :3].astype(np.float64), found.tri_verts.astype(np.int32)
    )
    rng = np.random.default_rng(sorted(SHAPES).index(part))
    points = exact.vertices
    offset = WHITE * rng.standard_normal(len(points))
    for deviation, length in ROUGHNESS:
        offset += deviation * _smooth_noise(points, length, rng)
    offset -= offset.mean()
    return TriangleMesh(points + exact.normals * offset[:, None], exact.triangles)


def _refined(shape: Manifold, target: int) -> Manifold:
    """The shape with about as many vertices, by bisection of the length of its edges."""
    low, high = 0.1, 1.0
    best = shape
    for _ in range(12):
        length = (low + high) / 2
        found = shape.refine_to_length(length)
        if abs(found.num_vert() - target) < abs(best.num_vert() - target):
            best = found
        if abs(best.num_vert() - target) < 0.002 * target:
            break
        low, high = (length, high) if found.num_vert() > target else (low, length)
    return best


def _smooth_noise(points: Points, length: float, rng: np.random.Generator) -> Points:
    """Noise of deviation 1 at the points, smooth over a length: a filtered grid, interpolated."""
    step = length / 3.0
    low = points.min(axis=0) - 2 * step
    shape = np.ceil((points.max(axis=0) - low) / step).astype(int) + 3
    grid = gaussian_filter(rng.standard_normal(shape), length / step, mode="wrap")
    values: Points = map_coordinates(grid / grid.std(), ((points - low) / step).T, order=1)
    return values
