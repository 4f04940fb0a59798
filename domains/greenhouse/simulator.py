"""The greenhouse as a program of its own: an example of an environment in Python.

It speaks the protocol of docs/environments.md and knows nothing of menid-plan. The probabilities of
the domain are nowhere in it: what happens follows from how far the wheels slip and how much water
reaches the pot.
"""

import json
import os
import random
import sys

# Only answers may go to standard output; what libraries print there is sent to standard error.
answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
os.dup2(2, 1)


class Greenhouse:
    """Where the robot is, which pots are dry, and whether there is water in the can."""

    def __init__(self, hello: dict) -> None:
        self.slip = hello["options"].get("slip", 0.15)
        self.pots = {name for name, o in hello["objects"].items() if "pot" in o["types"]}
        self.first = hello["init"]
        self.reset(self.first, 0)

    def reset(self, atoms: list[str] | None, seed: int) -> None:
        """Take over a state; None is the first one of this environment."""
        self.atoms = set(self.first if atoms is None else atoms)
        self.random = random.Random(seed)  # noqa: S311

    @property
    def place(self) -> str:
        """The place of the atom at(PLACE)."""
        return next(atom[3:-1] for atom in self.atoms if atom.startswith("at("))

    def execute(self, action: str, arguments: list[str]) -> float:
        """Change the state; the seconds that it takes."""
        return getattr(self, action)(*arguments)

    def drive(self, to: str) -> float:
        """The wheels may slip so far that the robot stays where it is."""
        if self.random.gauss(1, self.slip) > 0.6:
            self.atoms -= {f"at({self.place})"}
            self.atoms |= {f"at({to})"}
        return 8.0

    def fill(self) -> float:
        """The can is full afterwards."""
        self.atoms |= {"full"}
        return 5.0

    def pour(self) -> float:
        """The plant needs most of the water; the rest may miss the pot."""
        if "full" in self.atoms and self.place in self.pots:
            self.atoms -= {"full"}
            if self.random.gauss(0.9, 0.1) > 0.75:
                self.atoms -= {f"dry({self.place})"}
        return 3.0


def main() -> None:
    """Answer each line with a line."""
    greenhouse = None
    for line in sys.stdin:
        request = json.loads(line)
        kind = request["type"]
        answer = {"type": "state"}
        if kind == "close":
            break
        if kind == "hello":
            greenhouse = Greenhouse(request)
            answer = {"type": "hello", "protocol": 1, "name": "greenhouse in Python"}
        elif kind == "reset":
            greenhouse.reset(request["state"], request["seed"])
        elif kind == "execute":
            seconds = greenhouse.execute(request["action"], request["arguments"])
            answer = {"type": "execution", "duration": seconds}
        if kind != "hello":
            answer["state"] = sorted(greenhouse.atoms)
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main()
