"""`menid study learning`: the paper's protocol on the hard drive, from the bank."""

from __future__ import annotations

import contextlib
import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import Result

import menid_plan
from conftest import ROOT
from menid_plan.environments.runfile import read_run_file
from menid_plan.experience.store import Store
from menid_plan.learning.curve import Point
from menid_plan.learning.run import STORE
from menid_plan.studies import runs
from menid_plan.studies.learning import Curve, Interval, LearningStudy, Panel
from servers import RUN

Menid = Callable[..., Result]

DRIVE = ROOT / "domains" / "hdd"
SHORT = ("--target", "fine", "--penalties", "0,5", "--hours", "0.05", "--runs", "2", "--jobs", "1")


def study(**more: Any) -> LearningStudy:
    domain = menid_plan.read(DRIVE / "domain.menid").domain
    problem = menid_plan.read(DRIVE / "drive.menid").problem
    assert domain is not None
    assert problem is not None
    return LearningStudy(domain, problem, DRIVE / "bank.sqlite", **more)


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> tuple[LearningStudy, Path, list[Panel]]:
    file = tmp_path_factory.mktemp("learning") / "runs.jsonl"
    made = study(hours=0.05, penalties=(5.0,), runs=2)
    return made, file, made.execute(file, 1)


def test_a_run_is_what_it_says(short: tuple[LearningStudy, Path, list[Panel]]) -> None:
    _, _, panels = short
    assert [panel.name for panel in panels] == ["simulation-5", "robot-5"]
    for panel in panels:
        *tested, alone = panel.curves
        assert all(sum(r.executions.values()) > r.steps for c in tested for r in c.results)
        for result in alone.results:
            assert list(result.executions) == [made_target(panel)]
            # The drive is reset after each success, and after a failure nothing is.
            assert result.successes <= result.episodes <= result.successes + 1
        for curve in panel.curves:
            assert curve.reward.shape == (2, 19)
            for result in curve.results:
                failures = result.steps - result.successes
                assert result.reward[0] == 0.0
                # The last execution may end after the last time of the grid.
                assert abs(result.reward[-1] - (result.successes - 5 * failures)) in (0.0, 1.0, 5.0)
            assert curve.results[0].reward != curve.results[1].reward


def made_target(panel: Panel) -> str:
    return {"simulation": "fine", "robot": "robot"}[panel.study]


def test_rewards_are_those_at_the_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is earned at 10 s counts at 10 s, and not before."""
    made = study(hours=0.01, penalties=(5.0,), runs=1, studies=("robot",), every=6.0)

    class Learning:
        evidence = SimpleNamespace(keys=(), domain=made.domain)

        def __init__(self, *_: object, watch: Callable[[Point], None], **__: object) -> None:
            self.watch = watch

        def learn(self) -> Any:
            for seconds, reward in ((1.0, -5.0), (12.0, -4.0), (13.0, -3.0), (40.0, -2.0)):
                self.watch(Point(seconds, reward, 0, 0, 0, "step"))
            return runs.Result("", (), {}, 0, 0, 0)

    monkeypatch.setattr(runs, "Run", Learning)
    (panel,) = made.execute(tmp_path / "runs.jsonl", 1)
    assert made.grid.tolist() == [0, 6, 12, 18, 24, 30, 36]
    assert panel.curves[0].reward.tolist() == [[0, -5, -4, -3, -3, -3, -3]]


def test_runs_are_not_done_twice(
    short: tuple[LearningStudy, Path, list[Panel]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, file, panels = short
    lines = file.read_bytes().splitlines(keepends=True)
    copy = tmp_path / "runs.jsonl"
    copy.write_bytes(b"".join(lines[:-1]) + lines[-1][:20])  # a kill has cut the last
    done = []
    real = runs.run

    def counted(wanted: runs.Wanted, *rest: Any) -> runs.Result:
        done.append(wanted.name)
        return real(wanted, *rest)

    monkeypatch.setattr(runs, "run", counted)
    again = made.execute(copy, 1)
    assert done == [json.loads(lines[-1])["name"]]
    assert sorted(copy.read_bytes().splitlines()) == sorted(file.read_bytes().splitlines())
    assert [made.as_csv(p) for p in again] == [made.as_csv(p) for p in panels]
    more = replace(made, runs=3).execute(copy, 1)
    assert len(done) == 1 + 5
    assert [len(curve.results) for panel in more for curve in panel.curves] == [3] * 5


def test_an_interrupted_run_is_gone_on_with(
    short: tuple[LearningStudy, Path, list[Panel]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, file, _ = short
    copy = tmp_path / "runs.jsonl"
    points = 0
    real = runs.Run

    def stopping(*arguments: Any, **options: Any) -> Any:
        watch = options.pop("watch")

        def counted(point: Point) -> None:
            nonlocal points
            points += 1
            watch(point)
            if points == 30:
                raise KeyboardInterrupt

        return real(*arguments, watch=counted, **options)

    monkeypatch.setattr(runs, "Run", stopping)
    with pytest.raises(KeyboardInterrupt):
        made.execute(copy, 1)
    assert (tmp_path / "runs").is_dir()
    made.execute(copy, 1)
    assert sorted(copy.read_bytes().splitlines()) == sorted(file.read_bytes().splitlines())
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("there", [(), (STORE,)])
def test_a_run_killed_as_it_began_is_gone_on_with(
    short: tuple[LearningStudy, Path, list[Panel]], tmp_path: Path, there: tuple[str, ...]
) -> None:
    """Of its folder there is nothing in it yet, or a store without a byte."""
    made, file, _ = short
    for line in file.read_text().splitlines():
        folder = tmp_path / "runs" / json.loads(line)["name"]
        folder.mkdir(parents=True)
        for name in there:
            (folder / name).touch()
    made.execute(tmp_path / "runs.jsonl", 1)
    both = [sorted(path.read_bytes().splitlines()) for path in (file, tmp_path / "runs.jsonl")]
    assert both[0] == both[1]


def test_in_several_processes(
    short: tuple[LearningStudy, Path, list[Panel]], tmp_path: Path
) -> None:
    made, file, _ = short
    made.execute(tmp_path / "runs.jsonl", 2)
    both = [sorted(path.read_bytes().splitlines()) for path in (file, tmp_path / "runs.jsonl")]
    assert both[0] == both[1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda file: file.write_text("{}\n"), "line 1: it is no run of a study"),
        (lambda file: file.write_text("[]\n"), "line 1: it is no run of a study"),
        (lambda file: None, "has runs with other settings"),
    ],
)
def test_a_file_of_something_else(
    short: tuple[LearningStudy, Path, list[Panel]], tmp_path: Path, change: Any, message: str
) -> None:
    made, file, _ = short
    copy = tmp_path / "runs.jsonl"
    shutil.copy(file, copy)
    change(copy)
    before = copy.read_bytes()
    with pytest.raises(runs.RunsError, match=message):
        replace(made, m=3.0).execute(copy, 1)
    assert copy.read_bytes() == before


def test_measures() -> None:
    """By hand, for curves whose every value is known."""
    grid = np.arange(7)  # an hour, every ten minutes
    rewards = {"with": [[0, -3, 0, 3, 6, 9, 12]] * 2, "without": [grid * 2, grid * 3]}
    learners = study(runs=2)
    result = runs.Result("", (), {"fine": 10, "coarse": 7}, 10, 9, 8)
    (tested, alone) = (
        Curve(replace(curve_learner, name=name), np.array(rewards[name], float), (result, result))
        for curve_learner, name in zip(_learners(), rewards, strict=True)
    )
    panel = Panel("simulation", 5.0, (tested, alone))
    found = panel.measures(1.0)
    assert {key: values.tolist() for key, values in found["with"].items()} == {
        "reward at 10 minutes": [-3, -3],
        "reward at the end": [12, 12],
        "lowest reward": [-3, -3],
        "reward a minute, late": pytest.approx([0.3, 0.3]),
        "executions": [10, 10],
        "failures": [2, 2],
        "tests": [7, 7],
    }
    assert found["without"]["lowest reward"].tolist() == [0, 0]
    more = panel.differences(1.0)["with"]
    # The differences are 0 and -6: Student's t with one degree of freedom.
    assert more["reward at the end"].mean == -3
    assert more["reward at the end"].half == pytest.approx(12.706 * 3, rel=1e-4)
    assert learners.as_json([panel])["panels"][0]["differences"]["with"]["reward at the end"] == {
        "mean": -3, "half_width_95": pytest.approx(38.1186, rel=1e-4),
    }  # fmt: skip
    assert np.isnan(Interval.of(np.ones(1)).half)


def _learners() -> Any:
    from menid_plan.studies.learning import SETTINGS

    return SETTINGS["simulation"].learners


def test_the_command(menid: Menid, tmp_path: Path) -> None:
    result = menid("study", "learning", "-o", "out", *SHORT)
    assert result.exit_code == 0, result.output
    out = tmp_path / "out"
    assert sorted(path.name for path in out.iterdir() if path.suffix != ".lock") == [
        "learning-runs.jsonl", "learning.json",
        "simulation-0.csv", "simulation-0.png", "simulation-5.csv", "simulation-5.png",
    ]  # fmt: skip
    assert "target fine, penalty 5\n" in result.stdout
    first = {path.name: path.read_bytes() for path in out.iterdir()}
    with (out / "simulation-5.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["seconds"]) for row in rows] == list(range(0, 181, 10))
    last = rows[-1]
    each = [float(last[f"no tests: run {i}"]) for i in range(2)]
    assert float(last["no tests: mean"]) == pytest.approx(np.mean(each), rel=1e-5)
    assert float(last["no tests: sd"]) == pytest.approx(np.std(each, ddof=1), rel=1e-5)
    again = menid("study", "learning", "-o", "again", *SHORT, "--json")
    assert json.loads(again.stdout) == json.loads(first["learning.json"])
    for path in (tmp_path / "again").iterdir():
        assert path.read_bytes() == first[path.name]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--penalties", "5,x"), "--penalties: `5,x` is no list of numbers"),
        (("--penalties", "-1"), "they must be finite, and not below 0"),
        (("--live", "--bank", str(DRIVE / "bank.sqlite")), "--bank: with --live"),
        (("--runs", "0"), "--runs"),
    ],
)
def test_wrong_usage(menid: Menid, options: tuple[str, ...], message: str) -> None:
    result = menid("study", "learning", "-o", "out", *options)
    assert result.exit_code == 2, result.output
    assert message in result.stderr


def test_live(tmp_path: Path) -> None:
    """A few executions in the scenes themselves."""
    pytest.importorskip("pybullet")
    live = read_run_file(DRIVE / "robot.toml")
    made = study(live=live, hours=0.002, penalties=(5.0,), runs=1, studies=("simulation",))
    (panel,) = made.execute(tmp_path / "runs.jsonl", 1)
    tested, alone = (curve.results[0] for curve in panel.curves)
    assert tested.executions["coarse"] > 0
    assert alone.executions.keys() == {"fine"}
    assert alone.steps > 2
    assert made.origin() != replace(made, live=None).origin()


def test_the_bank_has_enough() -> None:
    """Replaying it does not repeat itself visibly: 200 of each action in each environment."""
    seen: dict[tuple[str, Any], int] = {}
    with Store.read(DRIVE / "bank.sqlite") as store:
        for each in store:
            key = each.environment, each.action
            seen[key] = seen.get(key, 0) + 1
    assert len(seen) == 3 * 57
    assert min(seen.values()) >= 200


def _running(group: int) -> list[str]:
    """The processes of a group that have not ended."""
    found = subprocess.run(
        ["ps", "-A", "-o", "pgid=,stat=,args="], capture_output=True, text=True, check=True
    ).stdout
    rows = [line.split(None, 2) for line in found.splitlines()]
    return [row[2] for row in rows if row[0] == str(group) and not row[1].startswith("Z")]


@pytest.mark.skipif(shutil.which("ps") is None, reason="there is no ps")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGINT"])
def test_a_signal_ends_all_processes(
    short: tuple[LearningStudy, Path, list[Panel]], tmp_path: Path, name: str
) -> None:
    """And the same command goes on where it was."""
    _, file, _ = short
    options = ["--penalties", "5", "--hours", "0.05", "--runs", "2", "--jobs", "2"]
    code = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n" + RUN
    process = subprocess.Popen(
        [sys.executable, "-c", code, "study", "learning", "-o", "out", *options],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    try:
        assert process.stderr is not None
        until = time.monotonic() + 120
        while "1 of 10 runs" not in process.stderr.readline() and time.monotonic() < until:
            pass
        process.send_signal(getattr(signal, name))
        _, said = process.communicate(timeout=60)
        assert process.returncode != 0
        assert "Traceback" not in said
        until = time.monotonic() + 20
        while (left := _running(process.pid)) and time.monotonic() < until:
            time.sleep(0.1)
        assert not left
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    made = study(hours=0.05, penalties=(5.0,), runs=2)
    made.execute(tmp_path / "out" / "learning-runs.jsonl", 2)
    both = [file, tmp_path / "out" / "learning-runs.jsonl"]
    assert len({tuple(sorted(each.read_bytes().splitlines())) for each in both}) == 1
