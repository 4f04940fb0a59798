"""What a solver is: options in, an MDP and an objective, a solution with bounds out.

Solvers live in packages of their own and are found by the entry points of the group
``menid_plan.solvers``; this package never imports one by its name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from typing import Any, ClassVar, Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from menid_plan.errors import MenidError
from menid_plan.errors import MissingDependencyError as MissingDependencyError
from menid_plan.grounding.state import GroundAction
from menid_plan.mdp.model import MDP, Floats, Ints, SmallInts
from menid_plan.model.domain import Domain, Problem

Objective: TypeAlias = Literal["reward", "goal-then-reward", "goal-probability", "steps"]
"""What is best.

``reward``: the highest expected sum of discounted rewards. ``goal-then-reward``: the highest
probability of the goal, then the highest expected reward among the policies that have it, where what
is paid once the goal is out of reach does not count. ``goal-probability``: that probability alone.
``steps``: the least expected number of steps to the goal among policies that reach it surely.
"""

Status: TypeAlias = Literal["solved", "limit", "unbounded", "infeasible"]
"""How a solution ended.

``solved``: the bounds are as close as asked. ``limit``: stopped early; the bounds are true all the
same. ``unbounded``: the sum of rewards has no upper bound. ``infeasible``: the objective asks for
what no policy can do (``steps`` without a sure way to the goal).
"""

GROUP = "menid_plan.solvers"

Progress: TypeAlias = Callable[[int, float, float], None]
"""Called now and then while solving: iterations so far, and bounds on the initial state's value."""


@dataclass(frozen=True, slots=True, eq=False)
class StepPolicy:
    """The policy of a finite horizon: which row to take with so many steps left.

    ``offsets`` (uint8, uint16 or uint32 [k, n], most steps left first) count from the first row of a
    state; the type's largest value is none. With fewer lines than steps, k < horizon, the first line
    holds for all higher numbers of steps left.
    """

    state_row: Ints
    offsets: NDArray[np.unsignedinteger[Any]]
    horizon: int

    def row(self, state: int, left: int) -> int:
        """The row to take in a state with ``left`` steps to go, from 1 on; -1 if there is none."""
        if left < 1:
            return -1
        offset = int(self.offsets[max(0, len(self.offsets) - left), state])
        none = int(np.iinfo(self.offsets.dtype).max)
        return -1 if offset == none else int(self.state_row[state]) + offset

    def rows(self, left: int) -> SmallInts:
        """The rows to take in every state (int32[n]) with ``left`` steps to go, from 1 on."""
        offsets = self.offsets[max(0, len(self.offsets) - left)].astype(np.int64)
        none = int(np.iinfo(self.offsets.dtype).max)
        rows = np.where(offsets == none, -1, self.state_row[:-1] + offsets)
        return rows.astype(np.int32)


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A policy and true bounds on the best value, for every state and for the initial one.

    Arrays are over states: ``lower`` and ``upper`` (float64[n]) enclose the best value of the
    objective; ``policy`` (int32[n]) is the chosen row, -1 where there is none. With a horizon they
    are for the first step, and ``steps`` has a policy for each number of steps left (None if it would
    be too large). ``goal_probability`` (float64[n]) is that of reaching the goal with the
    policy; None if there is no goal.
    """

    status: Status
    objective: Objective
    initial: int
    lower: Floats
    upper: Floats
    policy: SmallInts
    iterations: int
    seconds: float
    goal_probability: Floats | None = None
    steps: StepPolicy | None = None
    message: str = ""
    details: Mapping[str, float] = field(default_factory=dict)

    @property
    def value(self) -> float:
        """The value of the initial state: the middle of its bounds.

        Where nothing but rounding separates the bounds, the shortest decimal near the middle.
        """
        return self.value_of(self.initial)

    def value_of(self, state: int) -> float:
        """The value of a state by its number; see `value`."""
        low, high = float(self.lower[state]), float(self.upper[state])
        if low == high or not math.isfinite(high - low):
            return low if low == high else (low + high) / 2
        middle = low + (high - low) / 2  # the sum might overflow
        short = float(f"{middle:.12g}")
        return short if low <= short <= high else middle


class Solver(Protocol):
    """A frozen dataclass of options that solves MDPs.

    ``name`` is what the user calls it; ``promise`` says in a line what its answers are worth, and
    ``needs`` what must be installed (empty: nothing more).
    """

    name: ClassVar[str]
    promise: ClassVar[str]
    needs: ClassVar[str]

    def solve(
        self,
        mdp: MDP,
        objective: Objective,
        *,
        progress: Progress | None = None,
        start: Floats | None = None,
    ) -> Solution:
        """Solve an MDP for an objective.

        ``start`` (float64[n]) is a guess of the values, which changes nothing but the time.
        """


class OnlinePolicy(Protocol):
    """Something that can be asked for the next action, and may think each time."""

    def action(self, state: int, seconds: float | None = None) -> int:
        """The row to take in a state, -1 if there is none; ``seconds`` is a budget, None for any."""


class Posterior(Protocol):
    """What is believed about the outcome probabilities: float64, one for each slot."""

    def mean(self) -> Floats:
        """The expected probabilities."""

    def sample(self, rng: np.random.Generator) -> Floats:
        """Probabilities drawn from the belief."""


@dataclass(frozen=True, slots=True)
class Belief:
    """What an online solver acts on: a structure to put probabilities into, and what is believed.

    ``fill`` makes an MDP of probabilities (float64, one for each slot). The posterior may change
    between two questions; its owner then calls the policy's ``learned``, if it has one.
    """

    fill: Callable[[Floats], MDP]
    posterior: Posterior
    objective: Objective


class OnlineSolver(Protocol):
    """A frozen dataclass of options that makes policies which decide when they are asked."""

    name: ClassVar[str]
    promise: ClassVar[str]
    needs: ClassVar[str]

    def policy(self, belief: Belief, rng: np.random.Generator) -> OnlinePolicy:
        """A policy for what is believed; all that it draws comes from ``rng``."""


class AskedSolver(Protocol):
    """A frozen dataclass of options that chooses an action from the rules themselves.

    Its answers need not be the same each time: a learning run keeps them. With ``draw``, it is to be
    given a model drawn from what is believed, else the expected one.
    """

    name: ClassVar[str]
    promise: ClassVar[str]
    needs: ClassVar[str]

    @property
    def draw(self) -> bool:
        """Whether it is to plan for a drawn model."""

    def check(self) -> None:
        """Raise a MenidError if it cannot be asked."""

    def choose(
        self, domain: Domain, problem: Problem, params: Mapping[str, float]
    ) -> GroundAction | None:
        """The action to take in the initial state of a problem; None if there is none."""


class UnknownSolverError(MenidError):
    """No installed package offers a solver of that name."""

    exit_code = 2


class UnsupportedError(MenidError):
    """A solver does not handle an objective, or an MDP of that kind."""

    exit_code = 4


def solver_entry_points() -> dict[str, EntryPoint]:
    """The installed solvers by name; none is loaded."""
    return {point.name: point for point in entry_points(group=GROUP)}


def load_solver(name: str) -> type[Solver] | type[OnlineSolver] | type[AskedSolver]:
    """The class of a solver's options, by its name; UnknownSolverError lists those there are.

    It has a method ``solve`` (`Solver`), ``policy`` (`OnlineSolver`), or ``choose`` (`AskedSolver`), or
    several.
    """
    found = solver_entry_points()
    if name not in found:
        known = ", ".join(sorted(found)) or "none"
        raise UnknownSolverError(f"there is no solver `{name}`; installed: {known}")
    loaded: type[Solver] | type[OnlineSolver] | type[AskedSolver] = found[name].load()
    return loaded


def natural_objective(
    *, has_goal: bool, discount: float | None, horizon: int | None, has_dead_end_reward: bool
) -> Objective:
    """The objective of a problem unless the caller names one.

    Goal probability first for a problem with a goal and without discount, horizon and dead-end
    reward; the expected reward for every other.
    """
    if has_goal and (discount is None) and horizon is None and not has_dead_end_reward:
        return "goal-then-reward"
    return "reward"
