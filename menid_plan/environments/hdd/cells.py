"""The board as convex bodies that PyBullet can bring into contact with the bay.

PyBullet has no contact between two moving triangle meshes, and one convex hull would close every
notch. So the mesh is cut into columns over a square grid, and each column is a convex hull: the finer
the mesh, the finer the grid. What hangs under the plate is cut off from it, so that a column beside a
chip rests on the ledge with its plate.
"""

from __future__ import annotations

import math
from hashlib import sha256
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from menid_plan.environments.hdd import cache
from menid_plan.environments.hdd.mesh import Points, TriangleMesh

# The plate is what lies above this height, in mm.
PLATE_FROM = -0.2
# Hulls thinner than this (mm^3) are left out: they hold nothing.
SMALLEST = 0.02


# Columns narrower than this (mm) cost time, and show no more of the board's edge.
NARROWEST = 4.5


def grid_side(vertices: int) -> float:
    """The side of a column in mm: so that a plate of 6000 mm^2 has 0.075 columns for each vertex."""
    return max(math.sqrt(6000 / (0.075 * vertices)), NARROWEST)


def cells(mesh: TriangleMesh, margin: float) -> list[Points]:
    """The corners of the hulls in mm, each shrunk by the collision margin that PyBullet adds."""
    # Another way to cut makes other cells of the same mesh.
    method = sha256(Path(__file__).read_bytes()).hexdigest()[:12]
    key = f"cells-{mesh.digest[:24]}-{margin:g}-{method}"

    def make() -> cache.Arrays:
        hulls = _make(mesh, margin)
        return {"points": np.concatenate(hulls), "sizes": np.array([len(h) for h in hulls])}

    kept = cache.kept(key, make)
    return np.split(kept["points"].astype(np.float64), np.cumsum(kept["sizes"])[:-1])


def _make(mesh: TriangleMesh, margin: float) -> list[Points]:
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    counts = np.maximum(np.ceil((high - low)[:2] / grid_side(len(mesh.vertices))), 1).astype(int)
    xs, ys = (np.linspace(low[k], high[k], counts[k] + 1) for k in range(2))
    found = []
    for x0, x1 in pairwise(xs):
        strip = clipped(clipped(mesh.corners, 0, x0, 1), 0, x1, -1)
        for y0, y1 in pairwise(ys):
            column = clipped(clipped(strip, 1, y0, 1), 1, y1, -1)
            for side in (1, -1):
                hull = _hull(clipped(column, 2, PLATE_FROM, side).reshape(-1, 3), margin)
                if hull is not None:
                    found.append(hull)
    return found


def clipped(triangles: Points, axis: int, at: float, side: int) -> Points:
    """The parts of triangles (n, 3, 3) on one side of a plane square to an axis, as triangles."""
    heights = side * (triangles[:, :, axis] - at)
    inside = heights >= 0
    number = inside.sum(axis=1)
    whole = triangles[number == 3]
    pieces = [whole]
    for count in (1, 2):
        chosen = number == count
        corners, above = triangles[chosen], inside[chosen]
        # The corner that is alone on its side comes first.
        alone = np.argmax(above if count == 1 else ~above, axis=1)
        order = (alone[:, None] + np.arange(3)) % 3
        rows = np.arange(len(corners))[:, None]
        corners, height = corners[rows, order], heights[chosen][rows, order]
        first, second, third = corners.transpose(1, 0, 2)
        cuts = []
        for k in (1, 2):
            share = height[:, 0] / (height[:, 0] - height[:, k])
            cuts.append(first + share[:, None] * (corners[:, k] - first))
        if count == 1:
            pieces.append(np.stack([first, cuts[0], cuts[1]], axis=1))
        else:
            pieces.append(np.stack([cuts[0], second, third], axis=1))
            pieces.append(np.stack([cuts[0], third, cuts[1]], axis=1))
    return np.concatenate(pieces)


def _hull(points: Points, margin: float) -> Points | None:
    """The corners of the points' hull, narrower by the margin on each side; None if it is flat."""
    if len(points) < 4:
        return None
    try:
        hull = ConvexHull(points)
        if hull.volume < SMALLEST:
            return None
        corners: Points = points[hull.vertices]
    except QhullError:
        return None
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle, half = (low + high) / 2, (high - low) / 2
    shrunk: Points = middle + (corners - middle) * np.maximum(half - margin, half / 2) / half
    return shrunk
