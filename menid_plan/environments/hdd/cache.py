"""What took long to make, kept by its content's key in the user's cache folder."""

from __future__ import annotations

import io
import logging
import os
import zipfile
from collections.abc import Callable, Mapping
from functools import cache
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from platformdirs import user_cache_path

from menid_plan.files import replace_file

Arrays = Mapping[str, NDArray[np.generic]]

# Another folder for what is kept, for machines whose home is small or shared.
FOLDER_VARIABLE = "MENID_CACHE"


def folder() -> Path:
    """The folder of the cache."""
    chosen = os.environ.get(FOLDER_VARIABLE)
    return (Path(chosen) if chosen else user_cache_path("menid-plan")) / "hdd"


def kept(key: str, make: Callable[[], Arrays]) -> Arrays:
    """The arrays kept under a key; made, and kept from then on, if there are none that are whole.

    An entry begins with the hash of what follows: one that was cut short or changed is made anew.
    Where nothing can be written (a full disk, no rights), a warning says so, once for each reason.
    """
    path = folder() / f"{key}.npz"
    found = _read(path)
    if found is not None:
        return found
    arrays = make()
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=False, **dict(arrays))
    data = stream.getvalue()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, sha256(data).digest() + data)
    except OSError as error:
        _warn(
            f"the cache in {path.parent} can't be written ({error.strerror or error}); what it would"
            f" keep is made anew each time; {FOLDER_VARIABLE} names another folder"
        )
    return arrays


@cache
def _warn(text: str) -> None:
    """Say it once in a process."""
    logging.getLogger(__name__).warning("menid: warning: %s", text)


def _read(path: Path) -> Arrays | None:
    try:
        content = path.read_bytes()
    except OSError:
        return None
    digest, data = content[:32], content[32:]
    if sha256(data).digest() != digest:
        return None
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            return dict(arrays)
    except (ValueError, OSError, zipfile.BadZipFile):
        return None
