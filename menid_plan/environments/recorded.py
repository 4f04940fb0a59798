"""An environment that gives again what was seen before: an outcome bank."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from menid_plan.environments.atoms import Vocabulary
from menid_plan.environments.interface import (
    Capabilities,
    EnvironmentFailedError,
    Execution,
    NotRecordedError,
)
from menid_plan.environments.registry import Place
from menid_plan.environments.settings import SettingError
from menid_plan.errors import MeaningError
from menid_plan.experience.store import Store
from menid_plan.grounding.state import GroundAction, State, state_text

_Bank = dict[tuple[State, GroundAction], list[Execution]]

# The store in the folder of a run.
_STORE = "experiences.sqlite"

# A line of a bank in JSON longer than this is refused.
_MAX_LINE = 16 * 2**20


@dataclass(frozen=True, slots=True)
class Recorded:
    """Draws, with equal chances, one of the experiences of this action in this very state.

    ``store`` is a file of experiences, the folder of a run, or a file that ends in ``.jsonl`` with an
    experience on each line:
    an object with ``state`` and ``after`` (lists of atoms), ``action``, and perhaps ``reward``,
    ``duration`` in seconds and ``environment``. ``environment`` says whose experiences count, by
    default those of the same name. An action in a state that was never seen is a failure.
    """

    name: ClassVar[str] = "recorded"
    promise: ClassVar[str] = "draws from the experiences of a store, or of a file in JSON lines"
    needs: ClassVar[str] = ""

    store: str
    environment: str = ""

    def build(self, place: Place) -> RecordedEnvironment:
        """Read the bank; SettingError if there is no such file, or nothing of use in it."""
        path = place.folder / self.store
        if path.is_dir():
            path = path / _STORE
        environment = self.environment or place.name
        if not path.is_file():
            raise SettingError("store", f"there is no file `{path}`")
        vocabulary = Vocabulary(place.domain, place.problem)
        bank: _Bank = {}
        if path.suffix == ".jsonl":
            found = _from_lines(path, environment, vocabulary)
        else:
            found = _from_store(path, environment)
        for state, action, execution in found:
            try:
                vocabulary.check(state)
                vocabulary.check(execution.state)
            except MeaningError as error:
                raise SettingError("store", f"{path}: {error}") from error
            bank.setdefault((state, action), []).append(execution)
        if not bank:
            raise SettingError(
                "store", f"`{path}` has no experiences of environment `{environment}`"
            )
        return RecordedEnvironment(bank, frozenset(place.problem.init))


def _from_store(path: Path, environment: str) -> Iterator[tuple[State, GroundAction, Execution]]:
    with Store.read(path) as store:
        for seen in store:
            if seen.environment == environment:
                yield seen.state, seen.action, Execution(seen.after, seen.reward, seen.duration)


def _from_lines(
    path: Path, environment: str, vocabulary: Vocabulary
) -> Iterator[tuple[State, GroundAction, Execution]]:
    with path.open("rb") as file:
        for number, line in enumerate(iter(lambda: file.readline(_MAX_LINE), b""), start=1):
            if not line.strip():
                continue
            try:
                row = json.loads(line)
                if row.get("environment", environment) != environment:
                    continue
                action = vocabulary.action(row["action"])
                execution = Execution(
                    _atoms(row["after"], vocabulary),
                    _number(row.get("reward")),
                    _number(row.get("duration")),
                )
                yield _atoms(row["state"], vocabulary), action, execution
            except KeyError as error:
                raise SettingError("store", f"{path}:{number}: {error} is missing") from error
            except (MeaningError, ValueError, TypeError, AttributeError, RecursionError) as error:
                raise SettingError("store", f"{path}:{number}: {error}") from error


def _atoms(texts: Iterable[str], vocabulary: Vocabulary) -> State:
    if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
        raise ValueError("a state is a list of texts, one for each atom")
    return vocabulary.state(texts)


def _number(value: float | None) -> float | None:
    return None if value is None else float(value)


class RecordedEnvironment:
    """Experiences by what they are experiences of."""

    def __init__(self, bank: Mapping[tuple[State, GroundAction], list[Execution]], first: State):
        self._bank = bank
        self._first = self._state = first
        self._rng: np.random.Generator | None = None
        self.size = sum(map(len, bank.values()))

    @property
    def capabilities(self) -> Capabilities:
        """It can do all; the note tells how large it is."""
        pairs = len(self._bank)
        return Capabilities(note=f"{self.size} experiences of {pairs} pairs of state and action")

    def reset(self, state: State | None, seed: int) -> State:
        """Put it into a state (None: that of ``init``)."""
        self._state = self._first if state is None else state
        self._rng = np.random.default_rng(seed)
        return self._state

    def execute(self, action: GroundAction) -> Execution:
        """One of the experiences; EnvironmentFailedError if there is none."""
        if self._rng is None:
            raise EnvironmentFailedError("it was not reset")
        seen = self._bank.get((self._state, action))
        if seen is None:
            raise NotRecordedError(
                f"nothing was recorded of `{action}` in the state {state_text(self._state)}"
            )
        drawn = seen[int(self._rng.integers(len(seen)))]
        self._state = drawn.state
        return drawn

    def state(self) -> State:
        """The state that it is in."""
        return self._state

    def close(self) -> None:
        """There is nothing to let go of."""
