"""No bound is false, not even by rounding: compared with exact optima, by fractions as they are."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from menid_plan.mdp.check import faults
from menid_plan.mdp.model import MDP
from menid_plan.solving import Solution
from menid_solvers.policy_iteration import PolicyIteration
from menid_solvers.value_iteration import ValueIteration
from solver_reference import INF, Process, UndefinedError, best, build, gauss

Doubles = list[list[tuple[float, list[tuple[float, int]]]]]
TINY = 2.0**-30


def exact(process: Doubles) -> Process:
    """The doubles as fractions; what a row's probabilities sum to is 1."""
    found: Process = []
    for rows in process:
        fractions = []
        for reward, row in rows:
            total = sum(Fraction(p) for p, _ in row)
            fractions.append((Fraction(reward), [(Fraction(p) / total, t) for p, t in row]))
        found.append(fractions)
    return found


def best_discounted(process: Process, discount: Fraction) -> list[Fraction]:
    """The best discounted values, by policy iteration in fractions."""
    n = len(process)
    policy = [0] * n
    while True:
        matrix = [[Fraction(int(i == j)) for j in range(n)] for i in range(n)]
        for s, rows in enumerate(process):
            for p, t in rows[policy[s]][1] if rows else ():
                matrix[s][t] -= discount * p
        reward = [rows[policy[s]][0] if rows else Fraction(0) for s, rows in enumerate(process)]
        value = gauss(matrix, reward)
        changed = False
        for s, rows in enumerate(process):
            for i, (paid, row) in enumerate(rows):
                if paid + discount * sum(p * value[t] for p, t in row) > value[s]:
                    policy[s] = i
                    changed = True
                    break
        if not changed:
            return value


def assert_encloses(solution: Solution, values: list[Fraction | float] | list[Fraction]) -> None:
    for s, value in enumerate(values):
        low, high = float(solution.lower[s]), float(solution.upper[s])
        if isinstance(value, float) or np.isinf(low) or np.isinf(high):
            assert low <= value <= high
        else:
            assert Fraction(low) <= value <= Fraction(high)


def chances(rng: np.random.Generator, number: int) -> list[float]:
    """Probabilities of all sizes: even, any, or all but a little to the first."""
    weights = rng.integers(1, 5, number) if rng.random() < 0.4 else rng.random(number)
    if number > 1 and rng.random() < 0.4:
        rest = weights[1:] / weights[1:].sum() * 10.0 ** -rng.integers(1, 13)
        return [1.0 - float(rest.sum()), *rest.tolist()]
    return [float(p) for p in weights / weights.sum()]


def drawn(rng: np.random.Generator, most: int) -> Doubles:
    """A process of rewards of mixed scale or of one sign, with rows that pay nothing."""
    n = int(rng.integers(2, most))
    scale, sign = rng.integers(0, 4), rng.integers(0, 3)
    wide = rng.random() < 0.1

    def reward() -> float:
        if rng.random() < 0.3:
            return 0.0
        size = (
            float(rng.integers(-3, 4)),
            rng.normal() * 10.0 ** rng.integers(-9, 10),
            rng.choice([1.0, -1.0]) * 1e6 + rng.normal(),
            rng.choice([1e-9, -1e-9, 1.0, -1.0, 1e9, -1e9]),
        )[scale]
        return float((size, -abs(size), abs(size))[sign])

    process: Doubles = []
    for _ in range(n):
        rows = []
        for _ in range(int(rng.integers(rng.random() > 0.3, 3))):
            number = int(rng.integers(20, 40)) if wide else int(rng.integers(1, 4))
            targets = rng.integers(0, n, number).tolist()
            rows.append((reward(), list(zip(chances(rng, number), targets, strict=True))))
        process.append(rows)
    return process


def attempts(rng: np.random.Generator, mdp: MDP, objective: str) -> list[Solution]:
    """Solutions by value-iteration: to the end, stopped early, from a guess."""
    found = []
    for iterations in (None, int(rng.integers(1, 6)), int(rng.choice([10, 50, 101, 150, 300]))):
        start = rng.normal(size=mdp.states) * 10.0 ** rng.integers(-2, 6)
        epsilon = float(rng.choice([1e3, 1e-2, 1e-6, 1e-9, 1e-12]))
        solver = ValueIteration(epsilon=epsilon, max_iterations=iterations, max_seconds=1.0)
        found.append(solver.solve(mdp, objective))  # type: ignore[arg-type]
        found.append(solver.solve(mdp, objective, start=start))  # type: ignore[arg-type]
    return found


@pytest.mark.parametrize("leak", [0.5, 0.1, 1e-2, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9])
def test_discounted_bounds_of_random_processes(leak: float) -> None:
    rng = np.random.default_rng(7)
    discount = 1.0 - leak
    for _ in range(25):
        process = drawn(rng, 5)
        values = best_discounted(exact(process), Fraction(discount))
        for solution in attempts(rng, build(process, discount=discount), "reward"):
            assert_encloses(solution, values)


@pytest.mark.parametrize("objective", ["reward", "goal-probability", "steps"])
def test_total_bounds_of_random_processes(objective: str) -> None:
    rng = np.random.default_rng(8)
    for _ in range(120):
        process = drawn(rng, 5)
        goal = [len(process) - 1]
        try:
            values = best(exact(process), goal, objective)
        except UndefinedError:
            continue
        for solution in attempts(rng, build(process, goal), objective):
            assert_encloses(solution, list(values))


@pytest.mark.parametrize("pay", [1e6, 2.0**27, 1e12])
@pytest.mark.parametrize("reward", [TINY / 8, TINY, 8 * TINY, -TINY])
def test_what_a_step_earns_may_be_less_than_its_rounding(pay: float, reward: float) -> None:
    # Leave at once for the pay, or linger for 2^30 rounds, of which each earns next to nothing.
    linger = (reward, [(1.0 - TINY, 1), (TINY, 2)])
    process: Doubles = [
        [(0.0, [(1.0, 2)]), linger],
        [(0.0, [(1.0, 0)])],
        [(pay, [(1.0, 3)])],
        [],
    ]
    solution = ValueIteration(max_seconds=10.0).solve(build(process, [3]), "reward")
    assert_encloses(solution, list(best(exact(process), [3], "reward")))
    assert solution.upper[0] < 1.001 * pay


@pytest.mark.parametrize("rate", [1e-6, 1e-9, 1e-13, 1e-15])
def test_lingering_that_costs_no_chance(rate: float) -> None:
    # A fair coin at once, or much later: no row is better, and every one is allowed for.
    process: Doubles = [
        [(0.0, [(0.5, 2), (0.5, 3)]), (0.0, [(1.0 - rate, 1), (rate / 2, 2), (rate / 2, 3)])],
        [(0.0, [(1.0 - rate, 0), (rate, 2)])],
        [],
        [],
    ]
    solution = ValueIteration(max_seconds=10.0).solve(build(process, [2]), "goal-probability")
    assert_encloses(solution, list(best(exact(process), [2], "goal-probability")))
    assert "stopped" not in solution.message
    if rate >= 1e-9:
        assert solution.status == "solved"


@pytest.mark.parametrize("number", [50, 300, 2000])
def test_rows_of_many_outcomes(number: int) -> None:
    # They become rows of one entry or two; what was rounded off in adding up stays.
    for seed in range(6):
        rng = np.random.default_rng(seed)
        row = [(1.0 / number, int(t)) for t in rng.integers(1, 3, number)]
        process: Doubles = [[(0.0, row)], [], []]
        solution = ValueIteration().solve(build(process, [1]), "goal-probability")
        assert_encloses(solution, list(best(exact(process), [1], "goal-probability")))
        process = [[(1.0, row)], [(-1.0, [(1.0, 0)])], []]
        solution = ValueIteration().solve(build(process, discount=0.5), "reward")
        assert_encloses(solution, best_discounted(exact(process), Fraction(1, 2)))


@pytest.mark.parametrize("leak", [1e-7, 1e-8, 1e-9])
def test_discounts_next_to_one_are_solved(leak: float) -> None:
    # Sweeps alone would take billions.
    process: Doubles = [
        [(1.0, [(0.5, 1), (0.5, 2)])],
        [(-1.0, [(1.0, 0)]), (-2.0, [(0.25, 2), (0.75, 0)])],
        [(0.25, [(1.0, 1)])],
    ]
    discount = 1.0 - leak
    values = best_discounted(exact(process), Fraction(discount))
    solution = ValueIteration(epsilon=1e3).solve(build(process, discount=discount), "reward")
    assert solution.status == "solved"
    assert solution.iterations < 10_000
    assert_encloses(solution, values)


def by_kinds(mdp: MDP) -> MDP:
    """The same process with one kind for all rows of one action and the same probabilities."""
    kinds: dict[tuple[int, tuple[float, ...]], int] = {}
    row_kind = [
        kinds.setdefault((int(mdp.row_action[r]), tuple(mdp.row_probabilities(r))), len(kinds))
        for r in range(mdp.rows)
    ]
    sizes = [len(probabilities) for _, probabilities in kinds]
    return replace(
        mdp,
        row_kind=np.array(row_kind, np.int32),
        kind_first=np.cumsum([0, *sizes]).astype(np.int64),
        kind_probability=np.array([p for _, each in kinds for p in each], np.float64),
        kind_action=np.array([action for action, _ in kinds], np.int32),
    )


@pytest.mark.parametrize("solver", [ValueIteration(), PolicyIteration()], ids=lambda s: s.name)
@pytest.mark.parametrize("objective", ["reward", "goal-then-reward", "goal-probability", "steps"])
@pytest.mark.parametrize("discount", [1.0, 0.9])
def test_rows_that_share_kinds(
    solver: ValueIteration | PolicyIteration, objective: str, discount: float
) -> None:
    if objective == "goal-then-reward" and discount < 1.0 and solver.name == "policy-iteration":
        pytest.skip("policy-iteration cannot do that")
    rng = np.random.default_rng(9)
    shapes = [[1.0], [0.5, 0.5], [0.9, 0.1], [0.25, 0.0, 0.75], [0.2, 0.3, 0.5]]
    shared = 0
    for _ in range(40):
        n = int(rng.integers(3, 12))
        process: Doubles = []
        for _ in range(n - 1):
            rows = []
            for a in range(3):  # a shape for each action, now and then another one
                shape = shapes[a + int(rng.integers(0, 3))]
                # Targets are few: they meet in one row, and are the state itself.
                targets = rng.integers(0, n, len(shape)).tolist()
                rows.append((-float(rng.integers(1, 4)), list(zip(shape, targets, strict=True))))
            process.append(rows)
        mdp = build([*process, []], [n - 1], discount=discount)
        other = by_kinds(mdp)
        assert faults(other) == []
        assert np.array_equal(other.probability, mdp.probability)
        shared += mdp.rows - len(other.kind_action)
        one = solver.solve(mdp, objective)  # type: ignore[arg-type]
        two = solver.solve(other, objective)  # type: ignore[arg-type]
        assert (one.status, one.message) == (two.status, two.message)
        for name in ("lower", "upper", "policy"):
            assert np.array_equal(getattr(one, name), getattr(two, name))
        if np.abs(one.value) < INF:
            assert one.status == "solved"
    assert shared > 300
