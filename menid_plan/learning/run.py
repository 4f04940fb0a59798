"""A learning run and the folder that keeps it.

The folder has `experiences.sqlite`, `settings.json`, `events.jsonl`, `curve.csv` and `learned.menid`. A
run that was killed is resumed from its store: it takes the same decisions again, and executes only
what the store does not have.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from menid_plan.environments.pool import Failure
from menid_plan.environments.runfile import Bound, WorkersTable
from menid_plan.environments.seeds import seed_of
from menid_plan.errors import MenidError
from menid_plan.experience.store import Store
from menid_plan.language.write import write
from menid_plan.learning.counts import Evidence, learned_domain
from menid_plan.learning.estimators import estimator
from menid_plan.learning.loop import Loop, Point, Progress
from menid_plan.learning.planner import Planner
from menid_plan.learning.settings import LearnSettings
from menid_plan.planning import Task
from menid_plan.solving import OnlineSolver, Solver, UnsupportedError

STORE = "experiences.sqlite"
VERSION = 1

# What a run that is resumed may change: when it ends.
LIMITS = ("steps", "episodes", "hours")


class RunError(MenidError):
    """A folder holds no run, another run, or one that these settings do not go on with."""

    exit_code = 3


class Run:
    """One learning run in a folder; ``watch`` is called with every point of its curve.

    ``resume`` goes on with the run that is there. Raises RunError, or StoreError, where that can't be.
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
        failed: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.folder = folder
        self.bound = bound
        self.settings = settings
        self.params = dict(params or {})
        self._watch = watch
        self._failed = failed
        self._prepare(resume)
        names = [spec.name for spec in bound.environments]
        self.evidence = Evidence(
            bound.domain, bound.problem, names,
            estimator(settings.estimator, **settings.estimator_options), settings.prior_weight,
            self.params,
        )  # fmt: skip
        self.task = Task(bound.domain, bound.problem, params=self.params)
        objective = settings.objective or self.task.objective
        self.planner = Planner(
            bound.domain, bound.problem, self.evidence, _solver(settings.solver), objective,
            np.random.default_rng(seed_of(settings.seed, "planner")), self.params,
        )  # fmt: skip
        self.store = Store.create(
            folder / STORE, bound.domain, bound.problem, settings=self._described(),
            seed=settings.seed, resume=resume,
        )  # fmt: skip
        try:
            self.curve = _Curve(folder / "curve.csv")
            self.loop = Loop(
                bound, settings, self.evidence, self.planner, self.store, workers=workers.number,
                scheduler=workers.scheduler, watch=self._point, failed=self._note,
            )  # fmt: skip
        except BaseException:
            self.store.close()
            raise

    def learn(self) -> Progress:
        """Learn to the end of the run; what was learned is written however it ends."""
        self._event("resumes" if len(self.store) else "starts", stored=len(self.store))
        end = "failed"
        try:
            self.loop.run()
            end = "ended"
        except KeyboardInterrupt:
            end = "interrupted"
            raise
        finally:
            try:
                self.write_learned()
                progress = self.loop.progress
                self._event(
                    end, steps=progress.steps, episodes=progress.episodes, reward=progress.reward,
                    executions=dict(progress.executions), failed=dict(progress.failed),
                )  # fmt: skip
            finally:
                self.curve.close()
                self.store.close()
        return self.loop.progress

    def write_learned(self) -> None:
        """Write the domain with what was learned, and with the roles of this run."""
        roles = {spec.name: spec.role for spec in self.bound.environments}
        _replace(self.folder / "learned.menid", write(learned_domain(self.evidence, roles)))

    # ------------------------------------------------------------------------------------ the folder

    def _prepare(self, resume: bool) -> None:
        """Make the folder, or see that the run that is there is this one."""
        path = self.folder / "settings.json"
        described = self._described()
        if path.exists():
            if not resume:
                raise RunError(
                    f"there is a run in `{self.folder}` already; go on with --resume, or give another "
                    "folder"
                )
            self._must_be_same(path, described)
        elif resume and not (self.folder / STORE).exists():
            raise RunError(f"there is no run in `{self.folder}` to resume")
        self.folder.mkdir(parents=True, exist_ok=True)
        _replace(path, json.dumps(described, indent=2) + "\n")

    def _described(self) -> dict[str, Any]:
        return {
            "version": VERSION,
            "domain": self.bound.domain.name,
            "problem": self.bound.problem.name,
            "params": self.params,
            "learn": asdict(self.settings),
            "environments": {
                spec.name: {
                    "role": spec.role,
                    "kind": type(spec.kind).name,
                    "duration": spec.duration,
                    "settings": _plain(asdict(spec.kind)),  # type: ignore[call-overload]
                }
                for spec in self.bound.environments
            },
        }

    def _must_be_same(self, path: Path, described: dict[str, Any]) -> None:
        try:
            before = json.loads(path.read_text(encoding="utf-8"))
            learn = dict(before["learn"])
        except (ValueError, KeyError, TypeError) as error:
            raise RunError(f"`{path}` is not what a run has written: {error}") from error
        if before.get("version") != VERSION:
            raise RunError(f"`{path}` was written by another version of the program")
        now = json.loads(json.dumps(described))
        for key in ("domain", "problem", "params", "environments"):
            if before.get(key) != now[key]:
                raise RunError(f"`{path}`: the run has another {key.rstrip('s')} setting")
        for key in (field.name for field in fields(LearnSettings)):
            if key not in LIMITS and learn.get(key) != now["learn"][key]:
                raise RunError(
                    f"`{path}`: the run has {key} = {learn.get(key)!r}, and is to be resumed with "
                    f"{now['learn'][key]!r}; only {', '.join(LIMITS)} may change"
                )

    # ---------------------------------------------------------------------------------------- events

    def _point(self, point: Point) -> None:
        self.curve.add(point)
        self._watch(point)

    def _note(self, failure: Failure) -> None:
        self._event("failure", environment=failure.environment, message=str(failure))
        self._failed(str(failure))

    def _event(self, event: str, **more: Any) -> None:
        line = json.dumps({"event": event, "when": time.time(), **more})
        with (self.folder / "events.jsonl").open("a", encoding="utf-8") as file:
            file.write(line + "\n")


class _Curve:
    """`curve.csv`: a row for each step in the target and each time that an action was tested.

    A run that is resumed goes through the points that are there already once more; those stay.
    """

    HEAD = "seconds,reward,steps,episodes,tests,what\n"

    def __init__(self, path: Path) -> None:
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        whole = text[: text.rfind("\n") + 1]  # a line that was being written is not a row
        if not whole.startswith(self.HEAD):
            whole = self.HEAD
        self._there = whole.count("\n") - 1
        self._file = path.open("w", encoding="utf-8", newline="\n")
        self._file.write(whole)
        self._file.flush()

    def add(self, point: Point) -> None:
        """Write a point down, unless it is there."""
        if self._there > 0:
            self._there -= 1
            return
        self._file.write(
            f"{point.seconds!r},{point.reward!r},{point.steps},{point.episodes},{point.tests},"
            f"{point.what}\n"
        )
        self._file.flush()

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()


def _solver(name: str) -> Solver | OnlineSolver:
    try:
        return Task.online_solver(name)
    except UnsupportedError:
        return Task.solver(name)


def _plain(value: Any) -> Any:
    """A value as JSON has it."""
    return json.loads(json.dumps(value, default=str))


def _replace(path: Path, text: str) -> None:
    """Write a file in one step."""
    new = path.with_name(f".{path.name}.new")
    new.write_text(text, encoding="utf-8", newline="\n")
    os.replace(new, path)
