"""The arm of the hard-drive scenes: its kinematics, its limits, and what it does to outcomes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import menid_plan
from conftest import ROOT

pytest.importorskip("pybullet", reason="the extra `hdd` is not installed")

import pybullet
import pybullet_data

from menid_plan.environments.hdd.arm import (
    ACCELERATION,
    HIGHEST,
    HOME,
    LOWEST,
    PEDESTAL,
    SPEED,
    Motion,
    Task,
    frames,
    jacobian,
    solved,
)
from menid_plan.environments.hdd.engine import Pose
from menid_plan.environments.hdd.environment import RANGES
from menid_plan.environments.hdd.film import film
from menid_plan.environments.hdd.kind import Deviations, HddRobot, Perception
from menid_plan.environments.hdd.lever import Lever
from menid_plan.environments.hdd.robot import RobotEnvironment
from menid_plan.environments.hdd.scene import TABLE, Scene
from menid_plan.environments.hdd.shake import Shake
from menid_plan.environments.hdd.suck import Suck
from menid_plan.environments.interface import EnvironmentFailedError
from menid_plan.environments.registry import Place
from menid_plan.environments.runfile import read_run_file
from menid_plan.environments.settings import read_settings
from menid_plan.grounding.state import GroundAction, State

DOCUMENT = menid_plan.read(ROOT / "domains" / "hdd" / "drive.menid")
assert DOCUMENT.domain is not None
assert DOCUMENT.problem is not None
PLACE = Place("robot", DOCUMENT.domain, DOCUMENT.problem)
QUALITY = 0.003  # that of the other tests of scenes, which keep its meshes
ATTRIBUTES = {thing.name: dict(thing.attributes) for thing in DOCUMENT.problem.objects}
EDGES = [a for a in ATTRIBUTES.values() if "direction" in a]
SPOTS = [a for a in ATTRIBUTES.values() if "x" in a and "direction" not in a]
SWAYS = [a["degrees"] for a in ATTRIBUTES.values() if "degrees" in a]
TOOLS: list[Lever | Suck | Shake] = [
    *(Lever(a["x"], a["y"], a["direction"]) for a in EDGES),
    *(Suck(a["x"], a["y"], -1135.0) for a in SPOTS),
    *map(Shake, SWAYS),
]


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.getbasetemp().parent / "hdd-cache"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MENID_CACHE", str(folder))
        yield folder


def environment(**settings: Any) -> RobotEnvironment:
    found = HddRobot(**{"quality": QUALITY, **settings}).build(PLACE)
    assert isinstance(found, RobotEnvironment)
    return found


def outcome(action: str, *arguments: str, seed: int = 1, **settings: Any) -> State:
    found = environment(**settings)
    found.reset(None, seed)
    return found.execute(GroundAction(action, arguments)).state


def names(state: State) -> set[str]:
    return {atom.predicate for atom in state}


def test_the_hand_is_where_pybullet_has_it() -> None:
    client = pybullet.connect(pybullet.DIRECT)
    try:
        file = str(Path(pybullet_data.getDataPath()) / "franka_panda" / "panda.urdf")
        arm = pybullet.loadURDF(file, useFixedBase=1, physicsClientId=client)
        rng = np.random.default_rng(1)
        for joints in rng.uniform(LOWEST, HIGHEST, (20, 7)):
            for k, angle in enumerate(joints):
                pybullet.resetJointState(arm, k, angle, physicsClientId=client)
            # Link 8 is the hand, whose fingers' tips are 103.4 mm further.
            at, turn = pybullet.getLinkState(
                arm, 8, computeForwardKinematics=1, physicsClientId=client
            )[4:6]
            matrix = Rotation.from_quat(turn).as_matrix()
            found = frames(joints)[7]
            assert found[:3, :3] == pytest.approx(matrix, abs=1e-4)
            assert found[:3, 3] == pytest.approx(
                1000 * np.array(at) + 103.4 * matrix[:, 2], abs=0.2
            )
    finally:
        pybullet.disconnect(client)


def test_the_jacobian_is_the_slope() -> None:
    joints = HOME + 0.1
    slopes = jacobian(joints)
    for k in range(7):
        step = np.zeros(7)
        step[k] = 1e-6
        before, after = frames(joints - step)[7], frames(joints + step)[7]
        way = (after[:3, 3] - before[:3, 3]) / 2e-6
        turn = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec() / 2e-6
        assert slopes[:, k] == pytest.approx([*way, *turn], abs=1e-3)


@pytest.mark.parametrize("first", [True, False])
def test_a_pose_is_solved_for(first: bool) -> None:
    wanted = frames(HOME + 0.2)[7]
    aim = Pose(wanted[:3, 3], Rotation.from_matrix(wanted[:3, :3]).as_quat())
    found = frames(solved(aim, HOME, first))[7]
    assert found[:3, 3] == pytest.approx(wanted[:3, 3], abs=0.05)
    assert found[:3, :3] == pytest.approx(wanted[:3, :3], abs=1e-3)


@pytest.mark.parametrize("tool", TOOLS, ids=str)
def test_all_that_the_drive_asks_for_is_within_reach_and_within_the_limits(
    tool: Lever | Suck | Shake,
) -> None:
    motion = Motion.of(Task.of(tool))
    assert (motion.joints > LOWEST).all()
    assert (motion.joints < HIGHEST).all()
    steps = np.diff(motion.times)[:, None]
    speed = np.diff(motion.joints, axis=0) / steps
    assert (np.abs(speed) <= 1.001 * SPEED).all()
    # Between knots the acceleration is that of the curve; differences of speeds blur it.
    acceleration = np.diff(speed, axis=0) / steps[1:]
    assert (np.abs(acceleration) <= 1.05 * ACCELERATION).all()
    # The lowest of its joints stays over the table.
    heights = [frames(q)[1:7, 2, 3] + TABLE + PEDESTAL for q in motion.joints[::5]]
    assert np.min(heights) > TABLE + 30


def test_the_wider_the_shake_the_slower_the_arm() -> None:
    stretches = [Motion.of(Task.of(Shake(degrees))).stretch for degrees in (0.01, 0.63, 5.0)]
    assert stretches[0] == 1.0
    assert stretches[0] < stretches[1] < stretches[2]


def test_what_is_too_far_is_refused_by_the_action_s_name(monkeypatch: pytest.MonkeyPatch) -> None:
    # Whatever a domain may ask for is within the arm's reach.
    monkeypatch.setitem(RANGES, "y", (-1000.0, 1000.0))
    text = (ROOT / "domains" / "hdd" / "drive.menid").read_text()
    text = text.replace("n1: edge (x: -40, y: -30", "n1: edge (x: -40, y: -700")
    domain = (ROOT / "domains" / "hdd" / "domain.menid").read_text()
    document = menid_plan.parse(domain + text)
    assert document.domain is not None
    assert document.problem is not None
    far = HddRobot(quality=QUALITY).build(Place("robot", document.domain, document.problem))
    far.reset(None, 1)
    with pytest.raises(EnvironmentFailedError, match=r"`lever\(n1\)`: the arm can't reach so far"):
        far.execute(GroundAction("lever", ("n1",)))
    far.reset(None, 1)
    assert names(far.execute(GroundAction("lever", ("n8",))).state) == {"on-table"}


def test_the_arm_levers_and_sucks() -> None:
    quiet = {"noise": 0.0}
    assert names(outcome("lever", "n8", **quiet)) == {"on-table"}
    assert names(outcome("lever", "n5", **quiet)) == {"in"}
    assert names(outcome("suck", "centre", "strong", **quiet)) == {"on-table"}
    assert names(outcome("suck", "centre", "weak", **quiet)) == {"in"}


def test_the_arm_goes_back_with_a_lever_that_did_not_go_in() -> None:
    found = environment(noise=0.0)
    reached: list[float] = []

    def watch(scene: Scene) -> None:
        if scene.reached is not None:
            reached.append(scene.reached)

    found.after_step = watch
    ends = {}
    for place in ("n5", "n8"):
        reached.clear()
        found.reset(None, 1)
        found.execute(GroundAction("lever", (place,)))
        ends[place] = (max(reached), reached[-1])
    # At n5 it does not get further than inside, and ends where it began; at n8 it ends at the end.
    assert ends["n8"][0] == ends["n8"][1]
    assert ends["n5"][0] < ends["n8"][0] / 2
    assert ends["n5"][1] < 0.1 * ends["n5"][0]


def test_a_shake_that_frees_the_board_is_too_fast_for_the_arm() -> None:
    assert names(outcome("shake", "s10", noise=0.0)) == {"in"}


def test_a_camera_that_errs_makes_the_lever_miss() -> None:
    found = [
        outcome("lever", "n8", seed=seed, deviations=Deviations(place=0.0), jerk=0.0,
                perception=Perception(x=6.0, y=6.0, z=2.0, yaw=0.1))
        for seed in range(4)
    ]  # fmt: skip
    assert any("in" in names(state) for state in found)


def test_the_camera_s_error_is_turned_into_the_tool_s() -> None:
    found = environment(perception=Perception(x=1.0, y=0.0, z=0.0, yaw=0.0), noise=1.0)
    found.reset(None, 1)
    ahead = found._seen_at({"x": 0.0, "y": -30.0, "direction": 90.0})
    # An error along x is across a lever that goes in along y.
    assert ahead["deeper"] == pytest.approx(0.0, abs=1e-12)
    assert abs(ahead["across"]) == abs(ahead["spot_x"]) > 0
    turned = environment(perception=Perception(x=0.0, y=0.0, z=0.0, yaw=0.01), noise=1.0)
    turned.reset(None, 1)
    beside = turned._seen_at({"x": 40.0, "y": -30.0, "direction": 90.0})
    assert beside["deeper"] == pytest.approx(40.0 * beside["askew"])
    assert beside["across"] == pytest.approx(-30.0 * beside["askew"])


def test_jerk_moves_the_tool_and_the_same_seed_moves_it_alike() -> None:
    motion = Motion.of(Task.of(Lever(50.0, -7.5, 180.0)))
    times = motion.times
    ways = [motion.hand(1e-3, np.random.default_rng(seed)).ways(times) for seed in (1, 1, 2)]
    assert (ways[0] == ways[1]).all()
    assert not (ways[0] == ways[2]).any()
    # A milliradian in each joint of an arm of half a metre: about a millimetre at the tool.
    assert 0.2 < np.std(ways[0]) < 3.0
    assert (motion.hand(0.0, np.random.default_rng(1)).ways(times) == 0).all()


def test_the_same_seed_ends_the_same_to_the_bit() -> None:
    found = environment()
    poses = []
    for seed in (1, 2, 1):
        found.reset(None, seed)
        found.execute(GroundAction("lever", ("n9",)))
        poses.append((*found.pose.position, *found.pose.turn))
    assert poses[0] == poses[2] != poses[1]


def test_an_arm_that_is_seen_changes_nothing() -> None:
    action = GroundAction("lever", ("n8",))
    found = environment()
    found.reset(None, 3)
    found.execute(action)
    plain = found.pose
    seen = film(found, action, None, 3)
    assert (found.pose.position == plain.position).all()
    assert (found.pose.turn == plain.turn).all()
    # The arm is white and grey; a scene without it has hardly any white on the table.
    middle = seen.pictures[len(seen.pictures) // 2][100:300]
    assert ((middle.min(axis=2) > 130) & (np.ptp(middle.astype(int), axis=2) < 12)).mean() > 0.05


@pytest.mark.parametrize("wrong", [{"jerk": -1}, {"jerk": 1}, {"perception": {"x": -1}}, {"w": 2}])
def test_bad_settings_are_refused(wrong: dict[str, object]) -> None:
    _, faults = read_settings(HddRobot, wrong)
    assert len(faults) == 1


def test_the_run_file_has_the_arm_as_the_target() -> None:
    assert DOCUMENT.domain is not None
    assert DOCUMENT.problem is not None
    bound = read_run_file(str(ROOT / "domains" / "hdd" / "robot.toml")).bind(
        DOCUMENT.domain, DOCUMENT.problem
    )
    assert isinstance(bound.target.kind, HddRobot)
    assert [spec.name for spec in bound.tests] == ["coarse", "fine"]
