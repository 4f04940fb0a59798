"""From PPDDL to MENID: one rule for each action, or one for each case that its rewards tell apart.

The effects that happen by chance become one table of outcomes: independent ones are multiplied out.
A condition around a chance is put inside, since what is drawn changes nothing where it fails.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import chain, count
from typing import NamedTuple

from menid_plan.language.grammar import lexer
from menid_plan.model.domain import (
    OBJECT,
    Domain,
    Object,
    Predicate,
    Problem,
    StateReward,
    Type,
)
from menid_plan.model.expressions import Arithmetic, Expression, Minus, Number
from menid_plan.model.formulas import (
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
from menid_plan.model.variables import free_variables, told_apart
from menid_plan.ppddl import task
from menid_plan.ppddl.parts import ACHIEVED, STEPS
from menid_plan.ppddl.tables import (
    ALWAYS,
    Key,
    Paid,
    Row,
    Tables,
    TooLargeError,
    Variant,
    exclude,
    joined,
)
from menid_plan.source import Span

# Rules of one action.
MAX_CASES = 256


class Imported(NamedTuple):
    """A domain and a problem in MENID, and what their objects are called there."""

    domain: Domain
    problem: Problem
    objects: Mapping[str, str]


def menid(domain: task.PddlDomain, problem: task.PddlProblem) -> Imported:
    """The domain and problem in MENID; TooLargeError for an action with too many outcomes."""
    return _Import(domain, problem).documents()


class _Import:
    def __init__(self, domain: task.PddlDomain, problem: task.PddlProblem) -> None:
        self.domain, self.problem = domain, problem
        objects = (*domain.constants, *problem.objects)
        words = lexer().reserved_words
        self.tables = Tables(domain, problem)
        self._types = {OBJECT: OBJECT, **_named((t.name for t in domain.types), words)}
        self._predicates = _named((p.name for p in domain.predicates), words)
        self._objects = _named((o.name for o in objects), words)
        # A variable may not be called like an object.
        self._variables = _Variables({*words, *self._objects.values()})
        self._actions = _named((a.name for a in domain.actions), words)
        self._named_objects: set[str] = set()

    def documents(self) -> Imported:
        """The domain and the problem."""
        d, p = self.domain, self.problem
        goal = None if p.goal is None else self.formula(told_apart(p.goal, ()))
        self._named_objects.clear()  # the goal is the problem's, and may speak of its objects
        variants = [self.tables.variants(action) for action in d.actions]
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
        problem = Problem(
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
        return Imported(made, problem, self._objects)

    def _object(self, thing: Object) -> Object:
        return Object(self._objects[thing.name], self._types[thing.type])

    # ---------------------------------------------------------------------------------------- rows

    @staticmethod
    def _of_states(rows: Iterable[Row]) -> list[Paid]:
        """What every action pays whatever happens, where a condition of the state alone holds."""
        common: list[Paid] | None = None
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
        self, action: task.Action, variants: Sequence[Variant], rewards: Collection[Paid]
    ) -> Action:
        tables = [
            Variant(
                condition,
                [row._replace(pays=tuple(p for p in row.pays if p not in rewards)) for row in rows],
            )
            for condition, rows in variants
        ]
        # What every outcome costs, whatever else it pays.
        always = {_amount(row.pays, {ALWAYS: 1}) for each in tables for row in each.rows}
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

    def _rules(self, action: task.Action, table: Variant, cost: Fraction) -> Iterator[Rule]:
        """A rule for each case that rewards tell apart."""
        keys = list(dict.fromkeys(p.key for row in table.rows for p in row.pays if p.key != ALWAYS))
        cases: list[tuple[tuple[int, Formula], ...]] = [()]
        for key in keys:
            cases = [
                (*case, (n, where))
                for case in cases
                for n, where in self._cases(key, action.span)
                if not any(exclude(where, other) for _, other in case)
            ]
            if len(cases) > MAX_CASES:
                raise TooLargeError(
                    f"its rewards tell more than {MAX_CASES} cases apart", action.span
                )
        taken = [v.name for v in action.parameters]
        for case in cases:
            times = dict(zip(keys, (n for n, _ in case), strict=True)) | {ALWAYS: 1}
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

    def _cases(self, key: Key, span: Span) -> list[tuple[int, Formula]]:
        """How often something may be paid, and where it is that often."""
        variables, condition = key
        if not variables:
            return [(1, condition), (0, negation(condition))]
        most = len(self.tables.tuples(variables, span))
        if condition == TRUE:
            return [(most, TRUE)]
        return [(n, Count(variables, condition, "=", n)) for n in range(most + 1)]

    def _outcomes(
        self, action: task.Action, rows: Sequence[Row],
        times: Mapping[Key, int],
        facts: Mapping[Formula, bool], cost: Fraction,
    ) -> Iterator[Outcome]:  # fmt: skip
        """The outcomes where rewards are paid so many times, and some conditions hold or not."""
        together: dict[tuple[tuple[Effect, ...], Fraction], Fraction] = {}
        for row in rows:
            changes = tuple(change for each in row.changes for change in _known(each, facts))
            reward = _amount(row.pays, times) + cost
            key = (joined(changes), reward)
            together[key] = together.get(key, Fraction(0)) + row.chance
        common = set.intersection(*(set(changes) for changes, _ in together))
        taken: set[str] = {NOISE, *lexer().reserved_words}
        parameters = [v.name for v in action.parameters]
        for (changes, reward), chance in together.items():
            name = next(n for n in _numbered(_outcome_name(changes, common)) if n not in taken)
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


# MENID's names have 255 characters at most; a number may be put behind this many.
LONGEST = 240


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
    return re.sub(r"-+", "-", name)[:LONGEST].strip("-")


def _numbered(name: str) -> Iterator[str]:
    return chain([name], (f"{name}-{i}" for i in count(2)))


def _named(names: Iterable[str], reserved: Collection[str]) -> dict[str, str]:
    """A name in MENID for each name."""
    variables = _Variables(reserved)
    return {name: variables[name] for name in names}


def _outcome_name(changes: Sequence[Effect], common: Collection[Effect]) -> str:
    """A name that says what an outcome changes, something that others don't if there is any."""
    if not changes:
        return "unchanged"
    first = next((change for change in changes if change not in common), changes[0])
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


def _amount(pays: Iterable[Paid], times: Mapping[Key, int]) -> Fraction:
    """What is paid if each is paid so many times."""
    return sum((paid.amount * times.get(paid.key, 0) for paid in pays), Fraction(0))


def _known(change: Effect, facts: Mapping[Formula, bool]) -> tuple[Effect, ...]:
    """A change, given which conditions hold."""
    if isinstance(change, ConditionalEffect) and change.condition in facts:
        return change.effects if facts[change.condition] else ()
    return (change,)
