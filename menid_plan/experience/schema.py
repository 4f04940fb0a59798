"""The tables of a store, its versions, and how an older one becomes the newest.

Version 1 had no ``role`` in its table of environments.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Mapping

from menid_plan.errors import InputError, MenidError
from menid_plan.language.files import parse_text

APPLICATION = 0x4D454E44
"""SQLite's ``application_id`` of a store: "MEND"."""

VERSION = 2
"""SQLite's ``user_version`` of a store."""

TABLES = """
CREATE TABLE meta (
    key TEXT PRIMARY KEY,
    value TEXT NOT NULL
) WITHOUT ROWID;
CREATE TABLE environments (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE,
    role TEXT NOT NULL
);
CREATE TABLE states (
    id INTEGER PRIMARY KEY,
    atoms TEXT NOT NULL UNIQUE
);
CREATE TABLE actions (
    id INTEGER PRIMARY KEY,
    text TEXT NOT NULL UNIQUE
);
CREATE TABLE explanations (
    id INTEGER PRIMARY KEY,
    action TEXT NOT NULL,
    rule TEXT NOT NULL,
    per TEXT NOT NULL,
    weights TEXT NOT NULL,
    UNIQUE (action, rule, per, weights)
);
CREATE TABLE experiences (
    id INTEGER PRIMARY KEY,
    environment INTEGER NOT NULL REFERENCES environments,
    state INTEGER NOT NULL REFERENCES states,
    action INTEGER NOT NULL REFERENCES actions,
    after INTEGER NOT NULL REFERENCES states,
    step INTEGER,
    test INTEGER,
    reward REAL,
    duration REAL NOT NULL,
    seed NOT NULL,
    finished REAL NOT NULL,
    explanation INTEGER REFERENCES explanations
);
CREATE UNIQUE INDEX steps ON experiences (step) WHERE step IS NOT NULL;
CREATE UNIQUE INDEX tests ON experiences (environment, action, test) WHERE test IS NOT NULL;
"""


class StoreError(MenidError):
    """A store cannot be used or written: the disk is full, the file is damaged, ..."""


class StoreInputError(StoreError):
    """What was given is no store, the store of something else, or nothing that a store can take."""

    exit_code = 3


def create(
    connection: sqlite3.Connection, meta: Mapping[str, str], roles: Mapping[str, str]
) -> None:
    """Make the tables in an empty database, in one transaction; ``roles`` are the environments'."""
    connection.execute("BEGIN IMMEDIATE")
    for statement in TABLES.split(";"):
        connection.execute(statement)
    connection.executemany("INSERT INTO meta VALUES (?, ?)", sorted(meta.items()))
    connection.executemany("INSERT INTO environments (name, role) VALUES (?, ?)", roles.items())
    connection.execute(f"PRAGMA application_id = {APPLICATION}")
    connection.execute(f"PRAGMA user_version = {VERSION}")
    connection.execute("COMMIT")


def is_empty(connection: sqlite3.Connection) -> bool:
    """Whether a database has nothing in it: a new file, or one whose making was broken off."""
    return _number(connection, "SELECT count(*) FROM sqlite_master") == 0


def version_of(connection: sqlite3.Connection, name: str) -> int:
    """The version of a store; StoreInputError if it is none, or newer than this program knows."""
    if _number(connection, "PRAGMA application_id") != APPLICATION:
        raise StoreInputError(f"`{name}` is no store of experiences")
    version = _number(connection, "PRAGMA user_version")
    if version > VERSION:
        raise StoreInputError(
            f"the store `{name}` has version {version}, and this menid-plan knows none beyond "
            f"{VERSION}; a newer menid-plan reads it"
        )
    if version < 1:
        raise StoreInputError(f"the store `{name}` is damaged: it has the version {version}")
    return version


def migrate(connection: sqlite3.Connection, version: int, name: str) -> None:
    """Bring a store of an older version to the newest, in one transaction.

    Raises StoreInputError if it is damaged; nothing is changed then once the connection is closed.
    """
    connection.execute("BEGIN IMMEDIATE")
    for step in range(version, VERSION):
        try:
            _MIGRATIONS[step](connection)
        except (InputError, TypeError, AttributeError) as error:
            raise StoreInputError(
                f"the store `{name}` is damaged: it has no domain that can be read"
            ) from error
    connection.execute(f"PRAGMA user_version = {VERSION}")
    connection.execute("COMMIT")


def _add_roles(connection: sqlite3.Connection) -> None:
    """From version 1 to 2: the environments' roles, as the domain has them."""
    (text,) = connection.execute("SELECT value FROM meta WHERE key = 'domain'").fetchone()
    domain = parse_text(text).domain
    connection.execute("ALTER TABLE environments ADD COLUMN role TEXT NOT NULL DEFAULT 'test'")
    if domain is not None:
        connection.execute(
            "UPDATE environments SET role = 'target' WHERE name = ?", (domain.target,)
        )


_MIGRATIONS: dict[int, Callable[[sqlite3.Connection], None]] = {1: _add_roles}


def _number(connection: sqlite3.Connection, query: str) -> int:
    return int(connection.execute(query).fetchone()[0])
