"""Meshes of the hard drive: what is checked of them, scans that are refused, and the cache."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from conftest import ROOT

pytest.importorskip("pybullet", reason="the extra `hdd` is not installed")

import trimesh
from click.testing import CliRunner, Result
from manifold3d import Manifold

import menid_plan
from menid_plan.cli.main import main
from menid_plan.environments.hdd import cache, geometry
from menid_plan.environments.hdd.kind import Hdd
from menid_plan.environments.hdd.mesh import TriangleMesh
from menid_plan.environments.hdd.meshes import Source, part_mesh, wanted_vertices
from menid_plan.environments.hdd.scans import MeshError, read_scan
from menid_plan.environments.registry import Place
from menid_plan.grounding.state import GroundAction

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], np.int32)
TETRAHEDRON = TriangleMesh(CORNERS, FACES)


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
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


def bar(x: float = 100.0, y: float = 60.0, z: float = 1.6) -> trimesh.Trimesh:
    """A plate like a board, of some ten thousand even triangles, as rough as a scan."""
    shape = Manifold.cube([x, y, z]).translate([-x / 2, -y / 2, 0]).refine_to_length(0.9)
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
    refused("text.stl", b"this is no mesh at all\n", "text.stl: ")
    refused("empty.ply", b"", "empty.ply: ")
    refused("empty.obj", b"", "empty.obj: ")
    whole = bar().export(file_type="stl")
    assert isinstance(whole, bytes)
    refused("short.stl", whole[: len(whole) // 2], "short.stl: ")
    refused("mesh.3ds", b"x", "must be one of stl, obj, ply")
    refused("missing.stl", None, "No such file")
    (tmp_path / "folder.stl").mkdir()
    refused("folder.stl", None, "directory")
    refused("nan.obj", b"v 0 0 0\nv 1 0 nan\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n", "nan.obj: ")


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
    bar(80.0, 50.0).export(tmp_path / "own.stl")
    after_change = part_mesh(Source("board", tmp_path / "own.stl"), 0.002)
    assert after_change.mesh.volume < 0.8 * before.mesh.volume


def test_a_scan_with_too_few_vertices_is_refused(tmp_path: Path) -> None:
    trimesh.creation.box((100, 60, 1.6)).export(tmp_path / "box.stl")
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
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def full(path: Path, data: bytes) -> None:
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(cache, "replace_file", full)
    made: list[int] = []
    with pytest.warns(UserWarning, match=r"No space left.*MENID_CACHE names another folder"):
        assert numbers([4], made)["numbers"].tolist() == [4]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        numbers([4], made)
    assert made == [1, 1]


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


def test_the_report_tells_what_was_checked(tmp_path: Path) -> None:
    shape = tmp_path / "plate.stl"
    bar(99.4, 59.4).export(shape)
    found = call("--quality", "0.002", "--scan", str(shape), "--report")
    assert found.exit_code == 0, found.output
    assert "(asked for: 662)" in found.stdout
    assert "open edges      0" in found.stdout
    assert "force at rest   1.0" in found.stdout
    bar(104.0, 60.0).export(shape)  # longer than the pocket
    found = call("--quality", "0.002", "--scan", str(shape), "--report")
    assert found.exit_code == 1
    assert "FAULT" in found.stdout


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--quality", "0.003"], 2, "--report"),
        (["--quality", "0.003", "-o", "board.gltf"], 2, "must be .obj, .stl or .ply"),
        (["--quality", "0.003", "-o", "nowhere/board.obj"], 2, "there is no folder nowhere"),
        (["--quality", "0.5", "--report"], 5, "from 0.001 to 0.1"),
        (["--quality", "fine", "--report"], 2, "'fine' is not a valid float"),
        (["--quality", "0.003", "--scan", "none.stl", "--report"], 2, "does not exist"),
    ],
)
def test_what_cannot_be_made_is_told(arguments: list[str], code: int, message: str) -> None:
    found = call(*arguments)
    assert found.exit_code == code, found.output
    assert message in found.output
