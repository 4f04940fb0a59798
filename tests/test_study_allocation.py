"""`menid study allocation`: where to act, with random actions, on the drive, and in several steps."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result

import menid_plan
from conftest import ROOT
from menid_plan.model.expressions import evaluate
from menid_plan.studies import pieces
from menid_plan.studies.allocation import LEARNERS, AllocationStudy, Case, drawn
from menid_plan.studies.allocation_tables import behind, curves_png, lost, rewards_csv, tables
from menid_plan.studies.bandits import (
    ALONE,
    GAIN,
    PAPER,
    SIMULATORS,
    TESTING,
    Bandit,
    population,
)
from test_study_estimators import small as small  # a bank that is quickly read

Menid = Callable[..., Result]
FILES = {"drive": ("hdd", "drive"), "assembly": ("assembly", "peg"), "stones": ("stones", "river")}


def study(bank: Path, **more: Any) -> AllocationStudy:
    files = {}
    for name, (folder, problem) in FILES.items():
        domain = menid_plan.read(ROOT / "domains" / folder / "domain.menid").domain
        task = menid_plan.read(ROOT / "domains" / folder / f"{problem}.menid").problem
        assert domain is not None
        assert task is not None
        files[name] = (domain, task)
    settings = {"penalties": (0.0, 5.0), "bandits": 3, "runs": 2, "hours": 0.1, **more}
    return AllocationStudy(files, bank, **settings)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, small: Path) -> tuple[Path, list[Case]]:
    file = tmp_path_factory.mktemp("allocation") / "runs.jsonl"
    return file, study(small).execute(file, 1)


def test_each_problem_has_each_learner(made: tuple[Path, list[Case]], small: Path) -> None:
    _, cases = made
    assert {case.group for case in cases} == {
        "20 random actions", "57 random actions", "several steps",
    }  # fmt: skip
    assert len(cases) == 2 * (2 * len(SIMULATORS) + len(study(small).problems))
    for case in cases:
        number = 2 if case.group == "several steps" else 3
        for name in LEARNERS:
            executed, won, failed, tests = case.counts[name].T
            assert case.rewards[name].shape == (number, len(case.minutes))
            assert (won + failed <= executed).all()
            assert (tests == 0).all() == (name in (PAPER, ALONE))
            if case.name != "assembly":  # a grip that slips costs nothing there
                steps = 0.0 if case.name != "stones" else 1e9  # to land earns nothing
                assert (executed - won - failed <= steps).all()
            # The execution that is under way as the time ends does not count.
            last = np.abs(case.rewards[name][:, -1] - won + case.penalty * failed)
            assert (last <= max(1.0, case.penalty)).all()


def test_nobody_earns_more_than_who_knows_all(made: tuple[Path, list[Case]]) -> None:
    """On average, and but for luck in a few runs."""
    for case in made[1]:
        if case.group == "several steps" and case.name.startswith("drive"):
            assert (case.oracle == case.oracle[0]).all()
        for name in LEARNERS:
            luck = 0.35 * case.oracle.mean() + 3.0
            assert case.rewards[name][:, -1].mean() <= case.oracle.mean() + luck, (case.name, name)


def test_the_same_again_in_several_processes(
    made: tuple[Path, list[Case]], small: Path, tmp_path: Path
) -> None:
    file, cases = made
    again = study(small, bandits=1, runs=2).execute(tmp_path / "runs.jsonl", 2)
    lines = set(file.read_text().splitlines())
    assert set((tmp_path / "runs.jsonl").read_text().splitlines()) <= lines
    of_drive = [case for case in cases if case.group == "several steps"]
    others = [case for case in again if case.group == "several steps"]
    for one, other in zip(of_drive, others, strict=True):
        for name in LEARNERS:
            assert np.array_equal(one.rewards[name], other.rewards[name])


def test_what_is_there_is_not_done_again(
    made: tuple[Path, list[Case]], small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, _ = made
    before = file.read_bytes()
    monkeypatch.setattr(Bandit, "run", lambda _: pytest.fail("done before"))
    study(small).execute(file, 1)
    assert file.read_bytes() == before
    with pytest.raises(pieces.RunsError, match="other settings"):
        study(small, seed=1).execute(file, 1)


def test_tables_figures_and_rows(made: tuple[Path, list[Case]]) -> None:
    _, cases = made
    shown = list(tables(cases))
    assert len(shown) == 3 * 2 * 6
    rewards = shown[0]
    assert rewards.title == "20 random actions, penalty 0: reward after 10 and 60 minutes"
    assert rewards.columns == ("idle", PAPER, TESTING, ALONE, GAIN, "oracle")
    assert [name for name, _ in rewards.rows] == list(SIMULATORS)
    perfect = cases[0]
    early, late = rewards.rows[0][1][4].split("/")
    assert float(early) == pytest.approx(perfect.rewards[GAIN][:, 9].mean(), abs=0.51)
    assert float(late) == pytest.approx(perfect.rewards[GAIN][:, 59].mean(), abs=0.51)
    counted = re.fullmatch(r"(\d+)=(\d+)\+(\d+)", shown[4].rows[0][1][3])
    assert counted is not None
    rows = list(csv.DictReader(rewards_csv(cases).splitlines()))
    last = next(row for row in rows if row["case"] == "perfect" and row["minute"] == "60")
    assert float(last["reward"]) == pytest.approx(
        perfect.rewards[last["learner"]][:, -1].mean(), 1e-5
    )
    assert curves_png(cases, "several steps").startswith(b"\x89PNG")


def test_what_is_told_of_a_case() -> None:
    minutes = 60.0 * np.arange(1.0, 4.0)
    rewards = {
        PAPER: np.array([[1.0, 3.0, 4.0], [1.0, 1.0, 2.0]]),
        TESTING: np.zeros((2, 3)),
        ALONE: np.array([[2.0, 4.0, 9.0], [2.0, 4.0, 7.0]]),
        GAIN: np.array([[0.0, 1.0, 6.0], [0.0, 2.0, 8.0]]),
    }
    counts = {name: np.zeros((2, 4)) for name in LEARNERS}
    case = Case("g", "n", 0.0, minutes, rewards, counts, np.array([9.0, 11.0]))
    assert behind(case) == pytest.approx(10.0)  # 1 of 10, at the first minute
    assert lost(case) == pytest.approx(10.0)
    assert case.regret(GAIN, 3.0).tolist() == [3.0, 3.0]
    assert case.regret(PAPER, 1.0).tolist() == pytest.approx([2.0, 11.0 / 3.0 - 1.0])


def test_random_actions() -> None:
    rng = np.random.default_rng(0)
    p = population(20_000, rng)
    assert np.mean(p < 0.2) == pytest.approx(0.58, abs=0.03)
    assert np.mean(p > 0.8) == pytest.approx(0.14, abs=0.02)
    for name, lie in SIMULATORS.items():
        q = lie(p, rng)
        assert q.shape == p.shape
        assert q.min() >= 0.0
        assert q.max() <= 1.0
        assert np.array_equal(q, p) == (name == "perfect")
    task = Bandit(20, 3, 0, (5.0,))
    found = task.run()
    assert json.loads(json.dumps(found)) == task.run() | {}
    perfect, high = found["perfect"]["5"], found["high"]["5"]
    assert perfect[PAPER] == high[PAPER]
    assert perfect[ALONE] == high[ALONE]
    assert perfect[TESTING] != high[TESTING]
    ends = perfect[GAIN]
    done = ends["successes"][-1] + ends["failures"][-1]
    assert 60 < done <= 120
    # An execution takes 30 s and a test .4 s: neither more nor less than an hour is used.
    assert 3600.0 - 30.0 - 64 * 0.4 <= 30.0 * done + 0.4 * ends["tests"] <= 3600.0 + 30.0


def test_domains_are_drawn_anew(small: Path) -> None:
    domain, problem = study(small).files["stones"]
    one, other = (drawn(domain, problem, np.random.default_rng(seed)) for seed in (1, 2))
    assert one != other
    rule = one.actions[0].rules[0]
    found = [
        [evaluate(cell, {}) for cell in rule.probability_cells(name, (stone,)) or ()]
        for stone in ("a1", "c6")
        for name in ("river", "model")
    ]
    for target, test in zip(found[::2], found[1::2], strict=True):
        assert sum(target) == pytest.approx(1.0)
        assert sum(test) == pytest.approx(1.0)
        assert abs(target[0] - test[0]) < 0.8
    assert one.actions[1] == domain.actions[1]  # what is certain stays so


def test_from_the_command_line(menid: Menid, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    arguments = (
        "study", "allocation", "--bandits", "2", "--runs", "2", "--hours", "0.02", "--penalties", "5",
        "--jobs", "1", "-o", str(folder),
    )  # fmt: skip
    out = menid(*arguments)
    assert out.exit_code == 0, out.output
    assert "57 random actions, penalty 5: how much more gain earns by minute 60 than" in out.output
    assert "…" not in out.output
    told = json.loads((folder / "allocation.json").read_text())
    assert told["settings"] == {
        "penalties": [5.0], "bandits": 2, "runs": 2, "hours": 0.02, "seed": 0,
    }  # fmt: skip
    assert {each["case"] for each in told["cases"]} >= {
        "perfect",
        "assembly",
        "drive: fine by coarse",
    }
    for name in ("20-random-actions", "57-random-actions", "several-steps"):
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    again = menid(*arguments, "--json")
    assert again.exit_code == 0
    assert json.loads(again.stdout) == told
    assert menid(*arguments[:-1], str(folder), "--runs", "1").exit_code == 2
