"""Hand-computed cases, one body over all solvers and the objectives that they know."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib.util import find_spec

import numpy as np
import pytest

from menid_plan.mdp.model import MDP
from menid_plan.solving import MissingDependencyError, Solution, Solver, UnsupportedError
from menid_solvers import storm
from menid_solvers.policy_iteration import PolicyIteration
from menid_solvers.storm import Storm
from menid_solvers.value_iteration import ValueIteration
from solver_reference import build, walk

INF = float("inf")
SOLVERS: list[Solver] = [ValueIteration(), PolicyIteration(), Storm()]
need_storm = pytest.mark.skipif(find_spec("stormpy") is None, reason="stormpy is not installed")
each_solver = pytest.mark.parametrize(
    "solver",
    [pytest.param(s, marks=need_storm if s.name == "storm" else ()) for s in SOLVERS],
    ids=lambda s: s.name,
)


def solve(solver: Solver, mdp: MDP, objective: str) -> Solution:
    try:
        return solver.solve(mdp, objective)  # type: ignore[arg-type]
    except UnsupportedError as error:
        pytest.skip(str(error))


@dataclass(frozen=True)
class Case:
    """A process, and (objective, status, value, first row) by hand."""

    mdp: MDP
    answers: tuple[tuple[str, str, float, int], ...]


CHAIN = build([[(1, [(1, 1)])], [(2, [(1, 2)])], []], [2])
# Falls into the sink with 0.35: the goal is reached with .65 at best.
NOISE = build(
    [
        [(-1, [(0.5, 2), (0.5, 3)]), (-2, [(0.65, 2), (0.35, 3)]), (0, [(0.65, 2), (0.35, 3)])],
        [],
        [],
        [],
    ],
    [2],
)
# Round and round for nothing, or out of it from either state.
FREE_CYCLE = build(
    [[(0, [(1, 1)]), (-1, [(1, 2)])], [(0, [(1, 0)]), (3, [(0.5, 2), (0.5, 3)])], [], []], [2]
)
# The cheap way may end where every step costs for ever.
TRAP = build([[(-1, [(0.5, 1), (0.5, 2)]), (-3, [(1, 2)])], [(-1, [(1, 1)])], []], [2])
DOOMED = build([[(-1, [(0.5, 1), (0.5, 2)])], [(-1, [(1, 1)])], []], [2])
GROWING = build([[(1, [(1, 1)]), (-1, [(1, 2)])], [(0, [(1, 0)])], []], [2])
# A component in which staying costs, but which pays a little on the way out.
PROFIT = build(
    [[(-1, [(1, 1)]), (-4, [(1, 2)])], [(-1, [(1, 0)]), (5, [(1, 3)])], [], [(-2, [(1, 2)])]], [2]
)
# Two free components in a row, the second with two ways out.
TWO = build(
    [
        [(0, [(1, 1)])],
        [(0, [(1, 0)]), (-1, [(0.5, 2), (0.5, 4)])],
        [(0, [(1, 3)]), (-1, [(0.9, 4), (0.1, 5)])],
        [(0, [(1, 2)]), (-2, [(1, 4)])],
        [],
        [],
    ],
    [4],
)
TIES = build(
    [[(-1, [(1, 1)]), (-1, [(1, 2)]), (-1, [(1, 1)])], [(0, [(1, 3)])], [(0, [(1, 3)])], []], [3]
)
LOOP = build([[(-1, [(0.9, 0), (0.1, 1)])], []], [1])

CASES = {
    "chain": Case(
        CHAIN,
        (
            ("reward", "solved", 3, 0),
            ("goal-probability", "solved", 1, 0),
            ("goal-then-reward", "solved", 3, 0),
            ("steps", "solved", 2, 0),
        ),
    ),
    "discounted": Case(replace(CHAIN, discount=0.5), (("reward", "solved", 2, 0),)),
    "discount-0": Case(
        replace(NOISE, discount=0.0),
        (("reward", "solved", 0, 2), ("goal-probability", "solved", 0.65, 1)),
    ),
    "noise": Case(
        NOISE,
        (
            ("reward", "solved", 0, 2),
            ("goal-probability", "solved", 0.65, 1),
            ("goal-then-reward", "solved", 0, 2),
            ("steps", "infeasible", INF, 0),
        ),
    ),
    "free-cycle": Case(
        FREE_CYCLE,
        (
            ("reward", "solved", 3, 0),
            ("goal-probability", "solved", 1, 1),
            ("goal-then-reward", "solved", -1, 1),
            ("steps", "solved", 1, 1),
        ),
    ),
    "trap": Case(
        TRAP,
        (
            ("reward", "solved", -3, 1),
            ("goal-probability", "solved", 1, 1),
            ("goal-then-reward", "solved", -3, 1),
            ("steps", "solved", 1, 1),
        ),
    ),
    "doomed": Case(
        DOOMED,
        (
            ("reward", "solved", -INF, 0),
            ("goal-probability", "solved", 0.5, 0),
            ("goal-then-reward", "solved", -1, 0),
        ),
    ),
    "growing": Case(
        GROWING,
        (
            ("reward", "unbounded", INF, 0),
            ("goal-probability", "solved", 1, 1),
            ("goal-then-reward", "unbounded", INF, 0),
            ("steps", "solved", 1, 1),
        ),
    ),
    "profit": Case(
        PROFIT,
        (
            ("reward", "solved", 2, 0),
            ("goal-then-reward", "solved", 2, 0),
            ("steps", "solved", 1, 1),
        ),
    ),
    "two": Case(
        TWO,
        (
            ("reward", "solved", 0, 0),
            ("goal-probability", "solved", 1, 0),
            # -1, and with one half on to the second component, where -2 is the sure way.
            ("goal-then-reward", "solved", -2, 0),
        ),
    ),
    "ties": Case(TIES, (("reward", "solved", -1, 0), ("steps", "solved", 2, 0))),
    "loop": Case(LOOP, (("reward", "solved", -10, 0), ("steps", "solved", 10, 0))),
    "no-rows": Case(build([[]]), (("reward", "solved", 0, -1),)),
    "no-goal": Case(
        build([[(0, [(1, 0)])]]), (("reward", "solved", 0, 0), ("goal-probability", "solved", 0, 0))
    ),
    "starts-at-goal": Case(
        build([[(5, [(1, 0)])]], [0]),
        (
            ("reward", "solved", 0, -1),
            ("goal-probability", "solved", 1, -1),
            ("goal-then-reward", "solved", 0, -1),
            ("steps", "solved", 0, -1),
        ),
    ),
    "horizon-0": Case(
        replace(CHAIN, horizon=0),
        (
            ("reward", "solved", 0, -1),
            ("goal-probability", "solved", 0, -1),
            ("steps", "infeasible", INF, -1),
        ),
    ),
    "horizon-1": Case(
        replace(CHAIN, horizon=1),
        (
            ("reward", "solved", 1, 0),
            ("goal-probability", "solved", 0, 0),
            ("goal-then-reward", "solved", 0, 0),
            ("steps", "infeasible", INF, 0),
        ),
    ),
    "horizon-2": Case(
        replace(CHAIN, horizon=2),
        (
            ("reward", "solved", 3, 0),
            ("goal-probability", "solved", 1, 0),
            ("goal-then-reward", "solved", 3, 0),
            ("steps", "solved", 2, 0),
        ),
    ),
    "horizon-discounted": Case(
        replace(CHAIN, horizon=9, discount=0.5), (("reward", "solved", 2, 0),)
    ),
    "horizon-growing": Case(replace(GROWING, horizon=7), (("reward", "solved", 4, 0),)),
    # From the middle of 0..1000: reached before the other end in half the cases, 500 * 500 steps.
    "slow-chance": Case(
        walk(1001, both_ends=True), (("goal-probability", "solved", 0.5, 499),)
    ),
    # 100 * 101 - 50 * 51 steps.
    "slow-steps": Case(walk(101), (("steps", "solved", 7550, 50),)),
}  # fmt: skip


@each_solver
@pytest.mark.parametrize(
    ("name", "objective"),
    [(name, answer[0]) for name, case in CASES.items() for answer in case.answers],
)
def test_by_hand(solver: Solver, name: str, objective: str) -> None:
    case = CASES[name]
    if solver.name == "storm" and name.startswith("slow"):
        pytest.skip("takes a minute")
    _, status, value, row = next(answer for answer in case.answers if answer[0] == objective)
    solution = solve(solver, case.mdp, objective)
    assert solution.status == status, solution.message
    first = case.mdp.initial
    if np.isinf(value):
        assert solution.value == value
    else:
        assert solution.lower[first] <= value + 1e-9 * abs(value)
        assert solution.upper[first] >= value - 1e-9 * abs(value)
        assert solution.upper[first] - solution.lower[first] <= 3e-6
        assert solution.value == pytest.approx(value, abs=3e-6)
    if solver.name != "storm":  # it does not promise the lowest
        assert solution.policy[first] == row


@each_solver
def test_goal_probability_of_lexicographic_answer(solver: Solver) -> None:
    solution = solve(solver, NOISE, "goal-then-reward")
    assert solution.goal_probability is not None
    assert solution.goal_probability == pytest.approx([0.65, 0, 1, 0], abs=1e-6)


@each_solver
def test_entries_of_zero_and_repeated(solver: Solver) -> None:
    mdp = build([[(-1, [(0.25, 1), (0.0, 2), (0.25, 1), (0.5, 0)])], [], [(-1, [(1, 2)])]], [1])
    assert solve(solver, mdp, "reward").value == pytest.approx(-2, abs=2e-6)
    assert solve(solver, mdp, "goal-probability").value == 1


def test_rewards_that_cancel() -> None:
    # +1 to state 1, -1 back; leaving costs 5. Staying swings between 0 and 1 for ever.
    mdp = build([[(1, [(1, 1)]), (-5, [(1, 2)])], [(-1, [(1, 0)])], []], [2])
    solution = ValueIteration().solve(mdp, "reward")
    assert solution.status == "limit"
    assert solution.lower[0] == pytest.approx(0)
    assert solution.upper[0] == pytest.approx(1)
    leaving = ValueIteration().solve(mdp, "goal-then-reward")
    assert leaving.status == "solved"
    assert leaving.value == -5
    assert leaving.value == pytest.approx(leaving.lower[0])


def test_leaving_what_cancels_at_the_right_place() -> None:
    # As above, but one leaves from state 1 as well, for 0.5.
    mdp = build([[(1, [(1, 1)]), (1, [(1, 2)])], [(-1, [(1, 0)]), (0.5, [(1, 2)])], []], [2])
    solution = ValueIteration().solve(mdp, "reward")
    assert (solution.status, solution.value) == ("solved", 1.5)
    assert solution.policy.tolist() == [0, 3, -1]


def test_infinity_of_both_signs_is_left_open() -> None:
    # Half into riches, half into ruin: the sum has no meaning, and no finite bound is claimed.
    mdp = build([[(0, [(0.5, 1), (0.5, 2)])], [(1, [(1, 1)])], [(-1, [(1, 2)])]])
    solution = ValueIteration().solve(mdp, "reward")
    assert solution.status == "limit"
    assert (solution.lower[0], solution.upper[0]) == (-INF, INF)
    assert (solution.lower[1], solution.upper[2]) == (INF, -INF)


def test_more_than_doubles_can_do() -> None:
    # 1000 * 1001 - 500 * 501 steps; a rounding error in one step counts a million times.
    solution = ValueIteration().solve(walk(1001), "steps")
    assert solution.status == "limit"
    assert "double precision" in solution.message
    assert solution.lower[500] <= 750_500 <= solution.upper[500]
    assert solution.upper[500] - solution.lower[500] < 750_500 * 1e-7
    assert ValueIteration(epsilon=0.1).solve(walk(1001), "steps").status == "solved"
    tiny = ValueIteration(epsilon=1e-300).solve(walk(11, both_ends=True), "goal-probability")
    assert tiny.status == "limit"
    assert tiny.lower[5] <= 0.5 <= tiny.upper[5]
    assert tiny.upper[5] - tiny.lower[5] < 1e-10


def test_storm_that_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> object:
        raise ImportError(name)

    monkeypatch.setattr(storm, "import_module", missing)
    with pytest.raises(MissingDependencyError, match=r"menid-plan\[storm\]"):
        Storm().solve(CHAIN, "reward")


@pytest.mark.parametrize("solver", [*SOLVERS], ids=lambda s: s.name)
def test_solvers_say_what_they_are(solver: Solver) -> None:
    assert solver.promise
    assert isinstance(solver.needs, str)


def test_epsilon_must_be_positive() -> None:
    with pytest.raises(ValueError, match="above 0"):
        ValueIteration(epsilon=0.0)
