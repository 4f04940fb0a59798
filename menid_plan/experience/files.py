"""Opening a store's file: for one writer or for readers, and what SQLite's errors mean to a user."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from menid_plan.experience.schema import StoreError, StoreInputError

_MEANINGS = {
    "SQLITE_FULL": "the disk is full",
    "SQLITE_IOERR": "the disk is full or fails",
    "SQLITE_READONLY": "it may not be written to",
    "SQLITE_CANTOPEN": "it cannot be opened",
    "SQLITE_BUSY": "another program keeps it locked",
    "SQLITE_PERM": "it may not be used",
}


@contextmanager
def guarded(path: Path, doing: str) -> Iterator[None]:
    """Turn SQLite's errors into StoreError, which says what could not be done and why."""
    try:
        yield
    except sqlite3.Error as error:
        code = getattr(error, "sqlite_errorname", "")
        if code.startswith("SQLITE_NOTADB"):
            raise StoreInputError(f"`{path}` is no store of experiences") from error
        # Tables that are not ours any more.
        if code == "SQLITE_ERROR" or "decode to UTF-8" in str(error):
            raise StoreInputError(
                f"cannot {doing} the store `{path}`, which is damaged: {error}"
            ) from error
        if code.startswith("SQLITE_CORRUPT"):
            raise StoreInputError(f"the store `{path}` is damaged: {error}") from error
        why = next((text for key, text in _MEANINGS.items() if code.startswith(key)), "")
        detail = f"{why} ({error})" if why else str(error)
        raise StoreError(f"cannot {doing} the store `{path}`: {detail}") from error


def lock(path: Path) -> sqlite3.Connection:
    """Become the one writer of a store, until the connection is closed or the process ends.

    The lock is on a file of its own, since one on the store itself would keep readers out or be let
    go at every commit. It is SQLite's, which works wherever the store does, and which processes that
    are forked from this one do not inherit: workers that outlive a run must not block the next. The
    file stays: who removes it may remove one that somebody else has locked meanwhile.
    """
    held = path.with_name(path.name + ".lock")
    with guarded(path, "write to"):
        connection = sqlite3.connect(held, timeout=0, isolation_level=None)
        try:
            connection.execute("BEGIN EXCLUSIVE")
        except sqlite3.OperationalError as error:
            connection.close()
            if getattr(error, "sqlite_errorname", "").startswith("SQLITE_BUSY"):
                raise StoreError(
                    f"another process writes to the store `{path}`; a store has one writer at a time"
                ) from error
            raise
    return connection


def open_writing(path: Path) -> sqlite3.Connection:
    """A connection that may write. The file is made if it is not there."""
    return sqlite3.connect(path, timeout=30, isolation_level=None)


def keep_log(connection: sqlite3.Connection) -> None:
    """Write through a log beside the file, which readers may read past.

    What is committed survives the end of the process at any point. A power cut may take the last
    commits, since only every checkpoint waits for the disk, but damages nothing.
    """
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = NORMAL")


def drop_log(connection: sqlite3.Connection) -> None:
    """Bring the log into the file and remove it, unless somebody reads: a store at rest is one file."""
    with suppress(sqlite3.Error):
        connection.execute("PRAGMA busy_timeout = 0")
        connection.execute("PRAGMA journal_mode = DELETE")


def open_reading(path: Path) -> sqlite3.Connection:
    """A connection that writes nothing."""
    if not path.is_file():
        raise StoreInputError(f"there is no store `{path}`")
    where = path.resolve().as_uri()
    with guarded(path, "read"):
        connection = sqlite3.connect(f"{where}?mode=ro", uri=True, isolation_level=None)
        try:
            connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
        except sqlite3.OperationalError:
            connection.close()
            # Where no file can be made beside the store, as on a read-only disk, SQLite cannot share
            # it; but nobody can write to it there either. A log that was left is needed, though.
            if path.with_name(path.name + "-wal").exists():
                raise
            connection = sqlite3.connect(f"{where}?immutable=1", uri=True, isolation_level=None)
            connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    return connection
