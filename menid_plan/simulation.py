"""Episodes drawn under a policy: every running episode takes its next step together with the others.

A step pays what the language says it pays, outcome by outcome, and not a row's average: the state
reward, the outcome's reward, less the action's cost, and on arrival the goal's or the dead end's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from menid_plan.errors import MeaningError
from menid_plan.grounding.state import SINK, state_text
from menid_plan.mdp.distance import goal_distance
from menid_plan.mdp.explore import Structure
from menid_plan.mdp.model import MDP, Bools, Floats, Ints, SmallInts
from menid_plan.memory import demand
from menid_plan.solving import Objective, OnlinePolicy, Solution, StepPolicy

MAX_STEPS = 10_000
"""After how many steps an episode is cut off, unless discounting makes an earlier end as good."""

NEGLIGIBLE = 1e-6
"""What may be left out of a discounted return, as a part of the largest reward of a step."""

Chooser: TypeAlias = Callable[[Ints, int | None], Ints]
"""The rows to take (int64[k], -1 for none) in some states (int64[k]) with so many steps left.

Without a horizon the number of steps left is None.
"""


def stationary(policy: SmallInts) -> Chooser:
    """Choose by one row for each state (int32[n])."""

    def choose(states: Ints, left: int | None) -> Ints:  # noqa: ARG001
        return policy[states].astype(np.int64)

    return choose


def stepwise(policy: StepPolicy) -> Chooser:
    """Choose by the steps that are left."""
    none = int(np.iinfo(policy.offsets.dtype).max)

    def choose(states: Ints, left: int | None) -> Ints:
        assert left is not None, "the policy is for a horizon"
        offsets = policy.offsets[max(0, len(policy.offsets) - left), states].astype(np.int64)
        return np.where(offsets == none, -1, policy.state_row[states] + offsets)

    return choose


def online(policy: OnlinePolicy) -> Chooser:
    """Ask for every state in turn, whatever the steps left.

    Episodes that run at the same time are asked about in turn: for a policy that learns within an
    episode, draw one episode after the other.
    """

    def choose(states: Ints, left: int | None) -> Ints:  # noqa: ARG001
        return np.array([policy.action(state) for state in states.tolist()], np.int64)

    return choose


def chooser(solution: Solution) -> Chooser:
    """Choose as a solution does; by the steps left where it knows."""
    if solution.steps is not None:
        return stepwise(solution.steps)
    return stationary(solution.policy)


@dataclass(frozen=True, slots=True)
class Estimate:
    """A sample mean and its standard error, which is NaN for a single value."""

    mean: float
    error: float

    @classmethod
    def of(cls, values: Floats | Ints | Bools) -> Estimate:
        """The mean of some values (at least one)."""
        sample = np.asarray(values, np.float64)
        if len(sample) < 2:
            return cls(float(sample.mean()), math.nan)
        return cls(float(sample.mean()), float(sample.std(ddof=1) / math.sqrt(len(sample))))


@dataclass(frozen=True, slots=True, eq=False)
class Traces:
    """The steps of all episodes, one episode after the other.

    Those of episode i are ``first[i]`` to ``first[i + 1]`` (int64[N + 1]). Of a step: the row that
    was taken (int64), the transition that was drawn (int64), and what it paid (float64, undiscounted).
    """

    first: Ints
    row: Ints
    transition: Ints
    reward: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Episodes:
    """What came of N episodes; arrays are over them.

    ``returns`` (float64) are the sums of rewards, discounted if the problem is; ``counted`` (float64)
    are the same without what was paid once the goal was out of reach (None if nobody asked).
    ``steps`` (int64), ``goal`` (bool: it ended in one), ``cut`` (bool: it was still going on after
    ``max_steps``). ``lacking`` bounds what a cut return may lack: inf without discount.
    ``interrupted``: they were cut since whoever watched raised KeyboardInterrupt.
    """

    returns: Floats
    counted: Floats | None
    steps: Ints
    goal: Bools
    cut: Bools
    max_steps: int
    lacking: float
    traces: Traces | None = None
    interrupted: bool = False

    def of_objective(self, objective: Objective) -> Estimate:
        """The estimate of what the objective's value is the expectation of.

        For ``goal-then-reward`` the episodes must have been drawn with ``hopeless``.
        """
        if objective == "reward":
            return Estimate.of(self.returns)
        if objective == "goal-probability":
            return Estimate.of(self.goal)
        if objective == "steps":
            return Estimate.of(self.steps)
        assert self.counted is not None, "drawn without `hopeless`"
        return Estimate.of(self.counted)


class Simulator:
    """Draws episodes of an MDP that was filled from a structure.

    An episode starts in the initial state and ends in a goal, a state where nothing applies, the
    sink, or at the horizon.
    """

    def __init__(self, structure: Structure, mdp: MDP) -> None:
        problem = structure.problem
        self.structure = structure
        self.mdp = mdp
        self._ended: Bools = (np.diff(mdp.state_row) == 0) | mdp.goal
        self._arrival = np.where(structure.goal, problem.goal_reward, 0.0)
        self._arrival[structure.dead_end] += problem.dead_end_reward
        self._slot_reward = problem.slot_reward
        self._cost = problem.action_cost
        self.largest = sum(
            float(np.max(np.abs(part), initial=0.0))
            for part in (structure.state_reward, self._slot_reward, self._cost, self._arrival)
        )

    def default_steps(self) -> int:
        """MAX_STEPS, or fewer if discounting leaves less than NEGLIGIBLE of a return behind them."""
        discount = self.mdp.discount
        if discount == 1.0:
            return MAX_STEPS
        if discount == 0.0:
            return 1
        needed = math.log(NEGLIGIBLE * (1.0 - discount)) / math.log(discount)
        return min(MAX_STEPS, max(1, math.ceil(needed)))

    def run(
        self,
        choose: Chooser,
        episodes: int,
        rng: np.random.Generator,
        *,
        max_steps: int | None = None,
        hopeless: bool = False,
        trace: bool = False,
        progress: Callable[[int, int], None] | None = None,
    ) -> Episodes:
        """Draw episodes, each of at most ``max_steps`` steps (by default `default_steps`).

        Every running episode takes one number of ``rng`` for each step, in the order of the
        episodes. ``hopeless`` also sums what was paid while the goal was within reach; ``trace``
        keeps every step. ``progress`` is told before each step how many there were, and how many
        episodes go on; if it raises KeyboardInterrupt those are cut there. Raises MeaningError where
        the policy has no row.
        """
        mdp = self.mdp
        most = self.default_steps() if max_steps is None else max_steps
        last = most if mdp.horizon is None else min(most, mdp.horizon)
        distance = self.goal_distance() if hopeless else None
        demand(60.0 * episodes, f"for {episodes} episodes at once")
        returns = np.zeros(episodes)
        counted = None if distance is None else np.zeros(episodes)
        steps = np.zeros(episodes, np.int64)
        goal = np.full(episodes, bool(mdp.goal[mdp.initial]))
        running = np.arange(0 if self._ended[mdp.initial] else episodes)
        states = np.full(len(running), mdp.initial, np.int64)
        kept: list[tuple[Ints, Ints, Ints, Floats]] = []
        factor = 1.0
        interrupted = False
        for step in range(last):
            if len(running) == 0:
                break
            try:
                if progress is not None:
                    progress(step, len(running))
            except KeyboardInterrupt:
                most = last = step
                interrupted = True
                break
            left = None if mdp.horizon is None else mdp.horizon - step
            rows = choose(states, left)
            self._check(states, rows, left)
            drawn = self._draw(rows, rng.random(len(rows)))
            after = mdp.next_state[drawn]
            pays = self._pays(states, rows, drawn)
            returns[running] += factor * pays
            if counted is not None and distance is not None:
                near = distance[states] <= (mdp.states if left is None else left)
                counted[running] += np.where(near, factor * pays, 0.0)
            if trace:
                kept.append((running, rows, drawn, pays))
            steps[running] += 1
            goal[running] = mdp.goal[after]
            going = ~self._ended[after]
            running, states = running[going], after[going].astype(np.int64)
            factor *= mdp.discount
        cut = np.zeros(episodes, np.bool_)
        if mdp.horizon is None or last < mdp.horizon:
            cut[running] = True
        lacking = 0.0
        if cut.any():
            rest = math.inf if mdp.discount == 1.0 else mdp.discount**last / (1.0 - mdp.discount)
            lacking = self.largest * rest if self.largest else 0.0
        traces = _traces(kept, steps) if trace else None
        return Episodes(returns, counted, steps, goal, cut, most, lacking, traces, interrupted)

    def goal_distance(self) -> Ints:
        """The least number of steps in which the goal can be reached (int64[n]).

        Of a state from which it cannot be reached, the largest int64: the goal is out of reach where
        this is more than the steps that are left.
        """
        return goal_distance(self.mdp)

    def _pays(self, states: Ints, rows: Ints, drawn: Ints) -> Floats:
        """What steps pay (float64)."""
        structure, mdp = self.structure, self.mdp
        pays: Floats = structure.state_reward[states] + self._slot_reward[structure.slot(drawn)]
        pays -= self._cost[mdp.kind_action[mdp.row_kind[rows]]]
        pays += self._arrival[mdp.next_state[drawn]]
        return pays

    def _draw(self, rows: Ints, chance: Floats) -> Ints:
        """The transition of each row at which its probabilities first sum to more than ``chance``."""
        mdp = self.mdp
        kinds = mdp.row_kind[rows]
        first, last = mdp.kind_first[kinds], mdp.kind_first[kinds + 1] - 1
        at = first.copy()
        passed = mdp.kind_probability[at]
        on = np.flatnonzero((passed <= chance) & (at < last))
        while len(on):
            at[on] += 1
            passed[on] += mdp.kind_probability[at[on]]
            on = on[(passed[on] <= chance[on]) & (at[on] < last[on])]
        # Rounding may leave the sum below the chance: then it is the last that can happen.
        back = np.flatnonzero(mdp.kind_probability[at] == 0.0)
        while len(back):
            at[back] -= 1
            back = back[mdp.kind_probability[at[back]] == 0.0]
        drawn: Ints = mdp.row_transition[rows] + (at - first)
        return drawn

    def _check(self, states: Ints, rows: Ints, left: int | None) -> None:
        silent = np.flatnonzero(rows < 0)
        if len(silent):
            raise MeaningError(self.silence(int(states[silent[0]]), left))

    def silence(self, number: int, left: int | None, who: str = "the policy") -> str:
        """The message that a policy has no action in a state."""
        state = self.structure.state(number)
        text = "sink" if state is SINK else state_text(state - self.structure.problem.always)
        steps = "" if left is None else f" with {left} step{'s' * (left != 1)} left"
        return f"{who} has no action{steps} in the state {text}, which an episode reaches"


def _traces(kept: list[tuple[Ints, Ints, Ints, Floats]], steps: Ints) -> Traces:
    """The steps by episode; they were kept by time."""
    first = np.concatenate(([0], np.cumsum(steps)))
    if not kept:
        none = np.zeros(0, np.int64)
        return Traces(first, none, none, np.zeros(0))
    running, rows, drawn, pays = (np.concatenate(column) for column in zip(*kept, strict=True))
    order = np.argsort(running, kind="stable")
    return Traces(first, rows[order], drawn[order], pays[order])
