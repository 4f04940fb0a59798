"""Which planners of others can be run: those that the project knows, and those that users declare."""

from __future__ import annotations

import os
import re
import shutil
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from platformdirs import user_config_path

from menid_plan.environments.settings import read_settings, unknown
from menid_plan.errors import MenidError
from menid_plan.solving import load_solver, solver_entry_points

# What may stand in a command in curly brackets.
PLACES = ("folder", "domain", "instance", "name", "host", "port")


class PlannerError(MenidError):
    """A planner is not known, not found, or declared wrongly."""

    exit_code = 3


class UnknownPlannerError(PlannerError):
    """There is no planner of that name."""


class PlannerMissingError(PlannerError):
    """A planner is known, and not installed."""

    exit_code = 5


@dataclass(frozen=True, slots=True)
class Planner:
    """A planner, as a table ``[planner.NAME]`` of a TOML file declares it.

    ``command`` are its program and arguments. In them stand, in curly brackets: ``folder``, the
    temporary folder in which it is started, ``domain`` and ``instance``, the files there, ``name``,
    the name of the instance, ``host`` and ``port`` of the server. ``files`` are linked into the folder;
    their names start from the folder of the TOML file.
    It reads RDDL, or PPDDL if the ``protocol`` that it speaks is mdpsim's.
    """

    command: tuple[str, ...]
    protocol: Literal["rddlsim", "mdpsim"] = "rddlsim"
    files: tuple[str, ...] = ()

    def filled(self, places: Mapping[str, str]) -> list[str]:
        """The command with all places filled; what else stands in brackets stays."""
        found = []
        for part in self.command:
            for key in PLACES:
                part = part.replace(f"{{{key}}}", places[key])
            found.append(part)
        return found


# PROST (Keller and Eyerich 2012) looks for its parser in the folder in which it is started.
_PROST = ("rddl-parser-release", "search-release")
_SEARCH = "[Prost -s 1 -se [IPC2014]]"


def prost() -> Planner:
    """PROST, by the folder in MENID_PROST or by PATH; PlannerMissingError tells where it was sought."""
    home = os.environ.get("MENID_PROST")
    found = [shutil.which(name, path=home) if home else shutil.which(name) for name in _PROST]
    missing = [name for name, path in zip(_PROST, found, strict=True) if path is None]
    if missing:
        raise PlannerMissingError(
            f"PROST was not found: {' and '.join(missing)} in "
            + (f"the folder {home} that MENID_PROST names" if home else "the folders of PATH")
            + "; build it from github.com/prost-planner/prost, put its rddl-parser and search"
            " into one folder under these names, and set MENID_PROST to that folder"
        )
    paths = tuple(str(Path(path).resolve()) for path in found if path is not None)
    return Planner(("./search-release", "{name}", "-p", "{port}", _SEARCH), files=paths)


def mdpsim_client() -> Planner:
    """The client that comes with mdpsim (Younes et al. 2005), which takes actions at random."""
    if shutil.which("mdpclient") is None:
        raise PlannerMissingError(
            "mdpclient was not found in the folders of PATH; build it from github.com/hlsyounes/mdpsim"
        )
    command = ("mdpclient", "-H", "{host}", "-P", "{port}", "{domain}", "{instance}")
    return Planner(command, protocol="mdpsim")


# Those that the project knows, and where they are.
KNOWN = {"prost": prost, "mdpsim-client": mdpsim_client}


def declarations() -> Path:
    """The file in which users declare planners."""
    return user_config_path("menid-plan", appauthor=False) / "planners.toml"


def declared(path: Path | None = None) -> dict[str, Planner]:
    """The planners that a file declares, by default the user's own, if there is one."""
    file = declarations() if path is None else path
    if path is None and not file.is_file():
        return {}
    try:
        table = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise PlannerError(f"{file}: {error}") from error
    tables = table.pop("planner", {})
    faults = [f"{key}: {unknown('table', key, ['planner'])}" for key in table]
    if not isinstance(tables, dict):
        tables = {}
        faults.append("planner: expected tables [planner.NAME]")
    planners = {}
    for name, each in tables.items():
        if not isinstance(each, dict):
            faults.append(f"planner.{name}: expected a table")
            continue
        found, wrong = read_settings(Planner, each, f"planner.{name}")
        faults += wrong
        if found is not None and not found.command:
            faults.append(f"planner.{name}.command: it is empty")
        elif found is not None and any("\0" in part for part in (*found.command, *found.files)):
            faults.append(f"planner.{name}: there is a null character in it")
        elif found is not None:
            faults += [f"planner.{name}.command: {each}" for each in _misspelt(found.command)]
            files = tuple(str(file.parent.absolute() / each) for each in found.files)
            planners[name] = replace(found, files=files)
    if faults:
        raise PlannerError("\n".join(f"{file}: {fault}" for fault in faults))
    return planners


def _misspelt(command: Sequence[str]) -> Iterator[str]:
    """Places of a command that look like those that there are."""
    for place in re.findall(r"\{(\w+)\}", " ".join(command)):
        if place not in PLACES and get_close_matches(place, PLACES):
            yield unknown(f"place `{{{place}}}`", place, PLACES)


def planner(name: str, path: Path | None = None) -> Planner:
    """The planner of that name: a declared one first, then one that is known."""
    found = declared(path)
    if name in found:
        return found[name]
    if name in KNOWN:
        return KNOWN[name]()
    solvers = [each for each in solver_entry_points() if hasattr(load_solver(each), "solve")]
    there = dict.fromkeys([*KNOWN, *found, *solvers])
    raise UnknownPlannerError(unknown(f"planner `{name}`", name, there))


@dataclass(frozen=True, slots=True)
class Found:
    """A planner, whether it is there, and where; if not, where it was sought and how to get it."""

    name: str
    there: bool
    told: str


def report(path: Path | None = None) -> list[Found]:
    """All planners that are known or declared."""
    found = []
    for name, seek in KNOWN.items():
        try:
            known = seek()
            program = known.files[-1] if known.files else shutil.which(known.command[0])
            found.append(Found(name, True, str(Path(program or "").parent)))
        except PlannerMissingError as error:
            found.append(Found(name, False, str(error)))
    storm = find_spec("stormpy") is not None
    how = "as the solver `storm`" if storm else "not installed: pip install 'menid-plan[storm]'"
    found.append(Found("storm", storm, how))
    source = declarations() if path is None else path
    for name, each in declared(path).items():
        program = each.command[0]
        there = shutil.which(program) is not None or program.startswith((".", "{"))
        lost = [file for file in each.files if not Path(file).exists()]
        told = f"declared in {source}: {program}"
        if not there:
            told += ", which is no program in PATH"
        elif lost:
            told += f"; there is no file {', '.join(lost)}"
        found.append(Found(name, there and not lost, told))
    return found
