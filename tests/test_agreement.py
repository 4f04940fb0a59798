"""Every shipped problem: value-iteration, policy-iteration and Storm give one value."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from conftest import ROOT
from menid_plan.language.files import check_files
from menid_plan.mdp.check import check
from menid_plan.planning import Task
from menid_plan.solving import UnsupportedError, load_solver

PROBLEMS = sorted(
    path for path in (ROOT / "domains").glob("*/*.menid") if path.name != "domain.menid"
)


def task_of(path: Path) -> Task:
    results = check_files([str(path.with_name("domain.menid")), str(path)])
    domain = next(r.domain for r in results if r.domain is not None)
    problem = next(r.problem for r in results if r.problem is not None)
    return Task(domain, problem)


@pytest.mark.parametrize("path", PROBLEMS, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_solvers_agree(path: Path) -> None:
    task = task_of(path)
    mdp = check(task.build())
    first = mdp.initial
    for objective in dict.fromkeys((task.objective, "goal-probability", "steps")):
        if not mdp.has_goal and objective != "reward":
            continue
        ours = load_solver("value-iteration")().solve(mdp, objective)
        assert ours.status in ("solved", "infeasible"), ours.message
        for name in ("policy-iteration", "storm"):
            if name == "storm" and find_spec("stormpy") is None:
                continue
            try:
                other = load_solver(name)().solve(mdp, objective)
            except UnsupportedError:
                continue
            assert other.status == ours.status, (name, objective, other.message)
            if np.isinf(ours.value):
                assert ours.value == other.value
                continue
            assert ours.lower[first] <= other.upper[first] + 1e-9, (name, objective)
            assert ours.upper[first] >= other.lower[first] - 1e-9, (name, objective)
            assert ours.value == pytest.approx(other.value, abs=2e-6, rel=2e-7)
