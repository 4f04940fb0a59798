"""Thompson sampling: how often it takes which action, learning, and warm starts."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from menid_plan.mdp.model import MDP
from menid_plan.solving import OnlinePolicy
from menid_solvers.thompson import DirichletPosterior, Probabilities, ThompsonPolicy
from solver_reference import build

# Two actions, each with a distribution of its own over the goal and a dead end.
STRUCTURE = build(
    [[(0, [(0.5, 1), (0.5, 2)]), (0, [(0.5, 1), (0.5, 2)])], [], []], [1], discount=0.9
)


def fill(probabilities: Probabilities) -> MDP:
    return replace(
        STRUCTURE,
        probability=np.concatenate(list(probabilities)),
        row_reward=np.array([row[0] for row in probabilities]),
    )


def policy(counts: list[list[float]], **options: object) -> ThompsonPolicy:
    posterior = DirichletPosterior([np.array(row) for row in counts])
    return ThompsonPolicy(fill, posterior, np.random.default_rng(7), **options)  # type: ignore[arg-type]


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
    for _ in range(400):
        learner.update(1, 0)
        learner.update(0, 1, 0.5)
    assert {learner.action(0) for _ in range(50)} == {1}
    assert isinstance(learner.posterior, DirichletPosterior)
    assert learner.posterior.counts[1].tolist() == [400, 0]
    assert learner.posterior.counts[0].tolist() == [0, 200]


@pytest.mark.parametrize("objective", ["reward", "goal-probability", "goal-then-reward"])
def test_a_warm_start_changes_no_action(objective: str) -> None:
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


def test_the_prior_must_be_positive() -> None:
    with pytest.raises(ValueError, match="prior"):
        DirichletPosterior([np.zeros(2)], prior=0)
