"""A closed triangle mesh, in mm."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

Points = NDArray[np.float64]
Triangles = NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class Check:
    """Something that was checked: what was found, what was wanted, and what is wrong, if anything."""

    name: str
    found: str
    wanted: str
    fault: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class TriangleMesh:
    """``vertices``: (n, 3) in mm; ``triangles``: (m, 3), rows of vertices, counter-clockwise."""

    vertices: Points
    triangles: Triangles

    @property
    def corners(self) -> Points:
        """The corners of every triangle: (m, 3, 3)."""
        return self.vertices[self.triangles]

    @property
    def volume(self) -> float:
        """The volume inside, in mm^3: the sum of the tetrahedra over the triangles."""
        a, b, c = self.corners.transpose(1, 0, 2)
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)

    @property
    def bodies(self) -> int:
        """How many pieces it has that share no vertex."""
        size = len(self.vertices)
        pairs = np.concatenate([self.triangles[:, :2], self.triangles[:, 1:]])
        graph = coo_matrix((np.ones(len(pairs), bool), pairs.T), (size, size))
        return int(connected_components(graph, directed=False, return_labels=False))

    @property
    def open_edges(self) -> int:
        """How many edges of triangles have no partner that runs the other way: 0 if it is closed."""
        edges = np.concatenate([self.triangles[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
        size = len(self.vertices)
        forth = edges[:, 0].astype(np.int64) * size + edges[:, 1]
        back = edges[:, 1].astype(np.int64) * size + edges[:, 0]
        codes, which = np.unique(np.concatenate([forth, back]), return_inverse=True)
        signs = np.repeat([1, -1], len(edges))
        return int(np.maximum(np.bincount(which, signs, len(codes)), 0).sum())

    @property
    def normals(self) -> Points:
        """Normals at the vertices, weighted by the areas around them: (n, 3), of length 1."""
        a, b, c = self.corners.transpose(1, 0, 2)
        facets = np.cross(b - a, c - a)
        size = len(self.vertices)
        total = np.stack(
            [
                sum(np.bincount(self.triangles[:, k], facets[:, axis], size) for k in range(3))
                for axis in range(3)
            ],
            axis=1,
        )
        normals: Points = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-30)
        return normals

    @property
    def digest(self) -> str:
        """A hash of all of it."""
        found = hashlib.sha256(np.ascontiguousarray(self.vertices).tobytes())
        found.update(np.ascontiguousarray(self.triangles).tobytes())
        return found.hexdigest()
