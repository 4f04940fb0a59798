"""The settings of a learning run: the table ``[learn]`` of a run file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from menid_plan.environments.settings import SettingError, check_range
from menid_plan.learning.exact_delta import LEAST_EPSILON

Allocation: TypeAlias = Literal["cheapest-first", "paper", "gain", "target-only"]
"""Where to act next.

``paper``: an action is tried for the time T in each test in which it is not known well, then executed
(Algorithm 1). ``cheapest-first``: of these tests, in the cheapest alone. ``gain``: tests and executions
are compared by what they bring in by the second. ``target-only``: likewise, without tests.
"""

StopRule: TypeAlias = Literal["delta", "gap", "best"]
"""When an action needs no more tests.

``delta``: the bound on the error of the test's distribution is down to the threshold (the paper's).
``gap``: or it is below the distance between test and target, for then more tests say nothing of the
target. ``best``: or the best action is the best in all but a share epsilon of the models that may be.
"""

Option: TypeAlias = bool | int | float | str | tuple[float, ...]
"""What an option of an estimator or a solver may be."""


@dataclass(frozen=True, slots=True)
class LearnSettings:
    """What a learning run does; T, m, delta and epsilon are those of the paper.

    ``test_time`` (T) is in seconds of the clock for each tested action, 0 never tests. ``delta`` is
    the threshold of the bound on the error in a test environment, ``epsilon`` the probability that it
    is exceeded, ``delta_method`` how it is found. ``allocate`` says where to act; with ``gain`` and
    ``target-only``, T, delta and the solver play no part. ``estimator`` merges the counts, with
    ``estimator_options`` such as m. ``solver`` chooses actions, with ``solver_options``; ``objective``
    says what is best (empty: as the problem has it). ``prior_weight``: how many executions the domain's
    own probabilities are worth. ``attribution``: how outcomes that lead to one state share a count.
    ``lanes``: how many tests run side by side on the virtual clock. An episode ends at a goal, a dead
    end, the horizon, or after ``episode_steps``. The run ends after ``steps`` executions in the target,
    ``episodes``, or ``hours`` of the clock (an hour if nothing is said).
    """

    seed: int = 0
    test_time: float = 20.0
    delta: float = 0.05
    epsilon: float = 0.05
    delta_method: Literal["exact", "monte-carlo", "bonferroni"] = "exact"
    stop: StopRule = "delta"
    allocate: Allocation = "cheapest-first"
    estimator: str = "decreasing-m"
    estimator_options: Mapping[str, Option] = field(default_factory=dict)
    prior_weight: float = 0.0
    attribution: Literal["em", "first"] = "em"
    solver: str = "thompson"
    solver_options: Mapping[str, Option] = field(default_factory=dict)
    objective: Literal["", "reward", "goal-then-reward", "goal-probability", "steps"] = ""
    clock: Literal["virtual", "real"] = "virtual"
    lanes: int = 1
    episode_steps: int = 1000
    steps: int | None = None
    episodes: int | None = None
    hours: float | None = None

    @property
    def tests(self) -> bool:
        """Whether there may be tests."""
        if self.allocate == "gain":
            return True
        return self.allocate != "target-only" and self.test_time > 0.0

    def __post_init__(self) -> None:
        for key in ("test_time", "delta", "prior_weight", "hours", "steps", "episodes", "seed"):
            check_range(self, key)
        check_range(self, "lanes", least=1, most=10_000)
        check_range(self, "episode_steps", least=1)
        if not 0.0 < self.epsilon < 1.0:
            raise SettingError(
                "epsilon", f"expected a number between 0 and 1, not {self.epsilon:g}"
            )
        if self.delta_method == "exact" and self.epsilon < LEAST_EPSILON:
            raise SettingError(
                "epsilon",
                f'expected at least {LEAST_EPSILON:g} with delta_method "exact", not '
                f"{self.epsilon:g}",
            )
        for key in ("test_time", "delta", "prior_weight", "hours"):
            value = getattr(self, key)
            if value is not None and not math.isfinite(value):
                raise SettingError(key, f"expected a finite number, not {value:g}")
        if self.steps is None and self.episodes is None and self.hours is None:
            object.__setattr__(self, "hours", 1.0)
