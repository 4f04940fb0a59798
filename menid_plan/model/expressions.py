"""Arithmetic over numbers and params: rewards, costs and probabilities."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

Operator: TypeAlias = Literal["+", "-", "*", "/"]


@dataclass(frozen=True, slots=True)
class Number:
    """A literal number, finite and not negative."""

    value: float


@dataclass(frozen=True, slots=True)
class ParamName:
    """The value of a param."""

    name: str


@dataclass(frozen=True, slots=True)
class Minus:
    """Unary minus."""

    operand: Expression


@dataclass(frozen=True, slots=True)
class Arithmetic:
    """Two expressions joined by an operator."""

    operator: Operator
    left: Expression
    right: Expression


Expression: TypeAlias = Number | ParamName | Minus | Arithmetic

ZERO = Number(0.0)


class EvaluationError(ArithmeticError):
    """An expression has no finite value; the message says why, in words for the user."""


def evaluate(expression: Expression, params: Mapping[str, float]) -> float:
    """The value of an expression, given those of its params.

    Raises EvaluationError on a division by zero or a value that is not finite, KeyError on a param
    without a value.
    """
    match expression:
        case Number(value):
            return value
        case ParamName(name):
            return params[name]
        case Minus(operand):
            return -evaluate(operand, params)
        case Arithmetic(operator, left, right):
            return _apply(operator, evaluate(left, params), evaluate(right, params))


def _apply(operator: Operator, left: float, right: float) -> float:
    match operator:
        case "+":
            value = left + right
        case "-":
            value = left - right
        case "*":
            value = left * right
        case "/":
            if right == 0:
                raise EvaluationError("division by zero")
            value = left / right
    if not math.isfinite(value):
        raise EvaluationError("the value is too large")
    return value


def params_in(expression: Expression) -> Iterator[str]:
    """The names of the params that an expression uses, in order, with repeats."""
    match expression:
        case Number():
            return
        case ParamName(name):
            yield name
        case Minus(operand):
            yield from params_in(operand)
        case Arithmetic(_, left, right):
            yield from params_in(left)
            yield from params_in(right)
