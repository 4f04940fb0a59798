"""Gymnasium both ways: its environments as ours, and our problems as its environments."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import menid_plan
from conftest import ROOT
from menid_plan.environments.interface import CannotResetError, EnvironmentFailedError
from menid_plan.environments.registry import make
from menid_plan.environments.session import Session
from menid_plan.environments.settings import SettingError
from menid_plan.errors import InputError, MeaningError
from menid_plan.grounding.semantics import Semantics
from menid_plan.grounding.state import GroundAction
from menid_plan.model.formulas import GroundAtom

gymnasium = pytest.importorskip("gymnasium")

LAMP = """
domain lamp
type switch
predicate lit
action press(s: switch) cost 1 {
  rule dark { when not lit outcomes { on: 0.7 lit reward 1  off: 0.2 nothing  noise: 0.1 } }
}
problem evening for lamp
object left, right: switch
goal lit
horizon 5
"""
DOCUMENT = menid_plan.parse(LAMP)
LIT = frozenset({GroundAtom("lit")})
LEFT = GroundAction("press", ("left",))
HERE = "environments_gym_example"


def lamp(**settings: Any) -> Session:
    given = {
        "make": f"{HERE}:Lamp", "atoms": f"{HERE}:atoms", "action": f"{HERE}:action", **settings,
    }  # fmt: skip
    found = {key: value for key, value in given.items() if value}
    return make(
        "gymnasium", found, DOCUMENT.domain, DOCUMENT.problem, "target",
        folder=Path(__file__).parent,
    )  # fmt: skip


# ---------------------------------------------------------------------------- an environment of ours


def test_actions_are_executed_in_it() -> None:
    session = lamp(arguments={"chance": 1.0})
    assert session.reset(None, 5) == frozenset()
    assert session.execute(GroundAction("press", ("right",))).state == frozenset()
    found = session.execute(LEFT)
    assert (found.state, found.reward) == (LIT, 0.0)
    assert found.duration is not None
    assert found.duration >= 0
    with pytest.raises(EnvironmentFailedError, match="the episode is over"):
        session.execute(LEFT)
    session.close()


def test_the_seed_decides() -> None:
    def states(seed: int) -> list[Any]:
        session = lamp(arguments={"chance": 0.5}, reward=False)
        session.reset(None, seed)
        return [session.execute(LEFT).state]

    assert states(2**53 - 1) == states(2**53 - 1)
    assert {s for seed in range(20) for s in states(seed)} == {frozenset(), LIT}


def test_put_it_into_a_state() -> None:
    assert lamp(put=f"{HERE}.py:put").reset(LIT, 0) == LIT
    session = lamp()
    assert not session.capabilities.reset_to_any
    with pytest.raises(CannotResetError, match="without `put`"):
        session.reset(LIT, 0)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"make": ""}, "id: expected either `id` or `make`"),
        ({"make": "", "id": "NoSuch-v0"}, "settings.id: `NoSuch-v0`"),
        ({"make": "nowhere:f"}, "settings.make: `nowhere:f`: ModuleNotFoundError"),
        ({"make": f"{HERE}:nothing"}, "settings.make: `environments_gym_example:nothing`: Attr"),
        ({"atoms": HERE}, "settings.atoms: expected `package.module:function`"),
        ({"action": "none.py:f"}, "settings.action: `none.py:f`: FileNotFoundError"),
    ],
)
def test_wrong_names_are_told(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingError) as caught:
        lamp(**settings)
    assert message in str(caught.value)


def test_a_file_may_import_what_is_beside_it(tmp_path: Path) -> None:
    (tmp_path / "beside_the_lamp.py").write_text(f"from {HERE} import atoms\n")
    (tmp_path / "lamp_file.py").write_text("from beside_the_lamp import atoms\n")
    found = make(
        "gymnasium",
        {"make": f"{HERE}:Lamp", "atoms": "lamp_file.py:atoms", "action": f"{HERE}:action"},
        DOCUMENT.domain, DOCUMENT.problem, "target", folder=tmp_path,
    )  # fmt: skip
    assert found.reset(None, 1) == frozenset()
    assert str(tmp_path) not in sys.path


def test_atoms_that_do_not_exist() -> None:
    with pytest.raises(EnvironmentFailedError, match="there is no predicate `shining`"):
        lamp(atoms=f"{HERE}:wrong_atoms").reset(None, 0)


# ----------------------------------------------------------------------- an environment of Gymnasium's


FILES = ["greenhouse/two-pots", "hdd/bench", "slippery-grid/pond"]


def problem_env(file: str, **options: Any) -> Any:
    from menid_plan.environments.gymnasium import GymEnv

    return GymEnv.from_files(ROOT / "domains" / f"{file}.menid", **options)


@pytest.mark.parametrize("file", FILES)
def test_gymnasium_finds_nothing_wrong(file: str) -> None:
    from gymnasium.envs.registration import EnvSpec
    from gymnasium.utils.env_checker import check_env

    document = menid_plan.read(ROOT / "domains" / f"{file}.menid")
    spec = EnvSpec(
        "menid/Problem-v0",
        "menid_plan.environments.gymnasium:GymEnv",
        kwargs={"domain": document.domain, "problem": document.problem},
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make(spec, render_mode="ansi")
        check_env(env.unwrapped)


@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize("noise", ["stay", "sink"])
def test_it_means_what_the_language_means(file: str, noise: Any) -> None:
    """Random walks: masks, rewards, ends and observations are those of the definition."""
    env = problem_env(file, noise=noise)
    document = menid_plan.read(ROOT / "domains" / f"{file}.menid")
    assert document.domain is not None
    assert document.problem is not None
    semantics = Semantics(document.domain, document.problem, None, noise)
    rng = np.random.default_rng(1)
    for episode in range(3):
        observation, info = env.reset(seed=episode)
        state = semantics.initial_state
        for step in range(1, 20):
            assert env.state == state
            held = {fact for fact, value in zip(env.facts, observation, strict=True) if value}
            assert held == state & set(env.facts)
            mask = info["action_mask"]
            offered = {a for a, value in zip(env.actions, mask, strict=True) if value}
            assert offered == {a for a, _ in semantics.applicable(state)}
            index = int(rng.choice(np.flatnonzero(mask)))
            ways = semantics.transitions(state, env.actions[index], document.domain.target)
            observation, reward, terminated, truncated, info = env.step(np.int64(index))
            after = env.state
            possible = {(None if t.state not in (after,) else t.state, t.reward) for t in ways}
            if after is None:
                assert terminated
                assert noise == "sink"
                break
            assert (after, reward) in possible
            assert terminated == semantics.is_final(after)
            horizon = document.problem.horizon
            assert truncated == (horizon is not None and step >= horizon and not terminated)
            state = after
            if terminated or truncated:
                break


def test_the_same_seed_gives_the_same_episode() -> None:
    def episode(seed: int) -> list[Any]:
        env = problem_env("slippery-grid/pond")
        _, info = env.reset(seed=seed)
        env.action_space.seed(seed)
        seen = []
        for _ in range(30):
            action = env.action_space.sample(info["action_mask"])
            observation, reward, terminated, _, info = env.step(action)
            seen.append((tuple(observation), reward))
            if terminated:
                break
        return seen

    assert episode(4) == episode(4)
    assert episode(4) != episode(5)


def test_an_action_that_does_not_apply_pays_the_penalty() -> None:
    env = problem_env("greenhouse/two-pots", penalty=-3.0, render_mode="ansi")
    before, info = env.reset(seed=0)
    index = int(np.flatnonzero(info["action_mask"] == 0)[0])
    after, reward, terminated, truncated, _ = env.step(np.int64(index))
    assert (after == before).all()
    assert (reward, terminated, truncated) == (-3.0, False, False)
    assert "at(sink)" in env.render()


def test_problems_that_are_no_episodes() -> None:
    from menid_plan.environments.gymnasium import GymEnv

    lit = menid_plan.parse(LAMP.replace("goal lit", "init lit goal lit"))
    with pytest.raises(MeaningError, match="ends where it begins"):
        GymEnv(lit.domain, lit.problem)
    bare = menid_plan.parse(
        "domain d predicate p action a { rule r { outcomes { o: 1 nothing } } } problem q for d"
    )
    with pytest.raises(MeaningError, match="nothing to do"):
        GymEnv(bare.domain, bare.problem)


def test_files_with_errors(tmp_path: Path) -> None:
    from menid_plan.environments.gymnasium import GymEnv

    (tmp_path / "a.menid").write_text("domain d predicate p problem q for d init r")
    with pytest.raises(InputError):
        GymEnv.from_files(tmp_path / "a.menid")
    (tmp_path / "a.menid").write_text("domain d predicate p")
    with pytest.raises(MeaningError, match="hold no problem"):
        GymEnv.from_files(tmp_path / "a.menid")
    env = GymEnv(DOCUMENT.domain, DOCUMENT.problem)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.int64(0))
