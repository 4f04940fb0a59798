"""From PPDDL to MENID: one rule for each action, or one for each case that its rewards tell apart.

The effects that happen by chance become one table of outcomes: independent ones are multiplied out.
A condition around a chance is put inside, since what is drawn changes nothing where it fails.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain, count, product
from typing import NamedTuple, TypeAlias

from menid_plan.language.grammar import lexer
from menid_plan.model.domain import (
    OBJECT,
    Domain,
    Object,
    Predicate,
    Problem,
    StateReward,
    Type,
    objects_by_type,
)
from menid_plan.model.expressions import Arithmetic, Expression, Minus, Number
from menid_plan.model.formulas import (
    FALSE,
    TRUE,
    And,
    Atom,
    Constant,
    Count,
    Equality,
    Exists,
    ForAll,
    Formula,
    GroundAtom,
    Implies,
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
from menid_plan.model.rules import (
    NOISE,
    Action,
    ConditionalEffect,
    Effect,
    Literal,
    Outcome,
    Rule,
    UniversalEffect,
)
from menid_plan.model.variables import free_variables, put_in, renamed, replaced, told_apart
from menid_plan.ppddl import task
from menid_plan.ppddl.read import ACHIEVED, STEPS
from menid_plan.source import Diagnostic, Span

# Rows of one table of outcomes, and rules of one action.
MAX_ROWS = 2_000
MAX_CASES = 256


class TooLargeError(Exception):
    """An action can't be written down; the diagnostic says why."""

    def __init__(self, message: str, span: Span) -> None:
        super().__init__(message)
        self.diagnostic = Diagnostic("error", "P302", message, span)


_Key: TypeAlias = tuple[tuple[TypedVariable, ...], Formula]


@dataclass(frozen=True, slots=True)
class _Paid:
    """What a row pays for every tuple for which a condition holds."""

    amount: Fraction
    variables: tuple[TypedVariable, ...]
    condition: Formula

    @property
    def key(self) -> _Key:
        """For what it is paid."""
        return self.variables, self.condition


class _Row(NamedTuple):
    chance: Fraction
    changes: tuple[Effect, ...]
    pays: tuple[_Paid, ...]


class _Variant(NamedTuple):
    """The rows of an action where a condition on its parameters holds."""

    condition: Formula
    rows: list[_Row]


# The key of what is paid whatever holds.
_ALWAYS: _Key = ((), TRUE)


def menid(domain: task.PddlDomain, problem: task.PddlProblem) -> tuple[Domain, Problem]:
    """The domain and problem in MENID; TooLargeError for an action with too many outcomes."""
    return _Import(domain, problem).documents()


class _Import:
    def __init__(self, domain: task.PddlDomain, problem: task.PddlProblem) -> None:
        self.domain, self.problem = domain, problem
        objects = (*domain.constants, *problem.objects)
        words = lexer().reserved_words
        self.members = objects_by_type(Domain(domain.name, domain.types), objects)
        self._types = {OBJECT: OBJECT, **_named((t.name for t in domain.types), words)}
        self._predicates = _named((p.name for p in domain.predicates), words)
        self._objects = _named((o.name for o in objects), words)
        # A variable may not be called like an object.
        self._variables = _Variables({*words, *self._objects.values()})
        self._actions = _named((a.name for a in domain.actions), words)
        self._named_objects: set[str] = set()
        self._init = frozenset(problem.init)
        self._changing = {name for action in domain.actions for name in _changed(action.effect)}

    def documents(self) -> tuple[Domain, Problem]:
        """The domain and the problem."""
        d, p = self.domain, self.problem
        goal = None if p.goal is None else self.formula(told_apart(p.goal, ()))
        self._named_objects.clear()  # the goal is the problem's, and may speak of its objects
        variants = [self._variants(action) for action in d.actions]
        rewards = self._of_states(row for own in variants for each in own for row in each.rows)
        actions = tuple(
            self._action(action, own, rewards)
            for action, own in zip(d.actions, variants, strict=True)
        )
        state_rewards = tuple(
            StateReward(
                _expression(paid.amount),
                self.formula(paid.condition),
                self._declared(paid.variables),
            )
            for paid in rewards
        )
        constants = {o.name for o in d.constants} | self._named_objects
        everything = (*d.constants, *p.objects)
        made = Domain(
            _named([d.name], lexer().reserved_words)[d.name],
            tuple(Type(self._types[t.name], self._types[t.parent]) for t in d.types),
            tuple(self._object(o) for o in everything if o.name in constants),
            (), (),
            tuple(
                Predicate(
                    self._predicates[q.name],
                    tuple(tuple(self._types[t] for t in types) for types in q.arguments),
                )
                for q in d.predicates
            ),
            (), state_rewards, actions,
        )  # fmt: skip
        reward = p.goal_reward * p.sign if p.metric not in (STEPS, ACHIEVED) else 0
        return made, Problem(
            _named([p.name], lexer().reserved_words)[p.name], made.name, (),
            tuple(self._object(o) for o in everything if o.name not in constants),
            tuple(
                GroundAtom(
                    self._predicates[a.predicate], tuple(self._objects[n] for n in a.arguments)
                )
                for a in p.init
            ),
            goal,
            _expression(Fraction(reward)) if reward else None,
        )  # fmt: skip

    def _object(self, thing: Object) -> Object:
        return Object(self._objects[thing.name], self._types[thing.type])

    # ---------------------------------------------------------------------------------------- rows

    def _variants(self, action: task.Action) -> list[_Variant]:
        """The rows of an action: of all of it, or for each object that it depends on how many."""
        parameters = [v.name for v in action.parameters]
        effect = _apart(action.effect, parameters)
        try:
            return [_Variant(TRUE, self._table(effect, action.span))]
        except TooLargeError:
            # Where a chance is drawn for every tuple of objects with some relation to the action's own
            # that never changes, there are few of them for each of these.
            related = _related(effect)
            some = [v for v in action.parameters if v.name in related]
            if not some:
                raise
        found = []
        for names in self._tuples(some, action.span):
            terms = {v.name: Constant(name) for v, name in zip(some, names, strict=True)}
            same = conjunction(Equality(Variable(name), term) for name, term in terms.items())
            found.append(_Variant(same, self._table(_with_terms(effect, terms), action.span)))
        return found

    def _table(self, effect: task.Effect, span: Span) -> list[_Row]:
        """The rows of a table: their chances sum to 1."""
        rows = self._rows(effect, (), TRUE, span)
        together: dict[tuple[tuple[Effect, ...], tuple[_Paid, ...]], Fraction] = {}
        for chance, changes, pays in rows:
            if chance:
                key = (_joined(changes), _summed(pays))
                together[key] = together.get(key, Fraction(0)) + chance
        if self.problem.metric in (STEPS, ACHIEVED):
            steps = Fraction(self.problem.sign * (self.problem.metric == STEPS))
            paid = (_Paid(steps, (), TRUE),) if steps else ()
            merged: dict[tuple[Effect, ...], Fraction] = {}
            for (changes, _), chance in together.items():
                merged[changes] = merged.get(changes, Fraction(0)) + chance
            return [_Row(chance, changes, paid) for changes, chance in merged.items()]
        return [_Row(chance, changes, pays) for (changes, pays), chance in together.items()]

    def _rows(
        self,
        effect: task.Effect,
        variables: tuple[TypedVariable, ...],
        condition: Formula,
        span: Span,
    ) -> list[_Row]:
        """What an effect may do, for every tuple of objects, where a condition holds."""
        nothing = _Row(Fraction(1), (), ())
        match effect:
            case Literal():
                return [nothing._replace(changes=(_change(variables, condition, effect),))]
            case task.Pay(fluent, amount):
                if fluent != self.problem.metric or not amount:
                    return [nothing]
                paid = _Paid(amount * self.problem.sign, variables, condition)
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
                    for names in self._tuples(own, span)
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
    ) -> list[_Row]:  # fmt: skip
        """What all of some effects may do: independent of each other, unless only one may happen."""
        groups: list[tuple[list[Formula], list[_Row]]] = []
        for each in effects:
            rows = self._rows(each, variables, condition, span)
            where = each.condition if isinstance(each, task.When) else TRUE
            for number, (conditions, others) in enumerate(groups):
                if all(_exclude(where, one) for one in conditions):
                    groups[number] = ([*conditions, where], _in_step(others, rows))
                    break
            else:
                groups.append(([where], rows))
        found = [_Row(Fraction(1), (), ())]
        for _, rows in groups:
            if len(found) * len(rows) > MAX_ROWS:
                raise TooLargeError(
                    f"effects that are independent of each other make more than {MAX_ROWS} outcomes",
                    span,
                )
            found = [_both(a, b, a.chance * b.chance) for a, b in product(found, rows)]
        return found

    def _tuples(self, variables: Sequence[TypedVariable], span: Span) -> list[tuple[str, ...]]:
        ranges = [
            list(dict.fromkeys(name for type_ in v.types for name in self.members[type_]))
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

    @staticmethod
    def _of_states(rows: Iterable[_Row]) -> list[_Paid]:
        """What every action pays whatever happens, where a condition of the state alone holds."""
        common: list[_Paid] | None = None
        for row in rows:
            some = [
                paid
                for paid in row.pays
                if (paid.condition != TRUE or paid.variables)
                and not free_variables(paid.condition) - {v.name for v in paid.variables}
            ]
            common = some if common is None else [paid for paid in common if paid in some]
        return common or []

    # ------------------------------------------------------------------------------------- actions

    def _action(
        self, action: task.Action, variants: Sequence[_Variant], rewards: Collection[_Paid]
    ) -> Action:
        tables = [
            _Variant(
                condition,
                [row._replace(pays=tuple(p for p in row.pays if p not in rewards)) for row in rows],
            )
            for condition, rows in variants
        ]
        # What every outcome costs, whatever else it pays.
        always = {_amount(row.pays, {_ALWAYS: 1}) for each in tables for row in each.rows}
        cost = -min(always) if len(always) == 1 and min(always) < 0 else Fraction(0)
        rules = [rule for each in tables for rule in self._rules(action, each, cost)]
        if len(rules) > MAX_CASES:
            raise TooLargeError(f"it needs {len(rules)} rules; at most {MAX_CASES}", action.span)
        if len(rules) > 1:
            rules = [replace(rule, name=f"case-{n}") for n, rule in enumerate(rules, 1)]
        return Action(
            self._actions[action.name], tuple(rules), self._declared(action.parameters),
            _expression(cost) if cost else None,
        )  # fmt: skip

    def _rules(self, action: task.Action, table: _Variant, cost: Fraction) -> Iterator[Rule]:
        """A rule for each case that rewards tell apart."""
        keys = list(
            dict.fromkeys(p.key for row in table.rows for p in row.pays if p.key != _ALWAYS)
        )
        cases: list[tuple[tuple[int, Formula], ...]] = [()]
        for key in keys:
            cases = [
                (*case, (n, where))
                for case in cases
                for n, where in self._cases(key, action.span)
                if not any(_exclude(where, other) for _, other in case)
            ]
            if len(cases) > MAX_CASES:
                raise TooLargeError(
                    f"its rewards tell more than {MAX_CASES} cases apart", action.span
                )
        taken = [v.name for v in action.parameters]
        for case in cases:
            times = dict(zip(keys, (n for n, _ in case), strict=True)) | {_ALWAYS: 1}
            where = conjunction(
                [action.condition, table.condition, *(condition for _, condition in case)]
            )
            facts = {condition: bool(n) for (v, condition), n in times.items() if not v}
            outcomes = tuple(self._outcomes(action, table.rows, times, facts, cost))
            yield Rule(
                self._actions[action.name],
                outcomes,
                condition=self.formula(told_apart(where, taken)),
            )

    def _cases(self, key: _Key, span: Span) -> list[tuple[int, Formula]]:
        """How often something may be paid, and where it is that often."""
        variables, condition = key
        if not variables:
            return [(1, condition), (0, negation(condition))]
        most = len(self._tuples(variables, span))
        if condition == TRUE:
            return [(most, TRUE)]
        return [(n, Count(variables, condition, "=", n)) for n in range(most + 1)]

    def _outcomes(
        self, action: task.Action, rows: Sequence[_Row],
        times: Mapping[_Key, int],
        facts: Mapping[Formula, bool], cost: Fraction,
    ) -> Iterator[Outcome]:  # fmt: skip
        """The outcomes where rewards are paid so many times, and some conditions hold or not."""
        together: dict[tuple[tuple[Effect, ...], Fraction], Fraction] = {}
        for row in rows:
            changes = tuple(change for each in row.changes for change in _known(each, facts))
            reward = _amount(row.pays, times) + cost
            key = (_joined(changes), reward)
            together[key] = together.get(key, Fraction(0)) + row.chance
        taken: set[str] = {NOISE, *lexer().reserved_words}
        parameters = [v.name for v in action.parameters]
        for (changes, reward), chance in together.items():
            name = next(n for n in _numbered(_outcome_name(changes)) if n not in taken)
            taken.add(name)
            effects = tuple(self._effect(change, parameters) for change in changes)
            yield Outcome(
                name, (_expression(chance),), effects, _expression(reward) if reward else None
            )
        yield Outcome(NOISE)

    # ------------------------------------------------------------------------- names of the language

    def _effect(self, effect: Effect, taken: Sequence[str]) -> Effect:
        match effect:
            case Literal():
                return self._literal(effect)
            case ConditionalEffect(condition, literals):
                return ConditionalEffect(
                    self.formula(told_apart(condition, taken)), tuple(map(self._literal, literals))
                )
        names = [*taken, *(v.name for v in effect.variables)]
        return UniversalEffect(
            self._declared(effect.variables),
            self.formula(told_apart(effect.condition, names)),
            tuple(map(self._literal, effect.effects)),
        )

    def _literal(self, literal: Literal) -> Literal:
        atom = self.formula(literal.atom)
        assert isinstance(atom, Atom)
        return Literal(atom, literal.positive)

    def _declared(self, variables: Iterable[TypedVariable]) -> tuple[TypedVariable, ...]:
        return tuple(
            TypedVariable(self._variables[v.name], tuple(self._types[t] for t in v.types))
            for v in variables
        )

    def _term(self, term: Term) -> Term:
        if isinstance(term, Variable):
            return Variable(self._variables[term.name])
        return Constant(self._objects[term.name])

    def formula(self, formula: Formula) -> Formula:
        """A formula with the names that it has in MENID, simplified."""
        match formula:
            case Truth():
                return formula
            case Atom(predicate, arguments):
                self._named_objects.update(t.name for t in arguments if isinstance(t, Constant))
                return Atom(self._predicates[predicate], tuple(map(self._term, arguments)))
            case Equality(left, right):
                self._named_objects.update(t.name for t in (left, right) if isinstance(t, Constant))
                return Equality(self._term(left), self._term(right))
            case Not(operand):
                return negation(self.formula(operand))
            case And(formulas):
                return conjunction(map(self.formula, formulas))
            case Or(formulas):
                return disjunction(map(self.formula, formulas))
            case Implies(left, right):
                return Implies(self.formula(left), self.formula(right))
            case Exists(variables, body):
                return Exists(self._declared(variables), self.formula(body))
            case ForAll(variables, body):
                return ForAll(self._declared(variables), self.formula(body))
            case Count(variables, body, comparison, number):
                return Count(self._declared(variables), self.formula(body), comparison, number)


class _Variables:
    """Names for variables, made as they are asked for: none is taken, and no two are the same."""

    def __init__(self, taken: Iterable[str]) -> None:
        self._taken = set(taken)
        self._known: dict[str, str] = {}

    def __getitem__(self, name: str) -> str:
        if name not in self._known:
            found = next(n for n in _numbered(_plain(name)) if n not in self._taken)
            self._taken.add(found)
            self._known[name] = found
        return self._known[name]


def _plain(name: str) -> str:
    """A name as MENID has them: hyphens stand between letters or digits, one at a time."""
    return re.sub(r"-+", "-", name).strip("-")


def _numbered(name: str) -> Iterator[str]:
    return chain([name], (f"{name}-{i}" for i in count(2)))


def _named(names: Iterable[str], reserved: Collection[str]) -> dict[str, str]:
    """A name in MENID for each name."""
    variables = _Variables(reserved)
    return {name: variables[name] for name in names}


def _outcome_name(changes: Sequence[Effect]) -> str:
    """A name that says what an outcome changes first."""
    if not changes:
        return "unchanged"
    first = changes[0]
    literal = first if isinstance(first, Literal) else first.effects[0]
    return _plain(("" if literal.positive else "not-") + literal.atom.predicate)


def _expression(value: Fraction) -> Expression:
    """A number, as a decimal where that is exact, else as a fraction."""
    if value < 0:
        return Minus(_expression(-value))
    rest = value.denominator
    for prime in (2, 5):
        while rest % prime == 0:
            rest //= prime
    if rest == 1 or max(value.numerator, value.denominator) >= 10**15:
        return Number(float(value))
    return Arithmetic("/", Number(float(value.numerator)), Number(float(value.denominator)))


def _both(first: _Row, second: _Row, chance: Fraction) -> _Row:
    """What happens if both do."""
    return _Row(chance, (*first.changes, *second.changes), (*first.pays, *second.pays))


def _in_step(first: Sequence[_Row], second: Sequence[_Row]) -> list[_Row]:
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


def _exclude(first: Formula, second: Formula) -> bool:
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


def _known(change: Effect, facts: Mapping[Formula, bool]) -> tuple[Effect, ...]:
    """A change, given which conditions hold."""
    if isinstance(change, ConditionalEffect) and change.condition in facts:
        return change.effects if facts[change.condition] else ()
    return (change,)


def _joined(changes: Iterable[Effect]) -> tuple[Effect, ...]:
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


def _summed(pays: Iterable[_Paid]) -> tuple[_Paid, ...]:
    """What is paid, once for each condition."""
    amounts: dict[_Key, Fraction] = {}
    for paid in pays:
        amounts[paid.key] = amounts.get(paid.key, Fraction(0)) + paid.amount
    return tuple(_Paid(amount, *key) for key, amount in amounts.items() if amount)


def _amount(pays: Iterable[_Paid], times: Mapping[_Key, int]) -> Fraction:
    """What is paid if each is paid so many times."""
    return sum((paid.amount * times.get(paid.key, 0) for paid in pays), Fraction(0))
