"""What needs more memory than there is ends with a message, before it is taken."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from conftest import ROOT
from menid_plan import memory
from menid_plan.cli.main import main
from menid_plan.errors import LimitError
from menid_plan.memory import available, demand


def test_there_is_some() -> None:
    assert available() > 1e6


def test_small_demands_are_not_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available", lambda: 0.0)
    demand(1e6, "nothing")
    with pytest.raises(LimitError, match="needs 100 MB more, and 0 MB can be had; so far nothing"):
        demand(1e8, "so far nothing")


@pytest.mark.parametrize(
    ("left", "said"), [(1e6, "so far"), (12e6, "to solve 52488 states")], ids=["explore", "solve"]
)
def test_a_problem_that_does_not_fit(
    left: float, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = [str(ROOT / "domains/maintenance" / name) for name in ("domain.menid", "plant.menid")]
    monkeypatch.setattr(memory, "available", lambda: left)
    monkeypatch.setattr(memory, "SMALL", 1e5)
    result = CliRunner().invoke(main, ["solve", *files])
    assert result.exit_code == 6, result.output
    assert "can be had" in result.output
    assert said in result.output
