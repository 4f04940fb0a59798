"""What a PPDDL domain and problem say, as immutable values; names are in small letters."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import TypeAlias

from menid_plan.model.domain import Object, Predicate, Type
from menid_plan.model.formulas import Formula, GroundAtom, TypedVariable
from menid_plan.model.rules import Literal
from menid_plan.source import Span


@dataclass(frozen=True, slots=True)
class Pay:
    """``fluent`` grows by an amount (shrinks if it is negative)."""

    fluent: str
    amount: Fraction


@dataclass(frozen=True, slots=True)
class Together:
    """All of some effects."""

    effects: tuple[Effect, ...]


@dataclass(frozen=True, slots=True)
class When:
    """An effect where a condition held before the step."""

    condition: Formula
    effect: Effect


@dataclass(frozen=True, slots=True)
class Every:
    """An effect for every tuple of objects."""

    variables: tuple[TypedVariable, ...]
    effect: Effect


@dataclass(frozen=True, slots=True)
class Chance:
    """One of some effects, each with its probability; what is left of 1 is nothing."""

    choices: tuple[tuple[Fraction, Effect], ...]


Effect: TypeAlias = Literal | Pay | Together | When | Every | Chance


@dataclass(frozen=True, slots=True)
class Action:
    """An action, with the text's place for messages."""

    name: str
    parameters: tuple[TypedVariable, ...]
    condition: Formula
    effect: Effect
    span: Span


@dataclass(frozen=True, slots=True)
class PddlDomain:
    """A PPDDL domain. ``functions`` are its numeric fluents that have no arguments."""

    name: str
    types: tuple[Type, ...]
    constants: tuple[Object, ...]
    predicates: tuple[Predicate, ...]
    functions: tuple[str, ...]
    actions: tuple[Action, ...]
    span: Span


@dataclass(frozen=True, slots=True)
class PddlProblem:
    """A PPDDL problem. ``metric`` is the fluent that is to grow (``sign`` 1) or to shrink (-1).

    It may be ``total-time``, the number of steps, or ``goal-achieved``.
    """

    name: str
    objects: tuple[Object, ...]
    init: tuple[GroundAtom, ...]
    goal: Formula | None
    goal_reward: Fraction
    metric: str
    sign: int
    span: Span
