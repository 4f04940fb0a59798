"""Planners of others as solvers: asked for the next action by a learning run."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result

import menid_plan
from learning_runs import DOMAIN, LEFT, PROBLEM, RIGHT, bound, run_of, stored
from menid_plan.environments.simulated import Simulated
from menid_plan.experience.record import DistributionKey
from menid_plan.grounding.state import GroundAction
from menid_plan.learning.counts import domain_with
from menid_plan.model.formulas import GroundAtom
from menid_plan.planners import known
from menid_plan.planners.asked import Asked, PlannerFailedError
from menid_plan.planning import Task
from test_plan_cli import CLIENT, COIN, PPDDL_CLIENT, declare

Menid = Callable[..., Result]

# Flips a coin that it chooses by what no two of its processes have in common.
MOODY = CLIENT.replace("coins[0]", 'coins[__import__("os").getpid() % len(coins)]')
RUN = """
[environment.target]
kind = "simulated"
role = "target"
[learn]
solver = "planner"
solver_options = {planner = "fake", seconds = 60}
steps = 6
"""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with coins, in which the user's own file of planners is looked for."""
    monkeypatch.setattr(known, "user_config_path", lambda *_, **__: tmp_path)
    (tmp_path / "coins.menid").write_text(COIN, encoding="utf-8")
    (tmp_path / "run.toml").write_text(RUN, encoding="utf-8")
    return tmp_path


def coins() -> Any:
    document = menid_plan.parse(COIN)
    assert document.domain is not None
    assert document.problem is not None
    return document.domain, document.problem


def decisions(folder: Path) -> list[Any]:
    events = map(json.loads, (folder / "events.jsonl").read_text().splitlines())
    return [event["action"] for event in events if event["event"] == "decided"]


def test_an_answer_is_the_first_action(here: Path) -> None:
    domain, problem = coins()
    declare(here, sys.executable, "-c", CLIENT, "{port}")
    asked = Asked("fake", horizon=5)
    assert asked.choose(domain, problem, {}) == GroundAction("flip", ("one",))
    flipped = replace(problem, init=(GroundAtom("seen", ("one",)),), horizon=1)
    assert asked.choose(domain, flipped, {}) == GroundAction("flip", ("other",))


def test_an_answer_from_one_that_reads_ppddl(here: Path) -> None:
    domain, problem = coins()
    command = (sys.executable, "-c", PPDDL_CLIENT, "{port}", "{domain}", "{instance}", "{name}")
    declare(here, *command, rest="protocol = 'mdpsim'\n")
    flipped = replace(problem, init=(GroundAtom("seen", ("one",)),))
    assert Asked("fake").choose(domain, flipped, {}) == GroundAction("flip", ("other",))


@pytest.mark.parametrize(
    ("script", "seconds", "message"),
    [
        ("print('no licence')", 60, "it ended with 0 before it asked for the task: no licence"),
        ("import time; time.sleep(60)", 0.5, "it was not done after 0.5 s"),
        (CLIENT.replace("coins[0]", '"nothing"'), 60, "`flip` has no arguments `nothing`"),
        (
            CLIENT.replace("if seen", "if True or seen"),
            60,
            "no action was sent where one has to be",
        ),
    ],
)
def test_one_that_does_not_answer(here: Path, script: str, seconds: float, message: str) -> None:
    declare(here, sys.executable, "-c", script, "{port}")
    with pytest.raises(PlannerFailedError, match="the planner `fake` failed: ") as caught:
        Asked("fake", seconds=seconds).choose(*coins(), {})
    assert message in str(caught.value)


def test_a_run_that_asks_is_gone_on_with(menid: Menid, here: Path) -> None:
    """What was decided is not asked again: the answer might be another."""
    declare(here, sys.executable, "-c", MOODY, "{port}")
    run = ("learn", "coins.menid", "--run", "run.toml", "-o", "out")
    result = menid(*run, "--steps", "4", "--json")
    assert result.exit_code == 0, result.output
    before, experiences = decisions(here / "out"), stored(here / "out")
    assert len(before) == len(experiences) == 4
    # The clock of the store tells whether it was executed again.
    (here / "planners.toml").unlink()
    declare(here, sys.executable, "-c", CLIENT, "{port}")
    result = menid(*run, "--steps", "7", "--resume", "--json")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["steps"] == 7
    assert decisions(here / "out")[:4] == before
    assert len(decisions(here / "out")) == 7
    assert stored(here / "out")[:4] == experiences


@pytest.mark.parametrize(
    "line",
    [
        '{"event": "decided", "number": 3, "action": ["flip", 3]}',
        '{"event": "decided", "number": 2, "action": "flip"}',
        '{"event": "decided", "number": 1, "action": []}',
        '{"event": "decided", "number": [], "action": ["flip", ["one"]]}',
        "[" * 100_000,
    ],
)
def test_what_others_wrote_into_the_events_is_passed_over(
    menid: Menid, here: Path, line: str
) -> None:
    declare(here, sys.executable, "-c", CLIENT, "{port}")
    run = ("learn", "coins.menid", "--run", "run.toml", "-o", "out")
    assert menid(*run, "--steps", "1").exit_code == 0
    with (here / "out" / "events.jsonl").open("a") as file:
        file.write(line + "\n")
    result = menid(*run, "--steps", "2", "--resume")
    assert result.exit_code == 0, result.output
    assert len(stored(here / "out")) == 2


def test_a_run_whose_planner_fails_can_be_gone_on_with(menid: Menid, here: Path) -> None:
    calls = here / "calls"
    third = f"""
import pathlib
calls = pathlib.Path({str(calls)!r})
calls.write_text(calls.read_text() + "x" if calls.exists() else "x")
if len(calls.read_text()) == 3:
    sys.exit("out of memory")
"""
    declare(here, sys.executable, "-c", "import sys\n" + third + CLIENT, "{port}")
    run = ("learn", "coins.menid", "--run", "run.toml", "-o", "out")
    result = menid(*run)
    assert result.exit_code == 5, result.output
    assert "the planner `fake` failed: it ended with 1 before it asked" in result.stderr
    assert "out of memory" in result.stderr
    assert len(stored(here / "out")) == 2
    result = menid(*run, "--resume")
    assert result.exit_code == 0, result.output
    assert len(stored(here / "out")) == 6
    assert len(calls.read_text()) == 7


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        ('planner = "fakir"', 3, "did you mean `fake`?"),
        ("planner = 3", 3, "planner must be a name, not 3"),
        ("horizon = 2.5", 3, "horizon must be a whole number from 1 to 1000000, not 2.5"),
        ("horizon = 0", 3, "horizon must be a whole number from 1 to 1000000, not 0"),
        ("seconds = -1.0", 3, "seconds must be above 0, and at most 1e+06, not -1.0"),
        ("seconds = 1e300", 3, "seconds must be above 0, and at most 1e+06, not 1e+300"),
        ('seconds = "x"', 3, "seconds must be above 0, and at most 1e+06, not x"),
        ("draw = 3", 3, "draw must be true or false, not 3"),
        ("horizon = true", 3, "horizon must be a whole number from 1 to 1000000, not True"),
        ("speed = 3", 3, "has no option --speed"),
    ],
)
def test_options_that_do_not_do(
    menid: Menid, here: Path, options: str, code: int, message: str
) -> None:
    declare(here, sys.executable, "-c", CLIENT, "{port}")
    text = re.sub("{.*}", f"{{{options}}}", RUN)
    (here / "run.toml").write_text(text, encoding="utf-8")
    result = menid("learn", "coins.menid", "--run", "run.toml", "-o", "out")
    assert result.exit_code == code, result.output
    assert message in result.stderr
    assert not (here / "out").exists()


def test_prost_is_missed_before_anything_is_done(
    menid: Menid, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MENID_PROST", str(here))
    (here / "run.toml").write_text(RUN.replace("solver_options", "# "), encoding="utf-8")
    run = ("learn", "coins.menid", "--run", "run.toml", "-o", "out", "--solver", "prost")
    result = menid(*run)
    assert result.exit_code == 5, result.output
    assert "PROST was not found" in result.stderr
    assert not (here / "out").exists()


@pytest.mark.parametrize("draw", [False, True])
def test_the_model_that_it_is_given(tmp_path: Path, draw: bool) -> None:
    """The present state, the steps left, and what is believed: the mean, or a draw."""
    seen = []

    class Recorder:
        name = promise = needs = "recorder"

        def __init__(self) -> None:
            self.draw = draw

        def choose(self, domain: Any, problem: Any, params: Any) -> GroundAction:
            task = Task(domain, problem, params=params)
            task.build()
            structure = task.structure
            keys = [(d.action, d.values) for d in structure.problem.distributions]
            seen.append((problem.init, problem.horizon, keys, task.chances))
            return LEFT if not problem.init else GroundAction("finish")

    run = run_of(tmp_path / "run", bound(Simulated(), {}), steps=5)
    run.planner.solver = Recorder()
    run.learn()
    assert [init for init, *_ in seen].count(()) >= 1

    def believed(asked: Any, key: tuple[str, tuple[str, ...]]) -> list[float]:
        parts = np.split(asked[3], np.arange(3, len(asked[3]), 3))
        return next(
            part.tolist() for found, part in zip(asked[2], parts, strict=True) if found == key
        )

    left, right = (LEFT.action, LEFT.arguments), (RIGHT.action, RIGHT.arguments)
    assert (believed(seen[0], left) == pytest.approx([1 / 3] * 3)) is not draw
    assert (believed(seen[0], right) == pytest.approx([1 / 3] * 3)) is not draw
    if not draw:
        at_last = next(asked for asked in reversed(seen) if not asked[0])
        assert believed(at_last, left) != pytest.approx([1 / 3] * 3)
        assert believed(at_last, right) == pytest.approx([1 / 3] * 3)


def test_probabilities_are_put_where_the_target_has_its_own() -> None:
    keys = [DistributionKey("pull", "dry", ("left",)), DistributionKey("finish", "ready")]
    chances = [np.array([0.25, 0.5, 0.25]), np.array([0.125, 0.75, 0.125])]
    written = domain_with(DOMAIN, "bench", keys, chances)
    text = menid_plan.write(written)
    task = Task(menid_plan.parse(text).domain, PROBLEM)
    task.build()
    found = {}
    for each, part in zip(
        task.structure.problem.distributions, np.split(task.chances, [3, 6]), strict=True
    ):
        found[each.action, each.values] = part.round(12).tolist()
    assert found == {
        ("pull", ("left",)): [0.25, 0.5, 0.25],
        ("pull", RIGHT.arguments): [0.6, 0.3, 0.1],
        ("finish", ()): [0.125, 0.75, 0.125],
    }
    again = Task(written, PROBLEM, "model")
    again.build()
    assert again.chances[:3].tolist() == [0.8, 0.2, 0.0]
