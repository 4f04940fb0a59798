"""On every shipped domain, the policy that was learned is as good as the best one.

What a run learns depends on what it tries, and Thompson sampling comes back late to an action that
failed when it was first tried (in the rescue one of four seeds has not after 2000 steps; on the bench,
where the best of five good actions frees 97 boards of 100 and the others 95, one of six has not after
1500). So two things are asked: whether enough data give the best policy, by any estimator that is
right in the end and for several seeds, and whether runs collect the data, for two.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import menid_plan
from conftest import ROOT
from learning_runs import run_of
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.runfile import Bound
from menid_plan.environments.simulated import Simulated
from menid_plan.learning.counts import Evidence, SlotBelief
from menid_plan.learning.estimators import ESTIMATORS
from menid_plan.model.domain import Domain, Problem
from menid_plan.planning import Task
from menid_plan.simulation import chooser
from menid_plan.solving import Solution

# Problems, and how many steps are taken in the target.
STEPS = {
    "assembly/pin": 800,
    "blocks/turn-over": 300,
    "exploding-blocks/unstack": 100,
    "greenhouse/two-pots": 120,
    "hdd/bench": 1500,
    "maintenance/workshop": 300,
    "rescue/corridor": 2000,
    "slippery-grid/pond": 1500,
    "stones/brook": 800,
    "tireworld/triangle-1": 100,
}
CONSISTENT = [name for name in ESTIMATORS if name != "pooled"]  # as wrong as the tests for ever


def test_no_domain_is_left_out() -> None:
    folders = {path.name for path in (ROOT / "domains").iterdir() if path.is_dir()}
    assert {name.split("/")[0] for name in STEPS} == folders


def read(name: str) -> tuple[Domain, Problem]:
    document = menid_plan.read(ROOT / "domains" / f"{name}.menid")
    assert document.domain is not None
    assert document.problem is not None
    return document.domain, document.problem


def check(true: Task, evidence: Evidence) -> None:
    """What is best by what is believed is worth as much as the best, by the true probabilities."""
    solver = Task.solver("value-iteration")
    best = true.solve(solver)
    # What is believed, in the states that there are: outcomes that were never seen may happen.
    believed = SlotBelief(evidence, true.structure.problem).learned()
    probability, value = worth(true, solver.solve(true.structure.fill(believed), true.objective))
    assert value >= best.value - max(0.01 * abs(best.value), 0.01)
    if true.objective != "reward" and best.goal_probability is not None:
        assert probability >= best.goal_probability[best.initial] - 0.01


@pytest.mark.parametrize("name", STEPS)
@pytest.mark.parametrize("estimator", CONSISTENT)
def test_enough_data_give_the_best_policy(name: str, estimator: str) -> None:
    """40,000 executions of every distribution in the target, and 400 in each test, which is wrong."""
    domain, problem = read(name)
    true = Task(domain, problem)
    true.build()
    names = [spec.name for spec in environments(domain, problem).environments]
    for seed in range(3):
        rng = np.random.default_rng(seed)
        evidence = Evidence(domain, problem, names, ESTIMATORS[estimator]())
        for key in SlotBelief(evidence, true.structure.problem).keys:
            for environment in names:
                column = evidence.given(key, environment)
                if column is not None:
                    number = 40_000 if environment == names[0] else 400
                    evidence.add(environment, key, rng.multinomial(number, column).tolist())
        check(true, evidence)


@pytest.mark.parametrize("name", STEPS)
@pytest.mark.parametrize("seed", [0, 1])
def test_runs_come_to_the_best_policy(tmp_path: Path, name: str, seed: int) -> None:
    domain, problem = read(name)
    run = run_of(
        tmp_path / "run", environments(domain, problem), solver="thompson", seed=seed,
        estimator="robust", test_time=5.0, steps=STEPS[name],
    )  # fmt: skip
    run.learn()
    true = Task(domain, problem)
    true.build()
    check(true, run.evidence)


@pytest.mark.parametrize("name", ["greenhouse/two-pots", "tireworld/triangle-1", "hdd/bench"])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_baseline_needs_no_tests(tmp_path: Path, name: str, seed: int) -> None:
    domain, problem = read(name)
    run = run_of(
        tmp_path / "run", environments(domain, problem), solver="thompson", seed=seed,
        estimator="empirical", test_time=0.0, steps=STEPS[name],
    )  # fmt: skip
    run.learn()
    true = Task(domain, problem)
    true.build()
    check(true, run.evidence)


def environments(domain: Domain, problem: Problem) -> Bound:
    """All the environments of a domain, simulated by its own columns."""
    target, *tests = sorted(
        (
            EnvironmentSpec(each.name, Simulated(), domain, problem, each.role)
            for each in domain.all_environments
        ),
        key=lambda spec: spec.role != "target",
    )
    return Bound(domain, problem, target, tuple(tests))


def worth(task: Task, solution: Solution) -> tuple[float, float]:
    """The probability of the goal under a policy, and its value, by the true probabilities.

    Found by following the distribution over states until hardly any is left under way. By objectives
    of a goal, what is paid once that is out of reach does not count.
    """
    mdp, simulator = task.mdp, task.simulator()
    choose = chooser(solution)
    over = (np.diff(mdp.state_row) == 0) | mdp.goal
    distance = simulator.goal_distance()
    share = np.zeros(mdp.states)
    share[mdp.initial] = 1.0
    value, factor = 0.0, 1.0
    for step in range(mdp.horizon or 5000):
        at = np.flatnonzero((share > 1e-13) & ~over)
        if task.objective != "reward":
            at = at[distance[at] <= mdp.states]
        if len(at) == 0 or factor < 1e-12:
            break
        rows = choose(at, None if mdp.horizon is None else mdp.horizon - step)
        value += factor * float(share[at] @ mdp.row_reward[rows])
        after = np.where(over, share, 0.0)
        for state, row in zip(at, rows, strict=True):
            entries = slice(mdp.row_transition[row], mdp.row_transition[row + 1])
            np.add.at(after, mdp.next_state[entries], share[state] * mdp.probability[entries])
        share, factor = after, factor * mdp.discount
    return float(share[mdp.goal].sum()), value
