"""The solver ``storm``: the same MDP handed to Storm's sparse engine through stormpy.

Hensel, Junges, Katoen, Quatmann and Volk, The probabilistic model checker Storm, 2022.
"""

from __future__ import annotations

import ctypes
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any, ClassVar

import numpy as np

from menid_plan.mdp.model import MDP, Bools, Floats, Ints, SmallInts
from menid_plan.solving import (
    MissingDependencyError,
    Objective,
    Progress,
    Solution,
    Status,
    UnsupportedError,
)
from menid_solvers.options import demand_positive, demand_share

MAX_HORIZON = 1_000_000


@dataclass(frozen=True, slots=True)
class Storm:
    """Storm with its sound methods (intervals); ``epsilon`` is how far apart the bounds may be.

    ``tie``: how exactly goal probabilities are told apart before rewards decide.

    Storm has no total of rewards of both signs without discount, and no discount together with a
    horizon: UnsupportedError. Its discounted values come without bounds; they are given as the value
    and half of epsilon to both sides.
    """

    name: ClassVar[str] = "storm"
    promise: ClassVar[str] = "what Storm's sound engine promises: within epsilon up to rounding"
    needs: ClassVar[str] = "stormpy>=2"

    epsilon: float = 1e-6
    tie: float = 1e-8

    def __post_init__(self) -> None:
        demand_positive(epsilon=self.epsilon)
        demand_share(tie=self.tie)

    def solve(
        self,
        mdp: MDP,
        objective: Objective,
        *,
        progress: Progress | None = None,  # noqa: ARG002
        start: Floats | None = None,  # noqa: ARG002
    ) -> Solution:
        """Solve by Storm; MissingDependencyError without stormpy."""
        begin = time.perf_counter()
        if mdp.horizon is not None and mdp.horizon > MAX_HORIZON:
            raise UnsupportedError(f"storm takes every step; no horizon above {MAX_HORIZON}")
        if mdp.horizon is not None and objective == "goal-then-reward":
            raise UnsupportedError("storm cannot put the goal before the reward within a horizon")
        rows = mdp.rows_of(~mdp.goal)
        import_stormpy()  # whatever is amiss with it is said first
        with quiet_output():
            if objective == "goal-then-reward":
                lower, upper, policy, chance = self._goal_then_reward(mdp, rows)
            else:
                chance = None
                lower, upper, policy = self._plain(mdp, rows, objective)
                if objective == "goal-probability":
                    chance = (lower + upper) / 2
            if mdp.horizon != 0:
                self._complete(mdp, rows, objective, (lower + upper) / 2, policy)
        low, high = lower[mdp.initial], upper[mdp.initial]
        status: Status = "solved"
        message = ""
        if objective == "steps" and low == np.inf:
            status, message = "infeasible", "no policy reaches the goal with probability 1"
        elif low == np.inf:
            status, message = "unbounded", "the sum of rewards has no upper bound"
        elif low != high and not high - low <= 1.001 * self.epsilon:
            status, message = "limit", "Storm's own bounds are wider than epsilon"
        return Solution(
            status=status,
            objective=objective,
            initial=mdp.initial,
            lower=lower,
            upper=upper,
            policy=policy,
            iterations=0,
            seconds=time.perf_counter() - begin,
            goal_probability=chance if mdp.has_goal else None,
            message=message,
        )

    def _plain(
        self, mdp: MDP, rows: Bools, objective: Objective
    ) -> tuple[Floats, Floats, SmallInts]:
        bound = "" if mdp.horizon is None else f"<={mdp.horizon}"
        if objective == "goal-probability":
            model = StormModel.build(mdp, rows, np.zeros(mdp.rows))
            return model.check(f'Pmax=? [F{bound} "goal"]', self.epsilon)
        if objective == "steps":
            if mdp.horizon is not None:
                raise UnsupportedError("storm has no least number of steps within a horizon")
            model = StormModel.build(mdp, rows, np.ones(mdp.rows))
            return model.check('R{"r"}min=? [F "goal"]', self.epsilon)
        reward = mdp.row_reward
        if mdp.discount < 1.0:
            if mdp.horizon is not None:
                raise UnsupportedError("storm cannot discount within a horizon")
            if mdp.discount == 0.0:
                raise UnsupportedError("storm has no discount of 0")
            model = StormModel.build(mdp, rows, reward)
            formula = f'R{{"r"}}max=? [Cdiscount={mdp.discount!r}]'
            return model.check(formula, self.epsilon)
        if mdp.horizon is not None:
            # Storm's rewards are not negative: what every step pays more is taken off again.
            lift = -min(0.0, float(np.min(reward[rows], initial=0.0)))
            model = StormModel.build(mdp, rows, reward + lift, lift)
            lower, upper, policy = model.check(f'R{{"r"}}max=? [C{bound}]', self.epsilon)
            return lower - lift * mdp.horizon, upper - lift * mdp.horizon, policy
        return self._total(mdp, rows, "C")

    def _complete(
        self, mdp: MDP, rows: Bools, objective: Objective, value: Floats, policy: SmallInts
    ) -> None:
        """Choose rows where Storm gives none: within a horizon, or if some total is infinite."""
        from menid_solvers.graph import Graph, lowest_rows

        missing = (policy < 0) & (lowest_rows(mdp, rows) >= 0)
        if not bool(missing.any()):
            return
        paid = mdp.row_reward if objective == "reward" else np.zeros(mdp.rows)
        after = value
        if mdp.horizon is not None:
            low, high, _ = self._plain(replace(mdp, horizon=mdp.horizon - 1), rows, objective)
            after = (low + high) / 2
        chance = mdp.probability
        with np.errstate(invalid="ignore"):
            worth = np.where(chance > 0.0, chance * after[mdp.next_state], 0.0)
        worth = np.add.reduceat(worth, mdp.row_transition[:-1]) + paid
        best = np.full(mdp.states, -np.inf)
        state = mdp.row_state
        np.maximum.at(best, state[rows], worth[rows])
        good = rows & (worth >= best[state] - self.epsilon)
        chosen = lowest_rows(mdp, good)
        if mdp.horizon is None:  # lingering among good rows would never be paid
            Graph(mdp, rows).steer(good, value <= self.epsilon, chosen)
        policy[missing] = chosen[missing]

    def _total(self, mdp: MDP, rows: Bools, path: str) -> tuple[Floats, Floats, SmallInts]:
        reward = mdp.row_reward
        if not bool(np.any(reward[rows] < 0.0)):
            model = StormModel.build(mdp, rows, reward)
            return model.check(f'R{{"r"}}max=? [{path}]', self.epsilon)
        if bool(np.any(reward[rows] > 0.0)):
            raise UnsupportedError("storm has no total of rewards of both signs")
        model = StormModel.build(mdp, rows, -reward)
        lower, upper, policy = model.check(f'R{{"r"}}min=? [{path}]', self.epsilon)
        return -upper, -lower, policy

    def _goal_then_reward(self, mdp: MDP, rows: Bools) -> tuple[Floats, Floats, SmallInts, Floats]:
        if mdp.discount < 1.0:
            raise UnsupportedError("storm cannot put the goal before a discounted reward")
        finer = replace(self, epsilon=min(self.epsilon, self.tie / 100))
        low, high, first = finer._plain(mdp, rows, "goal-probability")
        chance = (low + high) / 2
        reach = np.add.reduceat(mdp.probability * chance[mdp.next_state], mdp.row_transition[:-1])
        state = mdp.row_state
        hopeful = chance > self.tie
        best = rows & hopeful[state] & (reach >= chance[state] - self.tie)
        negative = not bool(np.any(mdp.row_reward[best] > 0.0))
        if not negative:
            raise UnsupportedError("storm puts the goal before rewards only if none is positive")
        ended = StormModel.build(mdp, best, -mdp.row_reward, ended=mdp.goal | ~hopeful)
        lower, upper, policy = ended.check('R{"r"}min=? [F "end"]', self.epsilon)
        policy = np.where(hopeful, policy, first).astype(np.int32)
        return -upper, -lower, policy, chance


@dataclass(frozen=True, slots=True, eq=False)
class StormModel:
    """An MDP in Storm, and which of its rows each choice is (int64[choices], -1 for a loop)."""

    model: Any
    source: Ints
    first: Ints

    @classmethod
    def build(
        cls,
        mdp: MDP,
        rows: Bools,
        reward: Floats,
        at_end: float = 0.0,
        ended: Bools | None = None,
    ) -> StormModel:
        """Build it from the rows (bool[r]); states without any loop, and are paid at_end."""
        from scipy.sparse import csr_matrix

        _, data, models = import_stormpy()
        counts = np.add.reduceat(np.append(rows, False).astype(np.int64), mdp.state_row[:-1])
        counts[np.diff(mdp.state_row) == 0] = 0
        choices = np.maximum(counts, 1)
        first = np.concatenate(([0], np.cumsum(choices)))
        source = np.full(first[-1], -1, np.int64)
        state = mdp.row_state
        kept = np.flatnonzero(rows)
        place = first[state[kept]] + np.arange(len(kept)) - np.cumsum(counts)[state[kept]]
        place += counts[state[kept]]
        source[place] = kept
        matrix = csr_matrix(
            (mdp.probability, mdp.next_state, mdp.row_transition), shape=(mdp.rows, mdp.states)
        )
        loops = np.flatnonzero(source < 0)
        owner = np.repeat(np.arange(mdp.states), choices)
        chosen = matrix[kept].tocoo()
        row = np.concatenate((place[chosen.row], loops))
        column = np.concatenate((chosen.col, owner[loops]))
        weight = np.concatenate((chosen.data, np.ones(len(loops))))
        whole = csr_matrix((weight, (row, column)), shape=(len(source), mdp.states))
        whole.sum_duplicates()
        whole.eliminate_zeros()
        entries = whole.tocoo()
        builder = data.SparseMatrixBuilder[float](
            rows=len(source),
            columns=mdp.states,
            entries=whole.nnz,
            has_custom_row_grouping=True,
            row_groups=mdp.states,
        )
        builder.add_next_values(
            entries.row.tolist(), entries.col.tolist(), entries.data.tolist(), first[:-1].tolist()
        )
        labels = models.StateLabeling(mdp.states)
        nowhere = np.zeros(mdp.states, np.bool_)
        first_state = nowhere.copy()
        first_state[mdp.initial] = True
        marks = {"init": first_state, "goal": mdp.goal, "end": nowhere if ended is None else ended}
        for label, where in marks.items():
            labels.add_label(label)
            for s in np.flatnonzero(where).tolist():
                labels.add_label_to_state(label, s)
        paid = np.where(source >= 0, reward[source] if mdp.rows else 0.0, at_end)
        rewards = models.SparseRewardModel[float](optional_state_action_reward_vector=paid.tolist())
        parts = models.SparseModelComponents[float](
            transition_matrix=builder.build(), state_labeling=labels, reward_models={"r": rewards}
        )
        return cls(models.SparseMdp[float](parts), source, first)

    def check(self, formula: str, epsilon: float) -> tuple[Floats, Floats, SmallInts]:
        """Lower and upper bounds (float64[n]) and the policy (int32[n]) for a formula."""
        stormpy, _, _ = import_stormpy()
        environment = stormpy.environments.sound()
        settings = environment.solver().min_max()
        settings.precision = stormpy.Rational(repr(epsilon / 2))
        settings.relative_termination_criterion = False
        result = stormpy.model_checking(
            self.model,
            stormpy.parse_property(formula),
            extract_scheduler="<=" not in formula,
            environment=environment,
        )
        value = np.array(result.get_value_vector(), dtype=np.float64)
        lower, upper = value - epsilon / 2, value + epsilon / 2
        policy = np.full(len(value), -1, np.int32)
        if result.has_scheduler():
            scheduler = result.get_scheduler()
            for s in range(len(value)):
                choice = scheduler.get_choice(s).get_deterministic_choice()
                policy[s] = self.source[self.first[s] + choice]
        return lower, upper, policy


@contextmanager
def quiet_output() -> Iterator[None]:
    """What Storm writes to standard output goes to standard error: our own output may be data."""
    sys.stdout.flush()
    try:
        kept = os.dup(1)
        os.dup2(2, 1)
    except OSError:  # one of them is closed
        yield
        return
    try:
        yield
    finally:
        ctypes.CDLL(None).fflush(None)  # before it goes where it should not
        os.dup2(kept, 1)
        os.close(kept)


def import_stormpy() -> tuple[Any, Any, Any]:
    """The modules stormpy, stormpy.datastructures and stormpy.models."""
    names = ("stormpy", "stormpy.datastructures", "stormpy.models")
    try:
        stormpy, data, models = (import_module(name) for name in names)
    except ImportError as error:
        raise MissingDependencyError(
            "the solver `storm` needs stormpy 2: pip install 'menid-plan[storm]'"
        ) from error
    return stormpy, data, models
