"""The store: a file that keeps what was seen in one run, batch by batch.

It is an SQLite database with a log (WAL). A process that ends at any point, be it by a kill, loses at
most the batch that it was adding. One process writes, others may read at the same time.
"""

from __future__ import annotations

import hashlib
import json
import math
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, closing
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import Any, TypeAlias

from menid_plan.experience import codec, files, schema
from menid_plan.experience.reading import StoreReader
from menid_plan.experience.record import Experience
from menid_plan.experience.sameness import difference, difference_for_experiences
from menid_plan.experience.schema import StoreError, StoreInputError
from menid_plan.experience.summary import Totals
from menid_plan.grounding.recent import Recent
from menid_plan.language.write import write
from menid_plan.model.domain import Domain, Problem

__all__ = ["AlreadyThereError", "Store", "StoreError", "StoreInputError", "Totals"]

_INSERT = (
    "INSERT OR IGNORE INTO experiences (environment, state, action, after, step, test, reward, "
    "duration, seed, finished, explanation) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"
)

# Rows that one statement inserts.
_BATCH = 5000

_Row: TypeAlias = tuple[Any, ...]


class AlreadyThereError(StoreInputError):
    """An experience is there already and was another; ``index`` is its place among those added."""

    def __init__(self, message: str, index: int) -> None:
        super().__init__(message)
        self.index = index


class _Ids(Recent[Any, int]):
    SIZE = 100_000


class Store(StoreReader):
    """The experiences of one run, in the order in which they were added.

    Made by `create`, `resume` or `read`. Everything that it does raises StoreError if the file cannot
    be used (full disk, no rights, another writer) and StoreInputError, which is one, if the file is no
    store, is damaged, or belongs to something else. Use it in one thread, and do not use it in a
    process forked from the one that opened it.
    """

    def __init__(
        self, path: Path, connection: sqlite3.Connection, lock: sqlite3.Connection | None
    ) -> None:
        """For internal use: the connection is to a store of the newest version."""
        super().__init__(path, connection)
        self._lock = lock
        self._known: dict[str, _Ids] = {}

    # -------------------------------------------------------------------------------------- opening

    @classmethod
    def create(
        cls,
        path: str | Path,
        domain: Domain,
        problem: Problem,
        *,
        settings: Mapping[str, Any] | None = None,
        seed: int | None = None,
        resume: bool = False,
    ) -> Store:
        """Make a store and open it for writing.

        ``settings`` (of whatever JSON can hold) and ``seed`` are kept for who reads it. If there is one
        already, ``resume`` goes on with it, whose settings and seed stay; otherwise that is an error.
        """
        path = Path(path)
        meta = _meta_of(domain, problem, settings or {}, seed)
        roles = {e.name: e.role for e in domain.all_environments}
        _look_at(path, may_be_empty=True, may_exist=resume)

        def fill(connection: sqlite3.Connection) -> None:
            schema.create(connection, meta, roles)

        return cls._open(path, domain, problem, fill)

    @classmethod
    def resume(
        cls, path: str | Path, domain: Domain | None = None, problem: Problem | None = None
    ) -> Store:
        """Open an existing store for writing; one of an older version is brought to the newest.

        With a domain or problem: StoreInputError unless it is the store's.
        """
        path = Path(path)
        if not path.is_file():
            raise StoreInputError(f"there is no store `{path}`")
        _look_at(path)
        return cls._open(path, domain, problem)

    @classmethod
    def _open(
        cls,
        path: Path,
        domain: Domain | None,
        problem: Problem | None,
        fill: Callable[[sqlite3.Connection], None] | None = None,
    ) -> Store:
        """Open for writing; ``fill`` makes the tables where there are none."""
        with ExitStack() as opened:
            lock = opened.enter_context(closing(files.lock(path)))
            connection = opened.enter_context(closing(files.open_writing(path)))
            with files.guarded(path, "open"):
                if fill is not None and schema.is_empty(connection):
                    fill(connection)
                version = schema.version_of(connection, str(path))
                fault = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
                if fault != "ok":
                    raise StoreInputError(f"the store `{path}` is damaged: {fault}")
                files.keep_log(connection)
                if version < schema.VERSION:
                    schema.migrate(connection, version, str(path))
            store = cls(path, connection, lock)
            store.must_be_of(domain, problem)
            opened.pop_all()
        return store

    @classmethod
    def read(cls, path: str | Path) -> Store:
        """Open an existing store for reading only; what is added meanwhile may be seen.

        One of an older version is migrated in memory, and stays as it is on the disk.
        """
        path = Path(path)
        connection = files.open_reading(path)
        try:
            with files.guarded(path, "read"):
                version = schema.version_of(connection, str(path))
                if version < schema.VERSION:
                    copy = sqlite3.connect(":memory:", isolation_level=None)
                    connection.backup(copy)
                    connection.close()
                    connection = copy
                    schema.migrate(connection, version, str(path))
            return cls(path, connection, None)
        except BaseException:
            connection.close()
            raise

    def close(self) -> None:
        """Let go of the file; may be called twice."""
        if self._lock is not None:
            files.drop_log(self._connection)
        self._connection.close()
        if self._lock is not None:
            self._lock.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def must_be_of(self, domain: Domain | None, problem: Problem | None) -> None:
        """Refuse another domain or problem; comments and layout do not count."""
        if domain is not None:
            self._refuse("domain", domain, difference(self.domain, domain))
        if problem is not None:
            self._refuse("problem", problem, difference(self.problem, problem))

    def must_suit(self, domain: Domain, problem: Problem | None = None) -> None:
        """Refuse a domain in which the experiences mean something else, and another problem.

        Probabilities and counts may be others, as in a domain with what was learned; see
        `sameness.difference_for_experiences`.
        """
        self._refuse("domain", domain, difference_for_experiences(self.domain, domain))
        self.must_be_of(None, problem)

    def _refuse(self, kind: str, given: Domain | Problem, why: str) -> None:
        own = self.domain if kind == "domain" else self.problem
        if why:
            raise StoreInputError(
                f"`{self.path}` is a store of another {kind}: of `{own.name}`, not of this "
                f"`{given.name}`; {why}"
            )

    # --------------------------------------------------------------------------------------- adding

    def add(self, experiences: Iterable[Experience]) -> int:
        """Add experiences, all or none, and keep them for good; how many were new.

        One that is there already (by the step of the run in the target environment, by environment,
        action and number in a test environment) is left out if it is the same, and StoreInputError if
        it went from or to another state or had another seed. ValueError if a number in one is negative
        or not finite where it must not be, or the domain and problem have no such environment, action,
        atom or rule.
        """
        if self._lock is None:
            raise StoreError(f"the store `{self.path}` is open for reading only")
        with files.guarded(self.path, "write to"):
            self._connection.execute("BEGIN IMMEDIATE")
            new = begin = 0
            try:
                for batch in _batches(map(self._row, experiences)):
                    added = self._connection.executemany(_INSERT, batch).rowcount
                    if added < len(batch):
                        self._must_be_same(batch, begin)
                    new += added
                    begin += len(batch)
                self._connection.execute("COMMIT")
            except BaseException:
                self._known.clear()  # some of these rows will not be there
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise
        return new

    def _row(self, experience: Experience) -> _Row:
        found = self._environments.get(experience.environment)
        if found is None:
            raise ValueError(f"the store has no environment `{experience.environment}`")
        environment, is_target = found
        number, reward, explanation = experience.number, experience.reward, experience.explanation
        if number < 0:
            raise ValueError(f"an experience has the number {number}; they begin with 0")
        if not (experience.duration >= 0.0 and math.isfinite(experience.duration)):
            raise ValueError(f"an experience has the duration {experience.duration}")
        if not (math.isfinite(experience.when) and (reward is None or math.isfinite(reward))):
            raise ValueError(f"an experience has reward {reward} and ended at {experience.when}")
        action = experience.action
        return (
            environment,
            self._id("states", experience.state),
            self._id("actions", action),
            self._id("states", experience.after),
            int(number) if is_target else None,
            None if is_target else int(number),
            None if reward is None else float(reward),
            float(experience.duration),
            codec.seed_column(experience.seed),
            float(experience.when),
            None if explanation is None else self._id("explanations", (action.action, explanation)),
        )

    def _id(self, table: str, value: Any) -> int:
        """The number of a state, action or explanation, which is added if it is not there."""
        cells: tuple[str, ...]
        known = self._known.setdefault(table, _Ids())
        found = known.get(value)
        if found is None:
            self._must_be_readable(table, value)
            if table == "states":
                columns, cells = "atoms", (codec.atoms_column(value),)
            elif table == "actions":
                columns, cells = "text", (str(value),)
            else:
                columns = "action, rule, per, weights"
                cells = codec.explanation_columns(*value)
            found = known[value] = self._intern(table, columns, cells)
        return found

    def _must_be_readable(self, table: str, value: Any) -> None:
        """ValueError, unless what is written will be read back."""
        try:
            if table == "states":
                self._rows.check_state(value)
            elif table == "actions":
                self._rows.check_action(value)
            else:
                self._rows.check_explanation(*value)
        except ValueError as error:
            raise ValueError(f"what is to be stored is no experience: {error}") from None

    def _intern(self, table: str, columns: str, cells: tuple[str, ...]) -> int:
        marks = ", ".join("?" * len(cells))
        cursor = self._connection.execute(
            f"INSERT OR IGNORE INTO {table} ({columns}) VALUES ({marks})",  # noqa: S608 - own names
            cells,
        )
        if cursor.rowcount == 1 and cursor.lastrowid is not None:
            return cursor.lastrowid
        where = f"SELECT id FROM {table} WHERE ({columns}) = ({marks})"  # noqa: S608
        return int(self._connection.execute(where, cells).fetchone()[0])

    def _must_be_same(self, rows: Iterable[_Row], begin: int) -> None:
        """Compare rows, ``begin`` being the place of the first, with those that stand there."""
        columns = "SELECT environment, state, action, after, seed FROM experiences WHERE "
        for index, row in enumerate(rows, begin):
            environment, _, action, _, step, test = row[:6]
            key: tuple[int, ...]
            if step is not None:
                where, key = "step = ?", (step,)
                what = f"step {step}"
            else:
                where, key = (
                    "environment = ? AND action = ? AND test = ?",
                    (environment, action, test),
                )
                what = f"test {test} of `{self._actions[action]}`"
            there = self._connection.execute(columns + where, key).fetchone()
            if there != (*row[:4], row[8]):
                raise AlreadyThereError(
                    f"the store `{self.path}` has {what} in `{self._names[environment]}` already, "
                    "and there its action, states or seed were others",
                    index,
                )


def _look_at(path: Path, *, may_be_empty: bool = False, may_exist: bool = True) -> None:
    """Refuse a file that is no store before anything is made beside it."""
    if not path.exists():
        return
    with closing(files.open_reading(path)) as connection, files.guarded(path, "open"):
        if may_be_empty and schema.is_empty(connection):
            return
        schema.version_of(connection, str(path))
    if not may_exist:
        raise StoreInputError(f"there is a store `{path}` already; resume it, or give another name")


def _batches(rows: Iterable[_Row]) -> Iterator[list[_Row]]:
    rows = iter(rows)
    while batch := list(islice(rows, _BATCH)):
        yield batch


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def _meta_of(
    domain: Domain, problem: Problem, settings: Mapping[str, Any], seed: int | None
) -> dict[str, str]:
    domain_text, problem_text = write(domain), write(problem)
    return {
        "domain": domain_text,
        "domain_hash": _hash(domain_text),
        "problem": problem_text,
        "problem_hash": _hash(problem_text),
        "settings": json.dumps(dict(settings), sort_keys=True),
        "seed": json.dumps(None if seed is None else int(seed)),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
    }
