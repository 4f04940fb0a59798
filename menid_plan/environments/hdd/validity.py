"""Whether board and bay are fit for contact: two tests that every representation has to pass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from menid_plan.environments.hdd.mesh import TriangleMesh
from menid_plan.environments.hdd.scene import BOARD_MASS, Physics, Scene, level
from menid_plan.environments.hdd.symbols import Seen

LIFT = 1.3  # times the weight
LIFTED_FOR = 0.6  # seconds


@dataclass(frozen=True, slots=True)
class Validity:
    """What the tests gave.

    ``force``: the sum of the contact forces on the board at rest, over its weight. ``rise``: how far
    1.3 times the weight lifts it in 0.6 s, over what it would without a bay. ``tilt`` (degrees) and
    ``aside`` (mm): how it comes out. ``loose``: it rests, but not in its seat.
    """

    force: float
    rise: float
    tilt: float
    aside: float
    loose: bool

    @property
    def faults(self) -> list[str]:
        """What is wrong, in words; empty if nothing is."""
        found = []
        if self.loose:
            found.append("the board does not come to rest in its seat")
        if abs(self.force - 1) > 0.02:
            found.append(f"at rest it is pressed with {self.force:.2f} times its weight: it jams")
        if abs(self.rise - 1) > 0.03 or self.tilt > 3.0 or self.aside > 1.0:
            found.append(
                f"{LIFT:g} times its weight do not lift it freely: it is caught in the bay"
            )
        return found


def validity(board: TriangleMesh, bay: TriangleMesh, physics: Physics) -> Validity:
    """Put the board into the bay, let it rest, and lift it."""
    weight = BOARD_MASS * physics.gravity / 1000
    with Scene(board, bay, physics, level(0, 0, 0.1)) as scene:
        scene.wait(0.4)
        forces = []
        for _ in range(50):
            scene.step()
            forces.append(scene.world.contact_force(scene.board))
        rest = scene.pose
        steps = round(LIFTED_FOR / scene.world.dt)
        for _ in range(steps):
            scene.world.push(scene.board, np.array([0, 0, LIFT * weight]), scene.pose.position)
            scene.step()
        lifted = scene.pose.position - rest.position
        free = 0.5 * (LIFT - 1) * physics.gravity * LIFTED_FOR**2
        return Validity(
            float(np.mean(forces)) / weight, float(lifted[2]) / free, scene.tilt,
            float(np.hypot(*lifted[:2])), Seen.of(rest).loose or Seen.of(rest).removed,
        )  # fmt: skip
