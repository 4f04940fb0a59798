"""A learning run and the folder that keeps it.

The folder has `experiences.sqlite`, `settings.json`, `events.jsonl`, `curve.csv` and `learned.menid`. A
run that was killed is resumed from its store: it takes the same decisions again, and executes only
what the store does not have.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from menid_plan import __version__
from menid_plan.environments.runfile import Bound, WorkersTable
from menid_plan.environments.seeds import seed_of
from menid_plan.environments.settings import SettingError, differences
from menid_plan.errors import MenidError
from menid_plan.experience.attribution import Attributor
from menid_plan.experience.store import Store, StoreError, StoreInputError
from menid_plan.files import replace_file
from menid_plan.grounding.state import GroundAction
from menid_plan.interrupts import Interrupts
from menid_plan.language.write import write
from menid_plan.learning.clock import Clock, RealClock, VirtualClock
from menid_plan.learning.counts import Evidence, learned_domain
from menid_plan.learning.curve import Curve, Point
from menid_plan.learning.estimators import Estimator, UnknownEstimatorError, estimator
from menid_plan.learning.events import Events
from menid_plan.learning.executions import Executions
from menid_plan.learning.loop import Loop, Progress
from menid_plan.learning.planner import Planner
from menid_plan.learning.settings import LearnSettings
from menid_plan.planning import OptionError, Task, made_solver
from menid_plan.solving import AskedSolver, OnlineSolver, Solver, UnknownSolverError

STORE = "experiences.sqlite"
SETTINGS = "settings.json"
EVENTS = "events.jsonl"
CURVE = "curve.csv"
LEARNED = "learned.menid"
VERSION = 1

# What a run that is resumed may change: when it ends.
LIMITS = ("steps", "episodes", "hours")


class RunError(MenidError):
    """A folder holds no run, another run, or one that these settings do not go on with."""

    exit_code = 3


class FolderError(MenidError):
    """A file in the folder of a run cannot be written: the disk is full, say."""


class Run:
    """One learning run in a folder; ``watch`` is called with every point of its curve.

    ``underway`` is told how far the run is between two of these, while an action is tested.
    ``reported`` is told in words of each execution that failed, from any thread. ``interrupts`` may
    have been entered already, so that a signal before `learn` is not lost. ``resume`` goes on with
    the run that is there; one in which nothing was executed is replaced in any case. Settings are
    looked at before anything is written: raises SettingError that names the key, UnsupportedError for
    an objective that the solver does not know, RunError or StoreError if the folder can't be used.
    """

    def __init__(
        self,
        folder: Path,
        bound: Bound,
        settings: LearnSettings,
        workers: WorkersTable,
        *,
        params: Mapping[str, float] | None = None,
        resume: bool = False,
        watch: Callable[[Point], None] = lambda _: None,
        underway: Callable[[Point], None] = lambda _: None,
        reported: Callable[[str], None] = lambda _: None,
        interrupts: Interrupts | None = None,
    ) -> None:
        self.folder = folder
        self.bound = bound
        self.settings = settings
        self.params = dict(params or {})
        self._watch = watch
        if settings.objective not in ("", "reward") and bound.problem.goal is None:
            raise SettingError("learn.objective", f"problem `{bound.problem.name}` has no goal")
        attributor = Attributor(bound.domain, bound.problem, self.params, settings.attribution)
        names = [spec.name for spec in bound.environments]
        self.evidence = Evidence(
            bound.domain, bound.problem, names, made_estimator(settings, len(names)),
            settings.prior_weight, self.params,
        )  # fmt: skip
        objective = settings.objective or Task(bound.domain, bound.problem).objective
        self.planner = Planner(
            bound.domain, bound.problem, self.evidence, _made_solver(settings), objective,
            np.random.default_rng(seed_of(settings.seed, "planner")), self.params,
        )  # fmt: skip
        self.planner.best()  # what can't be grounded or solved is told before anything is written
        with ExitStack() as opened:
            self.store = opened.enter_context(self._open_store(resume))
            self.resumed = len(self.store) > 0
            self.events = Events(folder / EVENTS)
            self._curve = Curve(folder / CURVE)
            opened.callback(self._curve.close)
            clock: Clock = VirtualClock()
            if settings.clock == "real":
                clock = RealClock(self._curve.times())
            self._interrupts = interrupts or Interrupts()
            executions = Executions(
                bound, settings.seed, attributor, self.evidence, self.store, self.events, workers,
                tests=settings.tests, interrupts=self._interrupts, reported=reported,
            )  # fmt: skip
            opened.callback(executions.close)
            self.loop = Loop(
                bound, settings, self.evidence, self.planner, attributor, executions, clock,
                self._point, underway,
            )  # fmt: skip
            self._opened = opened.pop_all()

    def close(self) -> None:
        """Let go of the folder and the workers; `learn` does so itself, and may not be called then."""
        self._opened.close()

    def learn(self) -> Progress:
        """Learn to the end of the run; what was learned is written however it ends.

        Raises FolderError or StoreError where the disk fails, KeyboardInterrupt (for SIGTERM, too), and
        whatever the target or the domain give reason to. A run can be resumed after any of these.
        """
        with self._opened, self._interrupts:
            versions = {"menid-plan": __version__, "numpy": np.__version__}
            started = "resumes" if self.resumed else "starts"
            limits = {name: getattr(self.settings, name) for name in LIMITS}
            self._event(started, stored=len(self.store), versions=versions, limits=limits)
            try:
                self.loop.run()
            except BaseException as error:
                interrupted = isinstance(error, KeyboardInterrupt)
                # What stopped the run is to be told, and not what comes of it.
                with suppress(MenidError, OSError):
                    self._write_end("interrupted" if interrupted else "failed", str(error))
                if isinstance(error, OSError):
                    raise FolderError(_failure(self.folder, error)) from error
                raise
            self._write_end("ended")
        return self.loop.progress

    def _write_end(self, end: str, why: str = "") -> None:
        self.write_learned()
        progress = self.loop.progress
        self._event(
            end, steps=progress.steps, episodes=progress.episodes, reward=progress.reward,
            executions=dict(progress.executions), failed=dict(self.failed),
            **({"message": why} if why else {}),
        )  # fmt: skip

    def write_learned(self) -> None:
        """Write the domain with what was learned, and with the roles of this run."""
        roles = {spec.name: spec.role for spec in self.bound.environments}
        with _writing(self.folder):
            learned = write(learned_domain(self.evidence, roles))
            replace_file(self.folder / LEARNED, learned.encode())

    def best(self) -> tuple[GroundAction | None, float, float | None]:
        """The best first action by what was learned; see `Planner.best`."""
        return self.planner.best()

    @property
    def failed(self) -> Mapping[str, int]:
        """Attempts at executions that came to nothing, by environment, those before a resume too."""
        return self.events.failed

    # ------------------------------------------------------------------------------------ the folder

    def _open_store(self, resume: bool) -> Store:
        """The store of the run that is there, if it is this one, or a new one."""
        described = self._described()
        there = [n for n in (STORE, SETTINGS, CURVE, EVENTS) if (self.folder / n).exists()]
        if not resume:
            if there:
                if not _is_untouched(self.folder):
                    raise RunError(
                        f"there is a run in `{self.folder}` already ({', '.join(there)}); go on "
                        "with --resume, or give another folder"
                    )
                _clear(self.folder)
            return self._make_store(described, resume=False)
        if not there:
            raise RunError(f"there is no run in `{self.folder}` to resume")
        _must_have_its_store(self.folder)
        try:
            return self._make_store(described, resume=True)
        except (RunError, StoreInputError):
            # Where nothing was executed there is nothing that other settings would not go with.
            if not _is_untouched(self.folder):
                raise
        _clear(self.folder)
        return self._make_store(described, resume=False)

    def _make_store(self, described: dict[str, Any], *, resume: bool) -> Store:
        settings, store = self.folder / SETTINGS, self.folder / STORE
        if settings.exists():
            _must_be_same(settings, _read_settings(settings), described)
        self.folder.mkdir(parents=True, exist_ok=True)
        opened = Store.create(
            store, self.bound.domain, self.bound.problem, settings=described,
            seed=self.settings.seed, resume=resume,
        )  # fmt: skip
        try:
            _must_be_same(store, opened.settings, described)
            if len(opened) == 0:
                _must_have_been_empty(self.folder, "has no experiences")
            with _writing(self.folder):
                replace_file(settings, (json.dumps(described, indent=2) + "\n").encode())
        except BaseException:
            opened.close()
            raise
        return opened

    def _described(self) -> dict[str, Any]:
        described = {
            "version": VERSION,
            "domain": self.bound.domain.name,
            "problem": self.bound.problem.name,
            "params": self.params,
            "learn": asdict(self.settings),
            "environments": self.bound.described(),
        }
        plain: dict[str, Any] = json.loads(json.dumps(described, default=str))
        return plain

    def _point(self, point: Point) -> None:
        self._curve.add(point)
        self._watch(point)

    def _event(self, event: str, **more: Any) -> None:
        with _writing(self.folder):
            self.events.write(event, **more)


def made_estimator(settings: LearnSettings, environments: int) -> Estimator:
    """The estimator of some settings, tried on counts of so many environments."""
    try:
        found = estimator(settings.estimator, **settings.estimator_options)
    except UnknownEstimatorError as error:
        wrong = "estimator_options" if "has no option" in str(error) else "estimator"
        raise SettingError(f"learn.{wrong}", str(error)) from error
    except (ValueError, TypeError) as error:
        raise SettingError("learn.estimator_options", str(error)) from error
    try:
        found.posterior(np.ones((environments, 2)))
    except (ValueError, TypeError) as error:
        raise SettingError("learn.estimator_options", str(error)) from error
    return found


def _made_solver(settings: LearnSettings) -> Solver | OnlineSolver | AskedSolver:
    name, options = settings.solver, dict(settings.solver_options)
    try:
        found = made_solver(name, options)
        if hasattr(found, "check"):
            found.check()
        return found
    except UnknownSolverError as error:
        raise SettingError("learn.solver", str(error)) from error
    except (OptionError, TypeError) as error:
        raise SettingError("learn.solver_options", str(error)) from error


def _executed(folder: Path) -> tuple[int, int]:
    """How many steps and tests the curve and the events of a run tell of."""
    steps = tests = 0
    with suppress(FileNotFoundError, NotADirectoryError):
        for row in (folder / CURVE).read_bytes().splitlines()[1:]:
            with suppress(ValueError, IndexError):
                cells = row.split(b",")
                steps, tests = max(steps, int(cells[2])), max(tests, int(cells[4]))
    with suppress(FileNotFoundError, NotADirectoryError):
        for line in (folder / EVENTS).read_bytes().splitlines():
            with suppress(ValueError, KeyError, TypeError, AttributeError, RecursionError):
                event = json.loads(line)
                if event["event"] in ("ended", "failed", "interrupted"):
                    done = int(event["steps"])
                    elsewhere = sum(map(int, event["executions"].values())) - done
                    steps, tests = max(steps, done), max(tests, elsewhere)
    return steps, tests


def _must_have_its_store(folder: Path) -> None:
    """Refuse to go on with a run whose store is lost: it would begin anew and say nothing."""
    store = folder / STORE
    if not store.exists():
        _must_have_been_empty(folder, "is missing")
    elif store.is_file() and store.stat().st_size == 0:
        _must_have_been_empty(folder, "is empty")


def _must_have_been_empty(folder: Path, fault: str) -> None:
    steps, tests = _executed(folder)
    if steps or tests:
        where = CURVE if (folder / CURVE).exists() else EVENTS
        raise RunError(
            f"the store `{folder / STORE}` {fault}, though {where} tells of {steps} steps and {tests} "
            "tests: put the store back to go on, or learn anew in another folder"
        )


def _is_untouched(folder: Path) -> bool:
    """Whether a run is there in which nothing was executed, such as one that failed to start."""
    store = folder / STORE
    if not store.exists() and not (folder / SETTINGS).exists():
        return False
    if any(_executed(folder)):
        return False
    if not store.exists() or (store.is_file() and store.stat().st_size == 0):
        return True
    try:
        with Store.read(store) as opened:
            return len(opened) == 0
    except StoreError:
        return False


def _clear(folder: Path) -> None:
    """Remove a run in which nothing was executed; StoreError if another process is at it."""
    store = folder / STORE
    if store.exists() and store.stat().st_size > 0:
        Store.resume(store).close()
    with _writing(folder):
        for name in (STORE, f"{STORE}-wal", f"{STORE}-shm", SETTINGS, EVENTS, CURVE, LEARNED):
            (folder / name).unlink(missing_ok=True)


def _read_settings(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(found, dict):
            raise ValueError("it is no table")
    except (ValueError, RecursionError) as error:
        raise RunError(
            f"`{path}` is not what a run has written: {error}; the store has the settings too, so the "
            "run can be resumed if you remove the file"
        ) from error
    return found


def _must_be_same(path: Path, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Refuse to go on with a run by other settings; names the first key that differs."""
    if before.get("version") != now["version"]:
        raise RunError(
            f"`{path}` has settings of version {before.get('version')!r}, and this menid-plan knows "
            f"{now['version']}"
        )
    for key, there, here in differences(before, now):
        if key not in [f"learn.{limit}" for limit in LIMITS]:
            raise RunError(
                f"`{path}`: the run has {key} = {there}, and is to be resumed with "
                f"{here}; only when it ends ({', '.join(LIMITS)}) may change"
            )


@contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Turn what the disk says into FolderError."""
    try:
        yield
    except OSError as error:
        raise FolderError(_failure(folder, error)) from error


def _failure(folder: Path, error: OSError) -> str:
    where = error.filename or folder
    return f"cannot write `{where}`: {error.strerror or error}; when it can be, --resume goes on"
