"""The hard-drive scenes: mechanics, outcomes that follow from it, and the kind of environment."""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from scipy.spatial.transform import Rotation

import menid_plan
from conftest import ROOT

pytest.importorskip("pybullet", reason="the extra `hdd` is not installed")

from menid_plan.cli.main import main
from menid_plan.environments.hdd.cells import cells, clipped
from menid_plan.environments.hdd.engine import EngineSettings, Pose, Surface, World
from menid_plan.environments.hdd.environment import HddEnvironment
from menid_plan.environments.hdd.film import film
from menid_plan.environments.hdd.geometry import SHAPES
from menid_plan.environments.hdd.kind import Deviations, Hdd
from menid_plan.environments.hdd.mesh import TriangleMesh
from menid_plan.environments.hdd.meshes import PARTS, Source, part_mesh
from menid_plan.environments.hdd.scene import BOARD_INERTIA, BOARD_MASS, Physics, Scene
from menid_plan.environments.hdd.shake import DURATION, Shake
from menid_plan.environments.hdd.suck import heights, hole_area
from menid_plan.environments.hdd.symbols import Seen
from menid_plan.environments.hdd.validity import validity
from menid_plan.environments.interface import CannotResetError, EnvironmentFailedError
from menid_plan.environments.pool import Failure, Pool
from menid_plan.environments.registry import EnvironmentSpec, Place
from menid_plan.environments.settings import SettingError, read_settings
from menid_plan.grounding.state import GroundAction, State
from menid_plan.model.formulas import GroundAtom

DOCUMENT = menid_plan.read(ROOT / "domains" / "hdd" / "drive.menid")
assert DOCUMENT.domain is not None
assert DOCUMENT.problem is not None
DOMAIN, PROBLEM = DOCUMENT.domain, DOCUMENT.problem
PLACE = Place("fine", DOMAIN, PROBLEM)

SEATED = frozenset({GroundAtom("in", ("board", "tray"))})
LOOSE = SEATED | {GroundAtom("loose", ("board",))}
REMOVED = frozenset({GroundAtom("on-table", ("board",))})
G = 9810.0
GREY = (0.5, 0.5, 0.5, 1)

# Where a session of several workers keeps the meshes, so that each is made once.
QUALITY = 0.003


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if base.name.startswith("popen-") else base) / "hdd-cache"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MENID_CACHE", str(folder))
        yield folder


def environment(**settings: Any) -> HddEnvironment:
    return Hdd(**{"quality": QUALITY, **settings}).build(PLACE)


def outcome(action: str, *arguments: str, seed: int = 1, **settings: Any) -> State:
    found = environment(**settings)
    found.reset(None, seed)
    return found.execute(GroundAction(action, arguments)).state


def meshes(quality: float) -> tuple[TriangleMesh, TriangleMesh]:
    board, bay = (part_mesh(Source(part), quality).mesh for part in ("board", "bay"))
    return board, bay


# ------------------------------------------------------------------------------------- mechanics


def test_a_free_fall_is_that_of_gravity() -> None:
    with World(EngineSettings()) as world:
        body = world.box((10, 10, 10), (0, 0, 0), 0.1, Surface(), GREY)
        for _ in range(250):
            world.step()
        assert world.time == pytest.approx(0.5)
        # Within a percent: steps of time, and the little damping that bodies have.
        assert world.pose(body).position[2] == pytest.approx(-0.5 * G * 0.5**2, rel=0.01)
        assert world.velocity(body)[0][2] == pytest.approx(-G * 0.5, rel=0.01)


@pytest.mark.parametrize("degrees", [10.0, 16.0, 25.0, 35.0])
def test_a_body_slides_on_an_incline_as_coulomb_says(degrees: float) -> None:
    friction, angle = 0.35, math.radians(degrees)
    turn = Rotation.from_euler("y", degrees, degrees=True)
    with World(EngineSettings()) as world:
        world.static_box(
            (500, 100, 10), turn.apply([0, 0, -10]), Surface(friction, 0.0), GREY, turn.as_quat()
        )
        body = world.box(
            (15, 15, 5), turn.apply([0, 0, 5.06]), 0.05, Surface(), GREY, turn=turn.as_quat()
        )
        for _ in range(150):
            world.step()
        moved = float(np.linalg.norm(world.pose(body).position - turn.apply([0, 0, 5.06])))
        acceleration = G * max(math.sin(angle) - friction * math.cos(angle), 0.0)
        assert moved == pytest.approx(0.5 * acceleration * 0.3**2, rel=0.03, abs=0.4)


def test_a_stack_rests_and_weighs_what_it_should() -> None:
    with World(EngineSettings()) as world:
        ground = world.static_box((100, 100, 10), (0, 0, -10), Surface(0.5, 0.1), GREY)
        bodies = [
            world.box((10, 10, 5), (0, 0, 5.2 + 10.3 * k), 0.05, Surface(0.8, 0.0), GREY)
            for k in range(3)
        ]
        for _ in range(500):
            world.step()
        forces = []
        for _ in range(50):
            world.step()
            forces.append(world.contact_force(ground))
        assert np.mean(forces) == pytest.approx(3 * 0.05 * G / 1000, rel=0.01)
        for k, body in enumerate(bodies):
            assert world.pose(body).position[2] == pytest.approx(5 + 10 * k, abs=0.3)
            assert np.linalg.norm(world.velocity(body)[0]) < 1.0


def test_a_force_and_a_torque_move_a_body_as_newton_says() -> None:
    with World(EngineSettings(), gravity=0.0) as world:
        body = world.box((10, 10, 10), (0, 0, 0), 0.1, Surface(), GREY, inertia=(10.0, 10.0, 10.0))
        for _ in range(100):
            at = world.motion(body)[0]
            world.push(body, at, (0.2, 0, 0), (0, 0, 0.05))
            world.step()
        linear, angular = world.velocity(body)
        assert linear[0] == pytest.approx(1000 * 0.2 / 0.1 * 0.2, rel=0.01)
        # 0.05 N mm on 10 kg mm^2 are 5 rad/s^2.
        assert angular[2] == pytest.approx(5 * 0.2, rel=0.01)


def test_the_shaken_frame_accelerates_as_its_angle_says() -> None:
    swing, h = Shake(2.0), 1e-5
    for time in np.linspace(0.01, DURATION - 0.01, 60):
        before, (_, rate, acceleration), after = (swing.angles(time + k * h) for k in (-1, 0, 1))
        assert rate == pytest.approx((after[0] - before[0]) / (2 * h), abs=1e-4)
        assert acceleration == pytest.approx((after[1] - before[1]) / (2 * h), abs=1e-2)
    assert swing.angles(0.0)[:2] == (0.0, 0.0)


# ------------------------------------------------------------------------------- meshes and cells


@pytest.mark.parametrize("quality", [0.001, 0.002, 0.003, 0.0045, 0.006, 0.01])
def test_the_board_rests_with_its_weight_and_can_be_lifted(quality: float) -> None:
    found = validity(*meshes(quality), Physics())
    assert found.faults == []
    assert found.force == pytest.approx(1, abs=0.02)
    assert found.rise == pytest.approx(1, abs=0.03)


def test_a_board_that_does_not_fit_is_found_out() -> None:
    board, bay = meshes(0.003)
    wide = TriangleMesh(board.vertices * [1.03, 1, 1], board.triangles)
    assert validity(wide, bay, Physics()).faults


def test_meshes_have_the_vertices_and_the_volume_that_they_should() -> None:
    for part in PARTS:
        for quality in (0.001, 0.01):
            report = part_mesh(Source(part), quality).report
            assert report.faults == []
            assert report.vertices == pytest.approx(
                quality * {"board": 331_000}.get(part, 518_300), rel=0.01
            )
            exact = SHAPES[part]().volume()
            assert report.volume == pytest.approx(exact, rel=0.012)


def test_a_full_scan_has_as_many_vertices_as_the_papers() -> None:
    for part, wanted in (("board", 331_000), ("bay", 518_300)):
        assert len(Source(part).full().vertices) == pytest.approx(wanted, rel=0.01)


def test_clipped_triangles_keep_their_area() -> None:
    rng = np.random.default_rng(3)
    triangles = rng.uniform(-1, 1, (200, 3, 3))

    def area(found: Any) -> float:
        a, b, c = found.transpose(1, 0, 2)
        return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)

    for axis in range(3):
        halves = [clipped(triangles, axis, 0.2, side) for side in (1, -1)]
        assert sum(map(area, halves)) == pytest.approx(area(triangles))
        assert halves[0][:, :, axis].min() >= 0.2 - 1e-12
        assert halves[1][:, :, axis].max() <= 0.2 + 1e-12


def test_cells_fill_the_plate() -> None:
    from scipy.spatial import ConvexHull

    board, _ = meshes(0.003)
    total = sum(ConvexHull(hull).volume for hull in cells(board, 0.0))
    # Hulls bridge notches and holes, and are as large as the board beside that.
    assert 0.97 < total / board.volume < 1.15


def test_heights_are_those_of_the_upper_side() -> None:
    board, _ = meshes(0.01)
    found = heights(board, np.array([[0.0, 0.0], [-45.5, -25.5], [80.0, 0.0], [-45.5, 16.0]]))
    assert found[0] == pytest.approx(1.6, abs=0.15)
    assert found[1] == -np.inf  # a hole for a screw
    assert found[2] == -np.inf  # beside the board
    assert found[3] > 4.0  # on the connector
    assert hole_area(board, np.array([0.0, 0.0])) == 0.0
    assert hole_area(board, np.array([-40.0, -20.0])) > 5.0


# -------------------------------------------------------------- outcomes follow from the mechanics


def test_the_lever_frees_the_board_where_there_is_a_slot() -> None:
    assert outcome("lever", "n8") == REMOVED
    assert outcome("lever", "n2") == SEATED  # a wall
    assert outcome("lever", "n11") == SEATED  # a high threshold


def test_without_force_the_lever_does_nothing() -> None:
    assert outcome("lever", "n8", force=0.0) == SEATED


def test_the_cup_lifts_what_its_pressure_and_place_can_lift() -> None:
    assert outcome("suck", "centre", "strong") == REMOVED
    assert outcome("suck", "centre", "weak") == SEATED
    assert outcome("suck", "right", "strong") != REMOVED  # the board's weight peels it off
    assert outcome("suck", "right", "strong", gravity=0.0) == REMOVED
    assert outcome("suck", "centre", "strong", gravity=30.0) == SEATED


def test_shaking_throws_the_board_out_when_it_overcomes_gravity() -> None:
    assert outcome("shake", "s1") == SEATED
    assert outcome("shake", "s8") == SEATED
    assert outcome("shake", "s10", gravity=100.0) == SEATED
    assert outcome("shake", "s9", gravity=0.0) == REMOVED


def test_friction_decides_where_a_shaken_board_ends() -> None:
    ends = []
    for friction in (0.0, 0.35):
        found = environment(friction=friction)
        found.reset(None, 1)
        found.execute(GroundAction("shake", ("s9",)))
        ends.append(float(np.hypot(*found.pose.position[:2])))
    assert ends[0] > 4 * ends[1]


SCENES = [
    ("lever", ("n8",)), ("lever", ("n5",)), ("shake", ("s10",)), ("suck", ("centre", "strong")),
    ("suck", ("right", "strong")),
]  # fmt: skip


@pytest.mark.parametrize("action", [GroundAction(*scene) for scene in SCENES], ids=str)
def test_energy_and_penetration_are_bounded(action: GroundAction) -> None:
    energies, depths = [], []

    def watch(scene: Scene) -> None:
        (_, _, z), _, linear, angular = scene.world.motion(scene.board)
        moves = 0.5 * BOARD_MASS * sum(v * v for v in linear) / 1e6
        turns = 0.5 * sum(i * w * w for i, w in zip(BOARD_INERTIA, angular, strict=True)) / 1e6
        energies.append(moves + turns + BOARD_MASS * 9.81 * z / 1000)
        depths.append(scene.world.deepest(scene.board))

    found = environment(noise=1.0)
    found.reset(None, 2)
    found.after_step = watch
    found.execute(action)
    # Lifted by 40 mm the board has a hundredth of a joule, and thrown out with gravity twice over some
    # hundredths.
    assert max(energies) < {"lever": 0.02, "shake": 0.06, "suck": 0.015}[action.action]
    assert energies[-1] < 0.002
    # In one step of time it falls by 2 mm; what sank in then is out again at rest.
    assert max(depths) < 4.0
    assert depths[-1] < 0.5


def run_of(folder: Path, trouble: str, seeds: range) -> tuple[list[State], list[Failure]]:
    """Executions in one worker, which is killed, or stopped, while it executes one of them."""
    failures: list[Failure] = []
    spec = EnvironmentSpec(
        "fine", Hdd(quality=QUALITY, noise=1.0), DOMAIN, PROBLEM, timeout=20.0, folder=folder
    )
    with Pool([spec], 1, failed=failures.append) as pool:
        action = GroundAction("shake", ("s5",))
        futures = [pool.submit("fine", SEATED, action, seed, seed) for seed in seeds]
        futures[0].result()
        if trouble:
            children = Path(f"/proc/{os.getpid()}/task").glob("*/children")
            (worker,) = {
                int(word)
                for file in children
                for word in file.read_text().split()
                if "menid_plan" in Path(f"/proc/{word}/cmdline").read_text()
            }
            os.kill(worker, getattr(signal, trouble))
        return [future.result().state for future in futures], failures


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="needs Linux's list of processes")
@pytest.mark.parametrize(("trouble", "kind"), [("SIGKILL", "crash"), ("SIGSTOP", "timeout")])
def test_a_worker_that_is_killed_or_hangs_costs_one_attempt(
    tmp_path: Path, trouble: str, kind: str
) -> None:
    seeds = range(4)
    expected, none = run_of(tmp_path, "", seeds)
    found, failures = run_of(tmp_path, trouble, seeds)
    assert none == []
    assert found == expected
    assert [failure.trouble for failure in failures] == [kind]


# --------------------------------------------------------------------------- the same to the bit


def final(seed: int, times: int = 1, quality: float = QUALITY) -> bytes:
    """The pose in which the last of so many equal executions in one environment ends."""
    found = environment(noise=1.0, quality=quality)
    for _ in range(times):
        found.reset(None, seed)
        found.execute(GroundAction("lever", ("n1",)))
    pose = found.pose
    return pose.position.tobytes() + pose.turn.tobytes()


def test_the_same_seed_ends_the_same_to_the_bit() -> None:
    first = final(5)
    assert final(5, times=10) == first
    assert final(6) != first
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        assert list(pool.map(final, [5, 5, 6])) == [first, first, final(6)]


def test_at_the_highest_quality_too() -> None:
    assert final(5, times=2, quality=0.01) == final(5, quality=0.01)


# ------------------------------------------------------------------------------- the environment


@pytest.mark.parametrize("state", [SEATED, LOOSE, REMOVED])
def test_it_can_be_put_into_every_state_of_the_domain(state: State) -> None:
    found = environment(noise=1.0)
    for seed in range(5):
        assert found.reset(state, seed) == state
        assert found.state() == state


def test_states_in_which_no_board_stays_are_refused_by_name() -> None:
    with pytest.raises(CannotResetError, match=r"in\(board, tray\), on-table\(board\)"):
        environment().reset(SEATED | REMOVED, 1)
    with pytest.raises(CannotResetError, match="nothing"):
        environment().reset(frozenset(), 1)


def test_an_execution_goes_on_from_where_the_board_is() -> None:
    found = environment()
    found.reset(LOOSE, 3)
    before = found.pose
    found.execute(GroundAction("shake", ("s1",)))
    assert np.linalg.norm(found.pose.position - before.position) < 0.5


def test_atoms_follow_from_thresholds() -> None:
    assert not Seen(0.3, 0.2, 0.1).loose
    assert Seen(0.3, 1.2, 0.1).loose
    assert Seen(0.3, 0.2, 2.5).loose
    assert Seen(21.0, 0.2, 0.0).removed
    assert Seen(0.0, 4.1, 0.0).removed
    assert not Seen(25.0, 4.1, 3.0).loose
    tilted = Pose(np.zeros(3), Rotation.from_euler("y", 30, degrees=True).as_quat())
    assert Seen.of(tilted).tilt == pytest.approx(30)


def test_a_domain_that_declares_damage_is_told_of_it() -> None:
    from menid_plan.model.domain import Predicate

    domain = replace(DOMAIN, predicates=(*DOMAIN.predicates, Predicate("damaged", (("pcb",),))))
    found = Hdd(quality=QUALITY).build(replace(PLACE, domain=domain))
    damaged = GroundAtom("damaged", ("board",))
    found.reset(None, 1)
    assert damaged not in found.execute(GroundAction("shake", ("s1",))).state
    found.reset(None, 1)
    found.execute(GroundAction("lever", ("n8",)))
    assert found.force > 1.0
    with pytest.raises(CannotResetError):
        found.reset(SEATED | {damaged}, 1)


def test_what_problem_or_domain_lack_is_named() -> None:
    line = menid_plan.read(ROOT / "domains" / "hdd" / "line.menid").problem
    assert line is not None
    with pytest.raises(SettingError, match="3 objects of type `pcb`"):
        Hdd().build(replace(PLACE, problem=line))
    objects = tuple(replace(o, attributes=()) if o.name == "s3" else o for o in PROBLEM.objects)
    with pytest.raises(SettingError, match=r"`s3`.*lacks the attribute `degrees`"):
        Hdd().build(replace(PLACE, problem=replace(PROBLEM, objects=objects)))
    for name, attributes, message in (
        ("centre", (("x", 5000.0), ("y", 0.0)), r"`x` of the object `centre`.* is 5000; it must"),
        ("strong", (("pascal", 1135.0),), r"`pascal`.* is 1135; .* between -101325 and 0"),
        ("s10", (("degrees", 1e300),), r"`degrees` .* between 0 and 45"),
    ):
        objects = tuple(
            replace(o, attributes=attributes) if o.name == name else o for o in PROBLEM.objects
        )
        with pytest.raises(SettingError, match=message):
            Hdd().build(replace(PLACE, problem=replace(PROBLEM, objects=objects)))
    unseen = tuple(p for p in PLACE.domain.predicates if p.name not in ("in", "on-table"))
    with pytest.raises(SettingError, match=r"neither `in\(pcb, bay\)` nor"):
        Hdd().build(replace(PLACE, domain=replace(PLACE.domain, predicates=unseen)))
    for scan in ("nofile.stl", ".", "a\0b.stl", "board.xyz"):
        with pytest.raises(SettingError) as found:
            Hdd(board=scan).build(PLACE)
        assert found.value.key == "board"
    greenhouse = menid_plan.read(ROOT / "domains" / "greenhouse" / "two-pots.menid")
    assert greenhouse.domain is not None
    assert greenhouse.problem is not None
    with pytest.raises(SettingError, match="no action `drive`; it has lever, shake, suck"):
        Hdd().build(Place("robot", greenhouse.domain, greenhouse.problem))


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"quality": 0.0005}, "quality: expected at least 0.001"),
        ({"quality": 0.2}, "quality: expected at most 0.1"),
        ({"quality": "fine"}, "quality: expected a number"),
        ({"noise": -1}, "noise: expected at least 0"),
        ({"deviations": {"above": -0.1}}, "above: expected at least 0"),
        ({"deviations": {"abvoe": 0.1}}, "did you mean `above`"),
        ({"step": 0}, "step: expected at least"),
        ({"gravity": 1e300}, "gravity: expected at most 1000"),
        ({"deviations": {"friction": 1e6}}, "friction: expected at most 1000"),
        ({"iterations": 0}, "iterations: expected at least 1"),
    ],
)
def test_settings_out_of_range_are_refused(table: dict[str, Any], message: str) -> None:
    found, faults = read_settings(Hdd, table)
    assert found is None
    assert message in faults[0]


def test_without_reset_it_does_not_execute() -> None:
    with pytest.raises(EnvironmentFailedError, match="not reset"):
        environment().execute(GroundAction("lever", ("n1",)))


def test_deviations_of_nothing_leave_nothing_to_chance() -> None:
    still = Deviations(**dict.fromkeys(Deviations.__slots__, 0.0))
    ends = {final_pose(seed, still) for seed in range(3)}
    assert len(ends) == 1


def final_pose(seed: int, deviations: Deviations) -> bytes:
    found = environment(noise=1.0, deviations=deviations)
    found.reset(None, seed)
    found.execute(GroundAction("lever", ("n1",)))
    position: bytes = found.pose.position.tobytes()
    return position


def test_without_the_extra_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    from menid_plan.environments.hdd import extra

    monkeypatch.setattr(extra, "find_spec", lambda name: None if name == "pybullet" else 1)
    with pytest.raises(EnvironmentFailedError, match=r"pybullet: pip install 'menid-plan\[hdd\]'"):
        Hdd().build(PLACE)


# -------------------------------------------------------------------------------------- pictures

DRIVE = [str(ROOT / "domains" / "hdd" / name) for name in ("domain.menid", "drive.menid")]
RUN = """
[environment.fine]
kind = "hdd"
role = "target"
settings = { quality = 0.003 }

[environment.coarse]
kind = "simulated"
"""


def render(folder: Path, *arguments: str) -> Result:
    (folder / "run.toml").write_text(RUN)
    return CliRunner().invoke(
        main, ["render", *DRIVE, *arguments, "--run", str(folder / "run.toml")]
    )


@pytest.mark.parametrize(
    ("kind", "begins"), [("gif", b"GIF89a"), ("png", b"\x89PNG"), ("mp4", b"ftyp")]
)
def test_an_execution_is_filmed(tmp_path: Path, kind: str, begins: bytes) -> None:
    out = tmp_path / f"lever.{kind}"
    found = render(tmp_path, "lever(n8)", "-o", str(out))
    assert found.exit_code == 0, found.output
    assert found.stdout == "lever(n8): on-table(board)\n"
    assert begins in out.read_bytes()[:12]


def test_in_the_pictures_the_board_moves_and_colours_tell_it_from_the_rest() -> None:
    found = film(environment(), GroundAction("suck", ("centre", "strong")), None, 1)

    def middle_of_green(picture: Any) -> Any:
        red, green, blue = picture.astype(int).transpose(2, 0, 1)
        rows, columns = np.nonzero((green > red + 40) & (green > blue + 20))
        assert len(rows) > 1000
        return np.array([rows.mean(), columns.mean()])

    first, last = found.pictures[0], found.pictures[-1]
    assert first.shape == (352, 480, 3)
    assert np.linalg.norm(middle_of_green(last) - middle_of_green(first)) > 50
    assert 20 <= len(found.pictures) <= 60


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["lever(n8)"], 2, "-o"),
        (["lever(n8)", "-o", "x.jpg"], 2, "must be .gif, .mp4 or .png"),
        (["lever(n8)", "-o", "nowhere/x.gif"], 2, "there is no folder `nowhere`"),
        (["lever(n99)", "-o", "x.gif"], 3, "n99"),
        (["lever(n8)", "-o", "x.gif", "--env", "coarse"], 5, "has nothing to be seen"),
        (["lever(n8)", "-o", "x.gif", "--env", "robot"], 2, "no environment `robot`"),
    ],
)
def test_what_cannot_be_filmed_is_told(
    tmp_path: Path, arguments: list[str], code: int, message: str
) -> None:
    found = render(tmp_path, *arguments)
    assert found.exit_code == code, found.output
    assert message in found.output


def test_what_is_read_is_not_written_over(tmp_path: Path) -> None:
    problem = tmp_path / "problem.png"
    problem.write_bytes(Path(DRIVE[1]).read_bytes())
    (tmp_path / "run.gif").write_text(RUN)
    for arguments in (
        [
            DRIVE[0],
            str(problem),
            "lever(n8)",
            "--run",
            str(tmp_path / "run.gif"),
            "-o",
            str(problem),
        ],
        [*DRIVE, "lever(n8)", "--run", str(tmp_path / "run.gif"), "-o", str(tmp_path / "run.gif")],
    ):
        found = CliRunner().invoke(main, ["render", *arguments])
        assert found.exit_code == 2
        assert "is an input" in found.output


def test_an_action_that_does_not_apply_is_told(tmp_path: Path) -> None:
    out = str(tmp_path / "x.png")
    found = render(tmp_path, "lever(n8)", "--state", "on-table(board)", "-o", out)
    assert found.exit_code == 0, found.output
    assert "`lever(n8)` does not apply in that state" in found.stderr


def test_the_best_action_is_filmed(tmp_path: Path) -> None:
    out = tmp_path / "best.png"
    found = render(tmp_path, "--best", "-o", str(out))
    assert found.exit_code == 0, found.output
    assert "the best action in fine: lever(n8)\n" in found.stderr
    assert found.stdout == "lever(n8): on-table(board)\n"
    assert out.read_bytes().startswith(b"\x89PNG")


def test_with_the_best_action_none_is_given(tmp_path: Path) -> None:
    found = render(tmp_path, "lever(n8)", "--best", "-o", str(tmp_path / "best.png"))
    assert found.exit_code == 2
    assert "--best stands in place of an action: leave out `lever(n8)`" in found.output


def test_an_action_that_is_missing_is_asked_for(tmp_path: Path) -> None:
    out = str(tmp_path / "x.png")
    arguments = [*DRIVE, "--run", str(ROOT / "domains/hdd/simulated.toml"), "-o", out]
    found = CliRunner().invoke(main, ["render", *arguments])
    assert found.exit_code == 2
    assert "give DOMAIN, PROBLEM and ACTION, or --best in place of an action" in found.output


def test_without_a_screen_there_is_no_window(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    found = render(tmp_path, "lever(n8)", "--gui")
    assert found.exit_code == 5
    assert "there is no screen" in found.output
