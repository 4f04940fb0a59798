"""Domains and problems as immutable values."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from menid_plan.model.expressions import EvaluationError, Expression, Number, evaluate, params_in
from menid_plan.model.formulas import Formula, GroundAtom, TypedVariable
from menid_plan.model.rules import Action
from menid_plan.source import Span

Role: TypeAlias = Literal["target", "test"]

OBJECT = "object"


@dataclass(frozen=True, slots=True)
class Type:
    """A type and the one that it specialises."""

    name: str
    parent: str = OBJECT
    doc: str = ""
    span: Span | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class Object:
    """An object of a problem or a constant of a domain, with numbers for the environments."""

    name: str
    type: str = OBJECT
    attributes: tuple[tuple[str, float], ...] = ()
    doc: str = ""
    span: Span | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class Param:
    """A named number; a problem or a caller may set it anew."""

    name: str
    value: Expression
    doc: str = ""
    span: Span | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class Environment:
    """A place where actions can be executed: the target, or a test."""

    name: str
    role: Role
    doc: str = ""
    span: Span | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class Predicate:
    """A basic predicate; an argument's object must be of one of its types."""

    name: str
    arguments: tuple[tuple[str, ...], ...] = ()
    doc: str = ""
    span: Span | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class DerivedPredicate:
    """A predicate that holds where its formula does; it may be recursive."""

    name: str
    parameters: tuple[TypedVariable, ...]
    formula: Formula
    doc: str = ""
    span: Span | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class StateReward:
    """Received for every step taken in a state where the condition holds, once for each binding."""

    reward: Expression
    condition: Formula
    variables: tuple[TypedVariable, ...] = ()
    doc: str = ""
    span: Span | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class Domain:
    """What a robot can do. Each tuple keeps the order of the declarations."""

    name: str
    types: tuple[Type, ...] = ()
    constants: tuple[Object, ...] = ()
    params: tuple[Param, ...] = ()
    environments: tuple[Environment, ...] = ()
    predicates: tuple[Predicate, ...] = ()
    derived: tuple[DerivedPredicate, ...] = ()
    rewards: tuple[StateReward, ...] = ()
    actions: tuple[Action, ...] = ()
    doc: str = ""
    span: Span | None = field(default=None, compare=False, repr=False)

    @property
    def all_environments(self) -> tuple[Environment, ...]:
        """The declared environments, or the one that a domain without any has."""
        return self.environments or (Environment("target", "target"),)

    @property
    def target(self) -> str:
        """The name of the target environment."""
        return next(e.name for e in self.all_environments if e.role == "target")

    @property
    def changing(self) -> set[str]:
        """The basic predicates that some effect mentions."""
        return {
            literal.atom.predicate
            for action in self.actions
            for rule in action.rules
            for outcome in rule.outcomes
            for literal in outcome.literals
        }

    def supertypes(self, name: str) -> tuple[str, ...]:
        """A type and all that it descends from, itself first, ``object`` last."""
        parents = {t.name: t.parent for t in self.types}
        chain = [name]
        while chain[-1] != OBJECT:
            chain.append(parents[chain[-1]])
        return tuple(chain)

    def action(self, name: str) -> Action:
        """The action of that name; KeyError if there is none."""
        for action in self.actions:
            if action.name == name:
                return action
        raise KeyError(name)


@dataclass(frozen=True, slots=True)
class Problem:
    """One task in a domain: its objects, where it starts, and what is wanted."""

    name: str
    domain: str
    params: tuple[Param, ...] = ()
    objects: tuple[Object, ...] = ()
    init: tuple[GroundAtom, ...] = ()
    goal: Formula | None = None
    goal_reward: Expression | None = None
    horizon: int | None = None
    discount: float | None = None
    dead_end_reward: Expression | None = None
    doc: str = ""
    span: Span | None = field(default=None, compare=False, repr=False)


def param_values(
    domain: Domain, problem: Problem | None = None, override: Mapping[str, float] | None = None
) -> dict[str, float]:
    """The value of every param: the domain's, set anew by the problem, then by ``override``.

    Raises EvaluationError where an expression has no finite value, or ``override`` has another name.
    """
    expressions: dict[str, Expression] = {p.name: p.value for p in domain.params}
    expressions.update({p.name: p.value for p in (problem.params if problem else ())})
    for name, value in (override or {}).items():
        if name not in expressions:
            known = ", ".join(expressions) or "none"
            raise EvaluationError(f"there is no param `{name}`; the domain has: {known}")
        if not math.isfinite(value):
            raise EvaluationError(f"param `{name}` is {value}, not a finite number")
        expressions[name] = Number(value)
    values: dict[str, float] = {}
    for name in _dependencies_first(expressions):
        values[name] = evaluate(expressions[name], values)
    return values


def _dependencies_first(expressions: Mapping[str, Expression]) -> Iterator[str]:
    from graphlib import TopologicalSorter

    yield from TopologicalSorter(
        {name: set(params_in(e)) for name, e in expressions.items()}
    ).static_order()


def objects_by_type(domain: Domain, objects: Iterable[Object]) -> dict[str, tuple[str, ...]]:
    """For every type, the names of its objects (descendants included) in order of declaration."""
    found: dict[str, list[str]] = {OBJECT: [], **{t.name: [] for t in domain.types}}
    for item in objects:
        for ancestor in domain.supertypes(item.type):
            found[ancestor].append(item.name)
    return {name: tuple(members) for name, members in found.items()}
