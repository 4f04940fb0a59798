"""Which rule and which outcomes explain what an action did.

The rule is the one that covers the state. An outcome can have happened if its effects turn the state
before into the state after; where several can, they share the count. What no outcome describes is
noise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from menid_plan.errors import MeaningError
from menid_plan.experience.check import AtomChecker
from menid_plan.experience.record import DistributionKey, Explanation
from menid_plan.grounding.ground import GroundProblem
from menid_plan.grounding.recent import Recent
from menid_plan.grounding.semantics import Semantics
from menid_plan.grounding.state import SINK, GroundAction, State
from menid_plan.grounding.steps import Covering
from menid_plan.model.domain import Domain, Problem

Method: TypeAlias = Literal["em", "first"]

METHODS: tuple[Method, ...] = ("em", "first")

Chances: TypeAlias = Callable[[DistributionKey], Sequence[float] | None]
"""The current estimate of a distribution: a number >= 0 for each outcome, noise last; None: unknown.

The ``get`` of a dictionary is one.
"""


@dataclass(slots=True)
class _Step:
    """An action in a state: what covers it, and the outcomes that lead to each state after it."""

    key: DistributionKey
    covering: Covering
    leads_to: Mapping[State, tuple[int, ...]]
    noise: Explanation
    # States after that have one explanation whatever the estimates are.
    sure: dict[State, Explanation] = field(default_factory=dict)


class _Steps(Recent[tuple[State, GroundAction], "_Step | None"]):
    SIZE = 50_000


class Attributor:
    """Explains the steps of one problem.

    ``params`` sets params of the domain anew, which the rewards of steps depend on. ``method`` says how
    outcomes that lead to one state share the count: ``em``, in proportion to what is believed of them
    at the time (one step of expectation maximisation), or ``first``, all to the first in the table.
    What covers a state, and where its outcomes lead, is remembered.
    """

    def __init__(
        self,
        domain: Domain,
        problem: Problem,
        params: Mapping[str, float] | None = None,
        method: Method = "em",
    ) -> None:
        if method not in METHODS:
            raise ValueError(f"the method is `{method}`, and not one of: {', '.join(METHODS)}")
        self.method = method
        self.semantics = Semantics(domain, problem, params)
        self._atoms = AtomChecker(domain, problem)
        self._steps = _Steps()

    def distribution(self, state: State, action: GroundAction) -> DistributionKey | None:
        """The distribution that an action draws from in a state; None: no rule covers it.

        Raises MeaningError if there is no such action, object or atom, RuleConflict if two rules cover.
        """
        step = self._step(state, action)
        return None if step is None else step.key

    def covering(self, state: State, action: GroundAction) -> Covering | None:
        """The covering rule with its binding; see `distribution`."""
        step = self._step(state, action)
        return None if step is None else step.covering

    def explain(
        self, state: State, action: GroundAction, after: State, chances: Chances | None = None
    ) -> Explanation | None:
        """How the domain explains that an action led from one state to another; None: not at all.

        ``chances`` is asked only where several outcomes lead to the state after and the method is
        ``em``; without it, or where it gives None or 0 for all of them, they share alike. Raises as
        `distribution` does; ValueError if the chances are not one number >= 0 for each outcome.
        """
        step = self._step(state, action)
        if step is None:
            self._atoms.check(after)
            return None
        known = step.sure.get(after)
        if known is not None:
            return known
        able = step.leads_to.get(after)
        if able is None:
            self._atoms.check(after)
            return step.noise
        return self._shared(step, able, None if chances is None else chances(step.key))

    def reward(
        self, state: State, action: GroundAction, after: State, explanation: Explanation | None
    ) -> float:
        """What the problem pays for a step: by outcome, as they share it; 0 for an unexplained one."""
        step = self._step(state, action)
        if step is None or explanation is None:
            return 0.0
        self._atoms.check(after)
        covering = step.covering
        return math.fsum(
            weight * self.semantics.step_reward(covering, outcome, state, after).total
            for outcome, weight in zip(covering.rule.outcomes, explanation.weights, strict=True)
            if weight > 0.0
        )

    # --------------------------------------------------------------------------------------- inside

    def _step(self, state: State, action: GroundAction) -> _Step | None:
        key = (state, action)
        try:
            return self._steps[key]
        except KeyError:
            self._steps[key] = step = self._new_step(state, action)
            return step
        except TypeError:  # a set, say, cannot be a key
            raise MeaningError(
                f"{state!r} is no state: a frozenset of atoms is asked for"
            ) from None

    def _new_step(self, state: State, action: GroundAction) -> _Step | None:
        self._atoms.check(state)
        covering = self.semantics.covering(state, action)
        if covering is None:
            return None
        key = DistributionKey(action.action, covering.rule.name, covering.values)
        leads_to: dict[State, tuple[int, ...]] = {}
        for index, outcome in enumerate(covering.rule.outcomes):
            if not outcome.is_noise:
                after = self.semantics.successor(covering, outcome, state)
                assert after is not SINK
                leads_to[after] = (*leads_to.get(after, ()), index)
        # Noise is what no other outcome describes, so it has no part in a state that one leads to.
        step = _Step(key, covering, leads_to, _all_to(covering, len(covering.rule.outcomes) - 1))
        for after, able in leads_to.items():
            if len(able) == 1 or self.method == "first":
                step.sure[after] = _all_to(covering, able[0])
        return step

    def _shared(
        self, step: _Step, able: tuple[int, ...], chances: Sequence[float] | None
    ) -> Explanation:
        """The outcomes that can have happened, in proportion to their chances."""
        outcomes = step.covering.rule.outcomes
        shares = [1.0] * len(able)
        if chances is not None:
            if len(chances) != len(outcomes):
                raise ValueError(
                    f"`{step.key}` has {len(outcomes)} outcomes, and {len(chances)} chances are given"
                )
            given = [float(chances[index]) for index in able]
            if not all(math.isfinite(chance) and chance >= 0.0 for chance in given):
                raise ValueError(f"`{step.key}`: {given} are no chances: each must be >= 0")
            if max(given) > 0.0:
                shares = [chance / max(given) for chance in given]  # sums of these cannot overflow
        total = math.fsum(shares)
        weights = [0.0] * len(outcomes)
        for index, share in zip(able, shares, strict=True):
            weights[index] = share / total
        return Explanation(step.key.rule, step.key.values, tuple(weights))


def _all_to(covering: Covering, index: int) -> Explanation:
    weights = tuple(float(i == index) for i in range(len(covering.rule.outcomes)))
    return Explanation(covering.rule.name, covering.values, weights)


class Places:
    """Where the distributions of experiences stand in a ground problem."""

    def __init__(self, ground: GroundProblem) -> None:
        self._places = {
            DistributionKey(d.action, d.rule.name, d.values): (index, d.slots)
            for index, d in enumerate(ground.distributions)
        }

    def of(self, key: DistributionKey) -> tuple[int, range] | None:
        """The number of a distribution and its slots, one for each outcome, noise last.

        None if the ground problem lacks it: grounding leaves out what no reachable state can need,
        and an environment may go where the domain says that nothing leads.
        """
        return self._places.get(key)
