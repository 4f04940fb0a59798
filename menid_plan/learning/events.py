"""`events.jsonl`: what happened to a run that no experience tells of.

A line is an object with ``event``, ``when`` (seconds since 1970) and more. What is needed to resume
stands here as well: executions that were given up, since another attempt might succeed and the run go
on otherwise than it did, episodes that could not be gone on with, and what was decided by someone
who may decide otherwise the next time.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal, TypeAlias

from menid_plan.grounding.state import GroundAction

Reason: TypeAlias = Literal["failed", "cannot-reset"]
"""Why a test was given up: every attempt failed, or the environment can't be put into the state."""


Limits: TypeAlias = Mapping[str, float]
"""When a run is to end: ``steps``, ``episodes``, ``hours``, those that are given."""


def told_events(path: Path) -> Iterator[dict[str, Any]]:
    """What a file tells, in order; nothing if there is none. Lines that are no events are left out."""
    data = path.read_bytes() if path.exists() else b""
    for line in data.decode("utf-8", "replace").splitlines():
        with suppress(ValueError, RecursionError):
            event = json.loads(line)
            if isinstance(event, dict) and isinstance(event.get("event"), str):
                yield event


class Events:
    """The events of a run, those that were there already read.

    ``failed`` counts attempts at executions by environment that came to nothing. ``decisions`` has what
    was decided, by the number of the decision. ``limits`` says when the run was to end, and how many
    experiences it had, each time that it was begun or gone on with.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.failed: Counter[str] = Counter()
        self.decisions: dict[int, GroundAction | None] = {}
        self.limits: list[tuple[int, Limits]] = []
        self._given_up: dict[tuple[str, str, int], Reason] = {}
        self._broken_off: Counter[int] = Counter()
        if path.exists():
            data = path.read_bytes()
            whole = data[: data.rfind(b"\n") + 1]
            if whole != data:  # a line that a kill has cut
                with path.open("r+b") as file:
                    file.truncate(len(whole))
            for line in whole.decode("utf-8", "replace").splitlines():
                self._read(line)

    def _read(self, line: str) -> None:
        try:
            event = json.loads(line)
            match event["event"]:
                case "failure":
                    self.failed[event["environment"]] += 1
                case "given up":
                    key = event["environment"], event["action"], event["number"]
                    self._given_up[key] = event["reason"]
                case "decided":
                    found = event["action"]
                    if found is not None:
                        name, arguments = found
                        found = GroundAction(str(name), tuple(map(str, list(arguments))))
                    self.decisions[event["number"]] = found
                case "starts" | "resumes":
                    limits = {str(k): float(v) for k, v in event["limits"].items() if v is not None}
                    self.limits.append((int(event["stored"]), limits))
                case "broken off":
                    self._broken_off[event["step"]] += 1
        except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
            return  # whoever wrote it, it was not this program

    def write(self, event: str, **more: Any) -> None:
        """Note an event at once; raises OSError."""
        line = json.dumps({"event": event, "when": time.time(), **more})
        with self._path.open("a", encoding="utf-8", newline="\n") as file:
            file.write(line + "\n")

    def given_up(self, environment: str, action: GroundAction, number: int) -> Reason | None:
        """Whether, and why, a test was given up before the run was resumed."""
        return self._given_up.get((environment, str(action), number))

    def was_broken_off(self, step: int) -> bool:
        """Whether the episode was broken off before this step, each time that it was once."""
        if self._broken_off[step] == 0:
            return False
        self._broken_off[step] -= 1
        return True
