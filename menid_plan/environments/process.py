"""An environment that is a program in any language, spoken to in lines of JSON.

The protocol is written down for users in docs/environments.md.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, NoReturn

from menid_plan.environments.atoms import Vocabulary, state_texts
from menid_plan.environments.interface import (
    CannotResetError,
    Capabilities,
    EnvironmentFailedError,
    Execution,
)
from menid_plan.environments.program import Program, quoted
from menid_plan.environments.registry import Place
from menid_plan.environments.settings import SettingError
from menid_plan.errors import MeaningError
from menid_plan.grounding.state import GroundAction, State

PROTOCOL = 1


@dataclass(frozen=True, slots=True)
class Process:
    """Runs a program and speaks with it in lines of JSON on its standard streams.

    ``command`` is the program and its arguments; ``{python}`` as the program is the Python that runs
    menid. It is started without a shell in ``folder``, by default that of the run file, where a program
    given with a path is looked for too.
    ``options`` are handed to the program when it starts: whatever TOML can write.
    """

    name: ClassVar[str] = "process"
    promise: ClassVar[str] = "a program in any language: lines of JSON on its standard streams"
    needs: ClassVar[str] = ""

    command: tuple[str, ...]
    folder: str = "."
    options: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.command or not self.command[0]:
            raise SettingError("command", "expected a program and its arguments")

    def build(self, place: Place) -> ProcessEnvironment:
        """Start the program and greet it."""
        folder = (place.folder / self.folder).resolve()
        if not folder.is_dir():
            raise SettingError("folder", f"there is no folder `{folder}`")
        program = self.command[0]
        found: str | None
        if program == "{python}":
            found = sys.executable
        elif os.path.dirname(program):
            found = str(folder / program) if (folder / program).is_file() else None
        else:
            found = shutil.which(program)
        if found is None:
            raise SettingError("command", f"there is no program `{program}`")
        try:
            greeting = _greeting(place, self.options)
        except (TypeError, ValueError) as error:
            raise SettingError("options", f"JSON can't write them: {error}") from error
        return ProcessEnvironment(
            lambda: Program((found, *self.command[1:]), folder), greeting, place
        )


def _greeting(place: Place, options: Mapping[str, object]) -> dict[str, object]:
    """The first message: what the environment is for."""
    domain, problem = place.domain, place.problem
    return {
        "type": "hello",
        "protocol": PROTOCOL,
        "domain": domain.name,
        "problem": problem.name,
        "environment": place.name,
        "objects": {
            o.name: {"types": domain.supertypes(o.type), "attributes": dict(o.attributes)}
            for o in (*domain.constants, *problem.objects)
        },
        "predicates": {p.name: len(p.arguments) for p in domain.predicates},
        "actions": {a.name: [v.name for v in a.parameters] for a in domain.actions},
        "init": state_texts(set(problem.init)),
        "options": json.loads(json.dumps(options, allow_nan=False)),
    }


class ProcessEnvironment:
    """A program behind the protocol. After a failure it is killed, and started by the next reset."""

    def __init__(self, start: Any, greeting: Mapping[str, object], place: Place) -> None:
        self._start = start
        self._greeting = greeting
        self._timeout, self._start_timeout = place.timeout, place.start_timeout
        self._vocabulary = Vocabulary(place.domain, place.problem)
        self._program: Program | None = None
        self._capabilities = Capabilities()
        self._greet()

    @property
    def capabilities(self) -> Capabilities:
        """What the program says that it can do."""
        return self._capabilities

    def _greet(self) -> Program:
        program: Program = self._start()
        self._program = program
        answer = self._ask(self._greeting, "hello", self._start_timeout)
        if answer.get("protocol") != PROTOCOL:
            self._fail(f"the program speaks protocol {answer.get('protocol')!r}, not {PROTOCOL}")
        told = answer.get("capabilities", {})
        if not isinstance(told, dict):
            self._fail("in `hello`, `capabilities` is no object")
        for key, value in told.items():
            if key not in ("reset_to_any", "repeatable", "parallel"):
                self._fail(f"in `hello`, there is no capability `{key}`")
            if not isinstance(value, bool):
                self._fail(f"in `hello`, `capabilities.{key}` is neither true nor false")
        self._capabilities = Capabilities(**told, note=str(answer.get("name", ""))[:200])
        return program

    def reset(self, state: State | None, seed: int) -> State:
        """Put it into a state."""
        if self._program is None:
            self._greet()
        atoms = None if state is None else state_texts(state)
        return self._state_of(self._ask({"type": "reset", "state": atoms, "seed": seed}, "state"))

    def execute(self, action: GroundAction) -> Execution:
        """Have the program execute an action."""
        request = {
            "type": "execute", "action": action.action, "arguments": list(action.arguments),
        }  # fmt: skip
        answer = self._ask(request, "execution")
        state = self._state_of(answer)
        reward, duration = self._number(answer, "reward"), self._number(answer, "duration")
        if duration is not None and duration < 0:
            self._fail(f"the duration of `{action}` is negative: {duration:g}")
        return Execution(state, reward, duration)

    def state(self) -> State:
        """The state that the program is in, as it sees it now."""
        return self._state_of(self._ask({"type": "state"}, "state"))

    def close(self) -> None:
        """Say goodbye; a program that does not end by itself is killed."""
        program, self._program = self._program, None
        if program is not None:
            program.tell(_line({"type": "close"}))
            program.close()

    # ---------------------------------------------------------------------------------- messages

    def _ask(
        self, request: Mapping[str, object], expected: str, timeout: float | None = None
    ) -> dict[str, Any]:
        """The answer to a message, which is of the type that is expected."""
        if self._program is None:
            raise EnvironmentFailedError("it was not reset after a failure")
        limit = self._timeout if timeout is None else timeout
        try:
            line = self._program.ask(_line(request), limit)
        except EnvironmentFailedError as error:
            self._fail(f"{error}", words=False)
        try:
            answer = json.loads(line)
        except (ValueError, RecursionError):
            answer = None
        if not isinstance(answer, dict):
            self._fail(f"no JSON object in the line {quoted(line)}")
        kind = answer.get("type")
        if kind == "error":
            message = str(answer.get("message", "no reason given"))[:1000]
            if answer.get("code") == "cannot-reset" and request["type"] == "reset":
                raise CannotResetError(message)
            self._fail(f"the program says: {message}")
        if kind != expected:
            self._fail(f"expected a message of type `{expected}`, got the line {quoted(line)}")
        return answer

    def _state_of(self, answer: Mapping[str, Any]) -> State:
        atoms = answer.get("state")
        if not isinstance(atoms, list) or not all(isinstance(atom, str) for atom in atoms):
            self._fail(f"`state` in `{answer['type']}` is no list of texts, one for each atom")
        try:
            return self._vocabulary.state(atoms)
        except MeaningError as error:
            self._fail(str(error))

    def _number(self, answer: Mapping[str, Any], key: str) -> float | None:
        value = answer.get(key)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float):
            self._fail(f"`{key}` is no number: {json.dumps(value)[:80]}")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self._fail(f"`{key}` is {number}, not a finite number")
        return number

    def _fail(self, message: str, *, words: bool = True) -> NoReturn:
        """Kill the program: what it would say next can't be relied on."""
        program, self._program = self._program, None
        if program is not None:
            if words:
                message += program.last_words()
            with contextlib.suppress(OSError):
                program.close(patience=0.0)
        raise EnvironmentFailedError(message)


def _line(message: Mapping[str, object]) -> bytes:
    return json.dumps(message, ensure_ascii=False).encode("utf-8") + b"\n"
