"""The scenes with an arm that leads the tools."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from menid_plan.environments.hdd.arm import PEDESTAL, Motion, Task
from menid_plan.environments.hdd.environment import (
    NO_ERRORS,
    HddEnvironment,
    View,
    carry_out,
    tool_of,
)
from menid_plan.environments.hdd.kind import HddRobot
from menid_plan.environments.hdd.scene import GREY, Scene
from menid_plan.environments.interface import EnvironmentFailedError
from menid_plan.environments.registry import Place
from menid_plan.grounding.state import GroundAction

STAND = 80.0  # mm, the radius of what the arm stands on


class RobotEnvironment(HddEnvironment):
    """As without the arm, but the tools go where the arm brings them, when it can."""

    def __init__(self, kind: HddRobot, place: Place) -> None:
        super().__init__(kind, place)
        self._robot = kind
        # The way of the joints is that of the action as it is planned, whatever errs afterwards.
        self._motions: dict[GroundAction, Motion] = {}

    def view(self, action: GroundAction) -> View:
        """From where the drive and the arm's hand are best seen."""
        side = self._motion(action).task.side
        x, y = Rotation.from_euler("z", side, degrees=True).apply([50.0, 0.0, 0.0])[:2]
        return View(side + 100.0, 22.0, 480.0, (float(x), float(y), 50.0))

    def _prepared(
        self, action: GroundAction, numbers: Mapping[str, float], errors: Mapping[str, float]
    ) -> Callable[[Scene], None]:
        assert self._rng is not None
        kind = self._robot
        hand = self._motion(action).hand(kind.noise * kind.jerk, self._rng)
        tool = tool_of(action.action, numbers, {**errors, **self._seen_at(numbers)}, kind.force)
        return lambda scene: carry_out(scene, tool, hand, kind.cup)

    def _motion(self, action: GroundAction) -> Motion:
        """How the arm carries an action out, whatever errs then; EnvironmentFailedError if it can't."""
        if action not in self._motions:
            tool = tool_of(action.action, self.numbers(action), NO_ERRORS, self._robot.force)
            try:
                self._motions[action] = Motion.of(Task.of(tool))
            except EnvironmentFailedError as error:
                raise EnvironmentFailedError(f"`{action}`: {error}") from error
        return self._motions[action]

    def _furnish(self, scene: Scene, action: GroundAction) -> None:
        motion, world = self._motion(action), scene.world
        arm, stand = world.arm(), world.ghost(STAND, PEDESTAL, GREY)
        after_step = scene.after_step

        def shown(scene: Scene) -> None:
            motion.show(scene, arm, stand)
            if after_step is not None:
                after_step(scene)

        scene.after_step = shown

    def _seen_at(self, numbers: Mapping[str, float]) -> Mapping[str, float]:
        """Where the hand goes instead, as the camera errs about the drive; shaking needs no aim."""
        assert self._rng is not None
        kind = self._robot
        sizes = np.array(
            [kind.perception.x, kind.perception.y, kind.perception.z, kind.perception.yaw]
        )
        x, y, z, yaw = kind.noise * sizes * self._rng.standard_normal(4)
        if "x" not in numbers:
            return {}
        off = np.array([x - yaw * numbers["y"], y + yaw * numbers["x"]])
        angle = np.radians(numbers.get("direction", 0.0))
        way_in, across = (
            np.array([np.cos(angle), np.sin(angle)]),
            np.array([-np.sin(angle), np.cos(angle)]),
        )
        return {
            "across": float(off @ across), "deeper": float(off @ way_in), "above": float(z),
            "askew": float(yaw), "spot_x": float(off[0]), "spot_y": float(off[1]),
        }  # fmt: skip
