"""Meshes of the hard drive: what is checked of them, scans that are refused, and the cache."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from importlib import util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conftest import ROOT

pytest.importorskip("pybullet", reason="the extra `hdd` is not installed")

import trimesh
from click.testing import CliRunner, Result
from manifold3d import CrossSection, JoinType, Manifold

import menid_plan
import menid_plan.environments.hdd.meshes as reducing
from menid_plan.cli.main import main
from menid_plan.environments.hdd import cache, geometry
from menid_plan.environments.hdd.kind import Hdd
from menid_plan.environments.hdd.mesh import TriangleMesh
from menid_plan.environments.hdd.meshes import Source, part_mesh, tried_mesh, wanted_vertices
from menid_plan.environments.hdd.scans import MeshError, exported, read_scan
from menid_plan.environments.hdd.validity import Validity
from menid_plan.environments.registry import Place
from menid_plan.grounding.state import GroundAction

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], np.int32)
TETRAHEDRON = TriangleMesh(CORNERS, FACES)


@pytest.fixture(scope="module", autouse=True)
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The designed parts are made once, for other modules and workers as well."""
    base = tmp_path_factory.getbasetemp()
    with pytest.MonkeyPatch.context() as patch:
        kept = (base.parent if base.name.startswith("popen-") else base) / "hdd-cache"
        patch.setenv("MENID_CACHE", str(kept))
        yield


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of the test's own."""
    monkeypatch.setenv("MENID_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "hdd"


# ------------------------------------------------------------------------------------------ checks


def test_a_tetrahedron_is_closed_and_has_its_volume() -> None:
    assert TETRAHEDRON.volume == pytest.approx(1 / 6)
    assert TETRAHEDRON.open_edges == 0
    assert TETRAHEDRON.bodies == 1
    assert np.linalg.norm(TETRAHEDRON.normals, axis=1) == pytest.approx(np.ones(4))
    assert (TETRAHEDRON.normals[0] < 0).all()


def test_a_missing_triangle_opens_three_edges() -> None:
    assert TriangleMesh(CORNERS, FACES[1:]).open_edges == 3


def test_a_triangle_that_is_turned_opens_edges_too() -> None:
    turned = FACES.copy()
    turned[0] = turned[0][::-1]
    assert TriangleMesh(CORNERS, turned).open_edges == 6


def test_two_tetrahedra_are_two_bodies() -> None:
    both = TriangleMesh(np.vstack([CORNERS, CORNERS + 3]), np.vstack([FACES, FACES + 4]))
    assert both.bodies == 2
    assert both.volume == pytest.approx(1 / 3)


@pytest.mark.parametrize("quality", [0.0009, 0.11, -1.0, float("nan")])
def test_a_quality_out_of_range_is_refused(quality: float) -> None:
    with pytest.raises(MeshError, match=r"out of range.*from 0.001 to 0.1"):
        wanted_vertices("board", quality)


# ------------------------------------------------------------------------------------------- scans


def bar(x: float = 100.0, y: float = 60.0, z: float = 1.6, step: float = 0.9) -> trimesh.Trimesh:
    """A plate like a board, of some ten thousand even triangles, as rough as a scan."""
    shape = Manifold.cube([x, y, z]).translate([-x / 2, -y / 2, 0]).refine_to_length(step)
    found = shape.to_mesh()
    points = found.vert_properties[:, :3].astype(float)
    points += np.random.default_rng(1).normal(0, 0.02, points.shape)
    return trimesh.Trimesh(points, found.tri_verts, process=False)


@pytest.mark.parametrize("kind", ["stl", "obj", "ply"])
def test_a_scan_is_read_in_every_format(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"plate.{kind}"
    bar().export(path)
    mesh = read_scan(path)
    assert mesh.volume == pytest.approx(9600, rel=0.01)
    assert mesh.open_edges == 0
    assert mesh.bodies == 1


def test_a_scan_that_is_inside_out_is_turned(tmp_path: Path) -> None:
    plate = bar()
    plate.invert()
    plate.export(tmp_path / "plate.stl")
    assert read_scan(tmp_path / "plate.stl").volume == pytest.approx(9600, rel=0.01)


def test_triangles_that_are_turned_the_wrong_way_are_turned(tmp_path: Path) -> None:
    plate = bar()
    wrong = np.random.default_rng(2).random(len(plate.faces)) < 0.4
    faces = np.where(wrong[:, None], plate.faces[:, ::-1], plate.faces)
    trimesh.Trimesh(plate.vertices, faces, process=False).export(tmp_path / "plate.stl")
    mesh = read_scan(tmp_path / "plate.stl")
    assert mesh.volume == pytest.approx(9600, rel=0.01)
    assert mesh.open_edges == 0


def test_what_exporters_leave_in_a_scan_does_no_harm(tmp_path: Path) -> None:
    """A vertex for each place in a texture, triangles that are there twice, or are but lines."""
    plate = Manifold.cube([100, 60, 1.6]).translate([-50, -30, 0]).refine_to_length(5).to_mesh()
    points = plate.vert_properties[:, :3].astype(float)
    faces = plate.tri_verts.astype(int)
    lines = [f"v {x} {y} {z}" for x, y, z in points.tolist()]
    lines += [f"vt {k / faces.size} {k % 3}" for k in range(faces.size)] + ["vn 0 0 1"]
    for first, face in zip(range(1, faces.size, 3), faces + 1, strict=True):
        lines.append("f " + " ".join(f"{corner}/{first + k}/1" for k, corner in enumerate(face)))
    (tmp_path / "textured.obj").write_text("\n".join(lines))
    twice = np.vstack([faces, faces[:9, [1, 2, 0]], faces[:9, [0, 0, 1]]])
    trimesh.Trimesh(points, twice, process=False).export(tmp_path / "twice.ply")
    # An edge of two triangles is cut in its middle, and a sliver put into one side of it alone.
    a, b, c = faces[0]
    sliver = np.vstack([faces[1:], [[a, len(points), c], [len(points), b, c], [a, b, len(points)]]])
    more = np.vstack([points, (points[a] + points[b]) / 2])
    trimesh.Trimesh(more, sliver, process=False).export(tmp_path / "sliver.ply")
    for name in ("textured.obj", "twice.ply", "sliver.ply"):
        mesh = read_scan(tmp_path / name)
        assert mesh.volume == pytest.approx(9600), name
        assert mesh.bodies == 1


def test_a_scan_of_a_million_triangles_is_read_in_time(tmp_path: Path) -> None:
    plate = bar(step=0.165)
    assert len(plate.faces) > 1e6
    plate.export(tmp_path / "plate.stl")
    start = time.perf_counter()
    mesh = read_scan(tmp_path / "plate.stl")
    assert time.perf_counter() - start < 60  # it takes about 6 s
    assert len(mesh.triangles) == len(plate.faces)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: p / 1000, r"it measures 0\.1.* x 0\.06.* mm.*in metres, scale it by 1000"),
        (lambda p: p / 10, "in centimetres, scale it by 10"),
        (lambda p: p / 25.4, r"in inches, scale it by 25\.4"),
        (lambda p: p * [1.25, 1, 1], "it measures 125"),
        (lambda p: p[:, [1, 0, 2]] * [-1, 1, 1], "turn it by 90 degrees"),
        (lambda p: p[:, [0, 2, 1]] * [1, -1, 1], "z is up"),
        (lambda p: p * [1, 1, 0.1], "it measures"),
        (lambda p: np.add(p, [5, 0, 0]), r"its middle is at x = 5\.0, y = -?0\.0 mm"),
        (lambda p: np.add(p, [0, 0, 4]), r"its underside is at z = 4\.0 mm"),
    ],
)
def test_a_board_that_is_not_where_it_should_be_is_refused(
    tmp_path: Path, change: Callable[[Any], Any], message: str
) -> None:
    plate = bar(step=3.0)
    trimesh.Trimesh(change(plate.vertices), plate.faces, process=False).export(tmp_path / "own.ply")
    with pytest.raises(MeshError, match=message):
        Source("board", tmp_path / "own.ply").full()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: p / 1000, "in metres, scale it by 1000"),
        (lambda p: p * 3, "it measures 36"),
        (lambda p: np.add(p, [30, 0, 0]), "around x = 30"),
        (lambda p: np.add(p, [0, 0, 3]), "nothing at z = 0 for the board to rest on"),
    ],
)
def test_a_bay_that_is_not_where_it_should_be_is_refused(
    tmp_path: Path, change: Callable[[Any], Any], message: str
) -> None:
    mesh = part_mesh(Source("bay"), 0.002).mesh
    path = tmp_path / "own.ply"
    path.write_bytes(exported(TriangleMesh(change(mesh.vertices), mesh.triangles), "ply"))
    with pytest.raises(MeshError, match=message):
        Source("bay", path).full()


def test_a_designed_part_that_is_written_is_a_scan(tmp_path: Path) -> None:
    for part in ("board", "bay"):
        mesh = part_mesh(Source(part), 0.01).mesh
        for kind in ("stl", "obj", "ply"):
            path = tmp_path / f"{part}.{kind}"
            path.write_bytes(exported(mesh, kind))
            found = Source(part, path).full()
            # Vertices that are closer than the file's precision become one.
            assert len(found.vertices) == pytest.approx(len(mesh.vertices), abs=3)
            assert found.volume == pytest.approx(mesh.volume, rel=1e-5)
        assert tried_mesh(Source(part, tmp_path / f"{part}.ply"), 0.002).report.faults == []


def test_scans_that_cannot_be_used_are_refused_with_the_file_and_the_mend(tmp_path: Path) -> None:
    def refused(name: str, content: bytes | trimesh.Trimesh | None, message: str) -> None:
        path = tmp_path / name
        if isinstance(content, bytes):
            path.write_bytes(content)
        elif content is not None:
            content.export(path)
        with pytest.raises(MeshError, match=message) as error:
            read_scan(path)
        assert str(path) in str(error.value)

    holed = bar()
    holed.update_faces(np.arange(len(holed.faces)) > 5)
    refused("holed.stl", holed, "not closed.*close its holes")
    other = bar()
    other.apply_translation((300, 0, 0))
    refused("two.stl", trimesh.util.concatenate([bar(), other]), "2 pieces.*keep the largest")
    refused("text.stl", b"this is no mesh at all\n", "text.stl: there are no triangles in it")
    for kind in ("stl", "obj", "ply"):
        refused(f"empty.{kind}", b"", f"empty.{kind}: the file is empty")
    whole = bar().export(file_type="stl")
    assert isinstance(whole, bytes)
    refused("short.stl", whole[: len(whole) // 2], "short.stl: .* cut short: .* triangles would")
    refused("huge.stl", whole[:80] + b"\xff" * 4 + whole[84:], "4294967295 triangles would take")
    ply = bar().export(file_type="ply")
    assert isinstance(ply, bytes)
    refused("short.ply", ply[: len(ply) // 2], "short.ply: it can't be read as PLY")
    nan = np.array([np.nan], "<f4").tobytes()
    refused("nan.stl", whole[:96] + nan + whole[100:], "coordinates are not numbers")
    refused("flat.obj", b"v 0 0 0\nv 1 0 0\nf 1 2 2\n", "have no area")
    refused("index.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "index.obj: ")
    header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    header += (
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    )
    points = f"{header}0 0 0\n1 0 0\n0 1 0\n"
    refused("index.ply", f"{points}3 0 1 7\n".encode(), "corners that are not in it")
    refused("minus.ply", f"{points}3 0 1 -1\n".encode(), "corners that are not in it")
    refused("mesh.3ds", b"x", "must be one of stl, obj, ply")
    refused("missing.stl", None, "No such file")
    (tmp_path / "folder.stl").mkdir()
    refused("folder.stl", None, "it is no file")
    refused(
        "nan.obj",
        b"v 0 0 0\nv 1 0 nan\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n",
        "nan.obj: some of its coordinates are not",
    )


def test_an_own_scan_takes_the_place_of_the_designed_board(tmp_path: Path) -> None:
    bar(99.4, 59.4).export(tmp_path / "own.stl")
    found = menid_plan.read(ROOT / "domains" / "hdd" / "drive.menid")
    assert found.domain is not None
    assert found.problem is not None
    place = Place("fine", found.domain, found.problem, folder=tmp_path)
    environment = Hdd(quality=0.002, board="own.stl").build(place)
    environment.reset(None, 1)
    after = environment.execute(GroundAction("suck", ("centre", "strong"))).state
    assert {atom.predicate for atom in after} == {"on-table"}
    # A scan that changes is another scan.
    before = part_mesh(Source("board", tmp_path / "own.stl"), 0.002)
    bar(88.0, 54.0, 1.4).export(tmp_path / "own.stl")
    after_change = part_mesh(Source("board", tmp_path / "own.stl"), 0.002)
    assert after_change.mesh.volume < 0.8 * before.mesh.volume


def test_a_scan_with_too_few_vertices_is_refused(tmp_path: Path) -> None:
    box = trimesh.creation.box((100, 60, 1.6))
    box.apply_translation((0, 0, 0.8))
    box.export(tmp_path / "box.stl")
    with pytest.raises(
        MeshError, match="has only 8: ask for a lower quality, or bring a finer scan"
    ):
        part_mesh(Source("board", tmp_path / "box.stl"), 0.001)


# ------------------------------------------------------------------------------------------- cache


def numbers(values: list[int], made: list[int]) -> cache.Arrays:
    def make() -> cache.Arrays:
        made.append(1)
        return {"numbers": np.array(values)}

    return cache.kept("numbers", make)


def test_what_is_kept_is_not_made_again(folder: Path) -> None:
    made: list[int] = []
    for _ in range(3):
        assert numbers([1, 2, 3], made)["numbers"].tolist() == [1, 2, 3]
    assert made == [1]
    assert [path.name for path in folder.iterdir()] == ["numbers.npz"]


@pytest.mark.parametrize("damage", ["cut", "empty", "bit", "other"])
def test_an_entry_that_is_damaged_is_made_anew(folder: Path, damage: str) -> None:
    made: list[int] = []
    numbers([1, 2, 3], made)
    path = folder / "numbers.npz"
    content = bytearray(path.read_bytes())
    if damage == "bit":
        content[len(content) // 2] ^= 1
    path.write_bytes(
        {"cut": content[:-20], "empty": b"", "bit": bytes(content), "other": b"x" * 500}[damage]
    )
    assert numbers([1, 2, 3], made)["numbers"].tolist() == [1, 2, 3]
    assert made == [1, 1]
    numbers([1, 2, 3], made)
    assert made == [1, 1]  # it is whole again


def test_where_nothing_can_be_kept_a_warning_says_so_and_it_goes_on(
    folder: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(path: Path, data: bytes) -> None:
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(cache, "replace_file", full)
    made: list[int] = []
    assert numbers([4], made)["numbers"].tolist() == [4]
    numbers([4], made)
    assert made == [1, 1]
    (warning,) = caplog.messages  # once
    assert "No space left" in warning
    assert warning.endswith("MENID_CACHE names another folder")


def test_nothing_can_be_kept_where_a_file_is_in_the_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("MENID_CACHE", str(tmp_path / "file"))
    assert numbers([4], [])["numbers"].tolist() == [4]
    assert "can't be written" in caplog.text


def test_a_folder_where_the_entry_should_be_is_no_entry(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (folder / "numbers.npz").mkdir(parents=True)
    assert numbers([4], [])["numbers"].tolist() == [4]
    assert "can't be written" in caplog.text


def test_several_may_make_an_entry_at_once(folder: Path) -> None:
    made: list[int] = []

    def slow() -> cache.Arrays:
        time.sleep(0.05)
        made.append(1)
        return {"numbers": np.arange(100_000)}

    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: cache.kept("many", slow)["numbers"].sum(), range(4)))
    assert len(made) > 1
    assert set(found) == {np.arange(100_000).sum()}
    assert [path.name for path in folder.iterdir()] == ["many.npz"]
    assert cache.kept("many", slow)["numbers"].sum() == found[0]


def test_another_way_of_reducing_is_kept_under_another_key(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, folder: Path
) -> None:
    bar().export(tmp_path / "own.stl")
    source = Source("board", tmp_path / "own.stl")
    part_mesh(source, 0.002)
    part_mesh(source, 0.002)
    before = len(list(folder.glob("board-662-*")))
    changed = tmp_path / "meshes.py"
    changed.write_bytes(Path(reducing.__file__).read_bytes() + b"\n# changed\n")
    monkeypatch.setattr(reducing, "__file__", str(changed))
    part_mesh(source, 0.002)
    assert (before, len(list(folder.glob("board-662-*")))) == (1, 2)


def test_other_geometry_is_kept_under_another_key(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    before = Source("board").key
    changed = tmp_path / "geometry.py"
    changed.write_bytes(Path(geometry.__file__).read_bytes() + b"\n# changed\n")
    monkeypatch.setattr(geometry, "__file__", str(changed))
    assert Source("board").key != before


# ----------------------------------------------------------------------------------- the command


def call(*arguments: str) -> Result:
    return CliRunner().invoke(main, ["hdd", "mesh", *arguments])


@pytest.mark.parametrize("kind", ["obj", "stl", "ply"])
def test_a_mesh_is_written_and_can_be_read_again(tmp_path: Path, kind: str) -> None:
    shape = tmp_path / "plate.stl"
    bar().export(shape)
    out = tmp_path / f"board.{kind}"
    found = call("--quality", "0.002", "--scan", str(shape), "-o", str(out))
    assert found.exit_code == 0, found.output
    mesh = read_scan(out)
    assert len(mesh.vertices) == pytest.approx(662, rel=0.01)
    assert mesh.volume == pytest.approx(9600, rel=0.01)


def row(found: Result, name: str) -> str:
    return next(line for line in found.stdout.splitlines() if line.startswith(f"{name}  "))


def test_the_report_tells_what_was_checked(tmp_path: Path) -> None:
    shape = tmp_path / "plate.stl"
    bar(99.4, 59.4).export(shape)
    found = call("--quality", "0.002", "--scan", str(shape), "--report")
    assert found.exit_code == 0, found.output
    assert row(found, "vertices").split() == ["vertices", "662", "662,", "within", "1", "%", "ok"]
    assert row(found, "open edges").split() == ["open", "edges", "0", "0", "ok"]
    force = row(found, "force at rest").split()
    assert (float(force[3]), force[-1]) == (pytest.approx(1, abs=0.02), "ok")
    bar(104.0, 60.0).export(shape)  # longer than the pocket
    out = tmp_path / "long.obj"
    found = call("--quality", "0.002", "--scan", str(shape), "--report", "-o", str(out))
    assert found.exit_code == 1
    assert row(found, "force at rest").endswith("fault")
    assert row(found, "volume").endswith("ok")
    assert "fault: at rest the board is pressed with" in found.stdout
    assert out.exists()  # alone it is as it should be; with another bay it may fit


def test_the_report_as_json() -> None:
    found = call("--part", "bay", "--quality", "0.002", "--json")
    assert found.exit_code == 0, found.output
    told = json.loads(found.stdout)
    assert told["faults"] == []
    assert told["mesh"]["wanted"] == 1037
    assert told["mesh"]["vertices"] == pytest.approx(1037, rel=0.01)
    assert told["contact"]["force"] == pytest.approx(1, abs=0.02)


def test_the_other_part_may_be_a_scan_as_well(tmp_path: Path) -> None:
    shape = tmp_path / "plate.stl"
    bar(104.0, 60.0).export(shape)
    asked = ("--part", "bay", "--quality", "0.002", "--report")
    assert call(*asked).exit_code == 0
    found = call(*asked, "--other-scan", str(shape))
    assert found.exit_code == 1
    assert "it jams" in found.stdout


def test_a_mesh_that_is_not_accepted_is_reported_and_not_written(tmp_path: Path) -> None:
    # Long thin triangles from one side to the other.
    outline = CrossSection.square([95, 55], center=True)
    outline = outline.offset(2.2, JoinType.Round, circular_segments=400)
    found = Manifold.extrude(outline, 1.6).to_mesh()
    points = found.vert_properties[:, :3].astype(float)
    points += np.random.default_rng(0).normal(0, 0.02, points.shape)
    shape, out = tmp_path / "thin.stl", tmp_path / "board.obj"
    trimesh.Trimesh(points, found.tri_verts, process=False).export(shape)
    asked = ("--quality", "0.001", "--scan", str(shape), "-o", str(out))
    told = call(*asked, "--report")
    assert told.exit_code == 1, told.output
    assert "fault: " in told.stdout
    assert "contact was not tested, and nothing is written" in told.stdout
    assert call(*asked).exit_code == 5
    assert not out.exists()


def test_what_is_not_a_number_is_a_fault() -> None:
    nan = float("nan")
    assert len(Validity(nan, nan, nan, nan, False).faults) == 4
    assert Validity(1.0, 1.0, 0.0, 0.0, False).faults == []
    assert Validity(1.0, 1.0, 0.0, 0.0, True).faults == [
        "the board does not come to rest in its seat"
    ]


def test_a_cache_that_cannot_be_written_is_told_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    bar(99.4, 59.4).export(tmp_path / "own.stl")
    arguments = "hdd mesh --quality 0.002 --scan own.stl -o board.ply".split()
    found = subprocess.run(
        [sys.executable, "-c", "from menid_plan.cli.main import main; main()", *arguments],
        cwd=tmp_path, env={**os.environ, "MENID_CACHE": str(tmp_path / "file")}, text=True,
        capture_output=True, check=True,
    )  # fmt: skip
    warning, wrote = found.stderr.splitlines()
    assert warning.startswith("menid: warning: the cache in ")
    assert warning.endswith("; MENID_CACHE names another folder")
    assert wrote == "wrote board.ply"


def test_without_the_extra_its_name_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there = util.find_spec
    monkeypatch.setattr(
        "menid_plan.environments.hdd.extra.find_spec",
        lambda name: None if name == "manifold3d" else there(name),
    )
    found = call("--quality", "0.003", "-o", str(tmp_path / "board.obj"))
    assert found.exit_code == 5
    assert found.stderr == (
        "menid: the hard-drive scenes need manifold3d: pip install 'menid-plan[hdd]'\n"
    )


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--quality", "0.003"], 2, "--report"),
        (["--quality", "0.003", "-o", "board.gltf"], 2, "must be .obj, .stl or .ply"),
        (["--quality", "0.003", "-o", "nowhere/board.obj"], 2, "there is no folder `nowhere`"),
        (["--quality", "0.5", "--report"], 2, "from 0.001 to 0.1"),
        (["--quality", "nan", "--report"], 2, "from 0.001 to 0.1"),
        (["--quality", "0.003", "-o", "board.obj", "--other-scan", "own.stl"], 2, "--report"),
        (["--quality", "0.003", "--report", "--scan", "."], 2, "is a directory"),
        (["--quality", "0.003", "-o", "own.stl", "--scan", "own.stl"], 2, "is an input"),
        (["--quality", "0.003", "--scan", "own.stl", "--report"], 5, "own.stl: the file is empty"),
        (["--quality", "0.003", "--part", "lid", "--report"], 2, "'lid' is not one of"),
        (["--quality", "fine", "--report"], 2, "'fine' is not a valid float"),
        (["--quality", "0.003", "--scan", "none.stl", "--report"], 2, "does not exist"),
    ],
)
def test_what_cannot_be_made_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], code: int, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.stl").touch()
    found = call(*arguments)
    assert found.exit_code == code, found.output
    assert message in found.output
    assert [path.name for path in tmp_path.iterdir()] == ["own.stl"]
