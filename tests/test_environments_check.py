"""`menid env`: the checker passes what is right and names what is wrong."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

import menid_plan
from conftest import ROOT
from environments_faulty import Faulty
from menid_plan.cli.main import main
from menid_plan.environments.check import check
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.simulated import Simulated

PROBLEM = str(ROOT / "domains" / "hdd" / "bench.menid")
DOCUMENT = menid_plan.read(PROBLEM)
assert DOCUMENT.domain is not None
assert DOCUMENT.problem is not None

RUN = """
[environment.robot]
kind = "simulated"
duration = 30

[environment.coarse]
kind = "recorded"
settings.store = "none.db"
"""


def spec(kind: object) -> EnvironmentSpec:
    return EnvironmentSpec("coarse", kind, DOCUMENT.domain, DOCUMENT.problem)  # type: ignore[arg-type]


def env(*arguments: str, code: int = 0) -> str:
    result = CliRunner().invoke(main, ["env", *arguments])
    assert result.exit_code == code, result.output
    return result.output


def test_what_is_right_passes() -> None:
    report = check(spec(Simulated()), executions=2)
    assert report.is_right
    assert [f.verdict for f in report.findings] == ["pass"] * len(report.findings)
    assert report.states > 1
    assert {t.action for t in report.tallies} == {"lever", "shake", "suck"}
    for tally in report.tallies:
        assert sum(tally.outcomes.values()) == tally.executions
        assert tally.seconds == tally.executions


@pytest.mark.parametrize(
    ("kind", "about", "detail"),
    [
        (Faulty("start"), "it starts", "it does not start"),
        (Faulty("forgets"), "it has a first state", "`state()` nothing"),
        (Faulty("resets-elsewhere"), "it can be put into the problem's initial state", "without"),
        (Faulty("cannot-reset"), "it can be put into the problem's initial state", "not there"),
        (Faulty("nan"), "its actions can be executed", "the reward is nan"),
        (Faulty("negative"), "its actions can be executed", "the duration is -1.0 s"),
        (Faulty("raise"), "its actions can be executed", "ZeroDivisionError: of all things"),
        (Faulty("unknown-atom"), "its actions can be executed", "no predicate `nowhere`"),
        (Faulty("random"), "with the same seed it does the same", "once led to"),
        (Faulty("close"), "it can be closed twice", "RuntimeError: closed already"),
    ],
)
def test_what_is_wrong_is_named(kind: Faulty, about: str, detail: str) -> None:
    report = check(spec(kind), executions=1, states=2)
    assert not report.is_right
    wrong = {f.about: f.details for f in report.findings if f.verdict == "fail"}
    assert detail in " ".join(wrong[about])


def test_what_an_environment_does_not_claim_is_not_asked_of_it() -> None:
    report = check(spec(Faulty("random", repeatable=False)), executions=1, states=2)
    assert report.is_right
    skipped = [f.about for f in report.findings if f.verdict == "skip"]
    assert skipped == ["with the same seed it does the same"]
    report = check(spec(Faulty("cannot-reset", anywhere=False)), executions=1)
    assert report.is_right
    assert report.states == 1


def test_the_command(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text(RUN)
    run = str(tmp_path / "run.toml")
    text = env("check", PROBLEM, "--run", run, "--env", "robot", "--executions", "2")
    assert text.startswith("robot: simulated\n  PASS  it starts: in ")
    assert "FAIL" not in text
    assert "seated.freed" in text
    text = env("check", PROBLEM, "--run", run, "--states", "1", code=1)
    assert "\ncoarse: recorded\n  FAIL  it starts: " in text
    assert f"{run}: environment.coarse.settings.store: there is no file" in text
    found = json.loads(env("check", PROBLEM, "--run", run, "--json", code=1))["environments"]
    assert [each["right"] for each in found] == [True, False]
    assert found[0]["capabilities"] == {"reset_to_any": True, "repeatable": True, "parallel": True}
    assert {a["action"] for a in found[0]["actions"]} == {"lever", "shake", "suck"}
    once = env("check", PROBLEM, "--run", run, "--json", "--seed", "5", "--env", "robot")
    again = env("check", PROBLEM, "--run", run, "--json", "--seed", "5", "--env", "robot")
    assert (
        json.loads(once)["environments"][0]["actions"]
        == (json.loads(again)["environments"][0]["actions"])
    )


def test_a_record_need_not_have_everything(tmp_path: Path) -> None:
    document = menid_plan.read(PROBLEM)
    first = sorted(map(str, document.problem.init))
    row = {"environment": "coarse", "state": first, "action": "lever(n8)", "after": first}
    (tmp_path / "seen.jsonl").write_text(json.dumps(row) + "\n")
    (tmp_path / "run.toml").write_text(RUN.replace("none.db", "seen.jsonl"))
    text = env("check", PROBLEM, "--run", str(tmp_path / "run.toml"), "--env", "coarse")
    assert "FAIL" not in text
    assert "  SKIP  everything was recorded" in text
    assert " in the state " in text


def test_wrong_usage(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text(RUN)
    run = str(tmp_path / "run.toml")
    assert "has no environment `fine`: robot" in env(
        "check", PROBLEM, "--run", run, "--env", "fine", code=2
    )
    (tmp_path / "run.toml").write_text("[environment.robot]\nknd = 1\n")
    text = env("check", PROBLEM, "--run", run, code=3)
    assert "run.toml: environment.robot.knd: unknown key; did you mean `kind`?" in text


def test_the_kinds_are_listed() -> None:
    kinds = {each["name"]: each for each in json.loads(env("list", "--json"))["kinds"]}
    assert {"simulated", "recorded", "process", "gymnasium"} <= set(kinds)
    assert kinds["recorded"]["settings"]["store"]["required"]
    assert kinds["simulated"]["settings"]["duration"]["default"] == 1.0
    text = env("list")
    assert all(each["promise"] in text for each in kinds.values())
    text = env("list", "process")
    assert "command" in text
    assert "required" in text
    assert "did you mean `process`" in env("list", "proces", code=3)
