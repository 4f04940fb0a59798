"""A hard drive on a table, as an environment: actions on its objects, atoms of its state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields

import numpy as np
from scipy.spatial.transform import Rotation

from menid_plan.environments.hdd.engine import EngineSettings, Pose
from menid_plan.environments.hdd.geometry import LENGTH
from menid_plan.environments.hdd.hand import STEADY, Hand
from menid_plan.environments.hdd.kind import Deviations, Hdd
from menid_plan.environments.hdd.lever import Lever, lever
from menid_plan.environments.hdd.mesh import TriangleMesh
from menid_plan.environments.hdd.meshes import Source, part_mesh
from menid_plan.environments.hdd.scans import MeshError
from menid_plan.environments.hdd.scene import TABLE, BrokenDownError, Physics, Scene, level, turned
from menid_plan.environments.hdd.shake import FREQUENCY, Shake, shake
from menid_plan.environments.hdd.soft_cup import SoftGrip
from menid_plan.environments.hdd.suck import Suck, gripped, suck
from menid_plan.environments.hdd.symbols import PREDICATES, Seen
from menid_plan.environments.interface import (
    CannotResetError,
    Capabilities,
    EnvironmentFailedError,
    Execution,
)
from menid_plan.environments.registry import Place
from menid_plan.environments.settings import SettingError
from menid_plan.grounding.state import GroundAction, State, state_text
from menid_plan.model.domain import Domain, Problem
from menid_plan.model.formulas import GroundAtom

# The attributes of the objects that each action is about, in the order of its arguments.
ACTIONS: dict[str, tuple[tuple[str, ...], ...]] = {
    "lever": (("x", "y", "direction"),),
    "shake": (("degrees",),),
    "suck": (("x", "y"), ("pascal",)),
}

# What the attributes may be. A cup that sits beyond the board's edges has nothing to hold on to, and a
# vacuum is no better than none of the atmosphere's pressure.
RANGES = {
    "x": (-LENGTH, LENGTH), "y": (-LENGTH, LENGTH), "direction": (-360.0, 360.0),
    "degrees": (0.0, 45.0), "pascal": (-101_325.0, 0.0),
}  # fmt: skip

# A board that sank deeper than this into something, in mm, is an error of the computation: then all of
# it is computed again, with steps so many times shorter.
DEEPEST = 0.5
FINER = (1, 2, 4)
# How often a pose for a state is drawn before it is given up.
TRIES = 10

NO_ERRORS: Mapping[str, float] = {field.name: 0.0 for field in fields(Deviations)}


@dataclass(frozen=True, slots=True)
class View:
    """Where a camera is: in degrees around the drive and above it, in mm from the ``middle``."""

    direction: float
    elevation: float = 38.0
    distance: float = 330.0
    middle: tuple[float, float, float] = (0.0, 0.0, 0.0)


class HddEnvironment:
    """The board's pose is kept between executions; each has a world of its own, built anew.

    (A world that is put back to what was saved does not go on to the bit as before; one that is built
    anew does.)
    """

    capabilities = Capabilities()

    def __init__(self, kind: Hdd, place: Place) -> None:
        self._kind = kind
        self._arguments = _arguments(place.domain, place.problem)
        self._known = _known(place.domain, _parts(place.domain, place.problem))
        self._predicates = {atom.predicate for atom in self._known}
        self._init = frozenset(place.problem.init)
        self._others: State = frozenset(a for a in self._init if a not in self._known)
        self._meshes = _mesh(kind, place, "board"), _mesh(kind, place, "bay")
        # For pictures: bodies get shapes to be seen, and something is called after each step of time.
        self.drawn = self.window = False
        self.after_step: Callable[[Scene], None] | None = None
        self.pose = level()
        self.force = 0.0
        self._rng: np.random.Generator | None = None

    def reset(self, state: State | None, seed: int) -> State:
        """Put the board where the state says; CannotResetError for one in which it can't rest."""
        wanted = self._init if state is None else state
        self._rng = np.random.default_rng(seed)
        self._others = frozenset(a for a in wanted if a not in self._known)
        self.force = 0.0
        aim = frozenset(a for a in wanted if a in self._known)
        for _ in range(TRIES):
            pose = self._drawn(aim)
            if pose is None:
                break
            with self._scene(pose) as scene:
                scene.rest()
                self.pose = scene.pose
            if self._atoms() == aim:
                return self.state()
        raise CannotResetError(f"the board can't be put so that this holds: {state_text(aim)}")

    def execute(self, action: GroundAction) -> Execution:
        """Execute an action; EnvironmentFailedError if the computation breaks down."""
        if self._rng is None:
            raise EnvironmentFailedError("it was not reset")
        errors = self._errors()
        run = self._prepared(action, self.numbers(action), errors)
        fault = ""
        for finer in FINER:
            with self._scene(self.pose, errors, finer) as scene:
                if self.drawn or self.window:
                    self._furnish(scene, action)
                scene.rest()
                scene.began = scene.world.time
                try:
                    run(scene)
                except BrokenDownError as error:
                    fault = str(error)
                    continue
                depth = scene.world.deepest(scene.board)
                if np.isfinite(scene.pose.position).all() and depth <= DEEPEST:
                    self.pose = scene.pose
                    self.force = max(self.force, scene.peak_force)
                    return Execution(self.state())
                fault = f"the board is {depth:.1f} mm inside another body"
        raise EnvironmentFailedError(f"`{action}`: the computation broke down: {fault}")

    def numbers(self, action: GroundAction) -> Mapping[str, float]:
        """The attributes of an action's objects."""
        return {
            name: self._arguments[argument][name]
            for names, argument in zip(ACTIONS[action.action], action.arguments, strict=True)
            for name in names
        }

    def state(self) -> State:
        """The atoms that hold."""
        return self._atoms() | self._others

    def view(self, action: GroundAction) -> View:
        """From where an action is best seen."""
        if action.action == "lever":  # from beside the hand
            return View(self.numbers(action)["direction"] + 180.0 + 55.0)
        return View(25.0 if action.action == "suck" else -60.0)

    def close(self) -> None:
        """There is nothing to let go of: each execution has closed its world."""

    def _prepared(
        self, action: GroundAction, numbers: Mapping[str, float], errors: Mapping[str, float]
    ) -> Callable[[Scene], None]:
        """What carries an action out in a scene; EnvironmentFailedError if nobody can."""
        tool = tool_of(action.action, numbers, errors, self._kind.force)
        return lambda scene: carry_out(scene, tool, STEADY, self._kind.cup)

    def _furnish(self, scene: Scene, action: GroundAction) -> None:
        """Add to a scene what is only to be seen."""

    def _errors(self) -> Mapping[str, float]:
        """How far everything errs in one execution."""
        assert self._rng is not None
        found = {}
        for field in fields(self._kind.deviations):
            deviation = getattr(self._kind.deviations, field.name)
            found[field.name] = float(self._kind.noise * deviation * self._rng.standard_normal())
        return found

    def _scene(self, pose: Pose, errors: Mapping[str, float] = NO_ERRORS, finer: int = 1) -> Scene:
        kind = self._kind
        engine = EngineSettings(kind.step / finer, kind.iterations, kind.threshold, kind.margin)
        physics = Physics(
            engine,
            1000 * kind.gravity,
            kind.friction * np.exp(errors["friction"]),
            min(kind.restitution * np.exp(errors["restitution"]), 1.0),
        )
        return Scene(
            *self._meshes, physics, pose, window=self.window, drawn=self.drawn,
            watched="damaged" in self._predicates, after_step=self.after_step,
        )  # fmt: skip

    def _drawn(self, aim: State) -> Pose | None:
        """A pose in which the board may come to rest so that the atoms hold; None if there is none."""
        assert self._rng is not None
        names = {atom.predicate for atom in aim}
        place = self._kind.noise * self._kind.deviations.place * self._rng.standard_normal(2)
        if (
            "damaged" in names
            or names & {"tilted", "flipped"}
            or len(names & {"in", "on-table"}) != 1
        ):
            return None  # a board does not stay like that, or it is nowhere
        if "on-table" in names:
            return level(0.0, -130.0, TABLE + 3.0)
        if "loose" not in names:
            return level(place[0], place[1], 0.3)
        # One of its long edges has come to lie on the frame.
        side = self._rng.choice([-1.0, 1.0])
        lean = Rotation.from_euler("x", 2.2 * side, degrees=True)
        return turned(lean, np.array([place[0], side * self._rng.uniform(2.0, 4.0), 1.5]))

    def _atoms(self) -> State:
        """What the predicates of the scene say of the board."""
        seen = Seen.of(self.pose, self.force)
        return frozenset(atom for atom in self._known if PREDICATES[atom.predicate][1](seen))


def _mesh(kind: Hdd, place: Place, part: str) -> TriangleMesh:
    """The mesh of a part; SettingError for a scan that can't be used."""
    scan = kind.scan(part, place.folder)
    try:
        return part_mesh(Source(part, scan), kind.quality).mesh
    except MeshError as error:
        if scan is None:
            raise
        raise SettingError(part, str(error)) from error


def tool_of(
    action: str, numbers: Mapping[str, float], errors: Mapping[str, float], force: float
) -> Lever | Shake | Suck:
    """The tool that an action is about, and where it goes."""
    if action == "lever":
        return Lever(
            numbers["x"], numbers["y"], numbers["direction"], errors["across"], errors["above"],
            errors["deeper"], errors["askew"], force,
        )  # fmt: skip
    if action == "shake":
        return Shake(
            numbers["degrees"] * (1 + errors["swing"]), FREQUENCY * (1 + errors["frequency"])
        )
    return Suck(
        numbers["x"] + errors["spot_x"], numbers["y"] + errors["spot_y"],
        numbers["pascal"] * (1 + errors["pressure"]),
    )  # fmt: skip


def carry_out(scene: Scene, tool: Lever | Shake | Suck, hand: Hand, cup: str) -> None:
    """Carry an action out in a scene; ``cup`` is the setting."""
    if isinstance(tool, Lever):
        lever(scene, tool, hand)
    elif isinstance(tool, Shake):
        shake(scene, tool, hand)
    else:
        suck(scene, tool, hand, SoftGrip if cup == "soft" else gripped)


def _arguments(domain: Domain, problem: Problem) -> dict[str, dict[str, float]]:
    """The attributes of all objects that actions are about; SettingError for what is missing."""
    objects = (*domain.constants, *problem.objects)
    for action in domain.actions:
        if action.name not in ACTIONS:
            raise SettingError(
                "", f"the scene has no action `{action.name}`; it has {', '.join(ACTIONS)}"
            )
        asked = ACTIONS[action.name]
        if len(action.parameters) != len(asked):
            raise SettingError(
                "", f"`{action.name}` has {len(action.parameters)} parameters, and the scene gives it"
                f" {len(asked)}"
            )  # fmt: skip
        for parameter, names in zip(action.parameters, asked, strict=True):
            for thing in objects:
                if not any(t in parameter.types for t in domain.supertypes(thing.type)):
                    continue
                have = dict(thing.attributes)
                missing = [name for name in names if name not in have]
                if missing:
                    raise SettingError(
                        "", f"the object `{thing.name}` of problem `{problem.name}` lacks the attribute"
                        f" `{missing[0]}`, which `{action.name}` needs"
                    )  # fmt: skip
                for name in names:
                    least, most = RANGES[name]
                    if not least <= have[name] <= most:
                        raise SettingError(
                            "", f"the attribute `{name}` of the object `{thing.name}` of problem"
                            f" `{problem.name}` is {have[name]:g}; it must lie between {least:g} and"
                            f" {most:g}"
                        )  # fmt: skip
    return {thing.name: dict(thing.attributes) for thing in objects}


def _parts(domain: Domain, problem: Problem) -> dict[str, str]:
    """The names of the one board and the one bay."""
    objects = (*domain.constants, *problem.objects)
    found = {}
    for part, kind in (("board", "pcb"), ("bay", "bay")):
        names = [o.name for o in objects if kind in domain.supertypes(o.type)]
        if len(names) != 1:
            raise SettingError(
                "", f"the scene has one {part}, and problem `{problem.name}` has"
                f" {len(names)} objects of type `{kind}`"
            )  # fmt: skip
        found[part] = names[0]
    return found


def _known(domain: Domain, parts: Mapping[str, str]) -> frozenset[GroundAtom]:
    """The atoms that the scene tells: of those predicates that the domain declares."""
    found = []
    for predicate in domain.predicates:
        if predicate.name in PREDICATES:
            about, _ = PREDICATES[predicate.name]
            if len(predicate.arguments) != len(about):
                raise SettingError(
                    "", f"`{predicate.name}` has {len(predicate.arguments)} arguments, and what the"
                    f" scene tells has {len(about)}"
                )  # fmt: skip
            found.append(GroundAtom(predicate.name, tuple(parts[part] for part in about)))
    if not {"in", "on-table"} & {atom.predicate for atom in found}:
        raise SettingError(
            "", f"domain `{domain.name}` declares neither `in(pcb, bay)` nor `on-table(pcb)`: the scene"
            " can't be told where the board is"
        )  # fmt: skip
    return frozenset(found)
