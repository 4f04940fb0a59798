"""Reading a store: what it is, its experiences in order, and sums over them."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, Final, TypeAlias

from menid_plan.experience import codec, files
from menid_plan.experience.record import DistributionKey, Experience, Explanation
from menid_plan.experience.schema import StoreInputError
from menid_plan.experience.summary import Totals, add_up_counts, add_up_totals
from menid_plan.grounding.recent import Recent
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


class _Values(Recent[int, Any]):
    SIZE = 100_000


class StoreReader:
    """What can be read of a store, whoever may write to it."""

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        """For internal use: the connection is to a store of the newest version."""
        self.path: Final = path
        self._connection = connection
        self._read: dict[str, _Values] = {}
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
            found = add_up_counts(pairs, lambda number: self._value("explanations", number))
        return {(self._names[number], key): sums for (number, key), sums in found.items()}

    def totals(self) -> dict[str, Totals]:
        """By environment of the domain, how much was done there, seconds and rewards in order."""
        query = "SELECT environment, duration, reward, explanation FROM experiences ORDER BY id"
        with self._reading():
            rows = self._connection.execute(query)
            found = add_up_totals(rows, lambda number: self._value("explanations", number))
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
                (self._names[environment], self._value("actions", action)): number
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
        return number, Experience(
            environment=self._names[environment],
            state=self._value("states", state),
            action=self._value("actions", action),
            after=self._value("states", after),
            reward=reward,
            duration=duration,
            seed=int(seed),
            when=finished,
            explanation=None
            if explanation is None
            else self._value("explanations", explanation)[1],
            number=counter,
        )

    def _value(self, table: str, number: int) -> Any:
        """The state or action of a number; of an explanation, it and its distribution before it."""
        known = self._read.setdefault(table, _Values())
        if number not in known:
            known[number] = self._value_read(table, number)
        return known[number]

    def _value_read(self, table: str, number: int) -> State | GroundAction | _Explained:
        row = self._connection.execute(
            f"SELECT * FROM {table} WHERE id = ?",  # noqa: S608 - one of our names
            (number,),
        ).fetchone()
        if table == "states":
            return codec.state_of(row[1])
        if table == "actions":
            return codec.action_of(row[1])
        explanation = codec.explanation_of(*row[2:])
        return DistributionKey(row[1], explanation.rule, explanation.values), explanation
