"""Reading a store: what it is, its experiences in order, and sums over them."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, Final, TypeAlias

from menid_plan.experience import codec, files
from menid_plan.experience.record import DistributionKey, Experience, Explanation
from menid_plan.experience.schema import StoreInputError
from menid_plan.experience.summary import Totals, add_up_counts, add_up_totals
from menid_plan.grounding.recent import Recent, Value
from menid_plan.grounding.state import GroundAction, State
from menid_plan.language.files import parse_text
from menid_plan.model.domain import Domain, Problem

_SELECT = (
    "SELECT id, environment, state, action, after, coalesce(step, test), reward, duration, seed, "
    "finished, explanation FROM experiences WHERE id > ?"
)

# Experiences that one query reads: a reader that stays in one query keeps the log from shrinking.
_CHUNK = 5000

_Row: TypeAlias = tuple[Any, ...]
_Explained: TypeAlias = tuple[DistributionKey, Explanation]


class _Table(Recent[int, Value]):
    """The values of a table by their numbers, each read when it is first asked for."""

    SIZE = 100_000

    def __init__(self, read: Callable[[int], Value]) -> None:
        super().__init__()
        self._value_of = read

    def __missing__(self, number: int) -> Value:
        self[number] = value = self._value_of(number)
        return value


class StoreReader:
    """What can be read of a store, whoever may write to it."""

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        """For internal use: the connection is to a store of the newest version."""
        self.path: Final = path
        self._connection = connection
        self._states: _Table[State] = _Table(self._state)
        self._actions: _Table[GroundAction] = _Table(self._action)
        self._explanations: _Table[_Explained] = _Table(self._explained)
        with files.guarded(path, "read"):
            self._meta: dict[str, str] = dict(connection.execute("SELECT key, value FROM meta"))
            found = list(connection.execute("SELECT id, name, role FROM environments ORDER BY id"))
        self._environments = {name: (number, role == "target") for number, name, role in found}
        self._names: dict[int, str] = {number: name for number, name, _ in found}
        self.roles: Final[dict[str, str]] = {name: role for _, name, role in found}

    # ----------------------------------------------------------------------------------- what it is

    @cached_property
    def domain(self) -> Domain:
        """The domain of the run, read from its text."""
        found = parse_text(self._meta["domain"], name=f"{self.path}: domain").domain
        assert found is not None
        return found

    @cached_property
    def problem(self) -> Problem:
        """The problem of the run."""
        text = self._meta["problem"]
        found = parse_text(text, self.domain, name=f"{self.path}: problem").problem
        assert found is not None
        return found

    @property
    def settings(self) -> dict[str, Any]:
        """The settings that it was made with."""
        found: dict[str, Any] = json.loads(self._meta["settings"])
        return found

    @property
    def seed(self) -> int | None:
        """The seed of the run."""
        found: int | None = json.loads(self._meta["seed"])
        return found

    @property
    def created(self) -> str:
        """When it was made, in UTC, as ISO 8601 has it."""
        return self._meta["created"]

    # -------------------------------------------------------------------------------------- reading

    def __len__(self) -> int:
        with files.guarded(self.path, "read"):
            return int(self._connection.execute("SELECT count(*) FROM experiences").fetchone()[0])

    def __iter__(self) -> Iterator[Experience]:
        return self._experiences(_SELECT)

    def unexplained(self) -> Iterator[Experience]:
        """The experiences that no rule explains, in order."""
        return self._experiences(f"{_SELECT} AND explanation IS NULL")

    def counts(self) -> dict[tuple[str, DistributionKey], tuple[float, ...]]:
        """By environment and distribution, how often each outcome was seen, noise last.

        They are added up in the order of the experiences: to the last bit what a caller has who adds
        the weights of each to floats as it comes.
        """
        query = (
            "SELECT environment, explanation FROM experiences WHERE explanation IS NOT NULL "
            "ORDER BY id"
        )
        with self._reading():
            pairs = self._connection.execute(query)
            found = add_up_counts(pairs, self._explanations.__getitem__)
        return {(self._names[number], key): sums for (number, key), sums in found.items()}

    def totals(self) -> dict[str, Totals]:
        """By environment of the domain, how much was done there, seconds and rewards in order."""
        query = "SELECT environment, duration, reward, explanation FROM experiences ORDER BY id"
        with self._reading():
            rows = self._connection.execute(query)
            found = add_up_totals(rows, self._explanations.__getitem__)
        return {
            name: found.get(number, Totals()) for name, (number, _) in self._environments.items()
        }

    def next_step(self) -> int:
        """The step that the run takes next in the target environment: one more than the last."""
        query = "SELECT coalesce(max(step) + 1, 0) FROM experiences WHERE step IS NOT NULL"
        with files.guarded(self.path, "read"):
            return int(self._connection.execute(query).fetchone()[0])

    def next_tests(self) -> dict[tuple[str, GroundAction], int]:
        """By test environment and action, the number of its next test, for those tested at all."""
        query = (
            "SELECT environment, action, max(test) + 1 FROM experiences WHERE test IS NOT NULL "
            "GROUP BY environment, action"
        )
        with self._reading():
            return {
                (self._names[environment], self._actions[action]): number
                for environment, action, number in self._connection.execute(query)
            }

    @contextmanager
    def _reading(self) -> Iterator[None]:
        with files.guarded(self.path, "read"):
            try:
                yield
            except (KeyError, TypeError, ValueError) as error:
                raise StoreInputError(f"the store `{self.path}` is damaged: {error!r}") from error

    def _experiences(self, query: str) -> Iterator[Experience]:
        last = 0
        while True:
            with self._reading():
                rows = self._connection.execute(f"{query} ORDER BY id LIMIT {_CHUNK}", (last,))
                found = [self._experience(row) for row in rows.fetchall()]
            if not found:
                return
            last = found[-1][0]
            for _, experience in found:
                yield experience

    def _experience(self, row: _Row) -> tuple[int, Experience]:
        (number, environment, state, action, after, counter, reward, duration, seed, finished,
         explanation) = row  # fmt: skip
        states = self._states
        return number, Experience(
            self._names[environment], states[state], self._actions[action], states[after], reward,
            duration, int(seed), finished,
            None if explanation is None else self._explanations[explanation][1], counter,
        )  # fmt: skip

    def _state(self, number: int) -> State:
        return codec.state_of(self._row_of("atoms FROM states", number)[0])

    def _action(self, number: int) -> GroundAction:
        return codec.action_of(self._row_of("text FROM actions", number)[0])

    def _explained(self, number: int) -> _Explained:
        """An explanation, and before it the distribution that it is evidence for."""
        row = self._row_of("action, rule, per, weights FROM explanations", number)
        explanation = codec.explanation_of(*row[1:])
        return DistributionKey(row[0], explanation.rule, explanation.values), explanation

    def _row_of(self, columns: str, number: int) -> _Row:
        query = f"SELECT {columns} WHERE id = ?"
        found: _Row = self._connection.execute(query, (number,)).fetchone()
        return found
