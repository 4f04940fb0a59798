"""The suction cup of finite elements: its rubber, and what it does to the board."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import menid_plan
from conftest import ROOT

pytest.importorskip("pybullet", reason="the extra `hdd` is not installed")

from menid_plan.environments.hdd import soft_cup
from menid_plan.environments.hdd.environment import HddEnvironment
from menid_plan.environments.hdd.film import film
from menid_plan.environments.hdd.kind import Hdd
from menid_plan.environments.hdd.meshes import Source, part_mesh
from menid_plan.environments.hdd.soft_cup import POISSON, YOUNG, Body, SoftGrip, cup_body
from menid_plan.environments.hdd.suck import LIP, heights
from menid_plan.environments.interface import EnvironmentFailedError
from menid_plan.environments.registry import Place
from menid_plan.environments.settings import read_settings
from menid_plan.grounding.state import GroundAction, State
from menid_plan.model.formulas import GroundAtom

DOCUMENT = menid_plan.read(ROOT / "domains" / "hdd" / "drive.menid")
assert DOCUMENT.domain is not None
assert DOCUMENT.problem is not None
PLACE = Place("fine", DOCUMENT.domain, DOCUMENT.problem)

SEATED = frozenset({GroundAtom("in", ("board", "tray"))})
REMOVED = frozenset({GroundAtom("on-table", ("board",))})
WEIGHT = 0.025 * 9.81  # N, of the board
# A cube of 1 mm, in six parts around its diagonal.
CUBE = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
PARTS = np.array(
    [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]]
)


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if base.name.startswith("popen-") else base) / "hdd-cache"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MENID_CACHE", str(folder))
        yield folder


def environment(**settings: Any) -> HddEnvironment:
    return Hdd(**{"quality": 0.003, "cup": "soft", **settings}).build(PLACE)


def sucked(spot: str, pressure: str, seed: int = 1, **settings: Any) -> tuple[State, bytes]:
    found = environment(**settings)
    found.reset(None, seed)
    state = found.execute(GroundAction("suck", (spot, pressure))).state
    return state, found.pose.position.tobytes() + found.pose.turn.tobytes()


# --------------------------------------------------------------------------------------- the rubber


@pytest.mark.parametrize("strain", [-1e-4, 1e-4])
def test_a_little_pulled_the_rubber_is_as_stiff_as_hooke_says(strain: float) -> None:
    cube = Body.of(CUBE, PARTS, 8)
    pulled = CUBE * [1 - POISSON * strain, 1 - POISSON * strain, 1 + strain]
    forces = cube.forces(pulled.T.ravel()).reshape(3, 8)
    # It pulls back on its upper face of 1 mm^2, and not aside.
    assert forces[2, 4:].sum() == pytest.approx(-YOUNG * strain, rel=1e-3)
    assert np.abs(forces[:2]).max() < 1e-3 * YOUNG * abs(strain)


def test_the_rubber_turns_without_effort_and_comes_back_from_inside_out() -> None:
    cube = Body.of(CUBE, PARTS, 8)
    turn = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    assert np.abs(cube.forces((CUBE @ turn.T).T.ravel())).max() < 1e-12
    turned_over = CUBE * [1, 1, -0.1]
    assert cube.forces(turned_over.T.ravel()).reshape(3, 8)[2, 4:].sum() > 0.05


def test_a_mesh_that_is_inside_out_or_flat_is_refused() -> None:
    with pytest.raises(ValueError, match="inside out"):
        Body.of(CUBE, PARTS[:, [1, 0, 2, 3]], 8)
    with pytest.raises(ValueError, match="flat"):
        Body.of(CUBE * [1, 1, 0], PARTS, 8)


def test_the_vacuum_pulls_the_cup_down_by_what_its_lip_encloses() -> None:
    at = cup_body().nodes.T
    total = soft_cup._sucked(at, 0.001).sum(axis=1)

    def polygon(radius: float) -> float:
        return LIP / 2 * radius**2 * np.sin(2 * np.pi / LIP)

    assert total == pytest.approx([0, 0, -0.001 * (polygon(14.0) - polygon(4.5))], abs=1e-12)


def test_the_surface_under_the_lip_is_that_of_the_mesh() -> None:
    mesh = part_mesh(Source("board"), 0.003).mesh
    points = np.random.default_rng(1).uniform(-55, 55, (200, 3))
    found = np.empty(200)
    soft_cup._under(np.ascontiguousarray(mesh.corners.reshape(-1, 9)), points, found)
    assert found == pytest.approx(heights(mesh, points[:, :2]))
    assert 20 < np.isinf(found).sum() < 150


# ------------------------------------------------------------------------------- what it does


def test_it_lifts_the_board_which_hangs_on_it_with_its_weight(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pulls: list[float] = []
    forces = SoftGrip.forces

    def kept(self: SoftGrip, now: Any, found: Any) -> bool:
        holds = forces(self, now, found)
        pulls.append(found[2])
        return holds

    monkeypatch.setattr(SoftGrip, "forces", kept)
    assert sucked("centre", "strong")[0] == REMOVED
    assert min(pulls) < -0.5  # it was pressed on the board
    assert np.mean(pulls[-800:]) == pytest.approx(WEIGHT, rel=0.02)


def test_what_is_too_weak_or_off_the_middle_stays() -> None:
    assert GroundAtom("in", ("board", "tray")) in sucked("right", "strong")[0]
    found = environment(gravity=0.0)
    found.reset(None, 1)
    before = found.pose
    assert found.execute(GroundAction("suck", ("centre", "weak"))).state == SEATED
    # It floated 0.12 mm over its seat, into which the cup has pressed it.
    assert np.abs(found.pose.position - before.position).max() < 0.15


def test_the_same_seed_ends_the_same_to_the_bit() -> None:
    arguments = ("right", "strong", 5)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        other = pool.submit(sucked, *arguments, noise=1.0)
        first = sucked(*arguments, noise=1.0)[1]
        assert other.result()[1] == first
    assert sucked("right", "strong", 6, noise=1.0)[1] != first


@pytest.mark.parametrize("number", [1e12, np.nan])
def test_a_computation_that_breaks_down_says_so(
    monkeypatch: pytest.MonkeyPatch, number: float
) -> None:
    class Broken:
        def solve(self, impulses: Any) -> Any:
            return number * (1 + impulses)

    monkeypatch.setattr(soft_cup, "solver", lambda step: Broken())
    with pytest.raises(EnvironmentFailedError, match="broke down: the cup burst"):
        sucked("centre", "strong")


def test_it_is_seen_and_that_changes_nothing() -> None:
    found = environment()
    pictures = film(found, GroundAction("suck", ("centre", "weak")), None, 1).pictures
    blue = [(p[:, :, 2] > p[:, :, 0].astype(int) + 60).sum() for p in pictures]
    assert blue[0] == 0
    assert max(blue) > 500
    assert found.pose.position.tobytes() == sucked("centre", "weak")[1][:24]


@pytest.mark.parametrize("value", ["hard", "", 1])
def test_another_cup_is_refused(value: object) -> None:
    found, faults = read_settings(Hdd, {"cup": value})
    assert found is None
    assert faults[0].startswith("cup: expected")
    assert "soft" in faults[0]
