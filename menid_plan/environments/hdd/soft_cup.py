"""A suction cup of soft rubber: finite elements, with a lip that meets the board's surface.

Lengths are in mm, forces in N, times in s; so stresses are in MPa, and masses in tonnes.

PyBullet has soft bodies too. But it tells neither how fast their nodes are nor what they touch; and one
that is pressed on a body of many hulls takes tens of milliseconds for a step, and gets tangled.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array, diags_array
from scipy.sparse.linalg import SuperLU, splu

from menid_plan.compiled import kernel
from menid_plan.environments.hdd.engine import Pose, Vector
from menid_plan.environments.hdd.mesh import Points, TriangleMesh
from menid_plan.environments.hdd.scene import BLUE, BrokenDownError, Scene, level
from menid_plan.environments.hdd.suck import (
    ARC,
    BESIDE,
    CUP,
    LEAK,
    LIP,
    LOST,
    RADIUS,
    SHEAR,
    Suck,
    heights,
    hole_area,
    ring,
)

Indices = NDArray[np.int64]

# The wall from the lip up to where the hand holds it: radius and height of its inner and outer side.
WALL = (
    ((13.0, 0.4), (RADIUS, 0.0)),
    ((11.5, 2.4), (12.7, 3.0)),
    ((9.5, 4.2), (10.5, 5.0)),
    ((7.0, 5.6), (7.6, 6.8)),
    ((4.5, 6.6), (4.5, 8.0)),
)
STEM = WALL[-1][1][0], CUP - WALL[-1][1][1]  # radius and height of what is above, in pictures
RINGS = 2 * LIP * np.arange(len(WALL))  # the first node of the outer side at each height
YOUNG, POISSON = 1.0, 0.4  # MPa, of a soft silicone rubber; and its ratio
DENSITY = 1.1e-9  # t/mm^3
LOSS = 0.002  # s, by which its strain is behind its stress (Kelvin and Voigt)
CONTACT = 1.0  # N/mm, how hard a point of the lip is
ROUGH = 0.2  # mm, a gap that lets no air in
FINER = 4  # the steps of time are so many times shorter
LONGEST = 0.0005  # s, and no longer than this
# A step takes it to be so many times stiffer than at rest: it gets stiffer where it is bent, and a step
# that takes it to be less than half of what it is overshoots.
STIFFER = 2.0
BROKEN = 100.0  # mm: a node that is so far from its place is an error of the computation
REDRAWN = 20  # steps between two drawings of its shape


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """Tetrahedra of a rubber, from four nodes each.

    ``nodes``: (n, 3), those that are ``free`` to move first; ``tetrahedra``: (m, 4), their ``volumes``:
    (m,). ``gradient`` makes positions, (3 n,) with all x first, to deformation gradients, (9 m,) with
    entry (1, 1) of all first. ``mass`` of each node: (n,).
    """

    nodes: Points
    tetrahedra: Indices
    free: int
    gradient: csr_array[Any]
    volumes: Vector
    mass: Vector

    @classmethod
    def of(cls, nodes: Points, tetrahedra: Indices, free: int) -> Body:
        """The body of a mesh; ValueError unless all its tetrahedra have a volume."""
        edges = (nodes[tetrahedra[:, 1:]] - nodes[tetrahedra[:, :1]]).transpose(0, 2, 1)
        volumes = np.linalg.det(edges) / 6
        if not (volumes > 1e-9).all():
            raise ValueError("a tetrahedron is flat, or turned inside out")
        # How the barycentric coordinates grow along each axis: (m, 4, 3).
        slopes = np.linalg.inv(edges)
        slopes = np.concatenate([-slopes.sum(axis=1, keepdims=True), slopes], axis=1)
        n, m = len(nodes), len(tetrahedra)
        i, j, t, k = np.indices((3, 3, m, 4)).reshape(4, -1)
        gradient = csr_array(
            (slopes[t, k, j], ((3 * i + j) * m + t, i * n + tetrahedra[t, k])), (9 * m, 3 * n)
        )
        mass = np.zeros(n)
        np.add.at(mass, tetrahedra, DENSITY * volumes[:, None] / 4)
        return cls(nodes, tetrahedra, free, gradient, volumes, mass)

    def forces(self, at: Vector) -> Vector:
        """The forces on the nodes at positions: (3 n,) both.

        P = mu (1 - 1 / (I + 1)) F + lambda (J - alpha) dJ/dF, with I = |F|^2: a neo-Hookean rubber that
        even comes back when an element is turned inside out (Smith, de Goes and Kim 2018).
        """
        f = (self.gradient @ at).reshape(9, -1)
        cofactor = f[_ONE] * f[_TWO] - f[_THREE] * f[_FOUR]
        stretch = (f * f).sum(axis=0)
        growth = (f[:3] * cofactor[:3]).sum(axis=0)
        stress = _MU * (1 - 1 / (stretch + 1)) * f + _LAMBDA * (growth - _ALPHA) * cofactor
        found: Vector = -(self.gradient.T @ (self.volumes * stress).ravel())
        return found

    def stiffness(self) -> csc_array[Any]:
        """How the forces on the free nodes grow as they move, at rest: (3 free, 3 free), in N/mm."""
        at, step = self.nodes.T.ravel(), 1e-5
        columns = []
        for k in self.moving:
            forth, back = at.copy(), at.copy()
            forth[k] += step
            back[k] -= step
            columns.append((self.forces(back) - self.forces(forth))[self.moving] / (2 * step))
        found = np.array(columns)
        found = (found + found.T) / 2
        found[np.abs(found) < 1e-9] = 0.0
        return csc_array(found)

    @property
    def moving(self) -> Indices:
        """Where the free nodes are in a vector of all: (3 free,)."""
        n = len(self.nodes)
        return np.concatenate([axis * n + np.arange(self.free) for axis in range(3)])


# The numbers with which this rubber, at rest, is as stiff as YOUNG and POISSON say.
_LAME = YOUNG / (2 * (1 + POISSON))
_MU = 4 / 3 * _LAME
_LAMBDA = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON)) + 5 / 6 * _LAME
_ALPHA = 1 + 0.75 * _MU / _LAMBDA
# Which entries of F make up those of its cofactor.
_ROW, _COLUMN = np.divmod(np.arange(9), 3)
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])
_ONE, _TWO = 3 * _NEXT[_ROW] + _NEXT[_COLUMN], 3 * _LAST[_ROW] + _LAST[_COLUMN]
_THREE, _FOUR = 3 * _NEXT[_ROW] + _LAST[_COLUMN], 3 * _LAST[_ROW] + _NEXT[_COLUMN]


@cache
def cup_body() -> Body:
    """The cup, its lip at height 0: from below, the nodes of the outer and the inner side in turn."""
    nodes = [
        np.column_stack([ring(radius, LIP), np.full(LIP, height)])
        for inner, outer in WALL
        for radius, height in (outer, inner)
    ]
    first = (RINGS[:-1, None] + np.arange(LIP)).ravel()
    beside = (RINGS[:-1, None] + (np.arange(LIP) + 1) % LIP).ravel()
    bricks = np.stack(
        [k + side + up for up in (0, 2 * LIP) for side in (0, LIP) for k in (first, beside)], axis=1
    )
    # Each brick of the wall is cut into six parts around its diagonal (Kuhn 1960).
    parts = np.array([[0, a, b, 7] for a, b in ((1, 3), (3, 2), (2, 6), (6, 4), (4, 5), (5, 1))])
    return Body.of(np.vstack(nodes), bricks[:, parts].reshape(-1, 4), int(RINGS[-1]))


@cache
def inner_side() -> Indices:
    """The triangles on which the vacuum is, turned towards it: from the lip's edge inwards and up."""
    return _band([0, *(RINGS + LIP)])[:, ::-1]


@cache
def outer_side() -> Indices:
    """The triangles that are seen from outside."""
    return _band(RINGS)


def _band(rings: Sequence[int] | Indices) -> Indices:
    """Triangles between rings of nodes, of which the first is given; they face outwards: (k, 3)."""
    found = []
    here, beside = np.arange(LIP), (np.arange(LIP) + 1) % LIP
    for low, high in pairwise(rings):
        found.append(np.stack([low + here, low + beside, high + beside], axis=1))
        found.append(np.stack([low + here, high + beside, high + here], axis=1))
    return np.concatenate(found)


@cache
def solver(step: float) -> SuperLU:
    """What makes impulses on the free nodes (N s) to changes of their speed in a step of time (s).

    The steps are linearly implicit (Baraff and Witkin 1998), with the stiffness at rest, since the hand
    does not turn the cup; the surface is taken to be under all of the lip.
    """
    body = cup_body()
    surface = np.where(np.arange(body.free) < LIP, CONTACT, 0.0)
    inertia = np.tile(body.mass[: body.free] + step**2 * surface, 3)
    stiffness = STIFFER * step * (step + LOSS) * body.stiffness()
    return splu(csc_array(diags_array(inertia) + stiffness))


class SoftGrip:
    """The cup above a board, or on it. Its own weight is the hand's."""

    def __init__(self, scene: Scene, action: Suck) -> None:
        pose, mesh, world = scene.pose, scene.mesh, scene.world
        world.set_step(world.dt / max(FINER, math.ceil(world.dt / LONGEST)))
        self._step = world.dt
        self._pressure = abs(action.pressure) * 1e-6
        # The cup's middle on the surface, in the board's frame, and the holes under it, in mm^2.
        self._middle = pose.matrix.T @ (np.array([action.x, action.y, 0.0]) - pose.position)
        self._holes = hole_area(mesh, self._middle[:2])
        corners = mesh.corners
        aside = corners[:, :, :2] - self._middle[:2]
        near = (aside.min(axis=1) < RADIUS + LOST) & (aside.max(axis=1) > -RADIUS - LOST)
        self._surface = corners[near.all(axis=1)].reshape(-1, 9)
        under = heights(mesh, self._middle[:2] + ring(RADIUS, LIP))
        met = under[np.isfinite(under)]
        self._middle[2] = float(np.median(met)) if len(met) else 0.0
        top = pose.position[2] + met.max(initial=0.0)
        # Where the nodes would be, where they are, and how fast: (3, n). Where each point of the lip
        # holds on to the surface, in the board's frame: (LIP, 2).
        self._rest = cup_body().nodes.T + np.array([[action.x], [action.y], [top]])
        self._at = self._rest.copy()
        self._speed = np.zeros_like(self._rest)
        self._held: Points | None = None
        self._stem: int | None = None
        self._skin: int | None = None
        self._shown = 0

    def forces(self, now: Points, found: Points) -> bool:
        """As `Cup.forces`; the nodes move by a step of time."""
        body, step, at, moving = cup_body(), self._step, self._at, self._speed
        hand = now[13:16, None]
        if self._held is None:
            at += hand
        at[:, body.free :] = self._rest[:, body.free :] + hand
        moving[:, body.free :] = now[16:19, None]
        # The lip is where it will be after the step, and so is the board, if nothing else happens.
        matrix = Pose(now[:3], now[3:7]).matrix
        arms = (at + step * moving)[:, :LIP].T - now[:3]
        arms = arms - step * (now[7:10] + _cross(now[10:13], arms))
        own = arms @ matrix
        surface = np.empty(LIP)
        _under(self._surface, np.ascontiguousarray(own), surface)
        gap = own[:, 2] - surface
        openings = np.where(np.isfinite(gap), np.maximum(gap - ROUGH, 0.0), BESIDE)
        opening = self._holes + float(openings.sum()) * ARC
        vacuum = self._pressure / (1 + (opening / LEAK) ** 2)
        # Coulomb's friction: what is pulled too hard slips.
        push = np.empty((LIP, 3))
        push[:, 2] = CONTACT * np.maximum(-gap, 0.0)
        held = own[:, :2] if self._held is None else self._held
        push[:, :2] = CONTACT * (held - own[:, :2])
        pulled = np.hypot(push[:, 0], push[:, 1])
        push[:, :2] *= np.minimum(SHEAR * push[:, 2] / np.maximum(pulled, 1e-30), 1.0)[:, None]
        self._held = own[:, :2] + push[:, :2] / CONTACT
        push = push @ matrix.T
        with np.errstate(all="ignore"):
            # The strain after the step, and what is added to it while the stress lags.
            forces = body.forces((at + (step + LOSS) * moving).ravel()).reshape(3, -1)
            forces += _sucked(at, vacuum)
            forces[:, :LIP] += push.T
            impulses = step * forces[:, : body.free].ravel()
            moving[:, : body.free] += solver(step).solve(impulses).reshape(3, -1)
            at += step * moving
            whole = (np.abs(at - self._rest - hand) < BROKEN).all()
        if not whole:
            raise BrokenDownError("the cup burst")
        pull = vacuum * np.pi * RADIUS**2 * matrix[:, 2]
        found[:3] = pull - push.sum(axis=0)
        found[3:] = _cross(matrix @ self._middle, pull) - _cross(arms, push).sum(axis=0)
        return bool((gap < LOST).any())

    def show(self, scene: Scene, hand: Sequence[float]) -> None:
        """As `Cup.show`; what is shown of its shape is a few steps old."""
        world = scene.world
        if self._stem is None:
            self._stem = world.ghost(*STEM, BLUE)
        x, y, z = self._rest[:, -LIP:].mean(axis=1) + hand
        world.place(self._stem, level(x, y, z + STEM[1] / 2))
        if self._shown % REDRAWN == 0:
            if self._skin is not None:
                world.remove(self._skin)
            sides = np.concatenate([outer_side(), inner_side()]).astype(np.int32)
            self._skin = world.seen(TriangleMesh(self._at.T, sides), BLUE)
        self._shown += 1


@kernel("void(f8[:,::1], f8[:,::1], f8[::1])")
def _under(triangles: Points, points: Points, found: Vector) -> None:
    """Write how high the upper sides of triangles (k, 9) are over or under points, as `heights`."""
    for p in range(len(points)):
        x, y = points[p, 0], points[p, 1]
        found[p] = -np.inf
        for k in range(len(triangles)):
            ax, ay, az = triangles[k, 0] - x, triangles[k, 1] - y, triangles[k, 2]
            bx, by, bz = triangles[k, 3] - x, triangles[k, 4] - y, triangles[k, 5]
            cx, cy, cz = triangles[k, 6] - x, triangles[k, 7] - y, triangles[k, 8]
            u, v, w = bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx
            if u >= 0.0 and v >= 0.0 and w >= 0.0 and u + v + w > 1e-12:
                found[p] = max(found[p], (u * az + v * bz + w * cz) / (u + v + w))


def _sucked(at: Points, vacuum: float) -> Points:
    """The forces on the nodes (3, n): the pressure inside is so many MPa below that outside."""
    triangles = inner_side()
    a, b, c = at.T[triangles].transpose(1, 0, 2)
    areas = _cross(b - a, c - a) / 2
    return np.stack(
        [
            np.bincount(triangles.ravel(), np.repeat(vacuum / 3 * areas[:, axis], 3), at.shape[1])
            for axis in range(3)
        ]
    )


def _cross(a: Points, b: Points) -> Points:
    """The cross product along the last axis; NumPy's own takes five times as long for so few."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)
