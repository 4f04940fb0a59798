"""What a run did before it was resumed, in order.

A run that is resumed takes all its decisions again from the beginning, with the same seeds; what the
store has is not executed again. So both have to agree at every step.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from menid_plan.errors import MenidError
from menid_plan.experience.record import Experience
from menid_plan.grounding.state import GroundAction, State, state_text


class DivergedError(MenidError):
    """A store holds what the run that is resumed would not do: it was made otherwise, or altered."""

    exit_code = 3


class Replay:
    """The experiences of a store, to be taken one by one; ``path`` is what messages call it."""

    def __init__(self, experiences: Iterable[Experience], path: Path) -> None:
        self._path = path
        self._coming = iter(experiences)
        self.next: Experience | None = next(self._coming, None)

    @property
    def over(self) -> bool:
        """Whether everything was taken."""
        return self.next is None

    def take(
        self, environment: str, state: State, action: GroundAction, number: int, seed: int
    ) -> Experience | None:
        """The execution that the run is about to do, if the store has it; None once it has no more.

        Raises DivergedError if the store goes on with something else.
        """
        found = self.next
        if found is None:
            return None
        for what, there, here in (
            ("environment", found.environment, environment),
            ("action", str(found.action), str(action)),
            ("number", found.number, number),
            ("state", state_text(found.state), state_text(state)),
            ("seed", found.seed, seed),
        ):
            if there != here:
                raise DivergedError(
                    f"`{self._path}` goes on with execution {found.number} of `{found.action}` in "
                    f"`{found.environment}`, where the run does otherwise ({what}: {here}, not "
                    f"{there}); it can be resumed only by the version of the program, and of NumPy, "
                    "that began it, and if nothing was put into the store, or changed in events.jsonl"
                )
        self.next = next(self._coming, None)
        return found
