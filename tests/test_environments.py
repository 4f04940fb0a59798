"""Kinds of environments: simulated and recorded ones, settings, and the session around each."""

from __future__ import annotations

import json
import math
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import pytest

import menid_plan
from conftest import ROOT
from environments_faulty import Faulty
from menid_plan.environments.atoms import Vocabulary, state_texts
from menid_plan.environments.interface import (
    CannotResetError,
    Capabilities,
    EnvironmentFailedError,
    Execution,
)
from menid_plan.environments.registry import (
    EnvironmentSpec,
    UnknownKindError,
    kind_entry_points,
    load_kind,
    make,
)
from menid_plan.environments.seeds import seed_of
from menid_plan.environments.session import Session
from menid_plan.environments.settings import SettingError, read_settings
from menid_plan.environments.simulated import Simulated
from menid_plan.errors import MeaningError
from menid_plan.experience.record import Experience
from menid_plan.experience.store import Store
from menid_plan.grounding.semantics import Semantics
from menid_plan.grounding.state import GroundAction
from menid_plan.model.formulas import GroundAtom

DOCUMENT = menid_plan.read(ROOT / "domains" / "hdd" / "bench.menid")
assert DOCUMENT.domain is not None
assert DOCUMENT.problem is not None
DOMAIN, PROBLEM = DOCUMENT.domain, DOCUMENT.problem
INITIAL = frozenset(PROBLEM.init)
LEVER = GroundAction("lever", ("n8",))


def spec(kind: Any, **options: Any) -> EnvironmentSpec:
    return EnvironmentSpec("coarse", kind, DOMAIN, PROBLEM, **options)


# ------------------------------------------------------------------------------------- simulated


def test_outcomes_have_the_written_probabilities_and_rewards() -> None:
    environment = spec(Simulated(duration=0.4)).open()
    wanted: Counter[Any] = Counter()
    for t in Semantics(DOMAIN, PROBLEM).transitions(INITIAL, LEVER, "coarse"):
        wanted[t.state, t.reward] += t.probability  # type: ignore[assignment]
    drawn: Counter[Any] = Counter()
    n = 4000
    for seed in range(n):
        environment.reset(INITIAL, seed)
        found = environment.execute(LEVER)
        assert found.duration == 0.4
        assert environment.state() == found.state
        drawn[found.state, found.reward] += 1
    assert set(drawn) <= set(wanted)
    for key, probability in wanted.items():
        # six standard deviations
        slack = 6 * math.sqrt(probability * (1 - probability) / n) + 1e-9
        assert abs(drawn[key] / n - probability) <= slack


def test_the_same_seed_gives_the_same_and_the_state_evolves() -> None:
    def walk(seed: int) -> list[Any]:
        environment = spec(Simulated()).open()
        environment.reset(None, seed)
        semantics = Semantics(DOMAIN, PROBLEM)
        seen = []
        for _ in range(6):
            actions = semantics.applicable(environment.state())
            if not actions:
                break
            seen.append(environment.execute(actions[len(seen) % len(actions)][0]))
        return seen

    assert walk(3) == walk(3)
    assert len({tuple(e.state for e in walk(seed)) for seed in range(20)}) > 1


def test_another_column_other_params_and_durations_by_action() -> None:
    settings = {
        "column": "robot",
        "params": {"win": 7},
        "duration": {"lever": 1, "shake": 2.5, "suck": 3},
    }
    environment = make("simulated", settings, DOMAIN, PROBLEM, "coarse")
    environment.reset(None, 0)
    found = environment.execute(GroundAction("shake", ("s10",)))
    assert found.duration == 2.5
    rewards = {
        t.reward
        for t in Semantics(DOMAIN, PROBLEM, {"win": 7}).transitions(
            INITIAL, GroundAction("shake", ("s10",)), "robot"
        )
    }
    assert found.reward in rewards


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"column": "rbot"}, "settings.column: `rbot`: unknown environment; did you mean `robot`?"),
        ({"params": {"wn": 1}}, "settings.params.wn: unknown param; did you mean `win`?"),
        ({"duration": {"lifer": 1}}, "settings.duration.lifer: unknown action; did you mean"),
        ({"duration": {"lever": 1}}, "settings.duration: there is none for action `shake`"),
        ({"duration": -1}, "duration: expected at least 0, not -1"),
        ({"duration": {"lever": -1}}, "duration.lever: expected at least 0, not -1"),
        ({"duration": "soon"}, 'duration: expected a number or a table of numbers, not "soon"'),
        ({"duratoin": 1}, "duratoin: unknown key; did you mean `duration`?"),
        ({"column": 3}, "column: expected a text, not 3"),
        ({"params": {"win": True}}, "params.win: expected a number, not true"),
        ({"duration": math.nan}, "duration: expected a number"),
    ],
)
def test_wrong_settings_are_named(settings: dict[str, object], message: str) -> None:
    with pytest.raises(SettingError) as caught:
        make("simulated", settings, DOMAIN, PROBLEM, "coarse")
    assert message in str(caught.value)


def test_what_does_not_apply_is_no_outcome() -> None:
    environment = spec(Simulated()).open()
    with pytest.raises(EnvironmentFailedError, match="was not reset"):
        environment.execute(LEVER)
    environment.reset(frozenset(), 0)
    with pytest.raises(EnvironmentFailedError, match=r"`lever\(n8\)` does not apply in the state"):
        environment.execute(LEVER)
    environment.reset(None, 0)
    with pytest.raises(MeaningError, match="there is no action `push`"):
        environment.execute(GroundAction("push"))


def test_nominal_durations_win() -> None:
    environment = spec(Simulated(duration=2), duration={"lever": 30.0}).open()
    environment.reset(INITIAL, 0)
    assert environment.execute(LEVER).duration == 30.0
    environment.reset(INITIAL, 0)
    assert environment.execute(GroundAction("shake", ("s10",))).duration == 2.0


# -------------------------------------------------------------------------------------- recorded


AFTERS = [
    frozenset({GroundAtom("on-table", ("board",))}),
    frozenset({GroundAtom("in", ("board", "tray")), GroundAtom("loose", ("board",))}),
    INITIAL,
]


def rows() -> list[Experience]:
    return [
        Experience("coarse", INITIAL, LEVER, after, float(i), 0.5 + i, i, 0.0, None, i)
        for i, after in enumerate(AFTERS)
    ]


def bank(folder: Path, form: str) -> str:
    if form == "store":
        with Store.create(folder / "seen.db", DOMAIN, PROBLEM) as store:
            store.add(rows())
        return "seen.db"
    lines = [
        json.dumps(
            {
                "environment": row.environment,
                "state": state_texts(row.state),
                "action": str(row.action),
                "after": state_texts(row.after),
                "reward": row.reward,
                "duration": row.duration,
            }
        )
        for row in rows()
    ]
    other = '{"environment": "fine", "state": [], "action": "lever(n8)", "after": []}'
    (folder / "seen.jsonl").write_text("\n".join([*lines, "", other]) + "\n")
    return "seen.jsonl"


def test_a_bank_may_be_the_folder_of_a_run(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    bank(tmp_path / "run", "store")
    (tmp_path / "run" / "seen.db").rename(tmp_path / "run" / "experiences.sqlite")
    found = make("recorded", {"store": "run"}, DOMAIN, PROBLEM, "coarse", folder=tmp_path)
    assert found.capabilities.note == "3 experiences of 1 pairs of state and action"


@pytest.mark.parametrize("duration", [1e308, float("nan"), float("inf"), -1.0, 2e9])
def test_durations_that_cannot_be(duration: float) -> None:
    class Slow:
        capabilities = Capabilities()

        def execute(self, action: GroundAction) -> Execution:
            return Execution(INITIAL, None, duration)

    session = Session(Slow(), DOMAIN, PROBLEM, "coarse")  # type: ignore[arg-type]
    with pytest.raises(EnvironmentFailedError, match=r"environment `coarse`, .*: the duration is"):
        session.execute(LEVER)


def test_an_environment_that_ends_the_program() -> None:
    class Quitter:
        capabilities = Capabilities()

        def execute(self, action: GroundAction) -> Execution:
            sys.exit(4)

    session = Session(Quitter(), DOMAIN, PROBLEM, "coarse")  # type: ignore[arg-type]
    with pytest.raises(EnvironmentFailedError, match=r"`coarse`: it called sys.exit\(4\)"):
        session.execute(LEVER)


@pytest.mark.parametrize("form", ["store", "lines"])
def test_a_bank_gives_what_was_seen_with_equal_chances(tmp_path: Path, form: str) -> None:
    settings = {"store": bank(tmp_path, form)}
    environment = make("recorded", settings, DOMAIN, PROBLEM, "coarse", folder=tmp_path)
    assert environment.capabilities.note == "3 experiences of 1 pairs of state and action"
    counts = Counter()
    for seed in range(1500):
        assert environment.reset(INITIAL, seed) == INITIAL
        found = environment.execute(LEVER)
        index = AFTERS.index(found.state)
        assert (found.reward, found.duration) == (float(index), 0.5 + index)
        counts[index] += 1
        if seed < 5:
            environment.reset(INITIAL, seed)
            assert environment.execute(LEVER) == found
    assert min(counts[i] for i in range(3)) > 400
    environment.reset(INITIAL, 0)
    with pytest.raises(EnvironmentFailedError, match=r"nothing was recorded of `lever\(n3\)`"):
        environment.execute(GroundAction("lever", ("n3",)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "seen.jsonl:1: "),
        ('{"state": [], "action": "lever(n8)"}', "'after' is missing"),
        ('{"state": ["in(board)"], "action": "lever(n8)", "after": []}', "`in(board)`: `in` has 2"),
        ('{"state": [], "action": "lever(tray)", "after": []}', "`tray` is not of type edge"),
        ('{"state": [], "action": "lifer(n8)", "after": []}', "unknown action; did you mean"),
        ('{"state": "x", "action": "lever(n8)", "after": []}', "a state is a list of texts"),
        ("[1]", "seen.jsonl:1: "),
        ("", "has no experiences of environment `coarse`"),
    ],
)
def test_a_broken_bank_is_told(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "seen.jsonl").write_text(text)
    with pytest.raises(SettingError) as caught:
        make("recorded", {"store": "seen.jsonl"}, DOMAIN, PROBLEM, "coarse", folder=tmp_path)
    assert "environment.coarse.settings.store" in str(caught.value)
    assert message in str(caught.value)


def test_no_bank(tmp_path: Path) -> None:
    with pytest.raises(SettingError, match="there is no file"):
        make("recorded", {"store": "none.db"}, DOMAIN, PROBLEM, "coarse", folder=tmp_path)
    with pytest.raises(SettingError, match="store: it is missing; expected a text"):
        make("recorded", {}, DOMAIN, PROBLEM, "coarse", folder=tmp_path)


# --------------------------------------------------------------------------------------- session


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("nan", "`lever(n8)`: the reward is nan"),
        ("negative", "`lever(n8)`: the duration is -1.0 s"),
        ("list", "a state is a frozenset of atoms, not a list"),
        ("unknown-atom", "there is no predicate `nowhere`"),
        ("raise", "ZeroDivisionError: of all things"),
        ("fail", "environment `coarse`: the gripper is stuck"),
    ],
)
def test_what_breaks_the_protocol_is_a_failure(fault: str, message: str) -> None:
    session = spec(Faulty(fault)).open()
    session.reset(INITIAL, 0)
    with pytest.raises(EnvironmentFailedError) as caught:
        session.execute(LEVER)
    assert message in str(caught.value)
    assert "`coarse`" in str(caught.value)


def test_a_reset_that_ends_elsewhere() -> None:
    with pytest.raises(CannotResetError, match=r"without in\(board, tray\)"):
        spec(Faulty("resets-elsewhere")).open().reset(INITIAL, 0)
    with pytest.raises(CannotResetError, match="environment `coarse`: not there"):
        spec(Faulty("cannot-reset")).open().reset(INITIAL, 0)


# ------------------------------------------------------------------------------ kinds and settings


def test_kinds_are_found_by_entry_points() -> None:
    names = {"simulated", "recorded", "process", "gymnasium"}
    assert names <= set(kind_entry_points())
    for name in names:
        assert load_kind(name).name == name
    with pytest.raises(UnknownKindError, match="did you mean `simulated`"):
        load_kind("simulate")


@dataclass(frozen=True)
class Inner:
    depth: int = 1


@dataclass(frozen=True)
class Settings:
    need: float
    how: Literal["fast", "slow"] = "fast"
    names: tuple[str, ...] = ()
    inner: Inner | None = None
    flag: bool = False
    anything: object = None
    shared: ClassVar[int] = 1


def test_settings_of_every_type() -> None:
    table = {
        "need": 3, "how": "slow", "names": ["a", "b"], "inner": {"depth": 4}, "flag": True,
        "anything": {"x": [1]},
    }  # fmt: skip
    found, faults = read_settings(Settings, table)
    assert faults == []
    assert found == Settings(3.0, "slow", ("a", "b"), Inner(4), True, {"x": [1]})
    assert isinstance(found.need, float)


def test_all_faults_of_a_table_are_told_at_once() -> None:
    table = {
        "how": "quick", "names": ["a", 1], "inner": {"dept": 4}, "flag": 1, "neeed": 1, "shared": 2,
    }  # fmt: skip
    found, faults = read_settings(Settings, table, "learn")
    assert found is None
    assert faults == [
        "learn.neeed: unknown key; did you mean `need`?",
        "learn.shared: unknown key; there are: anything, flag, how, inner, names, need",
        "learn.need: it is missing; expected a number",
        'learn.how: expected "fast" or "slow", not "quick"',
        "learn.names[1]: expected a text, not 1",
        "learn.inner.dept: unknown key; did you mean `depth`?",
        "learn.flag: expected true or false, not 1",
    ]


# ----------------------------------------------------------------------------------------- seeds


def test_seeds_follow_from_what_an_execution_is() -> None:
    parts = [(0, "coarse", "lever(n8)", k) for k in range(1000)]
    parts += [(1, "coarse", "lever(n8)", 0), (0, "fine", "lever(n8)", 0), (0, "coarselever(n8)", 0)]
    seeds = [seed_of(*each) for each in parts]
    assert len(set(seeds)) == len(seeds)
    assert all(0 <= seed < 2**53 for seed in seeds)
    assert max(seeds) > 2**52
    assert seed_of(7) == 3118213489093189  # the same for ever, or old runs can't be repeated


# ----------------------------------------------------------------------------------------- atoms


def test_atoms_and_actions_as_texts() -> None:
    vocabulary = Vocabulary(DOMAIN, PROBLEM)
    assert vocabulary.atom(" in ( board , tray ) ") == GroundAtom("in", ("board", "tray"))
    assert vocabulary.action("lever(n8)") == LEVER
    assert vocabulary.state(state_texts(INITIAL)) == INITIAL


@pytest.mark.parametrize(
    "text", ["", "in", "in(board", "in(tray, board)", "clear(board)", "on(x)", "in(a,,b)", "in(a)x"]
)
def test_texts_that_are_no_atoms(text: str) -> None:
    with pytest.raises(MeaningError):
        Vocabulary(DOMAIN, PROBLEM).atom(text)
