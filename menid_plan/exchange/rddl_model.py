"""What an RDDL text has to say of a flat problem, as formulas over more than its own predicates.

Their names have a space, which none in a MENID file has: ``act a`` for executing an action, ``doing a``
for an action whose outcome is being applied, ``drawn a o`` for the outcome that was drawn of those of
an action, ``is t`` for being of a type, and flags without arguments.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import product
from typing import Literal as Choice
from typing import TypeAlias

from menid_plan.exchange.classes import Classes
from menid_plan.exchange.flat import Flat, NotExpressibleError, distribution, value_of
from menid_plan.model.domain import Predicate, StateReward, objects_by_type
from menid_plan.model.formulas import (
    FALSE,
    TRUE,
    Atom,
    Equality,
    Exists,
    Formula,
    Term,
    TypedVariable,
    Variable,
    conjunction,
    disjunction,
    negation,
    subformulas,
)
from menid_plan.model.rules import Action, Literal, Outcome, UniversalEffect
from menid_plan.model.variables import free_variables, replaced

Dialect: TypeAlias = Choice["prost", "pyrddlgym"]

APPLYING = "applying the outcome"
APPLIED = "applied the outcome"
STOPPED = "stopped by the discount"
PLAYED = "played a step"


class Model:
    """A flat problem of a given horizon, as it is said in a dialect.

    ``two_phases`` is whether a step is two. ``discount`` is the instance's, and ``stop`` the chance
    that a step ends it all. ``dynamic`` are the predicates that effects change, ``static`` the others
    that are spoken of. ``over`` holds where no action may be executed any more, ``some`` if one is,
    and ``applies`` where one could be. Raises NotExpressibleError for a problem without actions.
    """

    def __init__(self, flat: Flat, dialect: Dialect, horizon: int, *, stopping: bool) -> None:
        self.flat, self.domain, self.problem = flat, flat.domain, flat.problem
        self.actions = self.domain.actions
        if not self.actions:
            raise NotExpressibleError("RDDL has no problems without actions", self.problem.span)
        self.two_phases = dialect == "prost"
        discount = 1.0 if self.problem.discount is None else self.problem.discount
        self.stop = round(1.0 - discount, 15) if stopping else 0.0
        self.discount = self._of_step = 1.0 if stopping else discount
        if self.two_phases:
            if self.discount == 0:
                raise NotExpressibleError(
                    "two phases have no discount of 0; it can be a chance to stop",
                    self.problem.span,
                )
            self.discount = math.sqrt(self.discount)
        self.classes = Classes(self.domain, self.problem.goal or TRUE)
        self.objects = (*self.domain.constants, *self.problem.objects)
        self.members = objects_by_type(self.domain, self.objects)
        self.chances = {action.name: self._rows(action) for action in self.actions}
        self._outcomes = {action.name: self._possible(action) for action in self.actions}
        self._changing: dict[tuple[str, bool], dict[str, Action]] = {}
        self.dynamic, self.static = self._predicates()
        goal = self.problem.goal or FALSE
        self.over = disjunction([goal, Atom(STOPPED) if self.stop else FALSE])
        self.some = disjunction(self.does(action, "act") for action in self.actions)
        self.applies = disjunction(self._applies(action) for action in self.actions)
        self._goal_reward = self._paid_at_goal()
        self._late = 1.0 / self.discount if self.two_phases else 1.0
        # What a step leads to is known one phase after its outcome was applied.
        at_the_end = self._goal_reward or value_of(self.problem.dead_end_reward)
        self.horizon = 2 * horizon + bool(at_the_end) if self.two_phases else horizon
        self.flags = list(self._flags(bool(at_the_end)))

    def _rows(self, action: Action) -> Mapping[tuple[str, ...], list[float]]:
        """The distributions of an action's outcomes, by the values of `per`."""
        (rule,) = action.rules
        types = {v.name: v.types for v in action.parameters}
        there = [
            dict.fromkeys(name for type_ in types[parameter] for name in self.members[type_])
            for parameter in rule.per
        ]
        return {
            values: distribution(action.name, rule, "target", values, {})
            for values in product(*there)
        }

    def _possible(self, action: Action) -> list[tuple[int, Outcome]]:
        rows = self.chances[action.name].values()
        outcomes = enumerate(action.rules[0].outcomes)
        return [(i, outcome) for i, outcome in outcomes if any(row[i] > 0 for row in rows)]

    def outcomes(self, action: Action) -> list[tuple[int, Outcome]]:
        """The outcomes that can occur, with their places among all."""
        return self._outcomes[action.name]

    def _predicates(self) -> tuple[list[Predicate], list[Predicate]]:
        formulas = [self.problem.goal or TRUE, *(r.condition for r in self.domain.rewards)]
        for action in self.actions:
            formulas.append(action.rules[0].condition)
            for _, outcome in self.outcomes(action):
                for literal in outcome.literals:
                    key = literal.atom.predicate, literal.positive
                    self._changing.setdefault(key, {})[action.name] = action
                formulas += [e.condition for e in outcome.effects if not isinstance(e, Literal)]
        told = {e.predicate for f in formulas for e in subformulas(f) if isinstance(e, Atom)}
        every = self.domain.predicates
        changing = {predicate for predicate, _ in self._changing}
        dynamic = [p for p in every if p.name in changing]
        return dynamic, [p for p in every if p.name in told - changing]

    def _flags(self, at_the_end: bool) -> Iterator[str]:
        """The propositions that tell how far it is."""
        if self.two_phases:
            yield APPLYING
            if at_the_end:
                yield APPLIED
        elif not self.dynamic:
            yield PLAYED  # there has to be a state fluent
        if self.stop:
            yield STOPPED

    # ------------------------------------------------------------------------------------- actions

    def spread(self, action: Action) -> tuple[TypedVariable, ...]:
        """An action's parameters, over all objects of their classes."""
        return tuple(TypedVariable(v.name, self.classes.whole(v.types)) for v in action.parameters)

    def instance(self, action: Action, kind: str) -> Atom:
        """``act`` or ``doing``, with the action's parameters."""
        return Atom(f"{kind} {action.name}", tuple(Variable(v.name) for v in action.parameters))

    def does(self, action: Action, kind: str) -> Formula:
        """That any instance of an action is executed, or applied."""
        return _some(self.spread(action), self.instance(action, kind))

    @property
    def applied(self) -> str:
        """The kind of atom that says whose outcome takes effect."""
        return "doing" if self.two_phases else "act"

    def _applies(self, action: Action) -> Formula:
        (rule,) = action.rules
        told = free_variables(rule.condition)
        # There is something for all others to stand for.
        return _some(tuple(v for v in action.parameters if v.name in told), rule.condition)

    # ------------------------------------------------------------------------------------- effects

    def after(self, predicate: Predicate) -> tuple[tuple[TypedVariable, ...], Formula]:
        """Variables for a predicate's arguments, and when it holds of them after the step."""
        # No variable of a MENID file is called like a number.
        own = tuple(TypedVariable(str(i), t) for i, t in enumerate(predicate.arguments, 1))
        terms = tuple(Variable(variable.name) for variable in own)
        added, deleted = (
            self._changed(predicate.name, terms, positive=positive) for positive in (True, False)
        )
        kept = conjunction([Atom(predicate.name, terms), negation(deleted)])
        return own, disjunction([added, kept])

    def _changed(self, predicate: str, own: tuple[Variable, ...], *, positive: bool) -> Formula:
        """Whether some effect makes an atom of these arguments true, or false."""
        found = []
        for action in self._changing.get((predicate, positive), {}).values():
            outcomes = self.outcomes(action)
            # Where, over which variables, to which arguments: in which outcomes.
            where: dict[tuple[Formula, tuple[TypedVariable, ...], tuple[Term, ...]], list[Atom]]
            where = {}
            for _, outcome in outcomes:
                for effect in outcome.effects:
                    literals = (effect,) if isinstance(effect, Literal) else effect.effects
                    condition = TRUE if isinstance(effect, Literal) else effect.condition
                    variables = effect.variables if isinstance(effect, UniversalEffect) else ()
                    for literal in literals:
                        if (literal.atom.predicate, literal.positive) == (predicate, positive):
                            key = (condition, variables, literal.atom.arguments)
                            where.setdefault(key, []).append(drawn(action, outcome))
            for (condition, variables, arguments), atoms in where.items():
                chosen = TRUE if len(set(atoms)) == len(outcomes) else disjunction(atoms)
                body = conjunction([chosen, condition])
                found.append(self._caused(action, body, variables, arguments, own))
        return disjunction(found)

    def _caused(
        self, action: Action, condition: Formula, variables: tuple[TypedVariable, ...],
        arguments: tuple[Term, ...], own: tuple[Variable, ...],
    ) -> Formula:  # fmt: skip
        """Whether an action causes an effect on ``own`` for some values of its variables."""
        terms: dict[str, Term] = {}
        same: list[Formula] = []
        for argument, mine in zip(arguments, own, strict=True):
            if isinstance(argument, Variable) and argument.name not in terms:
                terms[argument.name] = mine
            else:
                stands = terms[argument.name] if isinstance(argument, Variable) else argument
                same.append(Equality(mine, stands))
        guards = [self.guard(v.types, terms[v.name]) for v in variables if v.name in terms]
        done = replaced(self.instance(action, self.applied), terms)
        body = conjunction([done, *same, *guards, replaced(condition, terms)])
        rest = tuple(v for v in (*self.spread(action), *variables) if v.name not in terms)
        return _some(rest, body)

    def guard(self, types: tuple[str, ...], term: Term) -> Formula:
        """That an object of the class is of one of these types of it."""
        if self.classes.spans(types):
            return TRUE
        return disjunction(Atom(f"is {each}", (term,)) for each in types)

    # ------------------------------------------------------------------------------------- rewards

    def _paid_at_goal(self) -> float:
        """What the goal pays: 1 if nothing pays anything, so that its probability counts."""
        p = self.problem
        if p.goal is None:
            return 0.0
        paying = [p.goal_reward, p.dead_end_reward, *(r.reward for r in self.domain.rewards)]
        for action in self.actions:
            paying += [action.cost, *(o.reward for o in action.rules[0].outcomes)]
        return value_of(p.goal_reward) if any(map(value_of, paying)) else 1.0

    def payments(self) -> list[tuple[float, Formula]]:
        """What is paid for actions and outcomes, with the condition.

        In two phases all is paid in the second: after the last step there is one more first phase, in
        which the goal is paid for, and nothing else must be.
        """
        paid: dict[float, list[Formula]] = {}
        for action in self.actions:
            outcomes = self.outcomes(action)
            by_value: dict[float, list[Atom]] = {}
            for _, outcome in outcomes:
                value = value_of(outcome.reward) - value_of(action.cost)
                by_value.setdefault(value, []).append(drawn(action, outcome))
            for value, atoms in by_value.items():
                chosen = TRUE if len(atoms) == len(outcomes) else disjunction(atoms)
                where = conjunction([self.does(action, self.applied), chosen])
                paid.setdefault(self._late * value, []).append(where)
        return [(value, disjunction(formulas)) for value, formulas in paid.items() if value]

    def state_payments(self) -> tuple[Formula, list[tuple[float, StateReward]]]:
        """What is paid for states that steps are taken in, and where such a step is taken."""
        taken = Atom(APPLYING) if self.two_phases else self.some
        paid = [(self._late * value_of(each.reward), each) for each in self.domain.rewards]
        return taken, [(value, each) for value, each in paid if value]

    def ends(self) -> list[tuple[float, Formula]]:
        """What is paid for where a step led to, with the condition."""
        goal = self.problem.goal or FALSE
        stuck = conjunction([negation(goal), negation(self.applies)])
        late = 1.0 / self._of_step if self.two_phases else 1.0
        paid = [(self._goal_reward, goal), (value_of(self.problem.dead_end_reward), stuck)]
        return [(late * value, condition) for value, condition in paid if value]


def _some(variables: tuple[TypedVariable, ...], body: Formula) -> Formula:
    return Exists(variables, body) if variables else body


def drawn(action: Action, outcome: Outcome) -> Atom:
    """That this outcome was drawn, of all that the action has."""
    return Atom(f"drawn {action.name} {outcome.name}")
