"""Reading a store: what it is, its experiences in order, and sums over them."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, TypeAlias

from menid_plan.experience import files
from menid_plan.experience.record import DistributionKey, Experience
from menid_plan.experience.rows import (
    Explained,
    Rows,
    check_environments,
    check_rows,
    columns_of,
    damaged,
    read_meta,
)
from menid_plan.experience.summary import Totals, add_up_counts, add_up_totals
from menid_plan.grounding.recent import Recent, Value
from menid_plan.grounding.state import GroundAction, State
from menid_plan.model.domain import Domain, Problem

_SELECT = (
    "SELECT id, environment, state, action, after, coalesce(step, test), reward, duration, seed, "
    "finished, explanation FROM experiences WHERE id > ?"
)

# Experiences that one query reads: a reader that stays in one query keeps the log from shrinking.
_CHUNK = 5000

_Row: TypeAlias = tuple[Any, ...]


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
    """What can be read of a store, whoever may write to it.

    Every row is looked at when it is opened, so that who reads one table only, and who reads all, are
    told the same of a store that is damaged.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        """For internal use: the connection is to a store of the newest version.

        ``domain`` and ``problem`` are those of the run, ``settings`` and ``seed`` what it was made
        with, ``created`` tells when, in UTC, as ISO 8601 has it.
        """
        self.path: Final = path
        self._connection = connection
        self._states: _Table[State] = _Table(lambda number: self._read("states", number))
        self._actions: _Table[GroundAction] = _Table(lambda number: self._read("actions", number))
        self._explanations: _Table[Explained] = _Table(lambda n: self._read("explanations", n))
        with files.guarded(path, "read"):
            meta = read_meta(path, dict(connection.execute("SELECT key, value FROM meta")))
            self.domain: Final[Domain] = meta["domain"]
            self.problem: Final[Problem] = meta["problem"]
            self.settings: Final[dict[str, Any]] = meta["settings"]
            self.seed: Final[int | None] = meta["seed"]
            self.created: Final[str] = meta["created"]
            found = list(connection.execute("SELECT id, name, role FROM environments ORDER BY id"))
            check_environments(path, found, self.domain)
            self._rows = Rows(self.domain, self.problem)
            check_rows(path, connection, self._rows, self._keep)
        self._environments = {name: (number, role == "target") for number, name, role in found}
        self._names: dict[int, str] = {number: name for number, name, _ in found}
        self.roles: Final[dict[str, str]] = {name: role for _, name, role in found}

    # -------------------------------------------------------------------------------------- reading

    def __len__(self) -> int:
        with files.guarded(self.path, "read"):
            return int(self._connection.execute("SELECT count(*) FROM experiences").fetchone()[0])

    def __iter__(self) -> Iterator[Experience]:
        return self._experiences(_SELECT)

    def unexplained(self) -> Iterator[Experience]:
        """The experiences that no rule explains, in order."""
        return self._experiences(f"{_SELECT} AND explanation IS NULL")

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Whatever is read inside is of one moment, though a run may go on writing."""
        with files.guarded(self.path, "read"):
            self._connection.execute("BEGIN")
        try:
            yield
        finally:
            self._connection.rollback()

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
                # Rows were looked at before: somebody has changed them since.
                raise damaged(self.path, "rows that belong together do not fit") from error

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

    def _keep(self, table: str, number: int, value: Any) -> None:
        """Remember a row that was read."""
        tables: dict[str, _Table[Any]] = {
            "states": self._states, "actions": self._actions, "explanations": self._explanations,
        }  # fmt: skip
        tables[table][number] = value

    def _read(self, table: str, number: int) -> Any:
        query = f"SELECT {columns_of(table)} FROM {table} WHERE id = ?"  # noqa: S608 - own names
        cells = self._connection.execute(query, (number,)).fetchone()
        return self._rows.read(table, cells)
