"""Where to act next in a ground problem: its model under a belief, seen as the rule looks at it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from menid_plan.allocation import rates
from menid_plan.allocation.belief import Belief
from menid_plan.allocation.rule import Rule, Tests, View
from menid_plan.errors import MenidError
from menid_plan.mdp.explore import Structure
from menid_plan.mdp.model import Floats, Ints, SmallInts

# Steps of an episode that are looked ahead, where its horizon is not nearer.
MOST_STEPS = 100
# Models that are drawn to see what there is to hope for.
DRAWS = 16
# Beyond so many values, tables for all steps and states would take long.
MOST_VALUES = 50_000_000


class TooLargeError(MenidError):
    """A problem has more states than can be looked at in every decision."""

    exit_code = 4


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """What is best by some probabilities.

    ``rate`` is the reward a second, ``later`` (float64[n]) what a state is worth after the first step,
    less the price of the time, ``policy`` (int32[steps, n]) the row to take by the steps that are left,
    less one, and ``visits`` (float64[n]) how often a second each state is come to.
    """

    rate: float
    later: Floats
    policy: SmallInts
    visits: Floats


class Model:
    """The rewards of a structure by the second, with probabilities as they are believed.

    Episodes begin in state 0, and follow one another. ``goals``: what counts is not the reward but how
    often a goal is reached. ``steps`` is the horizon, None if there is none.
    """

    def __init__(self, structure: Structure, steps: int | None, *, goals: bool = False) -> None:
        self.structure = structure
        problem = structure.problem
        self.steps = min(steps or MOST_STEPS, MOST_STEPS)
        if self.steps * structure.states > MOST_VALUES:
            raise TooLargeError(
                f"problem `{problem.problem.name}` has {structure.states} states, too many to weigh up "
                'tests in; learn with allocate = "cheapest-first"'
            )
        rows = len(structure.row_rule)
        self._row = np.repeat(np.arange(rows), np.diff(structure.row_transition))
        transitions = np.arange(len(self._row))
        self._slot = structure.slot(transitions).astype(np.int64)
        starts = np.array([d.start for d in problem.distributions], np.int64)
        self._distribution = np.searchsorted(starts, self._slot, side="right") - 1
        self._outcome = self._slot - starts[self._distribution]
        self.distribution: Ints = np.zeros(rows, np.int64)
        self.distribution[self._row] = self._distribution
        self.state: Ints = np.repeat(np.arange(structure.states), np.diff(structure.state_row))
        self._kind_distribution = np.searchsorted(starts, structure.kind_slot, side="right") - 1
        self._kind_outcome = structure.kind_slot - starts[self._kind_distribution]
        if goals:
            self._pay = np.where(structure.goal, 1.0, 0.0)[structure.next_state]
            self._flat = np.zeros(rows)
        else:
            arrival = np.where(structure.goal, problem.goal_reward, 0.0)
            arrival[structure.dead_end] += problem.dead_end_reward
            self._pay = problem.slot_reward[self._slot] + arrival[structure.next_state]
            cost = problem.action_cost[problem.tables.rule_action[structure.row_rule]]
            self._flat = structure.state_reward[self.state] - cost
        self._value = np.zeros((self.steps + 1, structure.states))
        self._policy = np.zeros((self.steps, structure.states), np.int32)
        self._reached = np.zeros((2, structure.states))

    @property
    def highest(self) -> Floats:
        """The highest reward of each row (float64[rows])."""
        found = np.full(len(self._flat), -np.inf)
        np.maximum.at(found, self._row, self._pay)
        return found + self._flat

    def solve(
        self, chances: Floats, seconds: Floats, price: float, bonus: Floats | None = None
    ) -> Solved:
        """What is best with ``chances`` (float64[D, K]) of the outcomes of each distribution.

        ``seconds`` (float64[rows]) is what an execution takes, ``price`` a guess of the best rate, and
        ``bonus`` (float64[D]) what an execution of a distribution brings in beside its reward.
        """
        structure = self.structure
        reward = self._flat + np.bincount(
            self._row, chances[self._distribution, self._outcome] * self._pay, len(self._flat)
        )
        if bonus is not None:
            reward += bonus[self.distribution]
        probability = chances[self._kind_distribution, self._kind_outcome]
        visits = np.empty(structure.states)
        rate, took = rates.best_rate(
            structure.state_row, structure.row_transition, structure.next_state, structure.row_rule,
            structure.kind_first, probability, reward, seconds, 0, price, self._value, self._policy,
            self._reached, visits,
        )  # fmt: skip
        return Solved(rate, self._value[-2].copy(), self._policy.copy(), visits / max(took, 1e-300))

    def payoffs(self, solved: Solved, seconds: Floats, width: int) -> Floats:
        """What each outcome of each row brings in, with what follows: float64[rows, width]."""
        found = np.zeros((len(self._flat), width))
        later = solved.later[self.structure.next_state]
        found[self._row, self._outcome] = self._pay + later
        found += (self._flat - solved.rate * seconds)[:, None]
        return found

    def others(self, worth: Floats) -> Floats:
        """The best of the other rows of its state, for each row (float64[rows]); -inf if none."""
        begin = self.structure.state_row[:-1]
        has = np.diff(self.structure.state_row) > 0
        best = np.full(self.structure.states, -np.inf)
        best[has] = np.maximum.reduceat(worth, begin[has])
        first = np.flatnonzero(worth == best[self.state])
        _, unique = np.unique(self.state[first], return_index=True)
        first = first[unique]
        rest = worth.copy()
        rest[first] = -np.inf
        second = np.full(self.structure.states, -np.inf)
        second[has] = np.maximum.reduceat(rest, begin[has])
        found: Floats = best[self.state]
        found[first] = second[self.state[first]]
        return found


@dataclass(frozen=True, slots=True)
class Time:
    """Of a run, in seconds: what is left of it, what has passed, and what of that were tests."""

    left: float
    passed: float
    tested: float


class Decider:
    """Decides between tests and executions, in the states of one model.

    ``seconds`` gives the durations of rows (float64[rows]): in the target (environment 0) and in each
    test, infinite where a row can't be tested.
    """

    def __init__(
        self,
        model: Model,
        belief: Belief,
        seconds: Callable[[int], Floats],
        rng: np.random.Generator,
    ) -> None:
        self.model = model
        self.belief = belief
        self.rule = Rule(belief, rng.random(len(belief.outcomes)))
        self._seconds = seconds
        self._rng = rng
        self._rate = 0.0

    def decide(self, state: int, left: int | None, time: Time) -> Tests | int:
        """Tests of a row, or the row to execute, with so many steps left; -1 if there is none."""
        model, belief = self.model, self.belief
        if belief.learn():
            self.rule.forget()
        seconds = self._seconds(0)
        test_seconds = np.array([self._seconds(1 + test) for test in range(belief.tests)])
        view, solved = self._view(seconds, test_seconds)
        if belief.tests:
            found = self.rule.tests(view, time.left, time.passed, time.tested)
            if found is not None:
                return found
        bonus = self.rule.bonuses(view, time.left)
        curious = model.solve(belief.mean(), seconds, solved.rate, bonus)
        step = model.steps if left is None else min(left, model.steps)
        return int(curious.policy[step - 1, state]) if step > 0 else -1

    def _view(self, seconds: Floats, test_seconds: Floats) -> tuple[View, Solved]:
        model, belief = self.model, self.belief
        mean = belief.mean()
        solved = model.solve(mean, seconds, self._rate)
        self._rate = solved.rate
        drawn = [
            model.solve(chances, seconds, solved.rate)
            for chances in belief.sample(self._rng, DRAWS)
        ]
        payoffs = model.payoffs(solved, seconds, mean.shape[1])
        worth = (payoffs * mean[model.distribution]).sum(axis=1)
        visits = (solved.visits + np.mean([each.visits for each in drawn], axis=0)) / 2.0
        return View(
            model.distribution, payoffs, model.others(worth), visits[model.state], seconds,
            test_seconds.reshape(belief.tests, len(seconds)), solved.rate,
            float(np.mean([each.rate for each in drawn])),
            float((np.maximum(model.highest, 0.0) / seconds).max()),
        ), solved  # fmt: skip


def believed(structure: Structure, counts: Callable[[int], Floats], tests: int) -> Belief:
    """A belief about the distributions of a structure's problem, after ``counts`` of each.

    Those of one rule are a group. ``counts`` gives float64[1 + tests, k], by a distribution's number.
    """
    distributions = structure.problem.distributions
    names = [(d.action, d.rule.name) for d in distributions]
    groups = {name: number for number, name in enumerate(dict.fromkeys(names))}
    belief = Belief(
        [len(d.rule.outcomes) for d in distributions], [groups[name] for name in names], tests
    )
    for index in range(len(distributions)):
        for environment, seen in enumerate(counts(index)):
            if seen.any():
                belief.add(index, environment, seen)
    return belief
