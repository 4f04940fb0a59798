"""Thompson sampling: how often it takes which action, learning, and warm starts."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from menid_plan.mdp.model import MDP, Floats
from menid_plan.planning import Certain
from menid_plan.solving import Belief, Objective, OnlinePolicy
from menid_solvers.thompson import DirichletPosterior, Thompson, ThompsonPolicy
from solver_reference import build

# Two actions, each with a distribution of its own over the goal and a dead end.
STRUCTURE = build(
    [[(0, [(0.5, 1), (0.5, 2)]), (0, [(0.5, 1), (0.5, 2)])], [], []], [1], discount=0.9
)


def fill(probabilities: Floats) -> MDP:
    return replace(STRUCTURE, kind_probability=probabilities, row_reward=probabilities[::2].copy())


def policy(
    counts: list[list[float]], objective: Objective = "reward", **options: Any
) -> ThompsonPolicy:
    belief = Belief(fill, DirichletPosterior.of(counts), objective)
    return Thompson(**options).policy(belief, np.random.default_rng(7))


def test_frequencies_match_the_belief() -> None:
    # With Beta(4, 2) and Beta(3, 3) the first is the better with probability 0.738...
    asked: OnlinePolicy = policy([[3, 1], [2, 2]])
    draws = 10_000
    first = sum(asked.action(0) == 0 for _ in range(draws))
    rng = np.random.default_rng(1)
    believed = np.mean(rng.beta(4, 2, 10**6) > rng.beta(3, 3, 10**6))
    error = np.sqrt(believed * (1 - believed) / draws)
    assert abs(first / draws - believed) < 4 * error


def test_update_turns_the_choice() -> None:
    learner = policy([[0, 0], [0, 0]])
    posterior = learner.belief.posterior
    assert isinstance(posterior, DirichletPosterior)
    for _ in range(400):
        posterior.update(2)
        posterior.update(1, 0.5)
    learner.learned()
    assert {learner.action(0) for _ in range(50)} == {1}
    assert posterior.counts.tolist() == [0, 200, 400, 0]
    assert posterior.mean() == pytest.approx([1 / 202, 201 / 202, 401 / 402, 1 / 402])


@pytest.mark.parametrize("objective", ["reward", "goal-probability", "goal-then-reward"])
def test_a_warm_start_changes_no_action(objective: Objective) -> None:
    warm, cold = (policy([[1, 1], [1, 1]], warm=w, objective=objective) for w in (True, False))
    assert [warm.action(0) for _ in range(300)] == [cold.action(0) for _ in range(300)]


def test_draws_are_kept_when_told() -> None:
    asked = policy([[1, 1], [1, 1]], redraw=3)
    solutions = []
    for _ in range(6):
        asked.action(0)
        solutions.append(asked.solution)
    assert [a is b for a, b in pairwise(solutions)] == [
        True, True, False, True, True,
    ]  # fmt: skip
    assert asked.action(1) == -1


def test_who_knows_the_probabilities_solves_once() -> None:
    asked = policy([[3, 1], [2, 2]])
    known = Certain(np.array([0.75, 0.25, 0.5, 0.5]))
    asked.belief = replace(asked.belief, posterior=known)
    found = [asked.draw() for _ in range(3)]
    assert found[0] is found[1] is found[2]
    assert asked.action(0) == 0
    known.chances[:] = [0.25, 0.75, 0.5, 0.5]
    asked.learned()
    assert asked.action(0) == 1
    # What was stopped is not the last word.
    known.chances[:] = [0.5, 0.5, 0.75, 0.25]
    asked.solution = replace(asked.draw(), status="limit")
    assert asked.draw().status == "solved"


def test_the_prior_must_be_positive() -> None:
    with pytest.raises(ValueError, match="prior"):
        DirichletPosterior.of([[0, 0]], prior=0)
    with pytest.raises(ValueError, match="counts"):
        DirichletPosterior.of([[0, -1]])
    with pytest.raises(ValueError, match="redraw"):
        Thompson(redraw=0)


def test_draws_are_distributions_whatever_the_counts() -> None:
    posterior = DirichletPosterior.of([[0, 0, 0], [5, 1], [0, 0]], prior=1e-4)
    rng = np.random.default_rng(3)
    drawn = np.array([posterior.sample(rng) for _ in range(2000)])
    assert np.all(drawn >= 0)
    for part in (slice(0, 3), slice(3, 5), slice(5, 7)):
        assert drawn[:, part].sum(axis=1) == pytest.approx(1)
    assert drawn.mean(axis=0) == pytest.approx(posterior.mean(), abs=0.05)
    assert drawn[:, 3].std() == pytest.approx(np.sqrt(5 / 6 / 6 / 7), rel=0.1)
