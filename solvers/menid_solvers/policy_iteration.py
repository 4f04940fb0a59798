"""The solver ``policy-iteration``: Howard's method with exact linear solves.

An independent check of value-iteration: it shares the questions about the graph, and no arithmetic.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from menid_plan.mdp.model import MDP, Bools, Floats, Ints, SmallInts
from menid_plan.solving import Objective, Progress, Solution, Status, UnsupportedError
from menid_solvers.options import demand_at_least, demand_positive, demand_share

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix, csr_matrix

DENSE = 300  # up to so many states a dense solve is the faster
SPARSE = 5000  # and up to so many elimination is
CANCEL = 1e-10  # what a step may lose, relative to the largest sum, and be taken for nothing


@dataclass(frozen=True, slots=True)
class PolicyIteration:
    """Howard 1960: solve a policy's equations, switch to better rows, until there are none.

    Without discount it begins with a policy that surely ends, and changes a row only where that is
    better by more than ``tie`` (relative to the largest value). Then a policy that would never end
    shows that the reward is unbounded: along its recurrent states the mean reward is above 0
    (Bertsekas and Tsitsiklis 1991). No finite horizon, and no end component in which rewards of both
    signs cancel. The bounds are the value of the policy and an estimate of what rounding and the
    rows that were not worth a change may come to; where they are more than ``epsilon`` apart the
    status is ``limit``.
    """

    name: ClassVar[str] = "policy-iteration"
    promise: ClassVar[str] = "the best policy's value up to rounding, as estimated"
    needs: ClassVar[str] = ""

    epsilon: float = 1e-6
    max_iterations: int = 1000
    tie: float = 1e-13

    def __post_init__(self) -> None:
        demand_positive(epsilon=self.epsilon)
        demand_share(tie=self.tie)
        demand_at_least(1, max_iterations=self.max_iterations)

    def solve(
        self,
        mdp: MDP,
        objective: Objective,
        *,
        progress: Progress | None = None,
        start: Floats | None = None,  # noqa: ARG002
    ) -> Solution:
        """Solve for an objective; UnsupportedError with a horizon."""
        if mdp.horizon is not None:
            raise UnsupportedError("policy-iteration has no finite horizons")
        return _Run(self, mdp, objective, progress).solution()


class _Run:
    """One solve: the matrix of all rows, and what was counted."""

    def __init__(
        self, options: PolicyIteration, mdp: MDP, objective: Objective, progress: Progress | None
    ) -> None:
        from scipy.sparse import csr_matrix

        from menid_solvers.graph import Graph

        self.options = options
        self.mdp = mdp
        self.objective = objective
        self.progress = progress
        self.begin = time.perf_counter()
        self.iterations = 0
        self.stopped = False
        self.stay = np.zeros(mdp.states)  # steps that the policy last evaluated takes
        self.state = mdp.row_state
        self.rows: Bools = ~mdp.goal[self.state]
        self.matrix: csr_matrix = csr_matrix(
            (mdp.probability, mdp.next_state, mdp.row_transition), shape=(mdp.rows, mdp.states)
        )
        self.graph = Graph(mdp, self.rows)
        self.ended: Bools = np.ones(mdp.states, np.bool_)
        self.ended[self.state[self.rows]] = False

    def solution(self) -> Solution:
        """Solve for the objective."""
        mdp = self.mdp
        chance = None
        if self.objective == "reward":
            lower, upper, policy = self.reward()
        elif self.objective == "goal-probability":
            lower, upper, policy = self.goal()
            chance = (lower + upper) / 2
        elif self.objective == "steps":
            lower, upper, policy, chance = self.steps()
        else:
            lower, upper, policy, chance = self.goal_then_reward()
        status: Status = "solved"
        message = ""
        lower = np.nan_to_num(lower, nan=-np.inf, posinf=np.inf, neginf=-np.inf)
        upper = np.nan_to_num(upper, nan=np.inf, posinf=np.inf, neginf=-np.inf)
        low, high = float(lower[mdp.initial]), float(upper[mdp.initial])
        if self.objective == "steps" and lower[mdp.initial] == np.inf:
            status, message = "infeasible", "no policy reaches the goal with probability 1"
        elif lower[mdp.initial] == np.inf:
            status, message = "unbounded", "the sum of rewards has no upper bound"
        elif low != high and not high - low <= self.options.epsilon:
            status, message = "limit", "linear systems cannot be solved closely enough here"
        if self.stopped:
            status, message = "limit", f"stopped after {self.iterations} iterations"
            upper = np.full(mdp.states, np.inf)
            lower = np.full(mdp.states, -np.inf)
        return Solution(
            status=status,
            objective=self.objective,
            initial=mdp.initial,
            lower=lower,
            upper=upper,
            policy=policy,
            iterations=self.iterations,
            seconds=time.perf_counter() - self.begin,
            goal_probability=chance if mdp.has_goal else None,
            message=message,
        )

    def reward(self) -> tuple[Floats, Floats, SmallInts]:
        """The best reward, discounted or in total."""
        from menid_solvers.graph import end_components, sure_reach

        mdp = self.mdp
        if mdp.discount < 1.0:
            return self.improve(
                self.rows,
                mdp.row_reward,
                np.zeros(mdp.states),
                mdp.discount,
                self.lowest(self.rows),
            )
        component, free = end_components(self.graph, self.rows & (mdp.row_reward == 0.0))
        may_stop = (component >= 0) & ~self.ended
        growing, staying = self.growing()
        sure, _, _ = sure_reach(self.graph, self.rows, self.ended | may_stop | growing)
        rows = self.rows.copy()
        self.graph.without(rows, ~sure)
        endless = self.graph.reaching(rows, growing & sure)
        rows &= ~endless[self.state]
        policy = self.towards(rows, self.ended | may_stop)
        known = np.where(endless, np.inf, np.where(sure, 0.0, -np.inf))
        lower, upper, policy = self.improve(rows, mdp.row_reward, known, 1.0, policy, may_stop)
        if not self.stopped and bool(np.any(upper < staying)):
            raise UnsupportedError(
                "policy-iteration cannot stay where rewards of both signs cancel: their sum swings"
            )
        stays = may_stop & (policy < 0)
        policy[stays] = self.lowest(free)[stays]
        lost = (policy < 0) & ~self.ended
        policy[lost] = self.lowest(self.rows)[lost]
        return lower, upper, policy

    def growing(self) -> tuple[Bools, Floats]:
        """The states (bool[n]) of end components in which rewards add up for ever.

        Where stopping for 0 is allowed everywhere, such a component is what keeps a policy going.
        The second answer (float64[n]) is the most that a state may collect where rewards of both
        signs cancel, -inf where they do not.
        """
        from menid_solvers.graph import end_components

        mdp = self.mdp
        component, inside = end_components(self.graph, self.rows)
        found = np.zeros(mdp.states, np.bool_)
        while True:
            stop = np.full(mdp.states, -1, np.int32)
            value, _, policy = self.improve(
                inside, mdp.row_reward, np.zeros(mdp.states), 1.0, stop, component >= 0
            )
            new = np.isin(component, component[~self.ends(policy)])
            if not bool(new.any()):
                return found, self.cancelling(inside, value)
            found |= new
            inside = inside & ~new[self.state]

    def cancelling(self, inside: Bools, stopping: Floats) -> Floats:
        """What staying may collect (float64[n]) in end components whose rewards cancel, else -inf.

        With the best value of stopping for 0 anywhere as a potential no row gains, and those that can
        be repeated without loss keep it: they collect the difference of the potential, back and forth.
        """
        from menid_solvers.graph import end_components

        reward = self.mdp.row_reward
        most = np.full(self.mdp.states, -np.inf)
        lost = stopping[self.state] - reward - self.matrix @ stopping
        scale = max(1.0, float(np.max(np.abs(stopping), initial=0.0)))
        component, kept = end_components(self.graph, inside & (lost <= CANCEL * scale))
        of_row = component[self.state]
        for mixed in np.intersect1d(of_row[kept & (reward > 0.0)], of_row[kept & (reward < 0.0)]):
            members = component == mixed
            most[members] = stopping[members] - np.min(stopping[members])
        return most

    def goal(self) -> tuple[Floats, Floats, SmallInts]:
        """The highest probability of the goal."""
        goal = self.mdp.goal
        possible = self.graph.reaching(self.rows, goal)
        rows = self.rows & possible[self.state]
        lower, upper, policy = self.improve(
            rows, np.zeros(self.mdp.rows), goal.astype(np.float64), 1.0, self.towards(rows, goal)
        )
        policy[~possible] = self.lowest(self.rows)[~possible]
        return np.clip(lower, 0.0, 1.0), np.clip(upper, 0.0, 1.0), policy

    def steps(self) -> tuple[Floats, Floats, SmallInts, Floats]:
        """The least expected number of steps."""
        from menid_solvers.graph import sure_reach

        goal = self.mdp.goal
        sure, rows, _ = sure_reach(self.graph, self.rows, goal)
        rows &= sure[self.state]
        known = np.where(sure, 0.0, -np.inf)
        lower, upper, policy = self.improve(
            rows, np.full(self.mdp.rows, -1.0), known, 1.0, self.towards(rows, goal)
        )
        policy[~sure] = self.lowest(self.rows)[~sure]
        return -upper, -lower, policy, sure.astype(np.float64)

    def goal_then_reward(self) -> tuple[Floats, Floats, SmallInts, Floats]:
        """The highest probability of the goal, then the highest reward."""
        mdp = self.mdp
        if mdp.discount < 1.0:
            raise UnsupportedError(
                "policy-iteration cannot put the goal before a discounted reward"
            )
        lower, upper, first = self.goal()
        chance = (lower + upper) / 2
        self.stopped |= not bool(np.all(upper - lower <= 1e-8))
        possible = self.graph.reaching(self.rows, mdp.goal)
        best = self.rows & possible[self.state]
        best &= self.matrix @ chance >= chance[self.state] - 1e-9
        policy = self.towards(best, mdp.goal)
        lower, upper, policy = self.improve(best, mdp.row_reward, np.zeros(mdp.states), 1.0, policy)
        policy[~possible] = first[~possible]
        return lower, upper, policy, chance

    def lowest(self, rows: Bools) -> SmallInts:
        """The lowest of the rows in each state, -1 where there is none."""
        policy = np.full(self.mdp.states, -1, np.int32)
        found = np.flatnonzero(rows)[::-1]
        policy[self.state[found]] = found
        return policy

    def towards(self, rows: Bools, targets: Bools) -> SmallInts:
        """A policy by which every state may come to the targets that can."""
        near = targets.copy()
        policy = np.full(self.mdp.states, -1, np.int32)
        while True:
            leads = rows & (self.matrix @ near.astype(np.float64) > 0.0) & ~near[self.state]
            if not bool(leads.any()):
                return policy
            found = self.lowest(leads)
            policy = np.where(found >= 0, found, policy)
            near |= found >= 0

    def improve(
        self,
        rows: Bools,
        reward: Floats,
        known: Floats,
        discount: float,
        policy: SmallInts,
        may_stop: Bools | None = None,
    ) -> tuple[Floats, Floats, SmallInts]:
        """Improve a policy (-1: the known value, or stopping for 0) until no row is better."""
        value, error = known, np.zeros(len(known))
        kept = np.flatnonzero(rows)
        owner = self.state[kept]
        for _ in range(self.options.max_iterations):
            self.iterations += 1
            solved = self.evaluate(policy, reward, known, discount)
            if solved is None:
                return self.endless(rows, reward, known, discount, policy, may_stop)
            value, error = solved
            if self.progress is not None:
                self.progress(self.iterations, float(value[self.mdp.initial]), np.inf)
            finite = np.where(np.isfinite(value), value, 0.0)
            worth = reward[kept] + discount * (self.matrix[kept] @ finite)
            best = np.full(len(value), -np.inf)
            np.maximum.at(best, owner, worth)
            if may_stop is not None:
                best[may_stop] = np.maximum(best[may_stop], 0.0)
            margin = self.options.tie * max(1.0, float(np.max(np.abs(finite))))
            better = best > value + margin
            better &= np.isfinite(value)
            if not bool(better.any()):
                # What rows are better by is to be had at every step on the way.
                told = np.isfinite(value) & np.isfinite(best)
                gain = float(np.max(best[told] - value[told], initial=0.0))
                return value - error, value + error + gain * self.stay, policy
            top = np.flatnonzero((worth >= best[owner]) & better[owner])[::-1]
            policy = policy.copy()
            policy[better] = -1
            policy[owner[top]] = kept[top]
        self.stopped = True
        return value - error, value + error, policy

    def endless(
        self,
        rows: Bools,
        reward: Floats,
        known: Floats,
        discount: float,
        policy: SmallInts,
        may_stop: Bools | None,
    ) -> tuple[Floats, Floats, SmallInts]:
        """Go on where the improved policy collects rewards for ever: those states are worth inf."""
        if self.objective in ("goal-probability", "steps"):
            self.stopped = True  # no sums grow there: the numbers were not good enough
        reaches = self.graph.reaching(rows, ~self.ends(policy))
        lower, upper, rest = self.improve(
            rows & ~reaches[self.state], reward, np.where(reaches, np.inf, known), discount,
            np.where(reaches, -1, policy).astype(np.int32), may_stop,
        )  # fmt: skip
        return lower, upper, np.where(reaches, policy, rest).astype(np.int32)

    def ends(self, policy: SmallInts) -> Bools:
        """From which states (bool[n]) the policy can come to one where it has no row."""
        taken = np.zeros(self.mdp.rows, np.bool_)
        taken[policy[policy >= 0]] = True
        return self.graph.reaching(taken, policy < 0)

    def evaluate(
        self, policy: SmallInts, reward: Floats, known: Floats, discount: float
    ) -> tuple[Floats, Floats] | None:
        """The values of a policy, and their estimated errors; None if it may never end."""
        from scipy.sparse import identity

        moving: Ints = np.flatnonzero(policy >= 0)
        if len(moving) == 0:
            self.stay = np.zeros(len(known))
            return known.copy(), np.zeros(len(known))
        if discount == 1.0 and not bool(self.ends(policy).all()):
            return None
        chosen = self.matrix[policy[moving]]
        finite = np.where(np.isfinite(known) & (policy < 0), known, 0.0)
        constant = reward[policy[moving]] + discount * (chosen @ finite)
        inner = discount * chosen[:, moving]
        right = np.column_stack((constant, np.ones(len(moving))))
        system = (identity(len(moving), format="csr") - inner).tocsc()
        answer = _linear_solve(system, right, discount < 1.0)
        with np.errstate(all="ignore"):  # overflow ends in bounds that say so
            residual = np.max(np.abs(constant + inner @ answer[:, 0] - answer[:, 0]))
        value = known.copy()
        value[moving] = answer[:, 0]
        error = np.zeros(len(known))
        size = 1e-15 * (1.0 + float(np.max(np.abs(answer[:, 0]))))
        self.stay = np.zeros(len(known))
        self.stay[moving] = np.abs(answer[:, 1])
        error[moving] = (residual + size) * self.stay[moving]
        return value, error


def _linear_solve(system: csc_matrix, right: Floats, contracts: bool) -> Floats:
    """Solve for some right-hand sides (float64[m, k]) by what suits the size.

    Elimination may fill a large sparse matrix up; where the iteration contracts BiCGSTAB (van der
    Vorst 1992) is tried first, and its answer counts if the residual is down to rounding.
    """
    from scipy.sparse.linalg import bicgstab, spsolve

    if len(right) <= DENSE:
        return np.asarray(np.linalg.solve(system.toarray(), right))
    if contracts and len(right) > SPARSE:
        columns = []
        for column in right.T:
            answer, failed = bicgstab(system, column, rtol=1e-14, maxiter=500)
            size = max(1.0, float(np.max(np.abs(answer))))
            if failed or float(np.max(np.abs(system @ answer - column))) > 1e-12 * size:
                break
            columns.append(answer)
        else:
            return np.column_stack(columns)
    return np.asarray(spsolve(system, right))
