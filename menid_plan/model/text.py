"""Formulas, expressions and effects in the concrete syntax, on one line."""

from __future__ import annotations

from collections.abc import Iterable

from menid_plan.model.expressions import Arithmetic, Expression, Minus, Number, ParamName
from menid_plan.model.formulas import (
    And,
    Atom,
    Count,
    Equality,
    Exists,
    ForAll,
    Formula,
    Implies,
    Not,
    Or,
    Term,
    Truth,
    TypedVariable,
)
from menid_plan.model.rules import ConditionalEffect, Effect, Literal

# How tightly a formula binds; an operand that binds less than its place asks for gets parentheses.
_IMPLIES, _OR, _AND, _NOT, _PRIMARY = range(5)


def formula_text(formula: Formula) -> str:
    """A formula, with no more parentheses than it needs."""
    return _formula(formula, _IMPLIES)


def _formula(formula: Formula, place: int) -> str:
    match formula:
        case Truth(value):
            return "true" if value else "false"
        case Atom(predicate, arguments):
            return atom_text(predicate, arguments)
        case Equality(left, right):
            return f"{left.name} = {right.name}"
        case Not(Equality(left, right)):
            return f"{left.name} != {right.name}"
        case Not(operand):
            strength, text = _NOT, f"not {_formula(operand, _NOT)}"
        case And(formulas):
            strength, text = _AND, " and ".join(_formula(f, _NOT) for f in formulas)
        case Or(formulas):
            strength, text = _OR, " or ".join(_formula(f, _AND) for f in formulas)
        case Implies(left, right):
            strength = _IMPLIES
            text = f"{_formula(left, _OR)} implies {_formula(right, _IMPLIES)}"
        case Exists(variables, body):
            return f"exists {variables_text(variables)} ({formula_text(body)})"
        case ForAll(variables, body):
            return f"forall {variables_text(variables)} ({formula_text(body)})"
        case Count(variables, body, comparison, number):
            quantified = f"count {variables_text(variables)} ({formula_text(body)})"
            return f"{quantified} {comparison} {number}"
    return text if strength >= place else f"({text})"


def atom_text(predicate: str, arguments: Iterable[Term]) -> str:
    """A predicate and its arguments; without arguments, no parentheses."""
    inside = ", ".join(argument.name for argument in arguments)
    return f"{predicate}({inside})" if inside else predicate


def variables_text(variables: Iterable[TypedVariable]) -> str:
    """Typed variables, those of one type together: ``x, y: block, z: robot | table``."""
    groups: list[tuple[list[str], tuple[str, ...]]] = []
    for variable in variables:
        if groups and groups[-1][1] == variable.types:
            groups[-1][0].append(variable.name)
        else:
            groups.append(([variable.name], variable.types))
    return ", ".join(f"{', '.join(names)}: {' | '.join(types)}" for names, types in groups)


def number_text(value: float) -> str:
    """A number that is not negative, as short as it can be read back exactly."""
    if value == int(value) and value < 1e16:
        return str(int(value))
    return repr(value)


_STRENGTH = {"+": 1, "-": 1, "*": 2, "/": 2}


def expression_text(expression: Expression) -> str:
    """An expression, with no more parentheses than it needs."""
    return _expression(expression, 0)


def _expression(expression: Expression, place: int) -> str:
    match expression:
        case Number(value):
            return number_text(value) if value >= 0 else f"-{number_text(-value)}"
        case ParamName(name):
            return name
        case Minus(operand):
            return f"-{_expression(operand, 3)}"
        case Arithmetic(operator, left, right):
            strength = _STRENGTH[operator]
            text = f"{_expression(left, strength)} {operator} {_expression(right, strength + 1)}"
            return text if strength >= place else f"({text})"


def cell_text(expression: Expression) -> str:
    """An expression as a cell of an outcome table: in parentheses unless it needs none."""
    match expression:
        case Number(value) if value >= 0:
            return number_text(value)
        case ParamName(name):
            return name
        case Arithmetic("/", Number(left), Number(right)) if (
            left.is_integer() and right.is_integer() and max(left, right) < 1e15
        ):
            return f"{number_text(left)}/{number_text(right)}"
        case _:
            return f"({expression_text(expression)})"


def literal_text(literal: Literal) -> str:
    """An effect's literal."""
    text = atom_text(literal.atom.predicate, literal.atom.arguments)
    return text if literal.positive else f"not {text}"


def effect_text(effect: Effect) -> str:
    """One effect of an outcome."""
    match effect:
        case Literal():
            return literal_text(effect)
        case ConditionalEffect(condition, effects):
            head = f"if {formula_text(condition)}"
        case _:
            variables = variables_text(effect.variables)
            head = f"forall {variables} where {formula_text(effect.condition)}"
            effects = effect.effects
    return f"{head} {{ {', '.join(literal_text(e) for e in effects)} }}"


def effects_text(effects: Iterable[Effect]) -> str:
    """The effects of an outcome; ``nothing`` if there are none."""
    return ", ".join(effect_text(e) for e in effects) or "nothing"
