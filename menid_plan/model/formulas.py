"""Terms and formulas: what can be said of a state."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

Comparison: TypeAlias = Literal["=", "!=", "<", "<=", ">", ">="]


@dataclass(frozen=True, slots=True)
class Variable:
    """An action's parameter, a deictic reference or a quantified variable."""

    name: str


@dataclass(frozen=True, slots=True)
class Constant:
    """A constant of the domain or an object of the problem, by its name."""

    name: str


Term: TypeAlias = Variable | Constant


@dataclass(frozen=True, slots=True)
class TypedVariable:
    """A declared variable, which ranges over the objects of any of ``types``."""

    name: str
    types: tuple[str, ...] = ("object",)


class GroundAtom(NamedTuple):
    """A predicate and the names of its objects: what a state is a set of."""

    predicate: str
    arguments: tuple[str, ...] = ()

    def __str__(self) -> str:
        if not self.arguments:
            return self.predicate
        return f"{self.predicate}({', '.join(self.arguments)})"


@dataclass(frozen=True, slots=True)
class Truth:
    """``true`` or ``false``."""

    value: bool


@dataclass(frozen=True, slots=True)
class Atom:
    """A basic or derived predicate of some terms."""

    predicate: str
    arguments: tuple[Term, ...] = ()


@dataclass(frozen=True, slots=True)
class Equality:
    """``left = right``: both terms name the same object. ``!=`` is its negation."""

    left: Term
    right: Term


@dataclass(frozen=True, slots=True)
class Not:
    """Negation."""

    formula: Formula


@dataclass(frozen=True, slots=True)
class And:
    """Conjunction of two or more formulas."""

    formulas: tuple[Formula, ...]


@dataclass(frozen=True, slots=True)
class Or:
    """Disjunction of two or more formulas."""

    formulas: tuple[Formula, ...]


@dataclass(frozen=True, slots=True)
class Implies:
    """``left implies right``."""

    left: Formula
    right: Formula


@dataclass(frozen=True, slots=True)
class Exists:
    """Some tuple of objects satisfies the formula; false over an empty type."""

    variables: tuple[TypedVariable, ...]
    formula: Formula


@dataclass(frozen=True, slots=True)
class ForAll:
    """Every tuple of objects satisfies the formula; true over an empty type."""

    variables: tuple[TypedVariable, ...]
    formula: Formula


@dataclass(frozen=True, slots=True)
class Count:
    """How many tuples satisfy the formula, compared with a whole number."""

    variables: tuple[TypedVariable, ...]
    formula: Formula
    comparison: Comparison
    number: int


Formula: TypeAlias = Truth | Atom | Equality | Not | And | Or | Implies | Exists | ForAll | Count
Quantified: TypeAlias = Exists | ForAll | Count

TRUE = Truth(True)
FALSE = Truth(False)


def negation(formula: Formula) -> Formula:
    """Not a formula, without a double ``not``."""
    match formula:
        case Truth(value):
            return Truth(not value)
        case Not(operand):
            return operand
    return Not(formula)


def conjunction(formulas: Iterable[Formula]) -> Formula:
    """All of some formulas, flattened, each once."""
    parts: dict[Formula, None] = {}
    for formula in formulas:
        if formula == FALSE:
            return FALSE
        inner = formula.formulas if isinstance(formula, And) else (formula,)
        parts.update(dict.fromkeys(part for part in inner if part != TRUE))
    if len(parts) < 2:
        return next(iter(parts), TRUE)
    return And(tuple(parts))


def disjunction(formulas: Iterable[Formula]) -> Formula:
    """Any of some formulas, flattened, each once."""
    parts: dict[Formula, None] = {}
    for formula in formulas:
        if formula == TRUE:
            return TRUE
        inner = formula.formulas if isinstance(formula, Or) else (formula,)
        parts.update(dict.fromkeys(part for part in inner if part != FALSE))
    if len(parts) < 2:
        return next(iter(parts), FALSE)
    return Or(tuple(parts))


def subformulas(formula: Formula) -> Iterator[Formula]:
    """A formula and all in it."""
    yield formula
    match formula:
        case And(formulas) | Or(formulas):
            for each in formulas:
                yield from subformulas(each)
        case Implies(left, right):
            yield from subformulas(left)
            yield from subformulas(right)
        case Not(inner) | Exists(_, inner) | ForAll(_, inner) | Count(_, inner):
            yield from subformulas(inner)
