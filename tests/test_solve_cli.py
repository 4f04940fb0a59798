"""`menid solve` on shipped problems, whose values are known by other means."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result

from conftest import ROOT

Menid = Callable[..., Result]

# Computed by an evaluator that shares no code with the solvers. The tireworlds are p01 and p02 of
# Little and Thiebaux (2007), the small exploding blocks are their ptiny problems.
KNOWN = {
    "tireworld/triangle-1": ("goal-then-reward", 1, -6.25, "move(l2-1)"),
    "tireworld/triangle-2": ("goal-then-reward", 1, -11.859375, "move(l2-1)"),
    "tireworld/triangle-3": ("goal-then-reward", 1, -19.2177734375, "move(l2-1)"),
    "exploding-blocks/unstack": ("goal-then-reward", 0.6, -4.4, None),
    "exploding-blocks/swap": ("goal-then-reward", 1, -15, None),
    "exploding-blocks/tower": ("goal-then-reward", 0.864, -27.508, None),
    "blocks/turn-over": ("goal-then-reward", 1, -9.55875, "pick(a)"),
    "blocks/tidy-up": ("goal-then-reward", 1, -12.21449, None),
    "hdd/bench": ("reward", None, 0.14603, "lever(n8)"),
    "hdd/drive": ("reward", None, 0.14603, "lever(n8)"),
    "hdd/line": ("reward", None, 0.433, "lever(n8)"),
    "slippery-grid/pond": ("reward", None, 6.36062, None),
    "slippery-grid/lake": ("reward", None, 10.15873, None),
    "rescue/corridor": ("reward", None, -0.7293, None),
    "rescue/house": ("reward", None, -6.38106, None),
    "maintenance/workshop": ("reward", None, 137.76885, None),
    "maintenance/plant": ("reward", None, 128.14213, None),
}


def solved(menid: Menid, *arguments: str) -> dict[str, Any]:
    result = menid("solve", *arguments, "--json")
    assert result.exit_code == 0, result.output
    found: dict[str, Any] = json.loads(result.output)
    return found


def problem(name: str) -> str:
    return str(ROOT / "domains" / f"{name}.menid")


@pytest.mark.parametrize("name", KNOWN)
def test_known_values(name: str, menid: Menid) -> None:
    objective, probability, value, action = KNOWN[name]
    found = solved(menid, problem(name))
    assert found["status"] == "solved"
    assert found["objective"] == objective
    assert found["lower"] <= found["value"] <= found["upper"]
    assert found["upper"] - found["lower"] <= 1e-6
    assert found["value"] == pytest.approx(value, abs=1e-5)
    if probability is not None:
        assert found["goal_probability"] == pytest.approx(probability)
    if action is not None:
        assert found["action"] == action
    assert set(found["seconds"]) == {"startup", "ground", "explore", "solve"}


def test_steps_and_goal_probability(menid: Menid) -> None:
    triangle = problem("tireworld/triangle-1")
    # Each action costs 1 and is a step.
    assert solved(menid, triangle, "--objective", "steps")["value"] == pytest.approx(6.25)
    found = solved(menid, problem("exploding-blocks/unstack"), "--objective", "goal-probability")
    assert found["value"] == pytest.approx(0.6)
    result = menid("solve", problem("exploding-blocks/unstack"), "--objective", "steps")
    assert result.exit_code == 1
    assert "infeasible" in result.output


def test_another_environment_and_param(menid: Menid) -> None:
    bench = problem("hdd/bench")
    # The coarse simulation holds n13 for the best place, where the robot mostly fails.
    assert solved(menid, bench, "--env", "coarse")["action"] == "lever(n13)"
    assert solved(menid, bench, "--set", "fail=0")["value"] > solved(menid, bench)["value"]


def test_the_policy_file_says_what_to_do_in_every_state_it_reaches(
    menid: Menid, tmp_path: Path
) -> None:
    solved(menid, problem("tireworld/triangle-1"), "-o", "policy.json")
    policy = json.loads((tmp_path / "policy.json").read_text())
    assert policy["objective"] == "goal-then-reward"
    first = policy["states"][0]
    assert "vehicle-at(l1-1)" in first["state"]
    assert first["action"] == "move(l2-1)"
    flat = [entry for entry in policy["states"] if {"flat", "has-spare"} <= {*entry["state"]}]
    assert flat
    assert {entry["action"] for entry in flat} == {"change"}


@pytest.mark.parametrize(
    ("text", "arguments", "code", "message"),
    [
        ("action a { rule r { outcomes { o: 1 p } } } problem t for d", [], 1, "unbounded"),
        ("problem t for d goal p", [], 0, "goal probability  0"),
        ("problem t for d", [], 0, "first action      none"),
        ("problem t for d", ["--env", "sim"], 3, "there is no environment `sim`"),
        ("problem t for d", ["--solver", "magic"], 2, "there is no solver `magic`"),
        ("problem t for d", ["--epsilon", "0"], 2, ""),
        ("problem t for d discount 0 horizon 0", [], 0, "value             0.0"),
    ],
)
def test_odd_problems(
    text: str, arguments: list[str], code: int, message: str, menid: Menid, tmp_path: Path
) -> None:
    (tmp_path / "a.menid").write_text(f"domain d predicate p reward 1 when true {text}")
    result = menid("solve", "a.menid", *arguments)
    assert result.exit_code == code, result.output
    assert message in result.output
