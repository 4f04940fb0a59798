"""The parts at a quality: reduced, checked, and kept."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path

import fast_simplification
import numpy as np
from manifold3d import Manifold, Mesh
from numpy.typing import NDArray

from menid_plan.environments.hdd import cache, geometry, scans
from menid_plan.environments.hdd.mesh import Check, TriangleMesh
from menid_plan.environments.hdd.scans import MeshError, check_place, read_bytes, read_scan

PARTS = tuple(geometry.SHAPES)
LOWEST, HIGHEST = 0.001, 0.1

# How far count and volume may be from what they should be.
TOLERANCE = 0.01
# What may be flattened before vertices are merged, in mm, in the order in which it is tried: about the
# noise of a scan.
FLATTEN = (0.05, 0.08, 0.03, 0.02, 0.01)
# By how much the number of vertices falls in one go, at most: each stage weighs the errors anew. In
# one go to a thirtieth, edges fold over, and the board jams in the bay.
STAGE = 3.0


@dataclass(frozen=True, slots=True)
class MeshReport:
    """What was checked of a reduced mesh. Volumes in mm^3; ``wanted`` is the count asked for."""

    part: str
    quality: float
    full_vertices: int
    full_volume: float
    wanted: int
    vertices: int
    triangles: int
    volume: float
    bodies: int
    open_edges: int

    @property
    def checks(self) -> tuple[Check, ...]:
        """All that was checked, with what keeps it from being accepted."""
        within = f"within {100 * TOLERANCE:g} %"
        change = self.volume / self.full_volume - 1
        return (
            Check(
                "vertices", f"{self.vertices}", f"{self.wanted}, {within}",
                f"it has {self.vertices} vertices instead of {self.wanted} (long thin triangles do not"
                " merge well: a scan of even ones does)"
                if abs(self.vertices - self.wanted) > TOLERANCE * self.wanted else "",
            ),
            Check(
                "volume", f"{self.volume:.1f} mm^3 ({100 * change:+.2f} %)",
                f"{self.full_volume:.1f} mm^3, {within}",
                f"its volume differs by {100 * change:+.1f} % from that of the full mesh"
                if abs(change) > TOLERANCE else "",
            ),
            Check(
                "pieces", f"{self.bodies}", "1",
                f"it has {self.bodies} pieces instead of one" if self.bodies != 1 else "",
            ),
            Check(
                "open edges", f"{self.open_edges}", "0",
                f"{self.open_edges} of its edges have no partner" if self.open_edges else "",
            ),
        )  # fmt: skip

    @property
    def faults(self) -> list[str]:
        """What keeps it from being accepted, in words; empty if nothing does."""
        return [check.fault for check in self.checks if check.fault]


@dataclass(frozen=True, slots=True, eq=False)
class PartMesh:
    """A reduced mesh with its report."""

    mesh: TriangleMesh
    report: MeshReport


@dataclass(frozen=True, slots=True)
class Source:
    """Where a part's full mesh comes from: a scan of the user's, or (None) the designed shape."""

    part: str
    scan: Path | None = None

    @property
    def key(self) -> str:
        """A hash of all that the full mesh depends on."""
        if self.scan is None:
            text = Path(geometry.__file__).read_bytes() + version("manifold3d").encode()
        else:
            # Another way to read it, or to judge it, is another mesh.
            text = read_bytes(self.scan) + Path(scans.__file__).read_bytes()
            text += version("trimesh").encode()
        return sha256(text).hexdigest()[:24]

    def full(self) -> TriangleMesh:
        """The mesh at full resolution; raises MeshError if a scan can't be used."""
        key = f"{self.part}-full-{self.key}"
        return _mesh(cache.kept(key, lambda: _arrays(self._made())))

    def _made(self) -> TriangleMesh:
        if self.scan is None:
            return geometry.scan(self.part)
        mesh = read_scan(self.scan)
        check_place(self.part, mesh, self.scan)
        return mesh


def wanted_vertices(part: str, quality: float) -> int:
    """How many vertices a quality asks for; MeshError if it is out of range.

    A quality is the share of a dense scan's vertices that are kept, counted against fixed numbers:
    331,000 for the board and 518,300 for the bay (Suárez-Hernández et al. 2021, whose scans had as
    many).
    """
    if not LOWEST <= quality <= HIGHEST:  # also for nan
        raise MeshError(
            f"quality {quality:g} is out of range: it is the share of the vertices of a dense scan that"
            f" is kept, from {LOWEST:g} to {HIGHEST:g}"
        )
    return round(quality * geometry.FULL_VERTICES[part])


def part_mesh(source: Source, quality: float) -> PartMesh:
    """A part reduced to a quality; raises MeshError if it can't be done within the tolerances."""
    found = tried_mesh(source, quality)
    if found.report.faults:
        raise MeshError(
            f"the {source.part} at quality {quality:g}: {'; '.join(found.report.faults)}"
        )
    return found


def tried_mesh(source: Source, quality: float) -> PartMesh:
    """A part reduced to a quality as well as it can be: its report says whether that is accepted."""
    wanted = wanted_vertices(source.part, quality)
    key = f"{source.part}-{wanted}-{source.key}-{_method()}"

    def make() -> cache.Arrays:
        full = source.full()
        numbers = np.array([len(full.vertices), full.volume])
        found = []
        for mesh in reduced(full, wanted):
            found.append(mesh)
            if not _report(source.part, quality, mesh, numbers).faults:
                break
        if not found:  # a scan with no more vertices than that
            raise MeshError(
                f"the {source.part} at quality {quality:g} would have {wanted} vertices, and the scan"
                f" has only {len(full.vertices)}: ask for a lower quality, or bring a finer scan"
            )
        return {**_arrays(found[-1]), "full": numbers}

    arrays = cache.kept(key, make)
    mesh = _mesh(arrays)
    return PartMesh(mesh, _report(source.part, quality, mesh, arrays["full"]))


def _method() -> str:
    """A hash of how meshes are reduced: what another version kept is not taken for this one's."""
    text = Path(__file__).read_bytes()
    text += f"{version('fast-simplification')} {version('manifold3d')}".encode()
    return sha256(text).hexdigest()[:12]


def _report(part: str, quality: float, mesh: TriangleMesh, full: NDArray[np.generic]) -> MeshReport:
    full_vertices, full_volume = full.tolist()
    return MeshReport(
        part, quality, int(full_vertices), full_volume, wanted_vertices(part, quality),
        len(mesh.vertices), len(mesh.triangles), mesh.volume, mesh.bodies, mesh.open_edges,
    )  # fmt: skip


def reduced(full: TriangleMesh, wanted: int) -> Iterator[TriangleMesh]:
    """The mesh with about so many vertices, in several ways, the most promising first.

    What is flatter than the noise of a scan is merged first, by a method that keeps the mesh closed;
    then edges are merged by quadric errors (Garland and Heckbert 1997), in stages.
    """
    shape = _manifold(full)
    for tolerance in FLATTEN:
        flat = _of_manifold(shape.simplify(tolerance))
        if len(flat.vertices) >= 1.1 * wanted:
            yield _merged(flat, wanted)
    if len(full.vertices) >= wanted:
        yield _merged(full, wanted)


def _merged(mesh: TriangleMesh, wanted: int) -> TriangleMesh:
    points, triangles = mesh.vertices.astype(np.float32), mesh.triangles
    count = len(points)
    # For a closed surface F = 2 (V - chi), Euler's formula; merging edges does not change chi.
    chi = count - len(triangles) // 2
    stages = max(math.ceil(math.log(count / wanted, STAGE)), 1)
    for stage in range(1, stages + 1):
        now = round(count * (wanted / count) ** (stage / stages))
        points, triangles = fast_simplification.simplify(
            points, triangles, target_count=2 * (now - chi)
        )
    used, rows = np.unique(triangles, return_inverse=True)
    return TriangleMesh(
        points[used].astype(np.float64), rows.reshape(triangles.shape).astype(np.int32)
    )


def _manifold(mesh: TriangleMesh) -> Manifold:
    return Manifold(Mesh(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32)))


def _of_manifold(shape: Manifold) -> TriangleMesh:
    found = shape.to_mesh()
    return TriangleMesh(
        found.vert_properties[:, :3].astype(np.float64), found.tri_verts.astype(np.int32)
    )


def _arrays(mesh: TriangleMesh) -> dict[str, np.ndarray]:
    return {"vertices": mesh.vertices, "triangles": mesh.triangles}


def _mesh(arrays: cache.Arrays) -> TriangleMesh:
    return TriangleMesh(arrays["vertices"].astype(np.float64), arrays["triangles"].astype(np.int32))
