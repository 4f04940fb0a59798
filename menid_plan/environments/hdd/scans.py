"""Scans that a user brings instead of the designed parts."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import trimesh

from menid_plan.environments.hdd.mesh import TriangleMesh
from menid_plan.environments.interface import EnvironmentFailedError

FORMATS = ("stl", "obj", "ply")


class MeshError(EnvironmentFailedError):
    """A mesh can't be read or made, or it is not fit for contact; the message says what to mend."""


def read_bytes(path: Path) -> bytes:
    """A file's content; MeshError if there is none."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise MeshError(f"{path}: {error.strerror or error}") from error


def read_scan(path: Path) -> TriangleMesh:
    """The mesh in a file in STL, OBJ or PLY, in mm, z upwards; MeshError for one that can't be used.

    It must be one closed body. Vertices at the same place are merged, since STL has no others, and
    triangles that turn inwards are turned.
    """
    kind = path.suffix.lower().removeprefix(".")
    if kind not in FORMATS:
        raise MeshError(f"{path}: the file's ending must be one of {', '.join(FORMATS)}")
    try:
        # Neither materials nor textures: nothing but this file is read.
        found = trimesh.load_mesh(
            io.BytesIO(read_bytes(path)), file_type=kind, process=True, skip_materials=True
        )
    except MeshError:
        raise
    except Exception as error:  # whatever a damaged file does to the reader
        raise MeshError(f"{path}: it can't be read as {kind.upper()}: {error}") from error
    if not isinstance(found, trimesh.Trimesh) or not len(found.faces):
        raise MeshError(f"{path}: there are no triangles in it")
    if not np.isfinite(found.vertices).all():
        raise MeshError(f"{path}: some of its coordinates are not numbers")
    found.merge_vertices()
    found.update_faces(found.nondegenerate_faces() & found.unique_faces())
    found.remove_unreferenced_vertices()
    mesh = _mesh(found)
    if mesh.open_edges:
        trimesh.repair.fix_normals(found)  # type: ignore[no-untyped-call]
        mesh = _mesh(found)
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


def exported(mesh: TriangleMesh, kind: str) -> bytes:
    """A mesh as the content of a file in one of the formats."""
    found = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
    content = found.export(file_type=kind)
    return content.encode() if isinstance(content, str) else bytes(content)


def _mesh(found: trimesh.Trimesh) -> TriangleMesh:
    return TriangleMesh(
        np.asarray(found.vertices, np.float64), np.asarray(found.faces).astype(np.int32)
    )
