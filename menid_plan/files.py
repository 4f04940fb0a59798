"""Writing files in one step: a reader, or a crash, sees the old content or the new."""

from __future__ import annotations

import errno
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

_TEMPORARY = ".menid."


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """A stream for the new content of a file, which is there when the block ends without an error.

    What is not a file, as a pipe or a device, is written to then. A new file has the usual
    permissions, an old one keeps its own; a link stays a link. OSError names ``path``, or the file
    with which something was wrong in the block.
    """
    target = resolved(path)
    special = target.exists() and not target.is_file()
    mode = stat.S_IMODE(target.stat().st_mode) if target.is_file() else 0o666 & ~_umask()
    try:
        folder = None if special else target.parent
        handle, name = tempfile.mkstemp(prefix=_TEMPORARY, dir=folder)
        try:
            with os.fdopen(handle, "wb") as stream:
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
            if special:
                with target.open("wb") as pipe, open(name, "rb") as written:
                    pipe.writelines(written)
            else:
                os.chmod(name, mode)
                os.replace(name, target)
        finally:
            with suppress(FileNotFoundError):
                os.unlink(name)
    except OSError as error:
        named = Path(error.filename or target)
        if named != target and not named.name.startswith(_TEMPORARY):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


def resolved(path: Path) -> Path:
    """Where a path leads to in the end; OSError for links that lead to each other."""
    try:
        return path.resolve()
    except RuntimeError as error:
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path)) from error


def replace_file(path: Path, data: bytes) -> None:
    """Write a file in one step; see `replacing`."""
    with replacing(path) as stream:
        stream.write(data)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
