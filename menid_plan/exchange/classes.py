"""For languages without subtypes, object constants, or types without objects: flat problems anew.

What variables range over becomes classes of objects of which each object has one; quantifiers over
nothing are done away with; ground facts become propositions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

from scipy.cluster.hierarchy import DisjointSet

from menid_plan.exchange.flat import Flat, unused
from menid_plan.model.domain import OBJECT, Domain, Predicate, objects_by_type
from menid_plan.model.formulas import (
    TRUE,
    And,
    Atom,
    Exists,
    ForAll,
    Formula,
    GroundAtom,
    Implies,
    Not,
    Or,
    Truth,
    TypedVariable,
    conjunction,
    disjunction,
    negation,
    subformulas,
)
from menid_plan.model.rules import ConditionalEffect, Effect, Literal, Rule, UniversalEffect


class Classes:
    """The classes of a flat domain: types that some variable spans, or that lie in another, are one.

    ``of`` has the class of each type, by the name of its most general types.
    """

    def __init__(self, domain: Domain, goal: Formula = TRUE) -> None:
        self.domain = domain
        parents = {type_.name: type_.parent for type_ in domain.types}
        self._below: dict[str, set[str]] = {name: {name} for name in (OBJECT, *parents)}
        for name in parents:
            for above in domain.supertypes(name):
                self._below[above].add(name)
        sets = DisjointSet(self._below)
        for types in (*ranges(domain), *_ranges(goal)):
            for each in types:
                for below in self._below[each]:
                    sets.merge(types[0], below)
        self.of: dict[str, str] = {}
        self._types: dict[str, set[str]] = {}
        for members in sets.subsets():
            top = [name for name in self._below if name in members]
            top = [name for name in top if parents.get(name) not in members]
            name = "_or_".join(top)
            self._types[name] = members
            self.of.update(dict.fromkeys(members, name))

    def spans(self, types: Sequence[str]) -> bool:
        """Whether every object of a class is of one of these types of it."""
        there = set().union(*(self._below[each] for each in types))
        return there >= self._types[self.of[types[0]]]

    def whole(self, types: Sequence[str]) -> tuple[str, ...]:
        """Types of the same class, of which all its objects are."""
        return tuple(sorted(self._types[self.of[types[0]]]))


def ranges(domain: Domain) -> Iterator[tuple[str, ...]]:
    """The types of everything in a flat domain that stands for objects."""
    for predicate in domain.predicates:
        yield from predicate.arguments
    for reward in domain.rewards:
        yield from (variable.types for variable in reward.variables)
        yield from _ranges(reward.condition)
    for action in domain.actions:
        yield from (variable.types for variable in action.parameters)
        (rule,) = action.rules
        yield from _ranges(rule.condition)
        for outcome in rule.outcomes:
            for effect in outcome.effects:
                if isinstance(effect, UniversalEffect):
                    yield from (variable.types for variable in effect.variables)
                if not isinstance(effect, Literal):
                    yield from _ranges(effect.condition)


def _ranges(formula: Formula) -> Iterator[tuple[str, ...]]:
    for each in subformulas(formula):
        if isinstance(each, Exists | ForAll):
            yield from (variable.types for variable in each.variables)


# -------------------------------------------------------------------------------- flat problems anew


def inhabited(flat: Flat) -> Flat:
    """A flat problem in which everything that stands for objects has some to stand for."""
    d, p = flat.domain, flat.problem
    members = objects_by_type(d, (*d.constants, *p.objects))

    def empty(types: Sequence[str]) -> bool:
        return not any(members[each] for each in types)

    def any_empty(variables: Iterable[TypedVariable]) -> bool:
        return any(empty(variable.types) for variable in variables)

    def formula(each: Formula) -> Formula:
        if isinstance(each, Exists | ForAll) and any_empty(each.variables):
            return Truth(isinstance(each, ForAll))
        return each

    there = replace(
        d,
        predicates=tuple(q for q in d.predicates if not any(map(empty, q.arguments))),
        rewards=tuple(each for each in d.rewards if not any_empty(each.variables)),
        actions=tuple(
            replace(action, rules=(replace(rule, outcomes=tuple(
                replace(outcome, effects=tuple(
                    effect for effect in outcome.effects
                    if not isinstance(effect, UniversalEffect) or not any_empty(effect.variables)
                ))
                for outcome in rule.outcomes
            )),))
            for action in d.actions if not any_empty(action.parameters)
            for rule in action.rules
        ),
    )  # fmt: skip
    return rewritten(replace(flat, domain=there), formula)


def propositional(flat: Flat) -> Flat:
    """A flat problem without objects: each fact of a grounded one is a proposition of its own.

    ``facts`` of what is returned has for each proposition what it stands for.
    """
    names: dict[Atom, str] = {}

    def proposition(each: Formula) -> Formula:
        if not isinstance(each, Atom):
            return each
        if each not in names:
            parts = (each.predicate, *(term.name for term in each.arguments))
            names[each] = unused("-".join(parts), taken)
            taken.add(names[each])
        return Atom(names[each])

    taken: set[str] = set()
    made = rewritten(flat, proposition)
    facts = {
        name: GroundAtom(atom.predicate, tuple(term.name for term in atom.arguments))
        for atom, name in names.items()
    }
    domain = replace(
        made.domain, types=(), constants=(), predicates=tuple(Predicate(name) for name in facts)
    )
    there = set(flat.problem.init)
    init = tuple(GroundAtom(name) for name, fact in facts.items() if fact in there)
    sunk = next((name for name, fact in facts.items() if fact == GroundAtom(flat.sunk)), "")
    return replace(
        made, domain=domain, problem=replace(made.problem, init=init), sunk=sunk, facts=facts
    )


def rewritten(flat: Flat, part: Callable[[Formula], Formula]) -> Flat:
    """A flat problem with something else in the place of parts of its formulas, from inside out."""
    d, p = flat.domain, flat.problem

    def formula(each: Formula) -> Formula:
        match each:
            case And(formulas):
                each = conjunction(map(formula, formulas))
            case Or(formulas):
                each = disjunction(map(formula, formulas))
            case Implies(left, right):
                premise, conclusion = formula(left), formula(right)
                each = Implies(premise, conclusion)
                if isinstance(premise, Truth) or isinstance(conclusion, Truth):
                    each = disjunction([negation(premise), conclusion])
            case Not(inner):
                each = negation(formula(inner))
            case Exists(variables, inner) | ForAll(variables, inner):
                body = formula(inner)
                # There is an object for each variable, or `part` sees to it.
                new = part(type(each)(variables, body))
                return body if isinstance(body, Truth) and not isinstance(new, Truth) else new
        return part(each)

    def literal(each: Literal) -> Literal:
        atom = part(each.atom)
        assert isinstance(atom, Atom)
        return replace(each, atom=atom)

    def effect(each: Effect) -> Effect:
        if isinstance(each, Literal):
            return literal(each)
        literals = tuple(map(literal, each.effects))
        if isinstance(each, ConditionalEffect):
            return ConditionalEffect(formula(each.condition), literals)
        return UniversalEffect(each.variables, formula(each.condition), literals)

    def of_rule(rule: Rule) -> Rule:
        outcomes = tuple(
            replace(outcome, effects=tuple(map(effect, outcome.effects)))
            for outcome in rule.outcomes
        )
        return replace(rule, condition=formula(rule.condition), outcomes=outcomes)

    domain = replace(
        d,
        rewards=tuple(replace(each, condition=formula(each.condition)) for each in d.rewards),
        actions=tuple(replace(a, rules=tuple(map(of_rule, a.rules))) for a in d.actions),
    )
    goal = None if p.goal is None else formula(p.goal)
    return replace(flat, domain=domain, problem=replace(p, goal=goal))
