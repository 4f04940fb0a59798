"""From lifted formulas and rules to ground ones over a circuit.

What never changes is evaluated away: atoms of predicates that no effect mentions, equality, types. A
deictic reference becomes one candidate for each tuple that may satisfy it, and the condition that no
other does.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from menid_plan.errors import LimitError
from menid_plan.grounding.circuit import FALSE, TRUE, Circuit, Signal
from menid_plan.grounding.state import Binding, GroundAction, ground_atom, object_named
from menid_plan.model.domain import DerivedPredicate, Domain, Problem, objects_by_type
from menid_plan.model.formulas import (
    And,
    Atom,
    Count,
    Equality,
    Exists,
    ForAll,
    Formula,
    GroundAtom,
    Implies,
    Not,
    Or,
    Quantified,
    Term,
    Truth,
    TypedVariable,
    Variable,
)
from menid_plan.model.rules import (
    Action,
    ConditionalEffect,
    Effect,
    Literal,
    Reference,
    Rule,
    UniversalEffect,
)
from menid_plan.model.strata import is_recursive, strata
from menid_plan.model.variables import free_variables

# Formulas grounded before giving up: about a minute of work.
MAX_WORK = 20_000_000

TRUTH = Truth(True)

Candidates: TypeAlias = list[tuple[tuple[str, ...], Signal]]
Lookup: TypeAlias = tuple[str, int, tuple[tuple[int, Term], ...]]
"""A predicate, the place of the argument that is looked for, and the arguments that are known."""


@dataclass(frozen=True, slots=True)
class GroundEffect:
    """Facts that an outcome adds and deletes where a condition holds before the step."""

    condition: Signal
    add: tuple[GroundAtom, ...]
    delete: tuple[GroundAtom, ...]


@dataclass(frozen=True, slots=True)
class GroundRule:
    """A rule with objects for its parameters and references, and where it covers.

    ``effects`` are those of each outcome, noise last; noise has none.
    """

    action: GroundAction
    rule: Rule
    binding: Mapping[str, str]
    condition: Signal
    effects: tuple[tuple[GroundEffect, ...], ...]

    @property
    def values(self) -> tuple[str, ...]:
        """The objects of the rule's `per` parameters."""
        return tuple(self.binding[name] for name in self.rule.per)


class Instantiation:
    """Grounds the formulas and rules of one problem into a circuit."""

    def __init__(self, domain: Domain, problem: Problem, max_work: int = MAX_WORK) -> None:
        self.domain = domain
        self.circuit = Circuit()
        self.init = frozenset(problem.init)
        objects = (*domain.constants, *problem.objects)
        self._order = {o.name: i for i, o in enumerate(objects)}
        self._members = objects_by_type(domain, objects)
        self._ranges: dict[tuple[str, ...], tuple[str, ...]] = {}
        self.changing = domain.changing
        self._derived = {d.name: d for d in domain.derived}
        self._recursive = {d.name for s in strata(domain) if is_recursive(s) for d in s}
        self._signals: dict[GroundAtom, Signal] = {}
        self._pending: list[GroundAtom] = []
        self._candidates: dict[tuple[int, tuple[str, ...]], Candidates] = {}
        self._free: dict[int, tuple[str, ...]] = {}
        self._kept: list[object] = []  # keeps what `_free` knows by its identity alive
        self._work = max_work
        self._plans: dict[
            tuple[int, int, bool], tuple[list[str], list[list[Formula]], list[list[Lookup]]]
        ] = {}
        self._indices: dict[tuple[str, int, tuple[int, ...]], dict[tuple[str, ...], list[str]]] = {}
        self._range_sets: dict[tuple[str, ...], frozenset[str]] = {}

    # ------------------------------------------------------------------------------- formulas

    def signal(self, formula: Formula, binding: Binding) -> Signal:
        """A formula with objects for its free variables, as a signal of the circuit."""
        found = self._signal(formula, binding)
        self._define_pending()
        return found

    def bound_signals(self, variables: Sequence[TypedVariable], formula: Formula) -> list[Signal]:
        """The signal of a formula for each tuple of objects for which it is not false."""
        found = self._satisfying(variables, formula, {})
        self._define_pending()
        return [signal for _, signal in found]

    def _signal(self, formula: Formula, binding: Binding) -> Signal:
        self._work -= 1
        if self._work < 0:
            raise LimitError("grounding takes more work than its limit: too many ground formulas")
        circuit = self.circuit
        match formula:
            case Atom(predicate, _):
                atom = ground_atom(formula, binding)
                if predicate in self._derived:
                    return self._derived_atom(atom)
                if predicate in self.changing:
                    return circuit.fact(atom)
                return TRUE if atom in self.init else FALSE
            case And(formulas):
                return circuit.conjunction(self._until(FALSE, formulas, binding))
            case Or(formulas):
                return circuit.disjunction(self._until(TRUE, formulas, binding))
            case Not(operand):
                return self._signal(operand, binding) ^ 1
            case Implies(left, right):
                premise = self._signal(left, binding)
                if premise == FALSE:
                    return TRUE
                return circuit.disjunction((premise ^ 1, self._signal(right, binding)))
            case Equality(left, right):
                same = object_named(left, binding) == object_named(right, binding)
                return TRUE if same else FALSE
            case Truth(value):
                return TRUE if value else FALSE
            case _:
                return self._quantified(formula, binding)

    def _until(
        self, decisive: Signal, formulas: Sequence[Formula], binding: Binding
    ) -> Iterator[Signal]:
        """The signals of formulas, none after one that decides the whole."""
        for formula in formulas:
            found = self._signal(formula, binding)
            yield found
            if found == decisive:
                return

    def _quantified(self, formula: Quantified, binding: Binding) -> Signal:
        circuit = self.circuit
        match formula:
            case Exists(variables, body):
                found = self._satisfying(variables, body, binding)
                return circuit.disjunction([signal for _, signal in found])
            case ForAll(variables, body):
                found = self._satisfying(variables, body, binding, negated=True)
                return circuit.disjunction([signal for _, signal in found]) ^ 1
            case Count(variables, body, comparison, number):
                signals = [signal for _, signal in self._satisfying(variables, body, binding)]
                return circuit.count(signals, comparison, number)

    def _satisfying(
        self,
        variables: Sequence[TypedVariable],
        formula: Formula,
        binding: Binding,
        negated: bool = False,
    ) -> Candidates:
        """The tuples for which a formula (or its negation) is not false, each with its signal.

        Each conjunct is looked at as soon as all its variables are bound, so that a false one spares
        the tuples that begin alike; atoms that never change tell which objects are worth a look.
        """
        names, due, lookups = self._plan(variables, formula, negated)
        found: Candidates = []
        inner = dict(binding)

        def bind(index: int, signals: list[Signal]) -> None:
            for part in due[index]:
                signal = self._signal(part, inner)
                if signal == FALSE:
                    return
                signals = [*signals, signal]
            if index == len(names):
                whole = self.circuit.conjunction(signals)
                if whole != FALSE:
                    found.append((tuple(inner[name] for name in names), whole))
                return
            for name in self._choices(variables[index], lookups[index], inner):
                inner[names[index]] = name
                bind(index + 1, signals)

        bind(0, [])
        return found

    def _plan(
        self, variables: Sequence[TypedVariable], formula: Formula, negated: bool
    ) -> tuple[list[str], list[list[Formula]], list[list[Lookup]]]:
        """In which order variables are bound: their names, what is due after each, and lookups."""
        key = (id(formula), id(variables), negated)
        if key not in self._plans:
            names = [variable.name for variable in variables]
            due: list[list[Formula]] = [[] for _ in range(len(names) + 1)]
            lookups: list[list[Lookup]] = [[] for _ in names]
            for part in _conjuncts(Not(formula) if negated else formula):
                places = [names.index(v) + 1 for v in self._free_variables(part) if v in names]
                last = max(places, default=0)
                due[last].append(part)
                if last and isinstance(part, Atom) and self._is_static(part):
                    lookups[last - 1].append(_lookup(part, names[last - 1]))
            self._plans[key] = (names, due, lookups)
            self._kept.append((formula, variables))
        return self._plans[key]

    def _is_static(self, atom: Atom) -> bool:
        return atom.predicate not in self.changing and atom.predicate not in self._derived

    def _choices(
        self, variable: TypedVariable, lookups: list[Lookup], inner: Binding
    ) -> Sequence[str]:
        """The objects that a variable may name, in order of declaration; perhaps too many."""
        possible = self.range_of(variable.types)
        if not lookups:
            return possible
        fewest: list[str] | None = None
        for predicate, place, others in lookups:
            values = tuple(object_named(term, inner) for _, term in others)
            places = tuple(position for position, _ in others)
            some = self._indexed(predicate, place, places).get(values, [])
            if fewest is None or len(some) < len(fewest):
                fewest = some
        assert fewest is not None
        members = self._range_sets.setdefault(variable.types, frozenset(possible))
        return [name for name in fewest if name in members]

    def _indexed(
        self, predicate: str, place: int, others: tuple[int, ...]
    ) -> dict[tuple[str, ...], list[str]]:
        """Of the atoms of a predicate that never change: one argument by some of the others."""
        key = (predicate, place, others)
        if key not in self._indices:
            index: dict[tuple[str, ...], set[str]] = {}
            for atom in self.init:
                if atom.predicate == predicate:
                    values = tuple(atom.arguments[other] for other in others)
                    index.setdefault(values, set()).add(atom.arguments[place])
            order = self._order.__getitem__
            self._indices[key] = {k: sorted(some, key=order) for k, some in index.items()}
        return self._indices[key]

    def range_of(self, types: tuple[str, ...]) -> tuple[str, ...]:
        """The objects of any of these types, each once, in order of declaration."""
        if types not in self._ranges:
            members = {name for type_ in types for name in self._members[type_]}
            self._ranges[types] = tuple(sorted(members, key=self._order.__getitem__))
        return self._ranges[types]

    def _free_variables(self, formula: Formula) -> tuple[str, ...]:
        known = self._free.get(id(formula))
        if known is None:
            known = self._free[id(formula)] = tuple(sorted(free_variables(formula)))
            self._kept.append(formula)
        return known

    # ---------------------------------------------------------------------- derived predicates

    def _derived_atom(self, atom: GroundAtom) -> Signal:
        found = self._signals.get(atom)
        if found is None:
            predicate = self._derived[atom.predicate]
            if atom.predicate in self._recursive:
                found = self._signals[atom] = self.circuit.derived(atom)
                self._pending.append(atom)
            else:
                found = self._signals[atom] = self._definition(predicate, atom)
        return found

    def _definition(self, predicate: DerivedPredicate, atom: GroundAtom) -> Signal:
        for variable, name in zip(predicate.parameters, atom.arguments, strict=True):
            if name not in self.range_of(variable.types):
                return FALSE
        names = (variable.name for variable in predicate.parameters)
        return self._signal(predicate.formula, dict(zip(names, atom.arguments, strict=True)))

    def _define_pending(self) -> None:
        while self._pending:
            atom = self._pending.pop()
            number = self._signals[atom] >> 1
            definition = self._definition(self._derived[atom.predicate], atom)
            self.circuit.definitions[number] = definition

    # ---------------------------------------------------------------------------------- rules

    def rules(self) -> Iterator[GroundRule]:
        """Every ground rule that may cover, in order of actions, their objects, and rules."""
        for action in self.domain.actions:
            for ground, binding in self._instances(action):
                others: list[GroundRule] = []
                for rule in action.rules:
                    if not rule.otherwise:
                        others.extend(self._rule(ground, rule, binding))
                found = others
                for rule in action.rules:
                    if rule.otherwise:
                        covered = self.circuit.disjunction([other.condition for other in others])
                        found = [*others, self._covering(ground, rule, binding, covered ^ 1)]
                yield from (rule for rule in found if rule.condition != FALSE)
        self._define_pending()  # of conditions that came to nothing

    def _instances(self, action: Action) -> Iterator[tuple[GroundAction, dict[str, str]]]:
        """The objects that an action may be for: those that what never changes allows some rule."""
        keys = [parameter.name for parameter in action.parameters]
        if any(rule.otherwise for rule in action.rules):
            allowed = {names for names, _ in self._satisfying(action.parameters, TRUTH, {})}
        else:
            allowed = set()
            for rule in action.rules:
                parts = [
                    part
                    for part in _conjuncts(rule.condition)
                    if set(self._free_variables(part)) <= set(keys)
                    and (
                        isinstance(part, Equality)
                        or (isinstance(part, Atom) and self._is_static(part))
                    )
                ]
                found = self._satisfying(action.parameters, And(tuple(parts)), {})
                allowed.update(names for names, _ in found)
        for names in sorted(allowed, key=lambda names: [self._order[name] for name in names]):
            yield GroundAction(action.name, names), dict(zip(keys, names, strict=True))

    def _rule(self, ground: GroundAction, rule: Rule, binding: Binding) -> Iterator[GroundRule]:
        """The rule with each choice of objects for its references."""

        def resolve(
            index: int, inner: dict[str, str], signals: list[Signal]
        ) -> Iterator[GroundRule]:
            if index == len(rule.references):
                condition = self.circuit.conjunction(
                    [*signals, *self._until(FALSE, _conjuncts(rule.condition), inner)]
                )
                if condition != FALSE:
                    yield self._covering(ground, rule, inner, condition)
                return
            reference = rule.references[index]
            candidates = self._resolutions(reference, inner)
            unique = self.circuit.count([signal for _, signal in candidates], "=", 1)
            if unique == FALSE:
                return
            names = [variable.name for variable in reference.variables]
            for objects, signal in candidates:
                chosen = dict(zip(names, objects, strict=True))
                yield from resolve(index + 1, {**inner, **chosen}, [*signals, signal, unique])

        yield from resolve(0, dict(binding), [])

    def _resolutions(self, reference: Reference, binding: Binding) -> Candidates:
        """The tuples that a reference may name; remembered for what its formula depends on."""
        own = {variable.name for variable in reference.variables}
        free = [name for name in self._free_variables(reference.formula) if name not in own]
        key = (id(reference), tuple(binding[name] for name in free))
        if key not in self._candidates:
            found = self._satisfying(reference.variables, reference.formula, binding)
            self._candidates[key] = found
        return self._candidates[key]

    def _covering(
        self, ground: GroundAction, rule: Rule, binding: Binding, condition: Signal
    ) -> GroundRule:
        effects = tuple(tuple(self._effects(outcome.effects, binding)) for outcome in rule.outcomes)
        self._define_pending()
        return GroundRule(ground, rule, dict(binding), condition, effects)

    def _effects(self, effects: Sequence[Effect], binding: Binding) -> Iterator[GroundEffect]:
        always: list[Literal] = []
        for effect in effects:
            match effect:
                case Literal():
                    always.append(effect)
                case ConditionalEffect(condition, literals):
                    yield from self._effect(self._signal(condition, binding), literals, binding)
                case UniversalEffect(variables, condition, literals):
                    names = [variable.name for variable in variables]
                    for objects, signal in self._satisfying(variables, condition, binding):
                        inner = {**binding, **dict(zip(names, objects, strict=True))}
                        yield from self._effect(signal, literals, inner)
        yield from self._effect(TRUE, always, binding)

    def _effect(
        self, condition: Signal, literals: Sequence[Literal], binding: Binding
    ) -> Iterator[GroundEffect]:
        if condition != FALSE and literals:
            add = tuple(ground_atom(li.atom, binding) for li in literals if li.positive)
            delete = tuple(ground_atom(li.atom, binding) for li in literals if not li.positive)
            yield GroundEffect(condition, add, delete)


def _conjuncts(formula: Formula) -> list[Formula]:
    """The formulas whose conjunction a formula is, as far as its outermost connectives tell."""
    match formula:
        case And(formulas):
            return [part for operand in formulas for part in _conjuncts(operand)]
        case Not(Not(operand)):
            return _conjuncts(operand)
        case Not(Or(formulas)):
            return [part for operand in formulas for part in _conjuncts(Not(operand))]
        case Not(Implies(left, right)):
            return [*_conjuncts(left), *_conjuncts(Not(right))]
    return [formula]


def _lookup(atom: Atom, name: str) -> Lookup:
    """How to look a variable up by an atom whose other variables are bound before it."""
    is_it = [isinstance(term, Variable) and term.name == name for term in atom.arguments]
    others = ((i, term) for i, term in enumerate(atom.arguments) if not is_it[i])
    return atom.predicate, is_it.index(True), tuple(others)
