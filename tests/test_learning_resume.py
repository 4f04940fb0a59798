"""The same run to the bit: in any number of workers, and however often it was killed."""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from conftest import ROOT
from environments_faulty import Faulty
from learning_runs import Counting, bound, run_of, stored
from menid_plan.environments.simulated import Simulated
from menid_plan.learning.replay import DivergedError
from menid_plan.learning.run import RunError

SETTINGS: dict[str, Any] = {
    "test_time": 6.0, "steps": 60, "delta": 0.2, "solver": "thompson", "seed": 11,
    "delta_method": "monte-carlo",
}  # fmt: skip
KINDS = {"model": Simulated(duration=0.7), "sketch": Simulated(duration=0.3)}
FILES = ("curve.csv", "learned.menid")


def content(folder: Path) -> Any:
    """All that a run is to give in any case."""
    return stored(folder), *((folder / name).read_bytes() for name in FILES)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("undisturbed") / "run"
    run_of(folder, bound(Simulated(duration=2.0), KINDS), **SETTINGS).learn()
    return content(folder)


@pytest.mark.parametrize("workers", [1, 2])
def test_any_number_of_workers(tmp_path: Path, undisturbed: Any, workers: int) -> None:
    folder = tmp_path / "run"
    run_of(folder, bound(Simulated(duration=2.0), KINDS), workers=workers, **SETTINGS).learn()
    assert content(folder) == undisturbed


def test_another_seed_gives_another_run(tmp_path: Path, undisturbed: Any) -> None:
    settings = {**SETTINGS, "seed": 12}
    run_of(tmp_path / "run", bound(Simulated(duration=2.0), KINDS), **settings).learn()
    assert content(tmp_path / "run")[0] != undisturbed[0]


def test_a_longer_run_goes_on_where_a_shorter_one_ended(tmp_path: Path, undisturbed: Any) -> None:
    folder = tmp_path / "run"
    environments = bound(Simulated(duration=2.0), KINDS)
    for steps in (1, 7, 30, 60):
        settings = {**SETTINGS, "steps": steps}
        run_of(folder, environments, resume=steps > 1, **settings).learn()
    assert content(folder) == undisturbed
    # One that is to be shorter keeps what it has.
    run_of(folder, environments, resume=True, **{**SETTINGS, "steps": 5}).learn()
    assert content(folder) == undisturbed


class StopError(Exception):
    pass


class Stopper:
    """Breaks a run off after so many points at which something was executed since the last."""

    def __init__(self, diary: Path, points: int) -> None:
        self.diary, self.points = diary, points
        self.executed = self.size()

    def size(self) -> int:
        return self.diary.stat().st_size if self.diary.exists() else 0

    def __call__(self, _: object) -> None:
        size = self.size()
        if size == self.executed:
            return
        self.executed = size
        self.points -= 1
        if self.points < 0:
            raise StopError


def test_nothing_that_is_stored_is_executed_again(tmp_path: Path, undisturbed: Any) -> None:
    """Runs are broken off after ever other numbers of executions; each is done once."""
    folder, diary = tmp_path / "run", tmp_path / "diary"
    kinds = {"model": Counting(str(diary), 0.7), "sketch": Counting(str(diary), 0.3)}
    environments = bound(Counting(str(diary), 2.0), kinds)
    chance = random.Random(3)
    broken = 0
    while True:
        stop = Stopper(diary, chance.randrange(0, 8))
        run = run_of(folder, environments, resume=broken > 0, watch=stop, **SETTINGS)
        try:
            run.learn()
        except StopError:
            broken += 1
            continue
        break
    assert broken >= 10
    # The kinds of the environments differ, and with them nothing that a run gives.
    assert content(folder) == undisturbed
    executed = Counter(diary.read_text(encoding="utf-8").splitlines())
    assert set(executed.values()) == {1}
    assert len(executed) == len(undisturbed[0])


def test_tests_that_were_given_up_are_not_tried_again(tmp_path: Path) -> None:
    """Whether they fail depends on the weather: what was learned is that they gave nothing."""
    once = tmp_path / "marks"
    once.mkdir()
    options = {**SETTINGS, "steps": 12}
    faulty = Faulty("fail", every=3, once=str(once))
    folder = tmp_path / "run"
    environments = bound(Simulated(duration=2.0), {"model": faulty}, {"model": 0.7}, retries=0)
    run_of(folder, environments, **options).learn()
    before = content(folder)
    assert any(number > 0 for number in run_of_failures(folder).values())
    run = run_of(folder, environments, resume=True, **options)
    run.learn()
    assert content(folder) == before
    assert run.failed == run_of_failures(folder)


def run_of_failures(folder: Path) -> Counter[str]:
    events = map(json.loads, (folder / "events.jsonl").read_text(encoding="utf-8").splitlines())
    return Counter(event["environment"] for event in events if event["event"] == "failure")


def test_a_store_that_says_otherwise(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    environments = bound(Simulated(duration=2.0), KINDS)
    run_of(folder, environments, **SETTINGS).learn()
    import sqlite3

    connection = sqlite3.connect(folder / "experiences.sqlite")
    with connection:
        connection.execute("DELETE FROM experiences WHERE id = 40")
    connection.close()
    with pytest.raises(DivergedError, match="where the run does otherwise"):
        run_of(folder, environments, resume=True, **SETTINGS).learn()


@pytest.mark.parametrize("damage", ["lost", "cut", "rubbish", "shuffled", "longer"])
def test_the_curve_is_made_good(tmp_path: Path, undisturbed: Any, damage: str) -> None:
    folder = tmp_path / "run"
    environments = bound(Simulated(duration=2.0), KINDS)
    run_of(folder, environments, **{**SETTINGS, "steps": 20}).learn()
    curve = folder / "curve.csv"
    rows = curve.read_bytes().splitlines(keepends=True)
    match damage:
        case "lost":
            curve.unlink()
        case "cut":
            curve.write_bytes(b"".join(rows)[:-3])
        case "rubbish":
            curve.write_bytes(b"\xff\xfe\x00 no curve")
        case "shuffled":
            curve.write_bytes(b"".join([rows[0], *reversed(rows[1:])]))
        case "longer":
            curve.write_bytes(b"".join([*rows, rows[-1]]))
    run_of(folder, environments, resume=True, **SETTINGS).learn()
    assert content(folder) == undisturbed


# ------------------------------------------------------------------------------ settings and folders


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"delta": 0.21}, "learn.delta = 0.2,"),
        ({"seed": 12}, "learn.seed = 11,"),
        ({"estimator_options": {"m": 3.0}}, "learn.estimator_options.m = nothing,"),
        ({"solver": "value-iteration"}, 'learn.solver = "thompson"'),
    ],
)
@pytest.mark.parametrize("file", [True, False])
def test_settings_that_change_on_resume(
    tmp_path: Path, change: dict[str, Any], key: str, file: bool
) -> None:
    folder = tmp_path / "run"
    environments = bound(Simulated(duration=2.0), KINDS)
    settings = {**SETTINGS, "steps": 2}
    run_of(folder, environments, **settings).learn()
    if not file:  # the store has them too
        (folder / "settings.json").unlink()
    before = content(folder)
    with pytest.raises(RunError) as caught:
        run_of(folder, environments, resume=True, **{**settings, **change})
    assert key in str(caught.value)
    assert content(folder) == before
    run_of(folder, environments, resume=True, **settings).learn()
    assert content(folder) == before
    assert json.loads((folder / "settings.json").read_text())["learn"]["steps"] == 2


def test_environments_that_change_on_resume(tmp_path: Path) -> None:
    run_of(tmp_path / "run", bound(Simulated(duration=2.0), KINDS), **SETTINGS).learn()
    other = bound(Simulated(duration=2.5), KINDS)
    with pytest.raises(RunError, match=r"environments\.bench\.settings\.duration = 2\.0"):
        run_of(tmp_path / "run", other, resume=True, **SETTINGS)
    fewer = bound(Simulated(duration=2.0), {"model": KINDS["model"]})
    with pytest.raises(RunError, match=r"environments\.sketch = "):
        run_of(tmp_path / "run", fewer, resume=True, **SETTINGS)


@pytest.mark.parametrize("text", ["{", "[]", "3", '{"version": 99}', ""])
def test_settings_that_no_run_has_written(tmp_path: Path, text: str) -> None:
    folder = tmp_path / "run"
    environments = bound(Simulated(duration=2.0), KINDS)
    run_of(folder, environments, **{**SETTINGS, "steps": 2}).learn()
    (folder / "settings.json").write_text(text, encoding="utf-8")
    with pytest.raises(RunError, match=r"settings\.json"):
        run_of(folder, environments, resume=True, **SETTINGS)
    (folder / "settings.json").unlink()
    run_of(folder, environments, resume=True, **{**SETTINGS, "steps": 3}).learn()
    assert len([e for e in stored(folder) if e.environment == "bench"]) == 3


def test_a_folder_with_another_run_or_none(tmp_path: Path) -> None:
    environments = bound(Simulated(duration=2.0), KINDS)
    with pytest.raises(RunError, match="no run"):
        run_of(tmp_path / "run", environments, resume=True)
    assert not (tmp_path / "run").exists()
    (tmp_path / "curve.csv").write_text("mine", encoding="utf-8")
    with pytest.raises(RunError, match="already"):
        run_of(tmp_path, environments)
    assert (tmp_path / "curve.csv").read_text(encoding="utf-8") == "mine"


# ------------------------------------------------------------------------------- processes that die

RUN_FILE = """\
[environment.robot]
kind = "simulated"
duration = 30
[environment.simulator]
kind = "process"
duration = 2
[environment.simulator.settings]
command = ["{python}", "SIMULATOR"]
[learn]
steps = 100
test_time = 20
seed = 5
[workers]
number = 2
"""


class Learner:
    """`menid learn` on the greenhouse, as a process of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.out = folder / "run"
        self.file = folder / "run.toml"
        simulator = ROOT / "domains" / "greenhouse" / "simulator.py"
        self.file.write_text(RUN_FILE.replace("SIMULATOR", str(simulator)), encoding="utf-8")

    def start(self, *options: str) -> subprocess.Popen[str]:
        house = ROOT / "domains" / "greenhouse"
        resume = ["--resume"] if (self.out / "experiences.sqlite").exists() else []
        return subprocess.Popen(
            [sys.executable, "-c", "from menid_plan.cli.main import main; main()", "learn",
             house / "domain.menid", house / "two-pots.menid", "--run", self.file, "-o", self.out,
             *resume, *options],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip

    def points(self, curve: bytes | None = None) -> int:
        """How far it has come: the points of its curve."""
        if curve is None:
            path = self.out / "curve.csv"
            curve = path.read_bytes() if path.exists() else b""
        return max(0, curve.count(b"\n") - 1)

    def finish(self) -> Any:
        process = self.start()
        _, said = process.communicate(timeout=120)
        assert process.returncode == 0, said
        return content(self.out)


def children(pid: int) -> list[int]:
    """The processes that one has started, and those that they have."""
    found: list[int] = []
    for file in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            found += map(int, file.read_text(encoding="utf-8").split())
    return found + [grandchild for child in found for grandchild in children(child)]


def alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


@pytest.fixture(scope="module")
def greenhouse(tmp_path_factory: pytest.TempPathFactory) -> Any:
    folder = tmp_path_factory.mktemp("greenhouse")
    return Learner(folder).finish()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks for processes in /proc")
def test_killed_at_any_point_and_resumed(tmp_path: Path, greenhouse: Any) -> None:
    learner = Learner(tmp_path)
    chance = random.Random(7)
    workers: set[int] = set()
    done = []
    for kill in range(10):
        process = learner.start()
        if kill % 4 == 0:  # at any time, while it starts or repeats what was done
            time.sleep(chance.uniform(0.2, 1.2))
        else:  # when it has come some points further
            wanted = learner.points() + chance.randrange(1, 9)
            deadline = time.monotonic() + 60
            while process.poll() is None and learner.points() < wanted:
                assert time.monotonic() < deadline
                time.sleep(0.001)
            time.sleep(chance.uniform(0.0, 0.01))
        workers |= set(children(process.pid))
        process.kill()
        process.communicate()
        done.append(learner.points())
    assert len(set(done)) >= 7
    assert done[-1] < learner.points(greenhouse[1])
    deadline = time.monotonic() + 10
    while any(map(alive, workers)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert workers
    assert not any(map(alive, workers)), "workers outlive the run"
    assert learner.finish() == greenhouse


@pytest.mark.skipif(os.name == "nt", reason="sends SIGINT")
def test_ctrl_c(tmp_path: Path, greenhouse: Any) -> None:
    learner = Learner(tmp_path)
    for number in range(4):
        process = learner.start()
        if number < 3:
            events = learner.out / "events.jsonl"
            deadline = time.monotonic() + 30
            while time.monotonic() < deadline and process.poll() is None:
                text = events.read_text(encoding="utf-8") if events.exists() else ""
                if text.count('"starts"') + text.count('"resumes"') > number:
                    break
                time.sleep(0.01)
            time.sleep(0.15 * number)
            process.send_signal(signal.SIGINT)
        out, said = process.communicate(timeout=120)
        if process.returncode == 0:
            break
        assert process.returncode == 6, said
        assert "interrupted; --resume goes on with this run" in said
        assert "robot (target)" in out
        assert (learner.out / "learned.menid").exists()
    assert learner.finish() == greenhouse


@pytest.mark.parametrize("fault", ["fail", "exit"])
def test_failures_change_nothing_in_any_number_of_workers(tmp_path: Path, fault: str) -> None:
    # A process that ends costs a start; so fewer of those.
    faulty = Faulty(fault, every=10 if fault == "exit" else 4)
    environments = bound(Simulated(duration=2.0), {"model": faulty}, {"model": 1.5}, retries=0)
    options = {**SETTINGS, "steps": 4 if fault == "exit" else 8}
    numbers = (1, 2) if fault == "exit" else (0, 1, 2)
    found = []
    for workers in numbers:
        folder = tmp_path / str(workers)
        run_of(folder, environments, workers=workers, **options).learn()
        found.append(content(folder))
    assert all(each == found[0] for each in found)
    assert "given up" in (tmp_path / "1" / "events.jsonl").read_text(encoding="utf-8")
