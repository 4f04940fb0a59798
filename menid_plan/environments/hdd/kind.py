"""The scenes as environments of a domain: the kinds `hdd` and `hdd-robot`."""

from __future__ import annotations

import sys
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

from menid_plan.environments.hdd.extra import require
from menid_plan.environments.registry import Place
from menid_plan.environments.settings import check_range

if TYPE_CHECKING:
    from menid_plan.environments.hdd.environment import HddEnvironment


# Beyond this, numbers of the scene make no sense, and soon none that can be computed with.
MOST = 1000.0


@dataclass(frozen=True, slots=True)
class Deviations:
    """How far things err: standard deviations of normal draws, one for each execution.

    The hand that leads a tool: ``across``, ``above``, ``deeper`` in mm and ``askew`` in radians for
    the lever, ``spot_x``, ``spot_y`` in mm for the cup. ``swing``, ``frequency``, ``pressure``,
    ``friction`` and ``restitution`` are shares of the values. ``place`` in mm: how the board lies in
    its clearance.
    """

    across: float = 0.5
    above: float = 0.12
    deeper: float = 0.5
    askew: float = 0.02
    spot_x: float = 0.5
    spot_y: float = 0.5
    swing: float = 0.03
    frequency: float = 0.03
    pressure: float = 0.05
    friction: float = 0.15
    restitution: float = 0.3
    place: float = 0.1

    def __post_init__(self) -> None:
        for field in fields(self):
            check_range(self, field.name, least=0, most=MOST)


@dataclass(frozen=True, slots=True)
class Perception:
    """How far a camera errs about where the drive is: standard deviations, one draw an execution.

    ``x``, ``y``, ``z`` in mm; ``yaw`` in radians about the drive's middle.
    """

    x: float = 0.5
    y: float = 0.5
    z: float = 0.12
    yaw: float = 0.01

    def __post_init__(self) -> None:
        for field in fields(self):
            check_range(self, field.name, least=0, most=MOST)


@dataclass(frozen=True, slots=True)
class Hdd:
    """Executes lever, shake and suck on a hard drive, in PyBullet.

    ``quality`` is the share of a dense scan's vertices that the meshes keep, 0.001 to 0.1. ``noise``
    scales all ``deviations`` of trajectories and surfaces; 0: none. ``board`` and ``bay`` are scans of
    your own (STL, OBJ, PLY; in mm) instead of the designed parts. ``friction`` and ``restitution`` are
    those between board and bay, ``gravity`` is in m/s^2, ``force`` in N what the hand with the lever
    can do. ``cup``: "seal" is a model of how its lip seals, "soft" a cup of rubber in finite elements.
    ``step`` (s), ``iterations``, ``threshold`` and ``margin`` (mm) are PyBullet's.
    """

    name: ClassVar[str] = "hdd"
    promise: ClassVar[str] = "a board is levered, shaken or sucked out of a hard drive, in PyBullet"
    needs: ClassVar[str] = (
        "pybullet>=3.2.7" if sys.version_info < (3, 12) else "pybullet-arm64>=3.2.8"
    )

    quality: float = 0.01
    noise: float = 0.0
    deviations: Deviations = Deviations()
    board: str = ""
    bay: str = ""
    friction: float = 0.35
    restitution: float = 0.1
    gravity: float = 9.81
    force: float = 30.0
    cup: Literal["seal", "soft"] = "seal"
    step: float = 0.002
    iterations: int = 30
    threshold: float = 0.1
    margin: float = 0.03

    def __post_init__(self) -> None:
        check_range(self, "quality", least=0.001, most=0.1)
        check_range(self, "noise", least=0, most=MOST)
        for key in ("friction", "restitution", "gravity", "force"):
            check_range(self, key, least=0, most=MOST)
        check_range(self, "step", least=1e-5, most=0.01)
        check_range(self, "iterations", least=1, most=1000)
        check_range(self, "threshold", least=0, most=1)
        check_range(self, "margin", least=0, most=0.5)

    def build(self, place: Place) -> HddEnvironment:
        """Prepare the meshes; SettingError for what the domain or problem lacks."""
        require()
        from menid_plan.environments.hdd.environment import HddEnvironment

        return HddEnvironment(self, place)

    def scan(self, part: str, folder: Path) -> Path | None:
        """The file of a part's scan, if there is one."""
        chosen = {"board": self.board, "bay": self.bay}[part]
        return folder / chosen if chosen else None


# An arm's hand errs by what its camera and its joints do.
_SURFACES = Deviations(across=0, above=0, deeper=0, askew=0, spot_x=0, spot_y=0)


@dataclass(frozen=True, slots=True)
class HddRobot(Hdd):
    """Executes lever, shake and suck on a hard drive with a Panda arm, in PyBullet.

    As kind `hdd`, but the tools follow what the arm can do: it is as slow as its joints have to be,
    and cannot do what is out of its reach. ``noise`` scales ``perception``, ``jerk`` (the standard
    deviation of its joints' errors while it moves, in radians) and ``deviations``, of which those of
    the hand are 0.
    """

    name: ClassVar[str] = "hdd-robot"
    promise: ClassVar[str] = "the same with a Panda arm, whose camera and joints err; in PyBullet"

    noise: float = 1.0
    deviations: Deviations = _SURFACES
    perception: Perception = Perception()
    jerk: float = 0.0002

    def __post_init__(self) -> None:
        Hdd.__post_init__(self)
        check_range(self, "jerk", least=0, most=0.1)

    def build(self, place: Place) -> HddEnvironment:
        """Prepare the meshes; SettingError for what the domain or problem lacks."""
        require()
        from menid_plan.environments.hdd.robot import RobotEnvironment

        return RobotEnvironment(self, place)
