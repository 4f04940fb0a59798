"""`menid solvers`."""

from __future__ import annotations

import json
import math

import pytest
from click.testing import CliRunner

from menid_plan.cli import solvers as module
from menid_plan.cli.main import main
from menid_plan.solving import load_solver


def run(*arguments: str, code: int = 0) -> str:
    result = CliRunner().invoke(main, ["solvers", *arguments])
    assert result.exit_code == code, result.output
    return result.output


def test_the_list_says_what_each_promises() -> None:
    found = {each["name"]: each for each in json.loads(run("--json"))["solvers"]}
    assert {"value-iteration", "policy-iteration", "storm", "thompson"} <= set(found)
    assert found["value-iteration"]["options"]["epsilon"] == 1e-6
    assert found["value-iteration"]["available"]
    assert (found["thompson"]["solves"], found["thompson"]["acts"]) == (False, True)
    assert found["storm"]["needs"].startswith("stormpy")
    text = run()
    for name, each in found.items():
        assert name in text
        assert each["promise"] in text


def test_all_about_one() -> None:
    text = run("value-iteration")
    assert "epsilon" in text
    assert "1e-06" in text
    assert "\noptions, to be set by --option NAME=VALUE of solve and simulate:\n  epsilon " in text
    assert "``" not in text


def test_what_is_not_installed_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "installed", lambda _: False)
    assert "needs stormpy>=2, which is not installed" in run()


def test_an_unknown_name() -> None:
    assert "there is no solver `magic`" in run("magic", code=2)


@pytest.mark.parametrize("name", ["value-iteration", "policy-iteration", "storm", "thompson"])
def test_a_solver_goes_by_its_own_name(name: str) -> None:
    assert load_solver(name).name == name


@pytest.mark.parametrize(
    ("name", "option", "value", "allowed"),
    [
        *(
            (name, "epsilon", value, "above 0 and finite")
            for name in ("value-iteration", "policy-iteration", "storm", "thompson")
            for value in (-1.0, 0.0, math.nan, math.inf)
        ),
        *(
            (name, "tie", value, "between 0 and 1")
            for name in ("value-iteration", "policy-iteration", "storm")
            for value in (-1e-9, 2.0)
        ),
        ("value-iteration", "max_seconds", math.nan, "at least 0 and finite"),
        ("value-iteration", "max_seconds", -1.0, "at least 0"),
        ("value-iteration", "max_iterations", -1, "at least 0"),
        ("value-iteration", "policy_bytes", -1, "at least 0"),
        ("policy-iteration", "max_iterations", 0, "at least 1"),
        ("thompson", "redraw", 0, "at least 1"),
    ],
)
def test_options_that_cannot_be_meant(name: str, option: str, value: float, allowed: str) -> None:
    with pytest.raises(ValueError, match=f"{option} must be {allowed}.*, not {value}"):
        load_solver(name)(**{option: value})
