"""Outcome banks: what is recorded, in what order, and how a recording goes on."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

import menid_plan
from conftest import ROOT
from menid_plan.cli.main import main
from menid_plan.environments import recording
from menid_plan.environments.interface import CannotResetError, EnvironmentFailedError
from menid_plan.environments.pool import Failure
from menid_plan.environments.recording import Progress, jobs, record, situations
from menid_plan.environments.runfile import Bound, parse_run_file
from menid_plan.environments.simulated import SimulatedEnvironment
from menid_plan.errors import LimitError
from menid_plan.experience.store import Store, StoreInputError
from menid_plan.grounding.state import GroundAction, State

DOCUMENT = menid_plan.read(ROOT / "domains" / "hdd" / "bench.menid")
assert DOCUMENT.domain is not None
assert DOCUMENT.problem is not None
DOMAIN, PROBLEM = DOCUMENT.domain, DOCUMENT.problem

RUN = """
[workers]
number = 0

[environment.fine]
kind = "simulated"
role = "target"
duration = 2

[environment.coarse]
kind = "simulated"
duration = 0.5
"""
ACTIONS = 11 + 2 + 8 * 2  # lever, shake, suck in `bench`
STATES = 2  # seated and loose: in the third, the goal, nothing is done


def bound(retries: int = 2) -> Bound:
    found = parse_run_file(
        RUN.replace("duration = 2", f"duration = 2\nretries = {retries}"), "run.toml"
    )
    return found.bind(DOMAIN, PROBLEM)


def open_store(path: Path) -> Store:
    found = bound()
    return Store.create(path, found.domain, found.problem, seed=0, resume=True)


def contents(path: Path) -> list[Any]:
    with Store.read(path) as store:
        return [
            (e.environment, e.state, e.action, e.after, e.seed, e.number, e.explanation)
            for e in store
        ]


def test_every_state_and_action_is_a_situation() -> None:
    found = situations(bound())
    assert len(found) == ACTIONS * STATES
    assert found[0][0] == frozenset(PROBLEM.init)
    assert len(set(found)) == len(found)


def test_numbers_are_those_of_a_run_and_more_executions_keep_the_first() -> None:
    few, more = list(jobs(bound(), 2, 0)), list(jobs(bound(), 5, 0))
    assert more[: len(few)] == few
    assert len({job.seed for job in more}) == len(more)
    assert [j.number for j in more if j.environment == "fine"] == list(range(5 * ACTIONS * STATES))
    tests = Counter((j.action, j.number) for j in more if j.environment == "coarse")
    assert set(tests.values()) == {1}
    assert {n for _, n in tests} == set(range(5 * STATES))


def test_each_is_executed_so_often_and_explained(tmp_path: Path) -> None:
    seen: list[Progress] = []
    with open_store(tmp_path / "bank") as store:
        found = record(bound(), store, 4, progress=seen.append)
    assert found == Progress(4 * 2 * ACTIONS * STATES, 4 * 2 * ACTIONS * STATES, 0)
    assert seen[-1] == found
    rows = contents(tmp_path / "bank")
    per = Counter((environment, state, action) for environment, state, action, *_ in rows)
    assert set(per.values()) == {4}
    assert all(row[-1] is not None for row in rows)


@pytest.mark.parametrize("stop", [1, 7, 40])
def test_what_was_interrupted_goes_on_to_the_same(tmp_path: Path, stop: int) -> None:
    with open_store(tmp_path / "whole") as store:
        record(bound(), store, 3)
    count = 0

    original = SimulatedEnvironment.execute

    def interrupted(self: SimulatedEnvironment, action: GroundAction) -> Any:
        nonlocal count
        count += 1
        if count > stop:
            raise KeyboardInterrupt
        return original(self, action)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SimulatedEnvironment, "execute", interrupted)
        with open_store(tmp_path / "parts") as store, pytest.raises(KeyboardInterrupt):
            record(bound(), store, 3, workers=0)
    with open_store(tmp_path / "parts") as store:
        record(bound(), store, 3, workers=2)
    assert contents(tmp_path / "parts") == contents(tmp_path / "whole")


def test_what_fails_each_time_is_left_out_and_tried_again_later(tmp_path: Path) -> None:
    original = SimulatedEnvironment.execute

    def broken(self: SimulatedEnvironment, action: GroundAction) -> Any:
        if action.arguments == ("n3",):
            raise RuntimeError("it broke")
        return original(self, action)

    failures: list[Failure] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SimulatedEnvironment, "execute", broken)
        with open_store(tmp_path / "bank") as store:
            found = record(bound(0), store, 2, workers=0, failed=failures.append)
    assert found.failed == 2 * 2 * STATES
    assert "it broke" in str(failures[0])
    with open_store(tmp_path / "bank") as store:
        again = record(bound(), store, 2, workers=0)
    assert again == Progress(again.wanted, again.wanted, 0)


def test_where_everything_fails_it_ends(tmp_path: Path) -> None:
    def broken(self: SimulatedEnvironment, action: GroundAction) -> Any:
        raise RuntimeError("it broke")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SimulatedEnvironment, "execute", broken)
        with (
            open_store(tmp_path / "bank") as store,
            pytest.raises(
                EnvironmentFailedError, match=r"first 10 executions all failed.*it broke"
            ),
        ):
            record(bound(0), store, 2, workers=0)


def test_problems_with_too_many_states_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording, "MAX_STATES", 2)
    with pytest.raises(LimitError, match="`bench` has more than 2 states"):
        situations(bound())


# -------------------------------------------------------------------------------- the command


def call(folder: Path, *arguments: str) -> Result:
    (folder / "run.toml").write_text(RUN)
    bench = str(ROOT / "domains" / "hdd" / "bench.menid")
    run = str(folder / "run.toml")
    return CliRunner().invoke(main, ["hdd", "record", bench, "--run", run, *arguments])


def test_the_command_records_and_the_bank_is_replayed(tmp_path: Path) -> None:
    bank = str(tmp_path / "bank.sqlite")
    found = call(tmp_path, "--executions", "3", "-o", bank)
    assert found.exit_code == 0, found.output
    assert found.stdout == f"{bank}: {3 * 2 * ACTIONS * STATES} executions\n"
    replay = RUN.replace('"simulated"', '"recorded"\nsettings = { store = "bank.sqlite" }')
    (tmp_path / "replay.toml").write_text(replay)
    bench = str(ROOT / "domains" / "hdd" / "bench.menid")
    learned = CliRunner().invoke(
        main,
        ["learn", bench, "--run", str(tmp_path / "replay.toml"), "--steps", "5", "-o",
         str(tmp_path / "learned")],
    )  # fmt: skip
    assert learned.exit_code == 0, learned.output
    assert "5 steps" in learned.output


def test_another_seed_or_a_missing_folder_is_refused(tmp_path: Path) -> None:
    bank = str(tmp_path / "bank.sqlite")
    assert call(tmp_path, "--executions", "1", "-o", bank).exit_code == 0
    other = call(tmp_path, "--executions", "2", "-o", bank, "--seed", "4")
    assert other.exit_code == 2
    assert "was recorded with --seed 0" in other.output
    nowhere = call(tmp_path, "--executions", "1", "-o", str(tmp_path / "no" / "bank"))
    assert nowhere.exit_code == 2
    assert "there is no folder" in nowhere.output


def test_a_store_of_something_else_is_left_alone(tmp_path: Path) -> None:
    bench = str(ROOT / "domains" / "hdd" / "bench.menid")
    (tmp_path / "run.toml").write_text(RUN)
    learned = CliRunner().invoke(
        main,
        ["learn", bench, "--run", str(tmp_path / "run.toml"), "--steps", "5",
         "-o", str(tmp_path / "learned")],
    )  # fmt: skip
    assert learned.exit_code == 0, learned.output
    store = tmp_path / "learned" / "experiences.sqlite"
    before = contents(store)
    found = call(tmp_path, "--executions", "1", "-o", str(store))
    assert found.exit_code == 3
    assert "is the store of a learning run" in found.output
    assert contents(store) == before


def test_other_settings_of_an_environment_are_named(tmp_path: Path) -> None:
    bank = tmp_path / "bank.sqlite"
    assert call(tmp_path, "--executions", "1", "-o", str(bank)).exit_code == 0
    before = contents(bank)
    (tmp_path / "run.toml").write_text(RUN.replace("duration = 0.5", "duration = 0.25"))
    bench = str(ROOT / "domains" / "hdd" / "bench.menid")
    found = CliRunner().invoke(
        main,
        ["hdd", "record", bench, "--run", str(tmp_path / "run.toml"), "--executions", "2",
         "-o", str(bank)],
    )  # fmt: skip
    assert found.exit_code == 3
    assert "was recorded with coarse.duration = 0.5, and this one has 0.25" in found.output
    assert contents(bank) == before


def test_an_execution_that_is_not_the_recordings_is_found(tmp_path: Path) -> None:
    path = tmp_path / "bank.sqlite"
    with open_store(path) as store:
        record(bound(), store, 1, 1, workers=0)
        with pytest.raises(StoreInputError, match="has another execution 0 of"):
            record(bound(), store, 1, 0, workers=0)


def test_a_state_that_can_not_be_had_is_left_out_and_told_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seated = frozenset(PROBLEM.init)
    reset = SimulatedEnvironment.reset

    def only_seated(self: SimulatedEnvironment, state: State | None, seed: int) -> State:
        if state not in (None, seated):
            raise CannotResetError("it does not stay like that")
        return reset(self, state, seed)

    monkeypatch.setattr(SimulatedEnvironment, "reset", only_seated)
    told: list[str] = []
    with open_store(tmp_path / "bank.sqlite") as store:
        found = record(bound(), store, 2, workers=0, left_out=told.append)
    assert (found.recorded, found.failed) == (2 * 2 * ACTIONS, 2 * 2 * ACTIONS)
    assert len(told) == 2  # in each of the two environments
    assert "loose(board)` in `fine`: " in told[0]
    assert told[0].endswith("it does not stay like that")


def test_more_than_can_ever_be_executed_is_refused(tmp_path: Path) -> None:
    found = call(tmp_path, "--executions", "1000000000", "-o", str(tmp_path / "bank.sqlite"))
    assert found.exit_code == 6
    assert "executions to be recorded; at most 5000000 are" in found.output


def test_the_shipped_bank_is_that_of_the_shipped_domain(tmp_path: Path) -> None:
    """So that a user can go on with it."""
    folder = ROOT / "domains" / "hdd"
    bank = tmp_path / "bank.sqlite"
    bank.write_bytes((folder / "bank.sqlite").read_bytes())
    found = CliRunner().invoke(
        main,
        ["hdd", "record", str(folder / "domain.menid"), str(folder / "drive.menid"), "--run",
         str(folder / "robot.toml"), "--executions", "100", "-o", str(bank)],
    )  # fmt: skip
    assert found.exit_code == 0, found.output
    assert found.stdout == f"{bank}: 34200 executions\n"
