"""What the folder of a learning run tells: how it went, and what was learned."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from menid_plan.errors import MenidError
from menid_plan.experience.reading import StoreReader
from menid_plan.experience.record import DistributionKey
from menid_plan.experience.sameness import without_comments
from menid_plan.experience.store import Store
from menid_plan.grounding.semantics import Semantics
from menid_plan.grounding.state import State
from menid_plan.learning.confidence import delta, gap_by_chance
from menid_plan.learning.counts import Evidence
from menid_plan.learning.curve import Point, read_curve
from menid_plan.learning.events import told_events
from menid_plan.learning.run import CURVE, EVENTS, STORE, RunError
from menid_plan.learning.settings import LearnSettings
from menid_plan.learning.stored import stored_evidence
from menid_plan.mdp.model import Floats, Ints
from menid_plan.model.domain import Domain, Problem
from menid_plan.model.rules import Outcome
from menid_plan.model.text import effects_text
from menid_plan.report.plan import Plan, learned_plan

FILM = "best.gif"


@dataclass(frozen=True, slots=True)
class Place:
    """What was done in an environment; ``failed`` attempts are not among the ``executions``.

    ``course`` has the executions at each point of the curve, ``unexplained`` are those that no rule
    covers.
    """

    name: str
    role: str
    executions: int
    seconds: float
    failed: int
    unexplained: int
    course: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Row:
    """An outcome: its estimate for the target with a credible interval, and how often it was seen.

    ``given`` is the probability that the domain itself writes for the target, None if it does not;
    ``interval`` is None where nothing that was seen bears on the target. ``counts`` are by environment,
    the target first.
    """

    name: str
    effects: str
    estimate: float
    interval: tuple[float, float] | None
    given: float | None
    counts: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Distribution:
    """What was learned of one distribution; ``totals`` and the bounds ``deltas`` by environment."""

    key: DistributionKey
    per: tuple[str, ...]
    rows: tuple[Row, ...]
    totals: tuple[float, ...]
    deltas: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Gap:
    """How far a test is from the target: the outcome whose relative frequencies differ most.

    ``chance`` is how often they differ as much if both have one distribution; see `gap_by_chance`.
    """

    key: DistributionKey
    test: str
    outcome: str
    in_target: float
    in_test: float
    target_total: float
    test_total: float
    chance: float

    @property
    def size(self) -> float:
        """The difference of the frequencies."""
        return abs(self.in_target - self.in_test)


@dataclass(frozen=True, slots=True, eq=False)
class RunReport:
    """A learning run as its folder tells it.

    ``domain`` and ``problem`` are those with which it began, less their comments. ``end`` says how it
    ended, ``notes`` what is missing. ``points`` are those of its curve, ``places`` its environments,
    the target first. ``unseen`` are rules of which there is no count. ``film`` is the GIF file in the
    folder, if there is one.
    """

    folder: Path
    domain: Domain
    problem: Problem
    created: str
    settings: Mapping[str, Any]
    versions: Mapping[str, str]
    end: str
    notes: tuple[str, ...]
    points: tuple[Point, ...]
    places: tuple[Place, ...]
    steps: int
    successes: int | None
    learned: tuple[Distribution, ...]
    unseen: tuple[str, ...]
    gaps: tuple[Gap, ...]
    plan: Plan
    film: bytes | None

    @property
    def target(self) -> Place:
        """The environment whose reward counts."""
        return self.places[0]

    @property
    def last(self) -> Point | None:
        """The last point of the curve; None where there is none."""
        return self.points[-1] if self.points else None

    @property
    def epsilon(self) -> float:
        """The probability with which a bound or an interval may be exceeded."""
        return float(self.settings["learn"]["epsilon"])


def read_run(folder: Path) -> RunReport:
    """Read what there is of a run, which may have been killed or be under way; nothing is changed.

    Raises RunError if there is no run or its curve is damaged, StoreError if the store is.
    """
    path = _store_of(folder)
    notes: list[str] = []
    points = _points(folder, notes)
    events = list(told_events(folder / EVENTS))
    film = _film(folder, notes)
    # After the curve: whoever writes to both stores first what the curve tells of.
    with Store.read(path) as store, store.at_once():
        evidence = stored_evidence(store)
        learn = _learn_settings(store)
        settings = {"params": {}, **store.settings, "learn": learn}
        totals = store.totals()
        order, successes = _history(store, evidence, settings["params"])
        problem, created = store.problem, store.created
    done = points[-1].steps + points[-1].tests if points else 0
    if done > len(order):
        raise RunError(
            f"`{folder / CURVE}` tells of {done} executions, and the store has {len(order)}: "
            "they are not of one run; put back the file that is of another"
        )
    if points and done < len(order):
        notes.append(
            f"{len(order) - done} executions were stored after the last point of the curve; counts and "
            "what was learned have them"
        )
    failed = Counter(str(e.get("environment")) for e in events if e["event"] == "failure")
    courses = _courses(order, len(evidence.environments), points)
    places = tuple(
        Place(
            name, "test" if number else "target", totals[name].executions, totals[name].seconds,
            failed[name], totals[name].unexplained, courses[number],
        )
        for number, name in enumerate(evidence.environments)
    )  # fmt: skip
    seen = [key for key in evidence.keys if evidence.counts(key).any()]
    known = {(key.action, key.rule) for key in seen}
    return RunReport(
        folder, without_comments(evidence.domain), without_comments(problem), created, settings,
        _versions(events), _end(events), tuple(notes), points, places, places[0].executions, successes,
        tuple(_learned(evidence, key, learn) for key in seen),
        tuple(
            f"{action.name}.{rule.name}"
            for action in evidence.domain.actions
            for rule in action.rules
            if (action.name, rule.name) not in known
        ),
        tuple(sorted(_gaps(evidence, seen), key=lambda gap: (-gap.size, gap.key, gap.test))),
        learned_plan(evidence, problem, learn["objective"], settings["params"]), film,
    )  # fmt: skip


def _store_of(folder: Path) -> Path:
    path = folder / STORE
    if not path.is_file():
        raise RunError(
            f"`{folder}` is not the folder of a run: it has no {STORE}; give one that `menid learn -o` "
            "has written"
        )
    if path.stat().st_size == 0:
        raise RunError(f"`{path}` is empty: the run has not begun; `menid learn` begins it anew")
    return path


def _points(folder: Path, notes: list[str]) -> tuple[Point, ...]:
    path = folder / CURVE
    try:
        return read_curve(path)
    except FileNotFoundError:
        notes.append(
            f"{CURVE} is missing, and curves with it; `menid learn --resume` writes it anew"
        )
        return ()
    except ValueError as error:
        raise RunError(
            f"`{path}`, {error}; remove the file, and `menid learn --resume` writes it anew"
        ) from error


def _film(folder: Path, notes: list[str]) -> bytes | None:
    path = folder / FILM
    if not path.is_file():
        return None
    data = path.read_bytes()
    if data.startswith(b"GIF8"):
        return data
    notes.append(f"{FILM} is no GIF image, and was left out")
    return None


def _history(
    store: StoreReader, evidence: Evidence, params: Mapping[str, float]
) -> tuple[Ints, int | None]:
    """Of each execution in turn the number of its environment, and how many ended at the goal."""
    semantics = Semantics(evidence.domain, store.problem, params)
    goals: dict[State, bool] = {}
    order, successes = [], 0
    for experience in store:
        order.append(evidence.environments.index(experience.environment))
        after = experience.after
        if order[-1] == 0:  # in the target
            if after not in goals:
                goals[after] = semantics.is_goal(after)
            successes += goals[after]
    return np.array(order, np.int64), None if store.problem.goal is None else successes


def _learn_settings(store: StoreReader) -> dict[str, Any]:
    """The settings of the loop; where an older run lacks one it had the usual value."""
    try:
        return asdict(LearnSettings(**store.settings.get("learn", {})))
    except (TypeError, MenidError) as error:
        raise RunError(f"the settings in the store `{store.path}` are no run's: {error}") from error


def _courses(order: Ints, environments: int, points: tuple[Point, ...]) -> list[tuple[int, ...]]:
    """The executions at each point, by environment; ``order`` has the environment of each in turn."""
    done = np.array([point.steps + point.tests for point in points], np.int64)
    sums = (np.concatenate(([0], np.cumsum(order == number))) for number in range(environments))
    return [tuple(each[done].tolist()) for each in sums]


def _versions(events: list[dict[str, Any]]) -> dict[str, str]:
    """The versions of what made the run, at its last sitting."""
    found: dict[str, str] = {}
    for event in events:
        versions = event.get("versions")
        if isinstance(versions, dict):
            found = {str(name): str(version) for name, version in versions.items()}
    return found


def _end(events: list[dict[str, Any]]) -> str:
    """How a run ended, as its last event says."""
    ends = [
        e for e in events if e["event"] in ("starts", "resumes", "ended", "interrupted", "failed")
    ]
    match ends[-1]["event"] if ends else "":
        case "ended":
            return "ended"
        case "interrupted":
            return "interrupted; --resume goes on with it"
        case "failed":
            return f"failed: {ends[-1].get('message', 'nobody knows why')}"
        case "":
            return f"not known, since {EVENTS} does not tell"
    return "under way, or killed; --resume goes on with a run that was killed"


def _learned(evidence: Evidence, key: DistributionKey, learn: Mapping[str, Any]) -> Distribution:
    epsilon, method = learn["epsilon"], learn["delta_method"]
    rule, counts = evidence.rule(key), evidence.counts(key)
    given = evidence.given(key, evidence.environments[0])
    estimate = evidence.answer(key).tolist()
    intervals: list[tuple[float, float] | None] = [None] * len(estimate)
    if evidence.knows(key):
        intervals = [
            (low, high) for low, high in evidence.belief(key).intervals(1 - epsilon).tolist()
        ]
    return Distribution(
        key, rule.per,
        tuple(
            Row(
                outcome.name, _effects(outcome), estimate[i], intervals[i],
                None if given is None else float(given[i]), tuple(counts[:, i].tolist()),
            )
            for i, outcome in enumerate(rule.outcomes)
        ),
        tuple(counts.sum(axis=1).tolist()),
        tuple(delta(row, epsilon, method) for row in counts),
    )  # fmt: skip


def _effects(outcome: Outcome) -> str:
    return "whatever else happens" if outcome.is_noise else effects_text(outcome.effects)


def _gaps(evidence: Evidence, keys: list[DistributionKey]) -> Iterator[Gap]:
    """Of each distribution that was seen in the target and in a test."""
    for key in keys:
        counts = evidence.counts(key)
        names = [outcome.name for outcome in evidence.rule(key).outcomes]
        for test, seen in zip(evidence.environments[1:], counts[1:], strict=True):
            if counts[0].any() and seen.any():
                here, there = _shares(counts[0]), _shares(seen)
                widest = int(np.abs(here - there).argmax())
                yield Gap(
                    key, test, names[widest], float(here[widest]), float(there[widest]),
                    float(counts[0].sum()), float(seen.sum()), gap_by_chance(counts[0], seen),
                )  # fmt: skip


def _shares(counts: Floats) -> Floats:
    return np.asarray(counts / counts.sum())


def setting_rows(settings: Mapping[str, Any], head: str = "") -> dict[str, str]:
    """Settings by their names with dots, as JSON."""
    found: dict[str, str] = {}
    for name, value in settings.items():
        if isinstance(value, Mapping) and value:
            found.update(setting_rows(value, f"{head}{name}."))
        else:
            found[head + name] = json.dumps(value, ensure_ascii=False)
    return found
