"""Scans that a user brings instead of the designed parts."""

from __future__ import annotations

import io
import stat
from pathlib import Path

import numpy as np
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from menid_plan.environments.hdd.geometry import LENGTH, WIDTH
from menid_plan.environments.hdd.mesh import Points, TriangleMesh, Triangles
from menid_plan.environments.interface import EnvironmentFailedError

FORMATS = ("stl", "obj", "ply")
# Bytes of a scan that are read at most.
LARGEST_FILE = 2**31

# A binary STL: a header with the number of triangles, and so many bytes for each.
STL_HEADER, STL_TRIANGLE = 84, 50

# Coordinates beyond this, in mm, are no lengths.
FARTHEST = 1e6

# Where a part has to be, since domains say in numbers where a lever or a cup goes. The board's length
# and width may differ by this share from those that the bay was made for; in mm: how far its middle
# may be from x = y = 0 and its underside, or the bay's ledge, from z = 0; how thin it may be, and how
# large a bay.
BOARD_SIZE, ASIDE, HEIGHT, THINNEST, LARGEST_BAY = 0.2, 2.0, 0.5, 0.3, 300.0
# The share of the board's area that the bay must offer it to rest on.
LEDGE_AREA = 0.01
UNITS = {"metres": 1000.0, "centimetres": 10.0, "inches": 25.4}


class MeshError(EnvironmentFailedError):
    """A mesh can't be read or made, or it is not fit for contact; the message says what to mend."""


def read_bytes(path: Path) -> bytes:
    """The content of a scan's file; MeshError if there is none, or its ending says nothing."""
    check_ending(path)
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise MeshError(f"{path}: it is no file")
        if found.st_size > LARGEST_FILE:
            raise MeshError(f"{path}: it is larger than {LARGEST_FILE // 2**20} MiB")
        return path.read_bytes()
    except (OSError, ValueError) as error:  # ValueError: a name that no file can have
        raise MeshError(f"{path}: {getattr(error, 'strerror', None) or error}") from error


def check_ending(path: Path) -> str:
    """The format that a file's ending names; MeshError for any other."""
    kind = path.suffix.lower().removeprefix(".")
    if kind not in FORMATS:
        raise MeshError(f"{path}: the file's ending must be one of {', '.join(FORMATS)}")
    return kind


def read_scan(path: Path) -> TriangleMesh:
    """The mesh in a file in STL, OBJ or PLY, in mm, z upwards; MeshError for one that can't be used.

    It must be one closed body. Vertices at the same place are merged, since STL has no others, and
    triangles that are turned the wrong way are turned.
    """
    found = _loaded(path, check_ending(path))
    if not (np.abs(found.vertices) < FARTHEST).all():  # also for nan
        raise MeshError(f"{path}: some of its coordinates are not numbers, or beyond a kilometre")
    # A file with a texture has as many vertices at a place as the texture has points for it.
    found.merge_vertices(merge_tex=True, merge_norm=True)
    triangles = _distinct(np.asarray(found.faces, np.int32))
    if not len(triangles):
        raise MeshError(f"{path}: its triangles have no area")
    used, rows = np.unique(triangles, return_inverse=True)
    mesh = TriangleMesh(
        np.asarray(found.vertices, np.float64)[used], rows.reshape(-1, 3).astype(np.int32)
    )
    if mesh.open_edges:
        mesh = TriangleMesh(mesh.vertices, _alike(mesh.triangles))
    if mesh.open_edges:
        raise MeshError(
            f"{path}: the surface is not closed: {mesh.open_edges} edges of triangles have no"
            " partner; close its holes, e.g. with MeshLab or `trimesh.repair.fill_holes`"
        )
    if mesh.volume < 0:
        mesh = TriangleMesh(mesh.vertices, np.ascontiguousarray(mesh.triangles[:, ::-1]))
    if mesh.bodies != 1:
        raise MeshError(
            f"{path}: it has {mesh.bodies} pieces that do not hang together; keep the largest, or join"
            " them"
        )
    return mesh


def check_place(part: str, mesh: TriangleMesh, path: Path) -> None:
    """Raise MeshError if a scan can't be of that part, or is not where the part should be."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    size = high - low
    measured = f"it measures {' x '.join(f'{s:.4g}' for s in size)} mm"
    if part == "board":
        if not _like_a_board(size):
            raise MeshError(
                f"{path}: {measured}, and a board that fits has about {LENGTH:g} x {WIDTH:g} mm"
                f" (z is up){_hint(size)}"
            )
        middle = (low + high)[:2] / 2
        if np.abs(middle).max() > ASIDE:
            raise MeshError(
                f"{path}: its middle is at x = {middle[0]:.1f}, y = {middle[1]:.1f} mm; move it to"
                " x = y = 0, where the middle of the seated board is"
            )
        underside = _underside(mesh)
        if abs(underside) > HEIGHT:
            raise MeshError(
                f"{path}: its underside is at z = {underside:.1f} mm; move it to z = 0, where that"
                " of the seated board is"
            )
        return
    need = np.array([LENGTH, WIDTH]) / 2 - ASIDE
    if size.max() > LARGEST_BAY or (low[:2] > -need).any() or (high[:2] < need).any():
        raise MeshError(
            f"{path}: {measured} around x = {(low + high)[0] / 2:.4g}, y ="
            f" {(low + high)[1] / 2:.4g} mm, and a bay has a board of {LENGTH:g} x {WIDTH:g} mm in it,"
            f" its middle at x = y = 0 (z is up){_hint(size)}"
        )
    if _ledge(mesh) < LEDGE_AREA * LENGTH * WIDTH:
        raise MeshError(
            f"{path}: there is nothing at z = 0 for the board to rest on; move the bay so that what"
            " the board rests on is there"
        )


def exported(mesh: TriangleMesh, kind: str) -> bytes:
    """A mesh as the content of a file in one of the formats."""
    found = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
    content = found.export(file_type=kind)
    return content.encode() if isinstance(content, str) else bytes(content)


def _loaded(path: Path, kind: str) -> trimesh.Trimesh:
    """What is in the file as it stands there; MeshError if that are no triangles."""
    content = read_bytes(path)
    if not content:
        raise MeshError(f"{path}: the file is empty")
    try:
        # Neither materials nor textures: nothing but this file is read. Nothing is mended either:
        # the reader would leave out corners that are not numbers, and the surface would have holes.
        found = trimesh.load_mesh(
            io.BytesIO(content), file_type=kind, process=False, skip_materials=True
        )
    except Exception as error:  # whatever a damaged file does to the reader
        raise MeshError(f"{path}: it can't be read as {kind.upper()}: {error}") from error
    if not isinstance(found, trimesh.Trimesh) or not len(found.faces):
        if kind == "stl" and len(content) >= STL_HEADER and not content.isascii():
            count = int.from_bytes(content[STL_HEADER - 4 : STL_HEADER], "little")
            raise MeshError(
                f"{path}: it is no STL file, or was cut short: {count} triangles would take"
                f" {STL_HEADER + STL_TRIANGLE * count} bytes, and it has {len(content)}"
            )
        raise MeshError(f"{path}: there are no triangles in it")
    if found.faces.min() < 0 or found.faces.max() >= len(found.vertices):
        raise MeshError(f"{path}: some of its triangles have corners that are not in it")
    return found


def _distinct(triangles: Triangles) -> Triangles:
    """The triangles without those that have shrunk to an edge, each once.

    Those that are only thin stay: without them the surface would have gaps.
    """
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    first = triangles.argmin(axis=1)
    turned = triangles[np.arange(len(triangles))[:, None], (first[:, None] + np.arange(3)) % 3]
    found: Triangles = np.unique(turned, axis=0)
    return found


def _alike(triangles: Triangles) -> Triangles:
    """The triangles turned so that neighbours run their common edge in opposite directions.

    Each triangle is there twice in a graph, as it is and turned; neighbours are linked as they go
    together. What hangs together is then one way of turning them all.
    """
    count = len(triangles)
    edges = np.concatenate([triangles[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
    owner = np.tile(np.arange(count), 3)
    forth = edges[:, 0] < edges[:, 1]
    low, high = edges.min(axis=1).astype(np.int64), edges.max(axis=1)
    _, which, sharing = np.unique(low * (high.max() + 1) + high, return_inverse=True,
                                  return_counts=True)  # fmt: skip
    order = np.argsort(which, kind="stable")
    pairs = order[sharing[which[order]] == 2].reshape(-1, 2)
    one, other = owner[pairs[:, 0]], owner[pairs[:, 1]]
    wrong = (forth[pairs[:, 0]] == forth[pairs[:, 1]]) * count
    rows = np.concatenate([one, one + count])
    columns = np.concatenate([other + wrong, other + count - wrong])
    graph = coo_matrix((np.ones(len(rows), bool), (rows, columns)), (2 * count, 2 * count))
    _, ways = connected_components(graph, directed=False)
    turn = ways[:count] > ways[count:]
    return np.where(turn[:, None], triangles[:, ::-1], triangles)


def _like_a_board(size: Points) -> bool:
    shares = np.abs(size[:2] / (LENGTH, WIDTH) - 1)
    return bool((shares <= BOARD_SIZE).all() and size[2] >= THINNEST)


def _hint(size: Points) -> str:
    """What to do with a part that would be like a board (or a bay around one) in another unit."""
    for unit, factor in UNITS.items():
        scaled = size * factor
        if _like_a_board(scaled) or (
            (scaled[:2] >= (LENGTH, WIDTH)).all() and scaled.max() <= LARGEST_BAY
        ):
            return f"; if it is in {unit}, scale it by {factor:g}"
    if _like_a_board(size[[1, 0, 2]]):
        return "; turn it by 90 degrees about z"
    return ""


def _level(mesh: TriangleMesh) -> tuple[Points, Points]:
    """The middles of all triangles, and their areas as seen from above: negative if they look down."""
    a, b, c = mesh.corners.transpose(1, 0, 2)
    return (a + b + c) / 3, np.cross(b - a, c - a)[:, 2] / 2


def _underside(mesh: TriangleMesh) -> float:
    """The height with as much of what looks down above it as below: that of the plate's underside."""
    middles, areas = _level(mesh)
    order = np.argsort(middles[:, 2])
    sums = np.cumsum(np.maximum(-areas[order], 0))
    return float(middles[order[np.searchsorted(sums, sums[-1] / 2)], 2])


def _ledge(mesh: TriangleMesh) -> float:
    """The area that looks up where the seated board's underside is, in mm^2."""
    middles, areas = _level(mesh)
    there = (np.abs(middles) <= (LENGTH / 2, WIDTH / 2, HEIGHT)).all(axis=1)
    return float(np.maximum(areas[there], 0).sum())
