"""Whether board and bay are fit for contact: two tests that every representation has to pass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from menid_plan.environments.hdd.mesh import Check, TriangleMesh
from menid_plan.environments.hdd.scene import BOARD_MASS, Physics, Scene, level
from menid_plan.environments.hdd.symbols import Seen

LIFT = 1.3  # times the weight
LIFTED_FOR = 0.6  # seconds

# How far force and rise may be from 1, and how far the board may tilt (degrees) or go aside (mm).
FORCE, RISE, TILT, ASIDE = 0.02, 0.03, 3.0, 1.0


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
    def checks(self) -> tuple[Check, ...]:
        """All that was tested, with what is wrong; what is not a number is wrong as well."""
        lifted = f"lifted with {LIFT:g} times its weight, the board"
        return (
            Check(
                "at rest", "loose" if self.loose else "in its seat", "in its seat",
                "the board does not come to rest in its seat" if self.loose else "",
            ),
            Check(
                "force at rest", f"{self.force:.3f} of the weight", f"1, within {100 * FORCE:g} %",
                "" if abs(self.force - 1) <= FORCE else
                f"at rest the board is pressed with {self.force:.2f} times its weight: it jams",
            ),
            Check(
                "rise", f"{self.rise:.3f} of a free one", f"1, within {100 * RISE:g} %",
                "" if abs(self.rise - 1) <= RISE else
                f"{lifted} rises {self.rise:.2f} times as far as a free one: it is caught in the bay",
            ),
            Check(
                "tilt", f"{self.tilt:.2f} degrees", f"{TILT:g} at most",
                "" if self.tilt <= TILT else
                f"{lifted} tilts by {self.tilt:.1f} degrees: it is caught in the bay",
            ),
            Check(
                "aside", f"{self.aside:.2f} mm", f"{ASIDE:g} at most",
                "" if self.aside <= ASIDE else
                f"{lifted} goes aside by {self.aside:.1f} mm: it is pushed by the bay",
            ),
        )  # fmt: skip

    @property
    def faults(self) -> list[str]:
        """What is wrong, in words; empty if nothing is."""
        return [check.fault for check in self.checks if check.fault]


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
            at = scene.world.motion(scene.board)[0]
            scene.world.push(scene.board, at, (0.0, 0.0, LIFT * weight), (0.0, 0.0, 0.0))
            scene.step()
        lifted = scene.pose.position - rest.position
        free = 0.5 * (LIFT - 1) * physics.gravity * LIFTED_FOR**2
        return Validity(
            float(np.mean(forces)) / weight, float(lifted[2]) / free, scene.tilt,
            float(np.hypot(*lifted[:2])), Seen.of(rest).loose or Seen.of(rest).removed,
        )  # fmt: skip
