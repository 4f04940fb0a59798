"""Where to act: what is believed of tests that may lie, what tests are worth, and who learns so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result
from scipy import stats
from scipy.special import betaln, gammaln

import menid_plan
from conftest import ROOT
from learning_runs import DONE, EMPTY, PROBLEM, READY, Journey, bound
from menid_plan.allocation import worth
from menid_plan.allocation.belief import LEAST, PRIOR, STRENGTH, Belief, classes, related
from menid_plan.allocation.decide import Model, TooLargeError
from menid_plan.allocation.rule import (
    EXECUTIONS,
    FIRST_TESTS,
    SHARE,
    TESTS,
    Rule,
    View,
    highest_reward,
)
from menid_plan.environments.recorded import Recorded
from menid_plan.environments.runfile import Bound, WorkersTable
from menid_plan.environments.simulated import Simulated
from menid_plan.grounding.ground import ground
from menid_plan.learning.curve import Point
from menid_plan.learning.mixtures import Floats
from menid_plan.learning.run import Run
from menid_plan.learning.settings import LearnSettings
from menid_plan.mdp.explore import explore
from menid_plan.studies.learning import recorded

Menid = Callable[..., Result]
DOMAINS = ROOT / "domains"


SKEWED = np.tile([0.02, 0.95, 0.05, 0.9, 0.03, 0.97, 0.1, 0.04], 3)


def bandit(number: int, tests: int = 1) -> Belief:
    return Belief([2] * number, [0] * number, tests)


def seen(belief: Belief, index: int, environment: int, good: int, bad: int) -> None:
    belief.add(index, environment, np.array([good, bad], float))


# ------------------------------------------------------------------------------------------- belief


def test_without_data_all_outcomes_are_alike() -> None:
    belief = Belief([2, 3, 1], [0, 1, 2], 2)
    belief.learn()
    assert belief.mean()[0, :2] == pytest.approx([1 / 2, 1 / 2])
    assert belief.mean()[1] == pytest.approx([1 / 3] * 3)
    assert belief.mean()[2] == pytest.approx([1.0, 0.0, 0.0])


def test_the_posterior_is_that_of_the_mixture() -> None:
    """By the formulas, with all weights as they are beforehand."""
    belief = bandit(1)
    seen(belief, 0, 1, 7, 3)
    belief.learn()
    prior = np.vstack([related(np.array([7.0, 3.0])), classes(2)])
    weights = np.array([1.0, 1.0, 0.1, 1 / 3, 1 / 3, 1 / 3])
    assert belief.mean()[0] == pytest.approx(
        (weights / weights.sum()) @ (prior / prior.sum(axis=1, keepdims=True))
    )
    # A single execution: the weights that are learned from it are those of expectation maximisation.
    seen(belief, 0, 0, 1, 0)
    belief.learn()
    counts = np.array([1.0, 1.0, 0.1, 1.0, 1.0, 1.0, 1.0])  # relations, unrelated, classes
    learned = counts.copy()
    for _ in range(4):
        shares = learned[:4] / learned[:4].sum()
        kinds = learned[4:] / learned[4:].sum()
        posterior = np.append(shares[:3], shares[3] * kinds) * prior[:, 0] / prior.sum(axis=1)
        posterior /= posterior.sum()
        learned = counts + np.concatenate([posterior[:3], [posterior[3:].sum()], posterior[3:]])
    shares = learned[:4] / learned[:4].sum()
    kinds = learned[4:] / learned[4:].sum()
    posterior = np.append(shares[:3], shares[3] * kinds) * prior[:, 0] / prior.sum(axis=1)
    assert belief.weights[0] == pytest.approx(posterior / posterior.sum())


def test_the_strength_of_a_relation_falls_short_where_the_test_is_not_known() -> None:
    few, many = related(np.array([1.0, 0.0])), related(np.array([1e6, 0.0]))
    assert many.sum(axis=1) == pytest.approx(STRENGTH + 2 * LEAST, rel=1e-3)
    assert (few.sum(axis=1) < 3.2).all()
    assert few[0] / few[0].sum() == pytest.approx([(1 + PRIOR) / (1 + 2 * PRIOR), 1 / 6], abs=0.02)
    assert few[2, 0] < few[2, 1]  # the other way round


@pytest.mark.parametrize(
    ("test", "relation"),
    [
        (lambda p: p, 0),
        (lambda p: 1.0 - p, 2),
        (lambda p: np.full(len(p), 0.9), None),
    ],
    ids=["right", "inverted", "says nothing"],
)
def test_whom_to_believe_is_learned_from_what_was_executed(
    test: Callable[[Floats], Floats], relation: int | None
) -> None:
    p = SKEWED
    belief = bandit(len(p) + 1)
    for index, (true, shown) in enumerate(zip(p, test(p), strict=True)):
        seen(belief, index, 0, round(20 * true), 20 - round(20 * true))
        seen(belief, index, 1, round(100 * shown), 100 - round(100 * shown))
    seen(belief, len(p), 1, 95, 5)
    belief.learn()
    mean = belief.mean()[-1, 0]  # of one that was only tested
    if relation is None:
        assert belief.shared.unrelated > belief.shared.related.max()
        assert 0.2 < mean < 0.8
    else:
        assert belief.shared.related[0, relation] > 0.4
        assert mean > 0.8 if relation == 0 else mean < 0.2


def test_of_two_tests_the_right_one_is_believed() -> None:
    p = SKEWED
    belief = bandit(len(p) + 1, tests=2)
    for index, true in enumerate(p):
        seen(belief, index, 0, round(20 * true), 20 - round(20 * true))
        seen(belief, index, 1, 50, 50)
        seen(belief, index, 2, round(100 * true), 100 - round(100 * true))
    seen(belief, len(p), 1, 90, 10)
    seen(belief, len(p), 2, 5, 95)
    belief.learn()
    assert belief.shared.related[1].sum() > 3 * belief.shared.related[0].sum()
    assert belief.mean()[-1, 0] < 0.3


def test_draws_have_the_mean_that_is_expected() -> None:
    belief = Belief([2, 3], [0, 1], 1)
    seen(belief, 0, 1, 8, 2)
    belief.add(1, 0, np.array([3.0, 0.0, 1.0]))
    belief.learn()
    drawn = belief.sample(np.random.default_rng(5), 40_000)
    assert drawn.shape == (40_000, 2, 3)
    assert drawn.sum(axis=2) == pytest.approx(1.0)
    assert drawn.mean(axis=0) == pytest.approx(belief.mean(), abs=0.01)


# -------------------------------------------------------------------------------------------- worth


@pytest.mark.parametrize("others", [0.1, 0.45, 0.8])
def test_what_executions_are_worth(others: float) -> None:
    """Against all outcomes, one by one."""
    a, b, w = np.array([[2.5, 0.3]]), np.array([[1.5, 6.0]]), np.array([[0.6, 0.4]])
    gains = np.zeros((1, len(EXECUTIONS)))
    worth.executions(a, b, w, np.array([others]), EXECUTIONS, np.empty(2), gains)
    now = (w * a / (a + b)).sum()
    for n, gain in zip(EXECUTIONS.tolist(), gains[0].tolist(), strict=True):
        best = 0.0
        for k in range(n + 1):
            chance = w[0] * stats.betabinom.pmf(k, n, a[0], b[0])
            best += max(others * chance.sum(), (chance * (a[0] + k) / (a[0] + b[0] + n)).sum())
        assert gain == pytest.approx(best - max(others, now), abs=1e-9)


@pytest.mark.parametrize("executed", [(0.0, 0.0), (1.0, 3.0)])
def test_what_tests_are_worth(executed: tuple[float, float]) -> None:
    """Against all outcomes, one by one, with the belief that each would lead to."""
    won, lost = executed
    others, up, down = 0.4, 2.0, 1.0
    own, kinds = np.array([0.4, 0.3, 0.05]), classes(2)
    weight = np.array([[0.1, 0.1, 0.05]])
    gains = np.zeros((1, len(TESTS)))
    worth.tests(
        np.ascontiguousarray(kinds[None, :, 0]), np.ascontiguousarray(kinds[None, :, 1]), weight,
        own[None], np.ascontiguousarray(kinds[None, :, 0]), np.ascontiguousarray(kinds[None, :, 1]),
        np.array([[won, lost, up, down, 1.0, 2.0, others]]), STRENGTH, PRIOR, LEAST, TESTS,
        np.empty((4, 6)), gains,
    )  # fmt: skip
    fit = np.exp(betaln(kinds[:, 0] + up, kinds[:, 1] + down) - betaln(*kinds.T))
    for n, gain in zip(TESTS.tolist(), gains[0].tolist(), strict=True):
        best = expected = 0.0
        for k in range(n + 1):
            chances = stats.betabinom.pmf(k, n, kinds[:, 0] + up, kinds[:, 1] + down)
            chance = float(fit / fit.sum() @ chances)
            prior = np.vstack([kinds, related(np.array([up + k, down + n - k]))])
            after = prior + np.array([won, lost])
            logs = np.log(np.append(weight[0], own)) + betaln(*after.T) - betaln(*prior.T)
            weights = np.exp(logs - logs.max())
            then = float(weights / weights.sum() @ (after[:, 0] / after.sum(axis=1)))
            best += chance * max(others, then)
            expected += chance * then
        assert gain == pytest.approx(best - max(others, expected), abs=2e-6)


def test_the_gamma_function_of_the_kernels() -> None:
    for x in (0.05, 0.5, 1.0, 6.9, 7.0, 30.0, 1e5):
        assert worth.log_gamma.function(x) == pytest.approx(gammaln(x), rel=1e-9, abs=1e-9)


# --------------------------------------------------------------------------------------------- rule


def view_of(belief: Belief, penalty: float = 5.0, **more: Any) -> View:
    number = len(belief.outcomes)
    payoffs = np.tile([1.0, -penalty], (number, 1))
    mean = (belief.mean() * payoffs).sum(axis=1)
    others = np.array([np.delete(mean, i).max() for i in range(number)])
    found = View(
        np.arange(number), payoffs, others, np.full(number, 1 / 30.0), np.full(number, 30.0),
        np.full((belief.tests, number), 0.4), mean.max() / 30.0, 0.5 / 30.0, 1 / 30.0,
    )  # fmt: skip
    return replace(found, **more)


def rule_of(belief: Belief) -> Rule:
    belief.learn()
    return Rule(belief, np.linspace(0.0, 1.0, len(belief.outcomes)))


def test_what_is_risky_and_unknown_is_tested_first() -> None:
    belief = bandit(4)
    found = rule_of(belief).tests(view_of(belief), 3600.0, 0.0, 0.0)
    assert found is not None
    assert found.number in TESTS


def test_tests_end_where_they_say_nothing_more() -> None:
    """One action surely succeeds, and the others surely fail."""
    belief = bandit(3)
    for index in range(3):
        seen(belief, index, 0, *((500, 0) if index == 1 else (0, 500)))
    rule = rule_of(belief)
    assert rule.tests(view_of(belief), 3600.0, 0.0, 0.0) is None
    view = view_of(belief)
    mean = (belief.mean() * view.payoffs).sum(axis=1)
    assert (mean + rule.bonuses(view, 3600.0)).argmax() == 1


def test_tests_have_a_budget_and_must_be_possible() -> None:
    belief = bandit(4)
    rule, view = rule_of(belief), view_of(belief)
    most = FIRST_TESTS * 30.0 + SHARE * 1000.0
    assert rule.tests(view, 2600.0, 1000.0, most) is not None
    assert rule.tests(view, 2600.0, 1000.0, most + 1.0) is None
    impossible = replace(view, test_seconds=np.full((1, 4), np.inf))
    assert rule.tests(impossible, 3600.0, 0.0, 0.0) is None
    assert rule.tests(view, 0.3, 0.0, 0.0) is None  # no test ends in time
    one = replace(view, test_seconds=np.array([[np.inf, np.inf, 0.4, np.inf]]))
    found = rule.tests(one, 3600.0, 0.0, 0.0)
    assert found is not None
    assert found.row == 2


def test_the_highest_reward() -> None:
    belief = bandit(4)
    rule_of(belief)
    view = view_of(belief, 54.0)
    assert highest_reward(view, belief.outcomes) == pytest.approx(1.0)
    assert highest_reward(replace(view, most=0.0), belief.outcomes) == pytest.approx(5.0)


def test_a_slower_test_is_chosen_only_where_it_says_more() -> None:
    p = SKEWED
    slow = np.vstack([np.full(len(p) + 1, 0.4), np.full(len(p) + 1, 0.8)])
    for liar, chosen in ((True, 1), (False, 0)):
        belief = bandit(len(p) + 1, tests=2)
        for index, true in enumerate(p):
            seen(belief, index, 0, round(20 * true), 20 - round(20 * true))
            shown = 0.5 if liar else true
            seen(belief, index, 1, round(100 * shown), 100 - round(100 * shown))
            seen(belief, index, 2, round(100 * true), 100 - round(100 * true))
        rule = rule_of(belief)
        view = view_of(belief, 0.0, test_seconds=slow)
        # The best that is known succeeds half the time: another may be better.
        view = replace(view, others=np.full(len(p) + 1, 0.5), rate=0.5 / 30.0)
        found = rule.tests(view, 3600.0, 0.0, 0.0)
        assert found is not None
        assert found.test == chosen


def test_an_execution_that_teaches_is_worth_more_the_more_time_is_left() -> None:
    belief = bandit(3)
    seen(belief, 0, 0, 20, 20)
    rule = rule_of(belief)
    view = view_of(belief, 0.0)
    long, short = rule.bonuses(view, 3600.0), rule.bonuses(view, 60.0)
    assert (long[1:] > short[1:]).all()
    assert long[0] < long[1]


# -------------------------------------------------------------------------------------------- rates


def peg(grips: list[float], ways: list[float], **params: float) -> tuple[Model, Floats, list[str]]:
    domain = menid_plan.read(DOMAINS / "assembly" / "domain.menid").domain
    problem = menid_plan.read(DOMAINS / "assembly" / "pin.menid").problem
    assert domain is not None
    assert problem is not None
    structure = explore(ground(domain, replace(problem, horizon=None), params))
    chances = np.zeros((12, 3))
    for row, d in zip(chances, structure.problem.distributions, strict=True):
        known = grips if d.action == "grasp" else ways
        number = int(d.values[0][1:]) - 1
        p = known[number] if number < len(known) else 0.01  # of the rest each is bad
        row[:2] = p, 1.0 - p
    names = [str(structure.action(row)) for row in range(len(structure.row_rule))]
    return Model(structure, None), chances, names


def test_the_best_reward_a_second() -> None:
    """Each push needs 1 / p grasps: the quick way may be better than the sure one."""
    grips, ways = [0.5, 0.8, 0.1], [0.9, 0.7, 0.2]
    model, chances, names = peg(grips, ways, win=1.0, fail=0.0)
    for slow in (1.0, 50.0):
        seconds = np.array([slow if name == "push(w1)" else 1.0 for name in names])
        rates = [
            p / (1.0 / g + (slow if p == 0.9 else 1.0)) for g in grips for p in ways
        ]  # fmt: skip
        solved = model.solve(chances, seconds, 0.0)
        assert solved.rate == pytest.approx(max(rates), rel=1e-6)
        grasps, pushes = solved.visits[:2]
        assert grasps == pytest.approx(pushes / 0.8, rel=1e-6)
        assert pushes * (1.0 / 0.8 + (slow if slow == 1.0 else 1.0)) == pytest.approx(1.0)
        chosen = [names[row] for row in solved.policy[-1].tolist() if row >= 0]
        assert chosen == ["grasp(g2)", "push(w1)" if slow == 1.0 else "push(w2)"]


def test_a_rate_may_be_negative() -> None:
    """Where all lose, what loses the least a second is the best."""
    grips, ways = [0.9, 0.5, 0.6, 0.7, 0.8, 0.9, 0.9], [0.1, 0.2, 0.3, 0.2, 0.1]
    model, chances, _ = peg(grips, ways, win=1.0, fail=10.0)
    solved = model.solve(chances, np.ones(len(model.state)), 0.0)
    rates = [(p - 10.0 * (1.0 - p)) / (1.0 / g + 1.0) for g in grips for p in ways]
    assert solved.rate == pytest.approx(max(rates), rel=1e-4)


def test_others_are_the_best_of_the_other_rows() -> None:
    model, chances, _ = peg([0.5, 0.8, 0.1], [0.9, 0.7, 0.2])
    worth_of = np.arange(12.0)
    worth_of[11] = 10.0  # a tie
    for row, other in enumerate(model.others(worth_of)):
        rest = [worth_of[i] for i in range(12) if i != row and model.state[i] == model.state[row]]
        assert other == max(rest)
    assert chances.sum(axis=1) == pytest.approx(1.0)


def test_too_many_states_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("menid_plan.allocation.decide.MOST_VALUES", 100)
    with pytest.raises(TooLargeError, match="too many to weigh up tests in; learn with allocate"):
        peg([0.5] * 3, [0.5] * 3)


# ----------------------------------------------------------------------------------------- learning


def drive(*names: str, **durations: float) -> Bound:
    domain = menid_plan.read(DOMAINS / "hdd" / "domain.menid").domain
    problem = menid_plan.read(DOMAINS / "hdd" / "drive.menid").problem
    assert domain is not None
    assert problem is not None
    found = recorded(domain, problem, DOMAINS / "hdd" / "bank.sqlite", names, {"fail": 5.0})
    target, *tests = (
        replace(spec, duration=durations.get(spec.name)) for spec in found.environments
    )
    return Bound(found.domain, problem, target, tuple(tests))


def learned(folder: Path, bound: Bound, **settings: Any) -> tuple[Run, list[Point]]:
    points: list[Point] = []
    run = Run(
        folder, bound,
        LearnSettings(**{"seed": 3, "allocate": "gain", "objective": "reward"} | settings),
        WorkersTable(0), params={"fail": 5.0} if bound.domain.name == "hdd" else {},
        resume=(folder / "experiences.sqlite").exists(), watch=points.append,
    )  # fmt: skip
    run.learn()
    return run, points


@pytest.mark.parametrize("tests", [("coarse",), ("coarse", "fine")])
def test_a_drive_is_learned_with_few_failures(tmp_path: Path, tests: tuple[str, ...]) -> None:
    run, points = learned(tmp_path / "run", drive("robot", *tests), hours=0.5)
    progress = run.loop.progress
    assert progress.reward > 0.5 * progress.steps
    assert progress.executions["coarse"] > 0
    again, others = learned(tmp_path / "again", drive("robot", *tests), hours=0.5)
    assert points == others
    assert again.loop.progress.executions == progress.executions


def test_the_target_only(tmp_path: Path) -> None:
    run, _ = learned(tmp_path / "run", drive("robot", "coarse"), allocate="target-only", steps=40)
    assert set(run.loop.progress.executions) == {"robot"}
    assert run.loop.progress.executions["robot"] == 40


def test_a_run_that_was_stopped_goes_on_as_if_it_was_not(tmp_path: Path) -> None:
    whole, points = learned(tmp_path / "whole", drive("robot", "coarse"), steps=30)

    class KilledError(Exception):
        pass

    def kill(point: Point) -> None:
        if point.steps == 11:
            raise KilledError

    run = Run(
        tmp_path / "killed", drive("robot", "coarse"),
        LearnSettings(seed=3, allocate="gain", objective="reward", steps=30), WorkersTable(0),
        params={"fail": 5.0}, watch=kill,
    )  # fmt: skip
    with pytest.raises(KilledError):
        run.learn()
    resumed, more = learned(tmp_path / "killed", drive("robot", "coarse"), steps=30)
    assert more == points
    assert resumed.loop.progress.executions == whole.loop.progress.executions


def test_a_run_gets_more_time(tmp_path: Path) -> None:
    """What is decided depends on the time that is left; what was done was decided by another limit."""
    _, first = learned(tmp_path / "run", drive("fine", "coarse"), steps=8)
    _, second = learned(tmp_path / "run", drive("fine", "coarse"), steps=40)
    run, third = learned(tmp_path / "run", drive("fine", "coarse"), steps=None, hours=0.05)
    assert second[: len(first)] == first
    assert third[: len(second)] == second
    assert run.loop.progress.steps > 40


def test_what_a_test_cannot_be_put_into_is_not_tested(tmp_path: Path) -> None:
    """The bank has no executions of the scene with another problem's objects; none can be reset."""
    domain = menid_plan.read(DOMAINS / "hdd" / "domain.menid").domain
    problem = menid_plan.read(DOMAINS / "hdd" / "bench.menid").problem
    assert domain is not None
    assert problem is not None
    found = recorded(domain, problem, DOMAINS / "hdd" / "bank.sqlite", ("robot", "coarse"), {})
    target = replace(found.target, kind=Simulated(), duration=10.0)
    run = Run(
        tmp_path / "run", Bound(found.domain, problem, target, found.tests),
        LearnSettings(allocate="gain", steps=5, objective="reward"), WorkersTable(0),
    )  # fmt: skip
    progress = run.learn()
    assert progress.steps == 5
    assert isinstance(found.tests[0].kind, Recorded)


def test_an_objective_about_the_goal(tmp_path: Path) -> None:
    """Then it is goals that are counted by the second, and not rewards."""
    kinds = {"model": Simulated(duration=0.1)}
    environments = bound(Simulated(duration=10.0), kinds, {"model": 0.1, "bench": 10.0})
    run, _ = learned(tmp_path / "run", environments, steps=60, objective="goal-probability")
    assert run.loop.progress.successes > 10


def test_durations_need_not_be_known(tmp_path: Path) -> None:
    kinds = {"model": Simulated(duration=0.1)}
    environments = bound(Simulated(duration=10.0), kinds, {})
    run, _ = learned(tmp_path / "run", environments, steps=40)
    executions = run.loop.progress.executions
    assert executions["bench"] == 40
    assert 0 < executions["model"] < 4000


def test_tests_that_take_no_time_come_to_an_end(tmp_path: Path) -> None:
    """With a reward, and where there are only costs."""
    kinds = {"model": Simulated(duration=0.0)}
    environments = bound(Simulated(duration=10.0), kinds, {"model": 0.0, "bench": 10.0})
    run, _ = learned(tmp_path / "run", environments, steps=30)
    assert 0 < run.loop.progress.executions["model"] < 20_000
    only_costs = replace(PROBLEM, goal_reward=None)
    environments = bound(Simulated(duration=10.0), kinds, {"model": 0.0, "bench": 10.0}, only_costs)
    run, _ = learned(tmp_path / "costs", environments, steps=30)
    assert run.loop.progress.executions["model"] < 20_000


def test_from_the_command_line(menid: Menid, tmp_path: Path) -> None:
    files = [str(DOMAINS / "hdd" / f"{name}.menid") for name in ("domain", "drive")]
    out = menid(
        "learn", *files, "--run", str(DOMAINS / "hdd" / "bank.toml"), "-o", str(tmp_path / "run"),
        "--allocate", "gain", "--steps", "30",
    )  # fmt: skip
    assert out.exit_code == 0, out.output
    assert "fine (target): 30 executions" in out.output
    wrong = menid("learn", *files, "--run", "x.toml", "-o", "y", "--allocate", "all")
    assert wrong.exit_code == 2


def test_an_odd_state_is_left_to_the_solver(tmp_path: Path) -> None:
    """An environment may come to a state that the domain does not foresee."""
    ready = replace(PROBLEM, init=(READY,))
    target = Journey((EMPTY, frozenset({READY}), frozenset({READY, DONE})))
    environments = bound(target, {}, {"bench": 1.0}, ready)
    run, points = learned(tmp_path / "run", environments, steps=3)
    assert [point.steps for point in points] == [1, 2, 3]
    assert run.loop.progress.successes == 1
