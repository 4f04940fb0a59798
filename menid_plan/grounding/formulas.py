"""Which formulas hold in a state, and which derived atoms: the semantics of formulas."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from collections.abc import Set as AbstractSet
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import product
from operator import eq, ge, gt, le, lt, ne
from types import MappingProxyType
from typing import TypeAlias

from menid_plan.errors import LimitError, MeaningError
from menid_plan.grounding.recent import Recent
from menid_plan.grounding.state import (
    Binding,
    State,
    World,
    extended,
    ground_atom,
    object_named,
)
from menid_plan.model.domain import DerivedPredicate, Domain, Object, objects_by_type
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
    Truth,
    TypedVariable,
)
from menid_plan.model.strata import is_recursive, negative_cycles, occurrences, strata

COMPARISONS = {"=": eq, "!=": ne, "<": lt, "<=": le, ">": gt, ">=": ge}

WORK_LIMIT = 8_000_000
"""Steps of evaluation that one call may take: some 10 seconds' worth."""

UNBOUND: Binding = MappingProxyType({})


NO_ATOMS: frozenset[GroundAtom] = frozenset()

_Given: TypeAlias = tuple[int, tuple[frozenset[GroundAtom], ...]]


@dataclass(frozen=True, slots=True)
class _Stratum:
    """Derived predicates that depend on each other, and all other predicates in their formulas."""

    predicates: tuple[DerivedPredicate, ...]
    reads: tuple[str, ...]
    is_recursive: bool

    @classmethod
    def of(cls, predicates: Sequence[DerivedPredicate]) -> _Stratum:
        own = {p.name for p in predicates}
        found = {name for p in predicates for name, _ in occurrences(p.formula)}
        return cls(tuple(predicates), tuple(sorted(found - own)), is_recursive(predicates))


class Formulas:
    """Formulas over the objects of one problem, evaluated by trying every tuple of objects.

    A *world* is a set of atoms in which a formula is read as it stands: for a state, what
    `complete` gives. Within one `task` evaluation may take ``work_limit`` steps (a formula looked
    at, a tuple tried) and raises LimitError beyond; outside of any it is not limited.
    """

    def __init__(
        self, domain: Domain, objects: Sequence[Object], work_limit: int = WORK_LIMIT
    ) -> None:
        for cycle in negative_cycles(domain):
            raise MeaningError(
                f"derived predicate `{cycle.culprit.name}` depends on itself through its negative "
                f"occurrence of `{cycle.negated.name}`: {cycle}"
            )
        self.objects = tuple(o.name for o in objects)
        self.work_limit = work_limit
        self._strata = [_Stratum.of(predicates) for predicates in strata(domain)]
        self._derived: Recent[_Given, frozenset[GroundAtom]] = Recent()
        self._members = objects_by_type(domain, objects)
        self._ranges: dict[tuple[str, ...], tuple[str, ...]] = {}
        self._sets: dict[tuple[str, ...], frozenset[str]] = {}
        self._task: str | None = None
        self._steps = 0

    # Objects ------------------------------------------------------------------------------------

    def range_of(self, types: tuple[str, ...]) -> tuple[str, ...]:
        """The objects of any of these types, each once, in order of declaration."""
        if types not in self._ranges:
            members = {name for t in types for name in self._members[t]}
            self._ranges[types] = tuple(name for name in self.objects if name in members)
        return self._ranges[types]

    def is_of(self, name: str, types: tuple[str, ...]) -> bool:
        """Whether an object is of any of these types."""
        if types not in self._sets:
            self._sets[types] = frozenset(self.range_of(types))
        return name in self._sets[types]

    def bindings(self, variables: Sequence[TypedVariable]) -> Iterator[tuple[str, ...]]:
        """Every tuple of objects that the variables can name; the last variable changes fastest."""
        for objects in product(*(self.range_of(v.types) for v in variables)):
            self._step()
            yield objects

    # Formulas -----------------------------------------------------------------------------------

    def satisfying(
        self,
        variables: Sequence[TypedVariable],
        formula: Formula,
        world: AbstractSet[GroundAtom],
        binding: Binding = UNBOUND,
    ) -> Iterator[tuple[str, ...]]:
        """The tuples of objects for the variables that make a formula true, as they are found."""
        names = [v.name for v in variables]
        inner = dict(binding)
        for objects in self.bindings(variables):
            inner.update(zip(names, objects, strict=True))
            if self.holds(formula, world, inner):
                yield objects

    def holds(
        self, formula: Formula, world: AbstractSet[GroundAtom], binding: Binding = UNBOUND
    ) -> bool:
        """Whether a formula is true in a world, its free variables bound."""
        self._step()
        match formula:
            case Atom():
                return ground_atom(formula, binding) in world
            case And(formulas):
                return all(self.holds(f, world, binding) for f in formulas)
            case Not(operand):
                return not self.holds(operand, world, binding)
            case Equality(left, right):
                return object_named(left, binding) == object_named(right, binding)
            case Or(formulas):
                return any(self.holds(f, world, binding) for f in formulas)
            case Implies(left, right):
                return not self.holds(left, world, binding) or self.holds(right, world, binding)
            case Exists(variables, body):
                return any(True for _ in self.satisfying(variables, body, world, binding))
            case ForAll(variables, body):
                return not any(True for _ in self.satisfying(variables, Not(body), world, binding))
            case Count(variables, body, comparison, number):
                count = sum(1 for _ in self.satisfying(variables, body, world, binding))
                return bool(COMPARISONS[comparison](count, number))
            case Truth(value):
                return value

    # Derived predicates -------------------------------------------------------------------------

    def complete(self, state: State) -> World:
        """A state and its derived atoms: the least model, stratum by stratum.

        In a stratum all that its predicates say of each other is positive: an atom that follows
        from some atoms follows from more. So adding whatever follows, in any order and until
        nothing does, ends in the least set that their formulas allow.
        """
        world = set(state)
        atoms = _by_predicate(state)
        for index, stratum in enumerate(self._strata):
            # What follows depends on the atoms of the predicates in the formulas alone, and those
            # many states have in common: a map, say, that no action changes.
            given = (index, tuple(atoms.get(name, NO_ATOMS) for name in stratum.reads))
            if given not in self._derived:
                self._derived[given] = self._derive(stratum, world)
            world |= self._derived[given]
            atoms.update(_by_predicate(self._derived[given]))
        return frozenset(world)

    def _derive(self, stratum: _Stratum, below: AbstractSet[GroundAtom]) -> frozenset[GroundAtom]:
        """The atoms of a stratum, given a world that is complete below it."""
        world = set(below)
        with self.task(f"derived predicate `{stratum.predicates[0].name}`"):
            while self._derive_once(stratum, world) and stratum.is_recursive:
                pass
        return frozenset(world - below)

    def _derive_once(self, stratum: _Stratum, world: set[GroundAtom]) -> bool:
        """Add to a world the atoms of a stratum that follow in it; whether there were any."""
        before = len(world)
        for predicate in stratum.predicates:
            for objects in self.bindings(predicate.parameters):
                atom = GroundAtom(predicate.name, objects)
                binding = extended(UNBOUND, predicate.parameters, objects)
                if atom not in world and self.holds(predicate.formula, world, binding):
                    world.add(atom)
        return len(world) > before

    # The limit ----------------------------------------------------------------------------------

    @contextmanager
    def task(self, what: str) -> Iterator[None]:
        """Limit what is evaluated within, all in all; the message of the limit will say ``what``.

        A task within a task shares its steps.
        """
        outer = self._task
        if outer is None:
            self._steps = 0
        self._task = what
        try:
            yield
        finally:
            self._task = outer

    def _step(self) -> None:
        self._steps += 1
        if self._steps > self.work_limit and self._task is not None:
            raise LimitError(
                f"evaluating {self._task} takes more than {self.work_limit} steps, the work limit; "
                "fewer objects or fewer variables in one quantifier would help"
            )


def _by_predicate(atoms: AbstractSet[GroundAtom]) -> dict[str, frozenset[GroundAtom]]:
    found: dict[str, set[GroundAtom]] = {}
    for atom in atoms:
        found.setdefault(atom.predicate, set()).add(atom)
    return {name: frozenset(members) for name, members in found.items()}
