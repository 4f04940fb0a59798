"""All that is said to PyBullet: a world of rigid bodies in mm, N and seconds.

PyBullet counts in whatever units it is given. Small parts behave best when their sizes are near 1, so a
unit of length is a centimetre inside (gravity 981, forces in kg cm/s^2); callers see millimetres and
newtons.
"""

from __future__ import annotations

import importlib
import os
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from menid_plan.environments.hdd.extra import require
from menid_plan.environments.hdd.mesh import Points, TriangleMesh
from menid_plan.environments.interface import EnvironmentFailedError

CM = 0.1  # one mm
FORCE = 100.0  # one N
GRAVITY = 9810.0  # mm/s^2
FINGERS = (9, 10)  # the joints of an arm that open its hand

Vector = NDArray[np.float64]
Plain = tuple[float, float, float]
# A position in mm, a quaternion, mm/s and rad/s.
Motion = tuple[Plain, tuple[float, float, float, float], Plain, Plain]


def bullet() -> ModuleType:
    """PyBullet; EnvironmentFailedError with the extra to install where it is missing."""
    require()
    if "pybullet" not in sys.modules:
        # As it is imported it says, from C, when it was built: nothing for who reads what we print.
        with tempfile.TemporaryFile() as away:
            sys.stderr.flush()
            kept = os.dup(2)
            os.dup2(away.fileno(), 2)
            try:
                importlib.import_module("pybullet")
            finally:
                os.dup2(kept, 2)
                os.close(kept)
    return sys.modules["pybullet"]


@dataclass(frozen=True, slots=True)
class EngineSettings:
    """How PyBullet computes: ``step`` in seconds, ``iterations`` of its solver for each step.

    ``threshold`` is the distance in mm at which a contact is dropped, ``margin`` the thickness in mm
    that it adds to shapes.
    """

    step: float = 1 / 500
    iterations: int = 30
    threshold: float = 0.1
    margin: float = 0.03


@dataclass(frozen=True, slots=True)
class Surface:
    """Friction and restitution of a body; those of two bodies in contact are multiplied."""

    friction: float = 1.0
    restitution: float = 1.0


@dataclass(frozen=True, slots=True)
class Pose:
    """``position`` in mm, ``turn``: a quaternion (x, y, z, w)."""

    position: Vector
    turn: Vector

    @property
    def matrix(self) -> Vector:
        """The turn as a matrix: (3, 3)."""
        x, y, z, w = self.turn
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )

    def outside(self, point: Vector) -> Vector:
        """Where a point of the body is in the world."""
        moved: Vector = self.position + self.matrix @ point
        return moved


class World:
    """A world of bodies in a PyBullet server of its own; with ``window`` it is seen while it runs."""

    def __init__(
        self,
        settings: EngineSettings,
        gravity: float = GRAVITY,
        window: bool = False,
        drawn: bool = False,
    ) -> None:
        """``drawn``: bodies have shapes for pictures (as they have in a window)."""
        self.settings = settings
        self.dt = settings.step
        self.drawn = drawn or window
        self._p = bullet()
        self._id = self._p.connect(self._p.GUI if window else self._p.DIRECT)
        if self._id < 0:
            raise EnvironmentFailedError("PyBullet could not open a window: is there a screen?")
        self._p.setPhysicsEngineParameter(
            fixedTimeStep=settings.step, numSolverIterations=settings.iterations,
            contactBreakingThreshold=settings.threshold * CM, deterministicOverlappingPairs=1,
            enableFileCaching=0, physicsClientId=self._id,
        )  # fmt: skip
        self._p.setGravity(0, 0, -gravity * CM, physicsClientId=self._id)
        self._folder = tempfile.TemporaryDirectory(prefix="menid-hdd-")
        self.time = 0.0
        self.steps = 0

    def __enter__(self) -> World:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the server; may be called twice."""
        if self._id >= 0:
            self._p.disconnect(physicsClientId=self._id)
            self._folder.cleanup()
            self._id = -1

    def static_mesh(self, mesh: TriangleMesh, surface: Surface, colour: Sequence[float]) -> int:
        """A body that does not move, of the very triangles of a mesh."""
        shape = self._p.createCollisionShape(
            self._p.GEOM_MESH, fileName=self._obj("static", [(mesh.vertices, mesh.triangles)]),
            meshScale=[CM] * 3, flags=self._p.GEOM_FORCE_CONCAVE_TRIMESH, physicsClientId=self._id,
        )  # fmt: skip
        return self._body(0.0, shape, self._visual(mesh, colour), surface)

    def static_box(
        self, half: Sequence[float], at: Sequence[float], surface: Surface, colour: Sequence[float],
        turn: Sequence[float] = (0, 0, 0, 1),
    ) -> int:  # fmt: skip
        """A box that does not move, from half its extents."""
        return self.box(half, at, 0.0, surface, colour, turn=turn)

    def box(
        self,
        half: Sequence[float],
        at: Sequence[float] | Vector,
        mass: float,
        surface: Surface,
        colour: Sequence[float],
        offset: Sequence[float] = (0, 0, 0),
        turn: Sequence[float] | Vector = (0, 0, 0, 1),
        seen: tuple[Sequence[float], Sequence[float]] | None = None,
        inertia: Sequence[float] | None = None,
        held: bool = False,
    ) -> int:
        """A box, its middle at an offset from the body's; ``seen``: half extents and offset drawn.

        ``mass`` in kg (0: it does not move), ``inertia`` in kg mm^2 about the body's axes.
        One that is to be ``held`` is a multibody without joints, which is slower, and whose speed
        PyBullet bounds by 1 m/s; the others are plain rigid bodies, which no constraint can hold.
        """
        extents = [CM * h for h in half]
        shape = self._p.createCollisionShape(
            self._p.GEOM_BOX, halfExtents=extents, collisionFramePosition=[CM * o for o in offset],
            physicsClientId=self._id,
        )  # fmt: skip
        drawn, middle = seen or (half, offset)
        visual = self._p.createVisualShape(
            self._p.GEOM_BOX, halfExtents=[CM * h for h in drawn], rgbaColor=list(colour),
            visualFramePosition=[CM * o for o in middle], physicsClientId=self._id,
        )  # fmt: skip
        return self._body(mass, shape, visual, surface, at, turn, inertia, held)

    def compound(
        self,
        hulls: Sequence[Points],
        mesh: TriangleMesh,
        pose: Pose,
        mass: float,
        inertia: Sequence[float],
        surface: Surface,
        colour: Sequence[float],
    ) -> int:
        """A moving body of convex hulls. ``mass`` in kg, ``inertia`` in kg mm^2 about its axes."""
        # PyBullet makes a hull of every object in the file; a face makes it read the points.
        groups = [(hull, np.arange(len(hull) // 3 * 3).reshape(-1, 3)) for hull in hulls]
        groups = [(h, np.vstack([f, [len(h) - 3, len(h) - 2, len(h) - 1]])) for h, f in groups]
        shape = self._p.createCollisionShape(
            self._p.GEOM_MESH, fileName=self._obj("hulls", groups), meshScale=[CM] * 3,
            physicsClientId=self._id,
        )  # fmt: skip
        visual = self._visual(mesh, colour)
        return self._body(mass, shape, visual, surface, pose.position, pose.turn, inertia)

    def _obj(self, name: str, groups: Sequence[tuple[Points, NDArray[np.integer[Any]]]]) -> str:
        path = Path(self._folder.name) / f"{name}.obj"
        lines, first = [], 1
        for number, (points, faces) in enumerate(groups):
            lines.append(f"o {name}{number}")
            lines += [f"v {x:.6g} {y:.6g} {z:.6g}" for x, y, z in points.tolist()]
            lines += [f"f {a} {b} {c}" for a, b, c in (faces + first).tolist()]
            first += len(points)
        path.write_text("\n".join(lines) + "\n")
        return str(path)

    def _visual(self, mesh: TriangleMesh, colour: Sequence[float]) -> int:
        if not self.drawn:
            return -1
        found: int = self._p.createVisualShape(
            self._p.GEOM_MESH, fileName=self._obj("seen", [(mesh.vertices, mesh.triangles)]),
            meshScale=[CM] * 3, rgbaColor=list(colour), specularColor=[0.2] * 3,
            physicsClientId=self._id,
        )  # fmt: skip
        return found

    def _body(
        self, mass: float, shape: int, visual: int, surface: Surface,
        at: Sequence[float] | Vector = (0, 0, 0), turn: Sequence[float] | Vector = (0, 0, 0, 1),
        inertia: Sequence[float] | None = None, held: bool = False,
    ) -> int:  # fmt: skip
        if shape < 0:
            raise EnvironmentFailedError("PyBullet could not build a body of a mesh")
        body: int = self._p.createMultiBody(
            mass,
            shape,
            visual,
            [CM * c for c in at],
            list(turn),
            useMaximalCoordinates=int(not held),
            physicsClientId=self._id,
        )
        if body < 0:
            raise EnvironmentFailedError("PyBullet could not put a body into the world")
        self._p.changeDynamics(
            body, -1, lateralFriction=surface.friction, restitution=surface.restitution,
            collisionMargin=self.settings.margin * CM, linearDamping=0.02, angularDamping=0.02,
            activationState=self._p.ACTIVATION_STATE_DISABLE_SLEEPING, physicsClientId=self._id,
        )  # fmt: skip
        if inertia is not None:
            self._p.changeDynamics(
                body, -1, mass=mass, localInertiaDiagonal=[i * CM * CM for i in inertia],
                physicsClientId=self._id,
            )  # fmt: skip
        return body

    def step(self) -> None:
        """Let one step of time pass."""
        self._p.stepSimulation(physicsClientId=self._id)
        self.steps += 1
        self.time += self.dt

    def set_step(self, seconds: float) -> None:
        """Make the steps of time shorter or longer from now on."""
        self.dt = seconds
        self._p.setPhysicsEngineParameter(fixedTimeStep=seconds, physicsClientId=self._id)

    def pose(self, body: int) -> Pose:
        """Where a body is."""
        at, turn = self._p.getBasePositionAndOrientation(body, physicsClientId=self._id)
        return Pose(np.array(at) / CM, np.array(turn))

    def place(self, body: int, pose: Pose) -> None:
        """Put a body somewhere, at rest."""
        self._p.resetBasePositionAndOrientation(
            body, (CM * pose.position).tolist(), pose.turn.tolist(), physicsClientId=self._id
        )

    def velocity(self, body: int) -> tuple[Vector, Vector]:
        """How fast a body moves, in mm/s, and turns, in rad/s."""
        linear, angular = self._p.getBaseVelocity(body, physicsClientId=self._id)
        return np.array(linear) / CM, np.array(angular)

    def set_velocity(self, body: int, linear: Vector, angular: Vector) -> None:
        """Set how fast a body moves, in mm/s, and turns, in rad/s."""
        self._p.resetBaseVelocity(
            body, (CM * linear).tolist(), angular.tolist(), physicsClientId=self._id
        )

    def motion(self, body: int) -> Motion:
        """Where a body is and how it moves, in plain numbers: for what is asked at every step."""
        (x, y, z), turn = self._p.getBasePositionAndOrientation(body, physicsClientId=self._id)
        (vx, vy, vz), angular = self._p.getBaseVelocity(body, physicsClientId=self._id)
        return (x / CM, y / CM, z / CM), turn, (vx / CM, vy / CM, vz / CM), angular

    def push(self, body: int, at: Plain, force: Sequence[float], torque: Sequence[float]) -> None:
        """A force in N on a body whose middle is at a point in mm, and a torque in N mm about it.

        Both are along axes of the world, and act for the next step.
        """
        p, frame = self._p, self._p.WORLD_FRAME
        force, at = [FORCE * f for f in force], (CM * at[0], CM * at[1], CM * at[2])
        p.applyExternalForce(body, -1, force, at, frame, physicsClientId=self._id)
        torque = [FORCE * CM * t for t in torque]
        p.applyExternalTorque(body, -1, torque, frame, physicsClientId=self._id)

    def hold(self, body: int, pose: Pose, force: float) -> int:
        """Hold a body at a pose by at most a force in N; what it is held by, for `move`."""
        constraint: int = self._p.createConstraint(
            body, -1, -1, -1, self._p.JOINT_FIXED, [0, 0, 0], [0, 0, 0],
            (CM * pose.position).tolist(), [0, 0, 0, 1], pose.turn.tolist(), physicsClientId=self._id,
        )  # fmt: skip
        self._p.changeConstraint(constraint, maxForce=FORCE * force, physicsClientId=self._id)
        return constraint

    def move(self, constraint: int, pose: Pose, force: float) -> None:
        """Move what a body is held by."""
        self._p.changeConstraint(
            constraint, (CM * pose.position).tolist(), pose.turn.tolist(), maxForce=FORCE * force,
            physicsClientId=self._id,
        )  # fmt: skip

    def ignore(self, one: int, other: int) -> None:
        """Let two bodies pass through each other."""
        self._p.setCollisionFilterPair(one, other, -1, -1, 0, physicsClientId=self._id)

    def contact_force(self, one: int, other: int | None = None) -> float:
        """The sum of the normal forces on a body in N, by one other body or by all."""
        return sum(f for _, f, _ in self.contacts(one, other))

    def contacts(self, one: int, other: int | None = None) -> list[tuple[int, float, float]]:
        """The contacts of a body: with which other, the normal force in N, and the distance in mm."""
        pair = {} if other is None else {"bodyB": other}
        points = self._p.getContactPoints(bodyA=one, physicsClientId=self._id, **pair)
        return [(point[2], point[9] / FORCE, point[8] / CM) for point in points]

    def ghost(self, radius: float, height: float, colour: Sequence[float]) -> int:
        """An upright cylinder that is seen, and touches nothing."""
        visual = self._p.createVisualShape(
            self._p.GEOM_CYLINDER, radius=CM * radius, length=CM * height, rgbaColor=list(colour),
            physicsClientId=self._id,
        )  # fmt: skip
        body: int = self._p.createMultiBody(0, -1, visual, physicsClientId=self._id)
        return body

    def seen(self, mesh: TriangleMesh, colour: Sequence[float]) -> int:
        """A mesh that is seen where its vertices are, and touches nothing."""
        visual = self._visual(mesh, colour)
        body: int = self._p.createMultiBody(0, -1, visual, physicsClientId=self._id)
        return body

    def remove(self, body: int) -> None:
        """Take a body out of the world."""
        self._p.removeBody(body, physicsClientId=self._id)

    def arm(self) -> int:
        """A Panda arm that is seen, and touches nothing."""
        data = importlib.import_module("pybullet_data")
        arm: int = self._p.loadURDF(
            str(Path(data.getDataPath()) / "franka_panda" / "panda.urdf"), useFixedBase=1,
            globalScaling=1000 * CM, physicsClientId=self._id,
        )  # fmt: skip
        # The arm's base counts as link -1.
        for link in range(-1, self._p.getNumJoints(arm, physicsClientId=self._id)):
            self._p.setCollisionFilterGroupMask(arm, link, 0, 0, physicsClientId=self._id)
        return arm

    def bend(self, arm: int, joints: Vector, fingers: float) -> None:
        """Bend an arm: its joints (7,) in rad, and how far each of its fingers is open in mm."""
        for joint, angle in enumerate(joints):
            self._p.resetJointState(arm, joint, angle, physicsClientId=self._id)
        for joint in FINGERS:
            self._p.resetJointState(arm, joint, CM * fingers, physicsClientId=self._id)

    def stand(self, arm: int, foot: Pose) -> None:
        """Put an arm's foot somewhere."""
        # PyBullet places a body's centre of mass.
        inertial = self._p.getDynamicsInfo(arm, -1, physicsClientId=self._id)[3:5]
        at, turn = self._p.multiplyTransforms(
            (CM * foot.position).tolist(), foot.turn.tolist(), *inertial
        )
        self._p.resetBasePositionAndOrientation(arm, at, turn, physicsClientId=self._id)

    def picture(
        self, eye: Vector, middle: Vector, up: Vector, width: int, height: int
    ) -> NDArray[np.uint8]:
        """What a camera sees: (height, width, 3). Only worlds that are ``drawn`` show their shapes."""
        view = self._p.computeViewMatrix((CM * eye).tolist(), (CM * middle).tolist(), up.tolist())
        lens = self._p.computeProjectionMatrixFOV(38, width / height, 1, 400)
        _, _, pixels, _, _ = self._p.getCameraImage(
            width, height, view, lens, renderer=self._p.ER_TINY_RENDERER, shadow=0,
            lightDirection=[-20, -30, 60], physicsClientId=self._id,
        )  # fmt: skip
        found = np.asarray(pixels, np.uint8).reshape(height, width, 4)
        return np.ascontiguousarray(found[:, :, :3])

    def deepest(self, body: int) -> float:
        """How far a body has sunk into others, in mm."""
        return max((-distance for _, _, distance in self.contacts(body)), default=0.0)

    def rays(self, starts: Points, ends: Points) -> list[tuple[int, float]]:
        """For each ray the body that it meets (-1: none) and the share of its way until then."""
        found = self._p.rayTestBatch(
            (CM * starts).tolist(), (CM * ends).tolist(), physicsClientId=self._id
        )
        return [(hit[0], hit[2]) for hit in found]
