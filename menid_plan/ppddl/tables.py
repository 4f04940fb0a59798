"""What the actions of a PPDDL domain may do: tables of outcomes with their chances.

Effects that are independent of each other are multiplied out. A condition around a chance is put
inside, since what is drawn changes nothing where it fails.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import product
from typing import NamedTuple, TypeAlias

from menid_plan.model.domain import Domain, objects_by_type
from menid_plan.model.formulas import (
    FALSE,
    TRUE,
    And,
    Atom,
    Constant,
    Equality,
    Formula,
    GroundAtom,
    Not,
    Or,
    Term,
    Truth,
    TypedVariable,
    Variable,
    conjunction,
    disjunction,
    negation,
)
from menid_plan.model.rules import ConditionalEffect, Effect, Literal, UniversalEffect
from menid_plan.model.variables import free_variables, put_in, renamed, replaced, told_apart
from menid_plan.ppddl import task
from menid_plan.ppddl.parts import ACHIEVED, STEPS
from menid_plan.source import Diagnostic, Span

# Rows of one table of outcomes.
MAX_ROWS = 2_000


class TooLargeError(Exception):
    """An action can't be written down; the diagnostic says why."""

    def __init__(self, message: str, span: Span) -> None:
        super().__init__(message)
        self.diagnostic = Diagnostic("error", "P302", message, span)


Key: TypeAlias = tuple[tuple[TypedVariable, ...], Formula]


@dataclass(frozen=True, slots=True)
class Paid:
    """What a row pays for every tuple for which a condition holds."""

    amount: Fraction
    variables: tuple[TypedVariable, ...]
    condition: Formula

    @property
    def key(self) -> Key:
        """For what it is paid."""
        return self.variables, self.condition


class Row(NamedTuple):
    """One row of a table: its chance, what it changes and what it pays."""

    chance: Fraction
    changes: tuple[Effect, ...]
    pays: tuple[Paid, ...]


class Variant(NamedTuple):
    """The rows of an action where a condition on its parameters holds."""

    condition: Formula
    rows: list[Row]


# The key of what is paid whatever holds.
ALWAYS: Key = ((), TRUE)


class Tables:
    """Makes the tables of the actions of one problem."""

    def __init__(self, domain: task.PddlDomain, problem: task.PddlProblem) -> None:
        self.problem = problem
        objects = (*domain.constants, *problem.objects)
        self._members = objects_by_type(Domain(domain.name, domain.types), objects)
        self._init = frozenset(problem.init)
        self._changing = {name for action in domain.actions for name in _changed(action.effect)}

    def variants(self, action: task.Action) -> list[Variant]:
        """The rows of an action: of all of it, or for each object that it depends on how many."""
        parameters = [v.name for v in action.parameters]
        effect = _apart(action.effect, parameters)
        try:
            return [Variant(TRUE, self._table(effect, action.span))]
        except TooLargeError:
            # Where a chance is drawn for every tuple of objects with some relation to the action's own
            # that never changes, there are few of them for each of these.
            related = _related(effect)
            some = [v for v in action.parameters if v.name in related]
            if not some:
                raise
        found = []
        for names in self.tuples(some, action.span):
            terms = {v.name: Constant(name) for v, name in zip(some, names, strict=True)}
            same = conjunction(Equality(Variable(name), term) for name, term in terms.items())
            found.append(Variant(same, self._table(_with_terms(effect, terms), action.span)))
        return found

    def _table(self, effect: task.Effect, span: Span) -> list[Row]:
        """The rows of a table: their chances sum to 1."""
        rows = self._rows(effect, (), TRUE, span)
        together: dict[tuple[tuple[Effect, ...], tuple[Paid, ...]], Fraction] = {}
        for chance, changes, pays in rows:
            if chance:
                key = (joined(changes), _summed(pays))
                together[key] = together.get(key, Fraction(0)) + chance
        if self.problem.metric in (STEPS, ACHIEVED):
            steps = Fraction(self.problem.sign * (self.problem.metric == STEPS))
            paid = (Paid(steps, (), TRUE),) if steps else ()
            merged: dict[tuple[Effect, ...], Fraction] = {}
            for (changes, _), chance in together.items():
                merged[changes] = merged.get(changes, Fraction(0)) + chance
            return [Row(chance, changes, paid) for changes, chance in merged.items()]
        return [Row(chance, changes, pays) for (changes, pays), chance in together.items()]

    def _rows(
        self,
        effect: task.Effect,
        variables: tuple[TypedVariable, ...],
        condition: Formula,
        span: Span,
    ) -> list[Row]:
        """What an effect may do, for every tuple of objects, where a condition holds."""
        nothing = Row(Fraction(1), (), ())
        match effect:
            case Literal():
                return [nothing._replace(changes=(_change(variables, condition, effect),))]
            case task.Pay(fluent, amount):
                if fluent != self.problem.metric or not amount:
                    return [nothing]
                paid = Paid(amount * self.problem.sign, variables, condition)
                return [nothing._replace(pays=(paid,))]
            case task.When(where, inner):
                both = conjunction([condition, self._decided(where)])
                return [nothing] if both == FALSE else self._rows(inner, variables, both, span)
            case task.Every(own, inner) if not _has_chance(inner):
                return self._rows(inner, (*variables, *own), condition, span)
            case task.Every(own, inner):
                every = [
                    _with_terms(
                        inner, dict(zip((v.name for v in own), map(Constant, names), strict=True))
                    )
                    for names in self.tuples(own, span)
                ]
                return self._rows(task.Together(tuple(every)), variables, condition, span)
            case task.Together(effects):
                return self._together(effects, variables, condition, span)
            case task.Chance(choices):
                found = [
                    row._replace(chance=row.chance * chance)
                    for chance, each in choices
                    for row in self._rows(each, variables, condition, span)
                ]
                rest = 1 - sum((chance for chance, _ in choices), Fraction(0))
                return [*found, nothing._replace(chance=rest)] if rest else found
        raise AssertionError(effect)

    def _together(
        self, effects: Iterable[task.Effect], variables: tuple[TypedVariable, ...],
        condition: Formula, span: Span,
    ) -> list[Row]:  # fmt: skip
        """What all of some effects may do: independent of each other, unless only one may happen."""
        groups: list[tuple[list[Formula], list[Row]]] = []
        for each in effects:
            rows = self._rows(each, variables, condition, span)
            where = each.condition if isinstance(each, task.When) else TRUE
            for number, (conditions, others) in enumerate(groups):
                if all(exclude(where, one) for one in conditions):
                    groups[number] = ([*conditions, where], _in_step(others, rows))
                    break
            else:
                groups.append(([where], rows))
        found = [Row(Fraction(1), (), ())]
        for _, rows in groups:
            if len(found) * len(rows) > MAX_ROWS:
                raise TooLargeError(
                    f"effects that are independent of each other make more than {MAX_ROWS} outcomes",
                    span,
                )
            found = [_both(a, b, a.chance * b.chance) for a, b in product(found, rows)]
        return found

    def tuples(self, variables: Sequence[TypedVariable], span: Span) -> list[tuple[str, ...]]:
        """The objects that variables may stand for; TooLargeError if there are too many."""
        ranges = [
            list(dict.fromkeys(name for type_ in v.types for name in self._members[type_]))
            for v in variables
        ]
        if math.prod(map(len, ranges)) > MAX_ROWS:
            raise TooLargeError(f"a chance for more than {MAX_ROWS} tuples of objects", span)
        return list(product(*ranges))

    def _decided(self, formula: Formula) -> Formula:
        """A formula without what never changes, as far as that is about named objects."""
        match formula:
            case Atom(predicate, arguments) if predicate not in self._changing:
                names = tuple(t.name for t in arguments if isinstance(t, Constant))
                if len(names) == len(arguments):
                    return Truth(GroundAtom(predicate, names) in self._init)
            case Equality(Constant(left), Constant(right)):
                return Truth(left == right)
            case Not(operand):
                return negation(self._decided(operand))
            case And(formulas):
                return conjunction(map(self._decided, formulas))
            case Or(formulas):
                return disjunction(map(self._decided, formulas))
        return formula


def _both(first: Row, second: Row, chance: Fraction) -> Row:
    """What happens if both do."""
    return Row(chance, (*first.changes, *second.changes), (*first.pays, *second.pays))


def _in_step(first: Sequence[Row], second: Sequence[Row]) -> list[Row]:
    """The rows of two effects of which only one can happen: one draw may decide for either."""
    found = []
    i = j = 0
    left, right = first[0].chance, second[0].chance
    while True:
        chance = min(left, right)
        if chance:
            found.append(_both(first[i], second[j], chance))
        left, right = left - chance, right - chance
        if not left:
            i += 1
            if i == len(first):
                return found
            left = first[i].chance
        if not right and j + 1 < len(second):
            j += 1
            right = second[j].chance


def exclude(first: Formula, second: Formula) -> bool:
    """Whether it is plain to see that two conditions never hold together."""
    ours = first.formulas if isinstance(first, And) else (first,)
    theirs = second.formulas if isinstance(second, And) else (second,)
    if any(negation(part) in theirs for part in ours):
        return True
    named = {(e.left, e.right) for e in ours if isinstance(e, Equality)}
    return any(
        isinstance(e, Equality)
        and isinstance(e.right, Constant)
        and any(v == e.left and isinstance(c, Constant) and c != e.right for v, c in named)
        for e in theirs
    )


def _has_chance(effect: task.Effect) -> bool:
    match effect:
        case task.Chance():
            return True
        case task.Together(effects):
            return any(map(_has_chance, effects))
        case task.When(_, inner) | task.Every(_, inner):
            return _has_chance(inner)
    return False


def _changed(effect: task.Effect) -> Iterator[str]:
    """The predicates that an effect may change."""
    match effect:
        case Literal(atom, _):
            yield atom.predicate
        case task.Together(effects):
            for each in effects:
                yield from _changed(each)
        case task.When(_, inner) | task.Every(_, inner):
            yield from _changed(inner)
        case task.Chance(choices):
            for _, each in choices:
                yield from _changed(each)


def _related(effect: task.Effect) -> set[str]:
    """The free variables of what an effect that is drawn for every tuple of objects depends on."""
    match effect:
        case task.Together(effects):
            return {name for each in effects for name in _related(each)}
        case task.Chance(choices):
            return {name for _, each in choices for name in _related(each)}
        case task.When(_, inner):
            return _related(inner)
        case task.Every(variables, inner) if _has_chance(inner):
            return _conditions_of(inner) - {v.name for v in variables}
    return set()


def _conditions_of(effect: task.Effect) -> set[str]:
    match effect:
        case task.Together(effects):
            return {name for each in effects for name in _conditions_of(each)}
        case task.Chance(choices):
            return {name for _, each in choices for name in _conditions_of(each)}
        case task.When(condition, inner):
            return free_variables(condition) | _conditions_of(inner)
        case task.Every(variables, inner):
            return _conditions_of(inner) - {v.name for v in variables}
    return set()


def _apart(effect: task.Effect, taken: Sequence[str]) -> task.Effect:
    """An effect whose variables are called like none around them."""
    match effect:
        case task.Together(effects):
            return task.Together(tuple(_apart(each, taken) for each in effects))
        case task.When(condition, inner):
            return task.When(told_apart(condition, taken), _apart(inner, taken))
        case task.Chance(choices):
            return task.Chance(tuple((p, _apart(each, taken)) for p, each in choices))
        case task.Every(variables, inner):
            own, terms = renamed(variables, taken)
            names = [*taken, *(v.name for v in own)]
            return task.Every(own, _apart(_with_terms(inner, terms), names))
    return effect


def _with_terms(effect: task.Effect, terms: Mapping[str, Term]) -> task.Effect:
    """An effect with terms in the place of its free variables."""
    match effect:
        case Literal(atom, positive):
            arguments = tuple(put_in(term, terms) for term in atom.arguments)
            return Literal(Atom(atom.predicate, arguments), positive)
        case task.Pay():
            return effect
        case task.Together(effects):
            return task.Together(tuple(_with_terms(each, terms) for each in effects))
        case task.When(condition, inner):
            return task.When(replaced(condition, terms), _with_terms(inner, terms))
        case task.Chance(choices):
            return task.Chance(tuple((p, _with_terms(each, terms)) for p, each in choices))
        case task.Every(variables, inner):
            own = {v.name for v in variables}
            rest = {name: term for name, term in terms.items() if name not in own}
            return task.Every(variables, _with_terms(inner, rest))


def _change(variables: tuple[TypedVariable, ...], condition: Formula, literal: Literal) -> Effect:
    if variables:
        return UniversalEffect(variables, condition, (literal,))
    return literal if condition == TRUE else ConditionalEffect(condition, (literal,))


def joined(changes: Iterable[Effect]) -> tuple[Effect, ...]:
    """Changes without repeats, those under one condition together."""
    found: dict[object, Effect] = {}
    for change in changes:
        match change:
            case ConditionalEffect(condition, literals):
                key: object = condition
            case UniversalEffect(variables, condition, literals):
                key = (variables, condition)
            case _:
                found.setdefault(change, change)
                continue
        before = found.get(key)
        if isinstance(before, ConditionalEffect | UniversalEffect):
            literals = tuple(dict.fromkeys((*before.effects, *literals)))
            change = replace(change, effects=literals)
        found[key] = change
    return tuple(found.values())


def _summed(pays: Iterable[Paid]) -> tuple[Paid, ...]:
    """What is paid, once for each condition."""
    amounts: dict[Key, Fraction] = {}
    for paid in pays:
        amounts[paid.key] = amounts.get(paid.key, Fraction(0)) + paid.amount
    return tuple(Paid(amount, *key) for key, amount in amounts.items() if amount)
