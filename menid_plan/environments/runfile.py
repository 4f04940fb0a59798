"""Run files: which environments a run uses, of what kinds and with what settings."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from menid_plan.environments.registry import (
    NO_PARAMS,
    EnvironmentSpec,
    Kind,
    UnknownKindError,
    load_kind,
)
from menid_plan.environments.session import MAX_DURATION
from menid_plan.environments.settings import SettingError, check_range, read_settings, unknown
from menid_plan.errors import MenidError
from menid_plan.model.domain import Domain, Problem

# A run file larger than this is refused.
MAX_BYTES = 2**20

# Each is a process of its own.
MAX_WORKERS = 1024

# An address of a Dask scheduler.
_ADDRESS = re.compile(r"[a-z]+://[^\s/]\S*|[^\s:/]+:\d{1,5}|\[[0-9a-fA-F:]+\]:\d{1,5}")

# Sections that others read; a reader that does not know one passes over it.
OTHERS = ("learn",)


class RunFileError(MenidError):
    """A run file cannot be used; ``messages`` tells all that is wrong, a line for each."""

    exit_code = 3

    def __init__(self, path: str, messages: list[str]) -> None:
        super().__init__(path, messages)
        self.path = path
        self.messages = messages

    def __str__(self) -> str:
        return "\n".join(f"{self.path}: {message}" for message in self.messages)


@dataclass(frozen=True, slots=True)
class EnvironmentTable:
    """The table ``[environment.NAME]``.

    ``role`` is None where it is the domain's. ``duration`` (nominal seconds of an execution: a
    number, or a table by action) is None where it is what the environment says, or else measured.
    ``timeout`` and ``start_timeout`` are in seconds. ``retries``: how often a failed execution is tried
    again. ``workers``: how many copies may run at once, None for as many as there are workers.
    ``settings`` are those of the kind.
    """

    kind: str
    role: Literal["target", "test"] | None = None
    duration: float | Mapping[str, float] | None = None
    timeout: float = 300.0
    start_timeout: float = 60.0
    retries: int = 2
    workers: int | None = None
    settings: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_range(self, "duration", most=MAX_DURATION)
        check_range(self, "timeout", above=True, most=MAX_DURATION)
        check_range(self, "start_timeout", above=True, most=MAX_DURATION)
        check_range(self, "retries")
        check_range(self, "workers", least=1)


@dataclass(frozen=True, slots=True)
class WorkersTable:
    """The table ``[workers]``: where executions in test environments run.

    ``number`` of worker processes; 0: in the process of the caller, where a crash is the end.
    ``scheduler`` is the address of a Dask scheduler, empty for processes on this machine.
    """

    number: int = 1
    scheduler: str = ""

    def __post_init__(self) -> None:
        check_range(self, "number", most=MAX_WORKERS)
        if self.scheduler and not _ADDRESS.fullmatch(self.scheduler):
            raise SettingError(
                "scheduler",
                f"expected an address such as tcp://HOST:8786, not `{self.scheduler[:80]}`",
            )


@dataclass(frozen=True, slots=True)
class Bound:
    """The environments of a run file, for a domain and a problem.

    ``domain`` has the roles of the run file: whatever asks it for the target gets this run's.
    """

    domain: Domain
    problem: Problem
    target: EnvironmentSpec
    tests: tuple[EnvironmentSpec, ...]

    @property
    def environments(self) -> tuple[EnvironmentSpec, ...]:
        """The target, then the tests."""
        return (self.target, *self.tests)

    def described(self) -> dict[str, Any]:
        """The environments with their roles, kinds and settings, as JSON has them."""
        found = {
            spec.name: {
                "role": spec.role,
                "kind": type(spec.kind).name,
                "duration": spec.duration,
                "settings": asdict(spec.kind),  # type: ignore[call-overload]
            }
            for spec in self.environments
        }
        plain: dict[str, Any] = json.loads(json.dumps(found, default=str))
        return plain


@dataclass(frozen=True, slots=True)
class RunFile:
    """A run file that was read: its environments in order, and the sections that were asked for."""

    path: Path
    environments: Mapping[str, EnvironmentTable]
    kinds: Mapping[str, Kind]
    workers: WorkersTable
    sections: Mapping[str, object]

    def bind(
        self, domain: Domain, problem: Problem, params: Mapping[str, float] = NO_PARAMS
    ) -> Bound:
        """The environments for a domain and a problem; ``params`` sets params of the domain anew.

        Environments that the file does not name are not used. Raises RunFileError for names that the
        domain lacks, and unless there is exactly one target.
        """
        declared = {e.name: e.role for e in domain.all_environments}
        actions = [a.name for a in domain.actions]
        faults = []
        for name, table in self.environments.items():
            if name not in declared:
                guess = unknown("environment", name, declared)
                faults.append(f"environment.{name}: {guess} (domain `{domain.name}`)")
            for action in table.duration if isinstance(table.duration, Mapping) else ():
                if action not in actions:
                    where = f"environment.{name}.duration.{action}"
                    faults.append(f"{where}: {unknown('action', action, actions)}")
        roles = {name: t.role or declared.get(name) for name, t in self.environments.items()}
        targets = [name for name, role in roles.items() if role == "target"]
        if len(targets) != 1 and not faults:
            found = f"there are {len(targets)}: {', '.join(targets)}" if targets else "none is"
            hint = '; set `role` ("target" or "test") where it is not the domain\'s'
            faults.append(f"environment: one environment must be the target, {found}{hint}")
        if faults:
            raise RunFileError(str(self.path), faults)
        specs = [
            EnvironmentSpec(
                name, self.kinds[name], domain, problem, roles[name] or "test", dict(params),
                self.path.parent, t.duration, t.timeout, t.start_timeout, t.retries, t.workers,
                str(self.path),
            )
            for name, t in self.environments.items()
        ]  # fmt: skip
        target = targets[0]
        declarations = tuple(
            replace(e, role="target" if e.name == target else "test")
            for e in domain.all_environments
        )
        return Bound(
            replace(domain, environments=declarations), problem,
            next(s for s in specs if s.name == target),
            tuple(s for s in specs if s.name != target),
        )  # fmt: skip


def read_run_file(path: str | Path, sections: Mapping[str, type] | None = None) -> RunFile:
    """Read a run file; see `parse_run_file`. Raises OSError if it can't be read."""
    path = Path(path)
    with path.open("rb") as file:
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise RunFileError(str(path), [f"the file is larger than {MAX_BYTES // 2**20} MiB"])
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        message = f"line {line}: byte 0x{data[error.start]:02x} is not UTF-8"
        raise RunFileError(str(path), [message]) from error
    return parse_run_file(text, path, sections)


def parse_run_file(
    text: str, path: str | Path, sections: Mapping[str, type] | None = None
) -> RunFile:
    """The run file that a text is; names of files in it start from the folder of ``path``.

    ``sections`` gives a dataclass for each further table that the caller reads; a table that is left
    out gives the dataclass's defaults. Raises RunFileError with all that is wrong.
    """
    path = Path(path)
    try:
        # A byte-order mark is what some editors put in front.
        table = tomllib.loads(text.removeprefix("\ufeff").replace("\r\n", "\n"))
    except tomllib.TOMLDecodeError as error:
        raise RunFileError(str(path), [_syntax_message(str(error), text)]) from error
    except RecursionError as error:
        raise RunFileError(str(path), ["the tables are nested too deeply"]) from error
    wanted = dict(sections or {})
    faults: list[str] = []
    known = {"environment", "workers", *wanted, *OTHERS}
    for key in table:
        if key not in known:
            faults.append(f"{key}: {unknown('table', key, known)}")
    environments, kinds = _environments(table.get("environment", {}), faults)
    workers = _section(WorkersTable, table, "workers", faults)
    found = {name: _section(kind, table, name, faults) for name, kind in wanted.items()}
    if faults:
        raise RunFileError(str(path), faults)
    assert isinstance(workers, WorkersTable)
    return RunFile(path, environments, kinds, workers, found)


def _environments(
    tables: object, faults: list[str]
) -> tuple[dict[str, EnvironmentTable], dict[str, Kind]]:
    environments: dict[str, EnvironmentTable] = {}
    kinds: dict[str, Kind] = {}
    if not isinstance(tables, dict):
        faults.append("environment: expected tables, as in [environment.NAME]")
        return environments, kinds
    for name, table in tables.items():
        where = f"environment.{name}"
        if not isinstance(table, dict):
            faults.append(f"{where}: expected a table, as in [{where}]")
            continue
        read, wrong = read_settings(EnvironmentTable, table, where)
        faults += wrong
        if read is None:
            continue
        environments[name] = read
        try:
            kind = load_kind(read.kind)
        except UnknownKindError as error:
            faults.append(f"{where}.kind: {error}")
            continue
        settings, wrong = read_settings(kind, read.settings, f"{where}.settings")
        faults += wrong
        if settings is not None:
            kinds[name] = settings
    return environments, kinds


def _section(kind: type, table: Mapping[str, object], name: str, faults: list[str]) -> object:
    part = table.get(name, {})
    if not isinstance(part, dict):
        faults.append(f"{name}: expected a table, as in [{name}]")
        return None
    found, wrong = read_settings(kind, part, name)
    faults += wrong
    return found


def _syntax_message(message: str, text: str) -> str:
    """What the TOML reader says, its place first."""
    place = re.search(r" \(at line (\d+), column (\d+)\)$", message)
    if place is None:
        lines = len(text.splitlines()) or 1
        return f"line {lines}: {message.removesuffix(' (at end of document)')}"
    return f"line {place[1]}, column {place[2]}: {message[: place.start()]}"
