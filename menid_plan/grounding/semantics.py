"""What the language means: which rule covers, what an outcome changes, what a step pays.

This module and `formulas` are the definition. They are slow and plain on purpose: every faster
reading of a domain (compiled exploration, the exports) is tested against them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from itertools import islice
from typing import Literal

from menid_plan.errors import MeaningError
from menid_plan.grounding.formulas import UNBOUND, WORK_LIMIT, Formulas
from menid_plan.grounding.recent import Recent
from menid_plan.grounding.state import (
    SINK,
    Binding,
    GroundAction,
    NextState,
    State,
    World,
    extended,
    ground_atom,
)
from menid_plan.grounding.steps import Covering, Reward, RuleConflict, Transition
from menid_plan.model.domain import Domain, Problem, param_values
from menid_plan.model.expressions import EvaluationError, Expression, evaluate
from menid_plan.model.formulas import Formula, GroundAtom, TypedVariable
from menid_plan.model.probabilities import is_one
from menid_plan.model.rules import (
    Action,
    ConditionalEffect,
    Effect,
    Outcome,
    Reference,
    Rule,
    UniversalEffect,
)
from menid_plan.model.rules import Literal as EffectLiteral

Noise = Literal["stay", "sink"]


class Semantics:
    """The meaning of one problem: its states, what applies in them and where that leads.

    ``params`` sets params of the domain anew; ``noise`` says where the noise outcome leads: to the
    same state (``stay``) or to the absorbing SINK (``sink``). Evaluating a formula, the rules of an
    action, an outcome's effects or a derived predicate raises LimitError if it takes more than
    ``work_limit`` steps.
    """

    def __init__(
        self,
        domain: Domain,
        problem: Problem,
        params: Mapping[str, float] | None = None,
        noise: Noise = "stay",
        work_limit: int = WORK_LIMIT,
    ) -> None:
        self.domain = domain
        self.problem = problem
        self.noise = noise
        self.params = _checked_params(domain, problem, params or {})
        self.formulas = Formulas(domain, (*domain.constants, *problem.objects), work_limit)
        self._actions = {action.name: action for action in domain.actions}
        # A state is asked about by every transition that arrives in it and every one that leaves.
        self._worlds: Recent[State, World] = Recent()
        self._goals: Recent[State, bool] = Recent()
        self._dead_ends: Recent[State, bool] = Recent()
        self._rewards: Recent[State, float] = Recent()

    # States -------------------------------------------------------------------------------------

    @property
    def objects(self) -> tuple[str, ...]:
        """The domain's constants, then the problem's objects."""
        return self.formulas.objects

    @property
    def initial_state(self) -> State:
        """The state in which the problem begins."""
        return frozenset(self.problem.init)

    def complete(self, state: State) -> World:
        """A state and its derived atoms."""
        if state not in self._worlds:
            self._worlds[state] = self.formulas.complete(state)
        return self._worlds[state]

    def holds(
        self, formula: Formula, world: AbstractSet[GroundAtom], binding: Binding = UNBOUND
    ) -> bool:
        """Whether a formula is true in a world as `complete` gives it, its free variables bound."""
        with self.formulas.task("a formula"):
            return self.formulas.holds(formula, world, binding)

    def satisfying(
        self,
        variables: Sequence[TypedVariable],
        formula: Formula,
        world: AbstractSet[GroundAtom],
        binding: Binding = UNBOUND,
    ) -> list[tuple[str, ...]]:
        """The tuples of objects for the variables that make a formula true in a world."""
        with self.formulas.task("a formula"):
            return list(self.formulas.satisfying(variables, formula, world, binding))

    def bindings(self, variables: Sequence[TypedVariable]) -> Iterator[tuple[str, ...]]:
        """Every tuple of objects that the variables can name, in order of declaration."""
        return self.formulas.bindings(variables)

    def is_goal(self, state: NextState) -> bool:
        """Whether the problem has a goal and it holds in a state."""
        if state is SINK or self.problem.goal is None:
            return False
        if state not in self._goals:
            with self.formulas.task("the goal"):
                self._goals[state] = self.formulas.holds(self.problem.goal, self.complete(state))
        return self._goals[state]

    def is_dead_end(self, state: NextState) -> bool:
        """Whether a state is the sink, or no goal and such that no rule of any action covers it.

        A conflict of rules is no dead end; it is reported by who asks what applies there.
        """
        if state is SINK:
            return True
        if state not in self._dead_ends:
            with self.formulas.task("whether anything applies"):
                self._dead_ends[state] = not self.is_goal(state) and not any(
                    self._coverings(action, ground, state)
                    for action in self.domain.actions
                    for ground in self.instances(action)
                )
        return self._dead_ends[state]

    def is_final(self, state: NextState, step: int = 0) -> bool:
        """Whether an episode that reaches a state after so many steps has ended there."""
        horizon = self.problem.horizon
        if horizon is not None and step >= horizon:
            return True
        return self.is_goal(state) or self.is_dead_end(state)

    # Actions and rules --------------------------------------------------------------------------

    def instances(self, action: Action) -> Iterator[GroundAction]:
        """The ground instances of an action, in order of the objects."""
        for arguments in self.formulas.bindings(action.parameters):
            yield GroundAction(action.name, arguments)

    def action_of(self, ground: GroundAction) -> Action:
        """The action that a ground action is an instance of; MeaningError if there is none."""
        action = self._actions.get(ground.action)
        if action is None:
            raise MeaningError(f"there is no action `{ground.action}`")
        expected, given = len(action.parameters), len(ground.arguments)
        if expected != given:
            raise MeaningError(f"`{ground}`: `{action.name}` has {expected} arguments, not {given}")
        for variable, name in zip(action.parameters, ground.arguments, strict=True):
            if not self.formulas.is_of(name, variable.types):
                types = " | ".join(variable.types)
                raise MeaningError(f"`{ground}`: there is no object `{name}` of type {types}")
        return action

    def applicable(self, state: State) -> list[tuple[GroundAction, Covering]]:
        """The action instances that apply in a state, each with the rule that covers it.

        In order of the actions' declaration, then of the objects. Raises RuleConflict.
        """
        found = []
        for action in self.domain.actions:
            with self.formulas.task(f"the rules of action `{action.name}`"):
                for ground in self.instances(action):
                    covering = _at_most_one(self._coverings(action, ground, state), state)
                    if covering is not None:
                        found.append((ground, covering))
        return found

    def covering(self, state: State, ground: GroundAction) -> Covering | None:
        """The one rule that covers a state for an action instance; None: it does not apply.

        Raises RuleConflict if there are several.
        """
        return _at_most_one(self.coverings(state, ground), state)

    def coverings(self, state: State, ground: GroundAction) -> list[Covering]:
        """All rules that cover a state for an action instance; more than one is a conflict."""
        with self.formulas.task(f"the rules of action `{ground.action}`"):
            return self._coverings(self.action_of(ground), ground, state)

    def _coverings(self, action: Action, ground: GroundAction, state: State) -> list[Covering]:
        """The rules that cover, or else, if no other rule does, the ``otherwise`` rule."""
        world = self.complete(state)
        arguments = extended(UNBOUND, action.parameters, ground.arguments)
        found = []
        for rule in action.rules:
            binding = None if rule.otherwise else self._cover(rule, world, arguments)
            if binding is not None:
                found.append(Covering(ground, rule, binding))
        return found or [Covering(ground, r, arguments) for r in action.rules if r.otherwise]

    def _cover(self, rule: Rule, world: World, arguments: Binding) -> Binding | None:
        """The binding with which a rule covers a world: references resolved, condition true."""
        binding = arguments
        for reference in rule.references:
            objects = self.resolve(reference, world, binding)
            if objects is None:
                return None
            binding = extended(binding, reference.variables, objects)
        return binding if self.formulas.holds(rule.condition, world, binding) else None

    def resolve(
        self, reference: Reference, world: World, binding: Binding
    ) -> tuple[str, ...] | None:
        """The one tuple that satisfies a deictic reference; None if there is none or several."""
        candidates = self.formulas.satisfying(
            reference.variables, reference.formula, world, binding
        )
        first_two = list(islice(candidates, 2))
        return first_two[0] if len(first_two) == 1 else None

    # Outcomes -----------------------------------------------------------------------------------

    def change(
        self, covering: Covering, outcome: Outcome, state: State
    ) -> tuple[frozenset[GroundAtom], frozenset[GroundAtom]]:
        """What an outcome adds and deletes. Conditions look at the state before the step."""
        world = self.complete(state)
        add: set[GroundAtom] = set()
        delete: set[GroundAtom] = set()
        with self.formulas.task(f"the effects of outcome `{outcome.name}`"):
            for literal, binding in self._literals(outcome.effects, world, covering.binding):
                atom = ground_atom(literal.atom, binding)
                (add if literal.positive else delete).add(atom)
        return frozenset(add), frozenset(delete)

    def _literals(
        self, effects: Sequence[Effect], world: World, binding: Binding
    ) -> Iterator[tuple[EffectLiteral, Binding]]:
        """The literals of the effects that happen, with the bindings under which they do."""
        for effect in effects:
            match effect:
                case EffectLiteral():
                    yield effect, binding
                case ConditionalEffect(condition, literals):
                    if self.formulas.holds(condition, world, binding):
                        yield from ((literal, binding) for literal in literals)
                case UniversalEffect(variables, condition, literals):
                    for objects in self.formulas.satisfying(variables, condition, world, binding):
                        inner = extended(binding, variables, objects)
                        yield from ((literal, inner) for literal in literals)

    def successor(self, covering: Covering, outcome: Outcome, state: State) -> NextState:
        """The state that an outcome leads to. Of an atom both deleted and added, the add wins."""
        if outcome.is_noise:
            return SINK if self.noise == "sink" else state
        add, delete = self.change(covering, outcome, state)
        return (state - delete) | add

    def probabilities(self, covering: Covering, environment: str) -> tuple[float, ...]:
        """The written probability of each outcome in an environment, in order, noise last.

        The column is divided by its sum. Raises MeaningError if it is unknown, or no distribution.
        """
        where = f"rule `{covering.rule.name}` of action `{covering.action.action}`"
        if environment not in {e.name for e in self.domain.all_environments}:
            raise MeaningError(f"there is no environment `{environment}`")
        cells = covering.rule.probability_cells(environment, covering.values)
        if cells is None:
            per = f" for {', '.join(covering.values)}" if covering.values else ""
            raise MeaningError(f"{where} has no probabilities in environment `{environment}`{per}")
        column = [self._value(cell, where) for cell in cells]
        total = math.fsum(column)
        if min(column) < 0 or not is_one(total):
            raise MeaningError(
                f"{where}: the probabilities in environment `{environment}` are "
                f"{', '.join(map(str, column))}; they must be >= 0 and sum to 1"
            )
        return tuple(p / total for p in column)

    # Rewards ------------------------------------------------------------------------------------

    def state_reward(self, state: State) -> float:
        """What each step taken in a state is paid, once for every binding that satisfies it."""
        if state not in self._rewards:
            world = self.complete(state)
            total = 0.0
            with self.formulas.task("the rewards of the state"):
                for reward in self.domain.rewards:
                    for _ in self.formulas.satisfying(reward.variables, reward.condition, world):
                        total += self._value(reward.reward, "the reward of the state")
            self._rewards[state] = total
        return self._rewards[state]

    def step_reward(
        self, covering: Covering, outcome: Outcome, state: State, next_state: NextState
    ) -> Reward:
        """What a step is paid in which an outcome of the covering rule leads to a state."""
        action, problem = self.action_of(covering.action), self.problem
        goal = problem.goal_reward if self.is_goal(next_state) else None
        dead_end = problem.dead_end_reward
        if dead_end is not None and not self.is_dead_end(next_state):
            dead_end = None
        return Reward(
            state=self.state_reward(state),
            outcome=self._value(outcome.reward, f"the reward of outcome `{outcome.name}`"),
            cost=self._value(action.cost, f"the cost of action `{action.name}`"),
            goal=self._value(goal, "the goal's reward"),
            dead_end=self._value(dead_end, "the dead end's reward"),
        )

    def transitions(self, state: State, ground: GroundAction, environment: str) -> list[Transition]:
        """How executing an action instance in an environment may go: its outcomes, noise last.

        Outcomes that lead to one state stay apart; those of probability 0 are left out. An action
        that does not apply has none.
        """
        covering = self.covering(state, ground)
        if covering is None:
            return []
        found = []
        column = self.probabilities(covering, environment)
        for outcome, probability in zip(covering.rule.outcomes, column, strict=True):
            if probability > 0:
                next_state = self.successor(covering, outcome, state)
                reward = self.step_reward(covering, outcome, state, next_state)
                found.append(Transition(probability, outcome.name, next_state, reward.total))
        return found

    def _value(self, expression: Expression | None, where: str) -> float:
        if expression is None:
            return 0.0
        try:
            return evaluate(expression, self.params)
        except EvaluationError as error:
            raise MeaningError(f"{where}: {error}") from error


def _at_most_one(coverings: Sequence[Covering], state: State) -> Covering | None:
    if len(coverings) > 1:
        raise RuleConflict(coverings, state)
    return coverings[0] if coverings else None


def _checked_params(
    domain: Domain, problem: Problem, override: Mapping[str, float]
) -> dict[str, float]:
    try:
        return param_values(domain, problem, override)
    except EvaluationError as error:
        raise MeaningError(str(error)) from error
