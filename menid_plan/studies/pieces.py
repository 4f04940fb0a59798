"""Pieces of a study's work: many, in several processes, each kept as soon as it has ended."""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any, TypeAlias

from menid_plan.errors import MenidError
from menid_plan.experience.files import lock

Row: TypeAlias = dict[str, Any]
"""What came of a piece, as JSON has it."""


class RunsError(MenidError):
    """A file of runs that can't be gone on with; the message says why."""

    exit_code = 3


def done(
    work: Mapping[str, Callable[[], Row]],
    file: Path,
    origin: str,
    jobs: int,
    told: Callable[[int, int], None] = lambda *_: None,
    kept: Callable[[str], None] = lambda _: None,
) -> dict[str, Row]:
    """What comes of all pieces of work, by their names; with several ``jobs`` they are pickled.

    ``file`` has a line for each that has ended, and ``origin`` is what it must be of: what is there is
    not done again. ``told`` is called with the number of pieces that have ended, and of all, ``kept``
    with the name of one that was just written down. Raises RunsError for a file of another origin, and
    whatever a piece raises.
    """
    with lock(file):
        found = _read(file, origin)
        missing = {name: piece for name, piece in work.items() if name not in found}
        ended = len(work) - len(missing)
        told(ended, len(work))
        for name, row in _results(missing, jobs):
            line = json.dumps({"origin": origin, "name": name, **row})
            with file.open("a", encoding="utf-8") as stream:
                stream.write(line + "\n")
            found[name] = {"name": name, **row}
            kept(name)
            ended += 1
            told(ended, len(work))
    return {name: found[name] for name in work}


def _results(missing: Mapping[str, Callable[[], Row]], jobs: int) -> Iterable[tuple[str, Row]]:
    if jobs == 1 or not missing:
        for name, piece in missing.items():
            yield name, piece()
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, context) as pool:
        futures = {pool.submit(piece): name for name, piece in missing.items()}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.kill()  # what it was at is gone on with the next time
            raise


def _read(file: Path, origin: str) -> dict[str, Row]:
    """The pieces in a file; the line that a kill has cut is dropped."""
    if not file.exists():
        return {}
    data = file.read_bytes()
    whole = data[: data.rfind(b"\n") + 1]
    if whole != data:
        with file.open("r+b") as stream:
            stream.truncate(len(whole))
    found = {}
    for number, line in enumerate(whole.splitlines(), start=1):
        try:
            row: Row = json.loads(line)
            there, name = row.pop("origin"), row["name"]
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise RunsError(f"{file}, line {number}: it is no run of a study") from error
        if there != origin:
            raise RunsError(
                f"{file} has runs with other settings or experiences: choose another folder, or move "
                "the file away"
            )
        found[name] = row
    return found
