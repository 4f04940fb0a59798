"""Kinds of environments, found by their entry points, and what it takes to build one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import ClassVar, Protocol

from menid_plan.environments.interface import Environment, EnvironmentFailedError
from menid_plan.environments.session import Session, said
from menid_plan.environments.settings import SettingError, read_settings
from menid_plan.environments.settings import unknown as unknown_name
from menid_plan.errors import MenidError
from menid_plan.model.domain import Domain, Problem, Role

GROUP = "menid_plan.environments"

NO_PARAMS: Mapping[str, float] = {}


@dataclass(frozen=True, slots=True)
class Place:
    """What an environment is built for.

    ``name`` is that of the environment in the domain, ``params`` sets params of the domain anew,
    ``folder`` is where file names in settings start. ``timeout`` and ``start_timeout``, in seconds,
    are for kinds that can tell by themselves when an execution, or the start, takes too long; None
    for no limit.
    """

    name: str
    domain: Domain
    problem: Problem
    params: Mapping[str, float] = field(default_factory=dict)
    folder: Path = Path()
    timeout: float | None = None
    start_timeout: float | None = None


class Kind(Protocol):
    """A kind of environment: a frozen dataclass of settings that builds environments.

    ``name`` is what run files call it, ``promise`` says in a line what it is, and ``needs`` what must
    be installed (empty: nothing more). Its fields are what `read_settings` can read; it is pickled
    on its way to workers.
    """

    name: ClassVar[str]
    promise: ClassVar[str]
    needs: ClassVar[str]

    def build(self, place: Place) -> Environment:
        """Build an environment; raises SettingError, or EnvironmentFailedError if it can't start."""


class UnknownKindError(MenidError):
    """No installed package offers a kind of environment of that name."""

    exit_code = 3


@dataclass(frozen=True, slots=True)
class EnvironmentSpec:
    """All that it takes to build an environment and to run it; can be pickled.

    ``duration`` is nominal, in seconds, for every action or by the names of some; where there is none
    it is what the environment says, else what is measured. ``timeout`` (of an execution) and
    ``start_timeout`` are in seconds. ``retries``: how often an execution that failed is tried again.
    ``workers``: how many copies may run at once; None for as many as there are workers. ``file`` is the
    run file, for messages.
    """

    name: str
    kind: Kind
    domain: Domain
    problem: Problem
    role: Role = "test"
    params: Mapping[str, float] = field(default_factory=dict)
    folder: Path = Path()
    duration: float | Mapping[str, float] | None = None
    timeout: float | None = 300.0
    start_timeout: float | None = 60.0
    retries: int = 2
    workers: int | None = None
    file: str = ""

    @property
    def place(self) -> Place:
        """What the kind is told."""
        return Place(
            self.name, self.domain, self.problem, self.params, self.folder, self.timeout,
            self.start_timeout,
        )  # fmt: skip

    def nominal(self, action: str) -> float | None:
        """The nominal duration of an action in seconds, if there is one."""
        if isinstance(self.duration, Mapping):
            return self.duration.get(action)
        return self.duration

    def open(self) -> Session:
        """Build the environment, as a session that checks it and gives durations; see `build`."""
        return Session(self.build(), self.domain, self.problem, self.name, self.nominal)

    def build(self) -> Environment:
        """Build the environment.

        Raises SettingError that names the run file and the key from its top, or
        EnvironmentFailedError that names the environment.
        """
        try:
            return self.kind.build(self.place)
        except SettingError as error:
            raise SettingError(
                f"environment.{self.name}.settings.{error.key}".rstrip("."), error.message,
                self.file,
            ) from error  # fmt: skip
        except EnvironmentFailedError as error:
            raise type(error)(f"environment `{self.name}`: {error}") from error
        except MenidError:
            raise
        except (Exception, SystemExit) as error:  # whatever a simulator does when it starts
            raise EnvironmentFailedError(f"environment `{self.name}`: {said(error)}") from error


def kind_entry_points() -> dict[str, EntryPoint]:
    """The installed kinds by name; none is loaded."""
    return {point.name: point for point in entry_points(group=GROUP)}


def load_kind(name: str) -> type[Kind]:
    """The class of a kind's settings; UnknownKindError lists those there are."""
    found = kind_entry_points()
    if name not in found:
        message = unknown_name(f"kind of environment `{name}`", name, found)
        raise UnknownKindError(message)
    loaded: type[Kind] = found[name].load()
    return loaded


def make(
    kind: str,
    settings: Mapping[str, object],
    domain: Domain,
    problem: Problem,
    name: str,
    params: Mapping[str, float] = NO_PARAMS,
    folder: Path = Path(),
) -> Session:
    """Build an environment by the name of its kind, from settings as a run file has them.

    Raises SettingError for wrong settings, EnvironmentFailedError if it can't start.
    """
    found, faults = read_settings(load_kind(kind), settings)
    if found is None:
        raise SettingError("", "; ".join(faults))
    return EnvironmentSpec(name, found, domain, problem, params=params, folder=folder).open()
