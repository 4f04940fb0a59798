"""The study of the meshes: errors by hand, runs that are gone on with, and what is refused."""

from __future__ import annotations

import csv
import json
import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result as CliResult

import menid_plan
from conftest import ROOT
from menid_plan.environments.hdd import extra
from menid_plan.environments.hdd.kind import Hdd
from menid_plan.environments.interface import Capabilities, EnvironmentFailedError, Execution
from menid_plan.environments.registry import Place
from menid_plan.errors import LimitError
from menid_plan.experience.store import StoreError
from menid_plan.grounding.state import GroundAction, State
from menid_plan.model.formulas import GroundAtom
from menid_plan.studies.mesh import (
    MeshStudy,
    Progress,
    curve_of,
    error,
    mean_error,
)
from menid_plan.studies.mesh_runs import Result, Run, RunsFile, RunsFileError

SMALL = """\
problem small for hdd
object board: pcb
object tray: bay
object s1: sway (degrees: 0.1)
object left: spot (x: -30, y: 0)
object centre: spot (x: 0, y: 0)
object strong: pressure (pascal: -1135)
init in(board, tray)
goal done()
horizon 40
discount 0.99
"""

SEATED = frozenset({GroundAtom("in", ("board", "tray"))})
LOOSE = SEATED | {GroundAtom("loose", ("board",))}
OUT = frozenset({GroundAtom("on-table", ("board",))})

A, B = GroundAction("suck", ("left", "strong")), GroundAction("suck", ("centre", "strong"))


# ---------------------------------------------------------------------------------------- by hand


def test_error() -> None:
    assert error(SEATED, SEATED) == 0
    assert error(SEATED, OUT) == error(LOOSE, OUT) == 1
    assert error(SEATED, LOOSE) == error(LOOSE, SEATED) == 0.5
    assert error(frozenset(), frozenset()) == 0
    assert error(frozenset(), OUT) == 1


def test_mean_error_weighs_places_alike() -> None:
    # Places of mean 1/2 and 1: the deviation between them is 1/sqrt(8), and 1/4 over sqrt(2).
    assert mean_error([[0, 1], [1, 1, 1, 1], []]) == pytest.approx((0.75, 0.25))
    mean, deviation = mean_error([[0.5, 0.25]])
    assert mean == 0.375
    assert math.isnan(deviation)
    assert all(map(math.isnan, mean_error([])))


def test_a_curve_by_hand() -> None:
    ends = {
        (A, 0.1): (SEATED, OUT), (A, 0.2): (SEATED, LOOSE),
        (B, 0.1): (OUT, None), (B, 0.2): (SEATED, OUT),
    }  # fmt: skip
    results = {
        Run(call, quality, r, r): Result(4.0 * quality + r, state)
        if state is not None
        else Result(failure="broke")
        for (call, quality), states in ends.items()
        for r, state in enumerate(states)
    }
    curve = curve_of("suck", [0.1, 0.2], results)
    assert curve.runs.tolist() == [3, 4]
    assert curve.failed.tolist() == [1, 0]
    # Same seed: A has errors 0 and 1, B has 1. At the highest quality there can be none.
    assert curve.error == pytest.approx(np.array([[0.75, 0.25], [0.0, 0.0]]))
    # Other seeds, 0.1: A has 1/2 (seated, loose) and 1 (out, seated), B has 0 (out, out).
    # At 0.2: 1/2 both ways for A, 1 both ways for B.
    assert curve.others == pytest.approx(np.array([[0.375, 0.375], [0.75, 0.25]]))
    assert curve.floor == pytest.approx([0.75, 0.25])
    # 0.4, 0.4 and 1.4 seconds; 0.8, 0.8, 1.8 and 1.8.
    assert curve.seconds == pytest.approx(
        np.array([[2.2 / 3, 0.4, 0.4, 0.9], [1.3, 0.8, 1.3, 1.8]])
    )


def test_one_repetition_has_no_floor() -> None:
    results = {Run(A, q, 0, 0): Result(1.0, SEATED) for q in (0.1, 0.2)}
    curve = curve_of("suck", [0.1, 0.2], results)
    assert curve.error[:, 0].tolist() == [0, 0]
    assert np.isnan(curve.others).all()


# ---------------------------------------------------------------------------- runs without PyBullet

BROKEN: set[float] = set()


@dataclass(frozen=True, slots=True)
class Fake(Hdd):
    """A scene whose board comes loose with some seeds, and that fails at the qualities in BROKEN."""

    def build(self, place: Place) -> FakeEnvironment:  # type: ignore[override]
        return FakeEnvironment(self.quality)


class FakeEnvironment:
    capabilities = Capabilities()

    def __init__(self, quality: float) -> None:
        self.quality = quality
        self.seed = 0

    def reset(self, state: State | None, seed: int) -> State:
        self.seed = seed
        return SEATED

    def execute(self, action: GroundAction) -> Execution:
        if self.quality in BROKEN and action != A:
            raise EnvironmentFailedError("the board\nwent through the bay")
        free = self.seed % 97 < 5000 * self.quality
        return Execution(OUT if free else LOOSE, duration=self.quality * (self.seed % 97))

    def state(self) -> State:
        return SEATED

    def close(self) -> None:
        pass


@pytest.fixture(autouse=True)
def _nothing_broken() -> Iterator[None]:
    yield
    BROKEN.clear()


@pytest.fixture
def study(tmp_path: Path) -> MeshStudy:
    path = tmp_path / "small.menid"
    path.write_text(SMALL)
    domain = menid_plan.read(ROOT / "domains/hdd/domain.menid").domain
    assert domain is not None
    problem = menid_plan.read(path, domain).problem
    assert problem is not None
    return MeshStudy(domain, problem, ("shake", "suck"), 3, 2, seed=4, scene=Fake(noise=1.0))


def test_runs_share_seeds_across_qualities_alone(study: MeshStudy) -> None:
    runs = list(study.runs())
    assert len(runs) == len(set(runs)) == 3 * 3 * 2
    keys = {(run.action, run.repetition) for run in runs}
    assert len({run.seed for run in runs}) == len(keys) == 6
    assert {run.quality for run in runs} == set(study.grid) == {0.00103, 0.005515, 0.01}
    assert set(runs) < set(replace(study, repetitions=3).runs())
    # So that a study can be made finer.
    assert set(replace(study, qualities=6).grid) < set(replace(study, qualities=36).grid)


def test_a_cut_file_is_gone_on_with(study: MeshStudy, tmp_path: Path) -> None:
    path = tmp_path / "runs.csv"
    seen: list[Progress] = []
    whole = study.run(path, 0, seen.append)
    data = path.read_bytes()
    assert list(whole) == list(study.runs())
    assert seen[-1] == Progress(18, 18, 0)
    assert {result.state for result in whole.values()} == {OUT, LOOSE}
    for cut in (0, 1, len(data) // 3, len(data) // 2, len(data) - 1, len(data)):
        path.write_bytes(data[:cut])
        assert study.run(path, 0) == whole
        assert path.read_bytes() == data
    # Another study of the same scenes may share the file.
    assert len(replace(study, seed=5).run(path, 0)) == 18
    assert path.read_bytes().startswith(data)
    assert study.run(path, 0) == whole


def test_what_fails_is_left_out_and_tried_again(study: MeshStudy, tmp_path: Path) -> None:
    path = tmp_path / "runs.csv"
    BROKEN.add(0.00103)
    notes: list[object] = []
    results = study.run(path, 0, failed=notes.append)
    bad = [run for run, result in results.items() if result.failure]
    assert {run.quality for run in bad} == {0.00103}
    assert len(bad) == 4
    assert len(notes) == 4 * 3
    shake, suck = study.curves(results)
    assert suck.failed.tolist() == [2, 0, 0]
    assert suck.runs.tolist() == [2, 4, 4]
    assert math.isnan(shake.error[0, 0])
    shown = study.as_json([shake, suck], results)
    assert shown["actions"][0]["qualities"][0]["seconds"] is None
    assert shown["failed"][0]["failure"] == "the board\nwent through the bay"
    assert json.loads(json.dumps(shown, allow_nan=False))["settings"]["seed"] == 4
    rows = list(csv.DictReader(study.as_csv([shake, suck]).splitlines()))
    assert (rows[0]["failed"], rows[0]["error"], rows[0]["seconds"]) == ("2", "", "")
    BROKEN.clear()
    again = study.run(path, 0)
    assert not any(result.failure for result in again.values())
    kept = {run: result for run, result in results.items() if not result.failure}
    assert kept.items() <= again.items()
    assert study.run(path, 0) == again


def test_nothing_but_failures_is_an_error(study: MeshStudy, tmp_path: Path) -> None:
    BROKEN.update(study.grid)
    study = replace(study, actions=("shake",))
    with pytest.raises(EnvironmentFailedError, match="first 6 executions all failed; last: the bo"):
        study.run(tmp_path / "runs.csv", 0)


def test_files_that_are_refused(study: MeshStudy, tmp_path: Path) -> None:
    path = tmp_path / "runs.csv"
    study.run(path, 0)
    data = path.read_bytes()
    moved = tuple(
        replace(o, attributes=(("x", 1.0), ("y", 0.0))) if o.name == "left" else o
        for o in study.problem.objects
    )
    for other in (
        replace(study, problem=replace(study.problem, objects=moved)),
        replace(study, scene=Fake(noise=1.0, force=20.0)),
    ):
        with pytest.raises(RunsFileError, match="another domain or problem, or of another version"):
            other.run(path, 0)
    for wrong in (b"x,y\n" + data, data + b"\n", data + b"\xff\n", data.replace(b",0,", b",zero,")):
        path.write_bytes(wrong)
        with pytest.raises(RunsFileError, match=r"runs.csv, line \d+: it is no run"):
            study.run(path, 0)
        assert path.read_bytes() == wrong
    for wrong in (data.replace(b"\n", b"\r"), b"my notes, no newline"):
        path.write_bytes(wrong)
        with pytest.raises(RunsFileError, match=r"runs.csv, line 1: it is no run"):
            study.run(path, 0)
        assert path.read_bytes() == wrong
    path.write_bytes(data.replace(b"on-table", b"elsewhere"))
    with pytest.raises(RunsFileError, match="has the atom `elsewhere"):
        study.run(path, 0)
    path.write_bytes(data[:5])  # a head that a kill has cut
    study.run(path, 0)
    with pytest.raises(LimitError, match="executions; at most 1000000 are made"):
        replace(study, repetitions=10**9).run(path, 0)


def test_the_figure_is_drawn_whatever_is_missing(study: MeshStudy, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    BROKEN.add(0.00103)
    for repetitions in (1, 2):
        made = replace(study, repetitions=repetitions)
        curves = made.curves(made.run(tmp_path / "runs.csv", 0))
        picture = made.as_png(curves, dpi=50)
        assert picture.startswith(b"\x89PNG")
        assert picture == made.as_png(curves, dpi=50)


# -------------------------------------------------------------------------------------- the command


def test_usage(menid: Callable[..., CliResult], tmp_path: Path) -> None:
    pytest.importorskip("pybullet")
    pytest.importorskip("matplotlib")
    (tmp_path / "file").write_text("")
    for arguments, message in (
        (["-o", "x", "--qualities", "1"], "--qualities"),
        (["-o", "x", "--repetitions", "0"], "--repetitions"),
        (["-o", "x", "--jobs", "0"], "--jobs"),
        (["-o", "x", "--actions", "suck,pull"], "has no action `pull`; it has lever, shake, suck"),
        (["-o", "x", "--actions", ""], "has no action ``"),
        (["-o", "x", "none.menid"], "none.menid"),
        (["-o", "x", str(ROOT / "domains/hdd/domain.menid")], "hold no problem"),
        (["-o", "file"], "is a file"),
        (["-o", "file/x"], "file/x: Not a directory"),
        ([], "'-o'"),
    ):
        result = menid("study", "mesh", *arguments)
        assert result.exit_code == 2, result.output
        assert message in result.output
    (tmp_path / "mesh.csv").write_bytes((ROOT / "domains/hdd/bench.menid").read_bytes())
    domain = str(ROOT / "domains/hdd/domain.menid")
    result = menid("study", "mesh", domain, "mesh.csv", "-o", ".")
    assert result.exit_code == 2
    assert "`mesh.csv` is an input" in result.output
    (tmp_path / "small.menid").write_text(SMALL)
    files = [str(ROOT / "domains/hdd/domain.menid"), "small.menid"]
    result = menid("study", "mesh", *files, "-o", "x")
    assert result.exit_code == 2
    assert "no `lever` applies in the initial state of problem `small`" in result.output
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize("which", ["hdd", "draw"])
def test_what_is_not_installed_is_told_at_once(
    which: str, menid: Callable[..., CliResult], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if which == "hdd":
        monkeypatch.setattr(extra, "find_spec", lambda _: None)
    else:
        pytest.importorskip("pybullet")
        monkeypatch.setitem(sys.modules, "matplotlib", None)
    result = menid("study", "mesh", "-o", "x")
    assert result.exit_code == 5
    assert f"pip install 'menid-plan[{which}]'" in result.output
    assert not (tmp_path / "x").exists()


def test_a_small_study(
    menid: Callable[..., CliResult],
    tmp_path: Path,
    tmp_path_factory: pytest.TempPathFactory,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("pybullet")
    pytest.importorskip("matplotlib")
    base = tmp_path_factory.getbasetemp()  # the cache that the tests of the scenes have, too
    base = base.parent if base.name.startswith("popen-") else base
    monkeypatch.setenv("MENID_CACHE", str(base / "hdd-cache"))
    (tmp_path / "small.menid").write_text(SMALL)
    command = [
        "study", "mesh", str(ROOT / "domains/hdd/domain.menid"), "small.menid", "--actions", "suck",
        "--qualities", "2", "--repetitions", "1", "--jobs", "1", "-o", "out",
    ]  # fmt: skip
    first = menid(*command)
    assert first.exit_code == 0, first.output
    assert "4 of 4 executions\n" in first.stderr
    assert "wrote out/mesh.png\n" in first.stdout
    assert "seeds at the best mesh" not in first.stdout  # one repetition has no other
    runs = tmp_path / "out/mesh-runs.csv"
    data = runs.read_bytes()
    rows = list(csv.DictReader(data.decode().splitlines()))
    assert {row["action"] for row in rows} == {str(A), str(B)}
    assert {row["atoms"] for row in rows if row["action"] == str(B)} == {"on-table(board)"}
    assert all(float(row["seconds"]) > 0 for row in rows)
    # One run is executed again, with the same outcome; the rest stays.
    lines = data.splitlines(keepends=True)
    runs.write_bytes(b"".join(lines[:-1]) + lines[-1][:20])
    second = menid(*command, "--json")
    assert second.exit_code == 0, second.output
    found = list(csv.DictReader(runs.read_text().splitlines()))
    assert found[:-1] == rows[:-1]
    assert {**found[-1], "seconds": ""} == {**rows[-1], "seconds": ""}
    told = json.loads(second.stdout)
    assert told == json.loads((tmp_path / "out/mesh.json").read_text())
    assert [row["runs"] for row in told["actions"][0]["qualities"]] == [2, 2]
    assert (tmp_path / "out/mesh.png").read_bytes().startswith(b"\x89PNG")
    assert len((tmp_path / "out/mesh.csv").read_text().splitlines()) == 1 + 2
    # What is of another version is not touched.
    runs.write_text(data.decode().replace(rows[0]["origin"], "0123456789ab"))
    third = menid(*command)
    assert third.exit_code == 3
    assert "mesh-runs.csv has runs of another domain or problem" in third.output


def test_only_one_process_writes_to_a_file_of_runs(tmp_path: Path) -> None:
    with (
        RunsFile(tmp_path / "runs.csv", "x"),
        pytest.raises(StoreError, match="another process writes to"),
    ):
        RunsFile(tmp_path / "runs.csv", "x")
    with RunsFile(tmp_path / "runs.csv", "x") as file:
        assert file.results == {}
