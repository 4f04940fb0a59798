"""Free variables of formulas, and other terms in their place."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import count

from menid_plan.model.formulas import (
    And,
    Atom,
    Constant,
    Count,
    Equality,
    Exists,
    ForAll,
    Formula,
    Implies,
    Not,
    Or,
    Quantified,
    Term,
    Truth,
    TypedVariable,
    Variable,
)


def free_variables(formula: Formula) -> set[str]:
    """The names of the variables that a formula speaks of and does not bind itself."""
    match formula:
        case Truth():
            return set()
        case Atom(_, arguments):
            return {term.name for term in arguments if isinstance(term, Variable)}
        case Equality(left, right):
            return {term.name for term in (left, right) if isinstance(term, Variable)}
        case Not(operand):
            return free_variables(operand)
        case And(formulas) | Or(formulas):
            return {name for operand in formulas for name in free_variables(operand)}
        case Implies(left, right):
            return free_variables(left) | free_variables(right)
        case Exists(variables, body) | ForAll(variables, body) | Count(variables, body):
            return free_variables(body) - {variable.name for variable in variables}


def bound(binding: Mapping[str, str]) -> dict[str, Term]:
    """A binding as terms to be put in: each variable's object."""
    return {variable: Constant(name) for variable, name in binding.items()}


def put_in(term: Term, terms: Mapping[str, Term]) -> Term:
    """A term, or what is to stand in its place if it is a variable."""
    return terms.get(term.name, term) if isinstance(term, Variable) else term


def replaced(formula: Formula, terms: Mapping[str, Term]) -> Formula:
    """A formula with terms in the place of its free variables.

    A variable that it binds gets a new name where it would catch one of those that are put in.
    """
    match formula:
        case Truth():
            return formula
        case Atom(predicate, arguments):
            return Atom(predicate, tuple(put_in(term, terms) for term in arguments))
        case Equality(left, right):
            return Equality(put_in(left, terms), put_in(right, terms))
        case Not(operand):
            return Not(replaced(operand, terms))
        case And(formulas):
            return And(tuple(replaced(f, terms) for f in formulas))
        case Or(formulas):
            return Or(tuple(replaced(f, terms) for f in formulas))
        case Implies(premise, conclusion):
            return Implies(replaced(premise, terms), replaced(conclusion, terms))
        case Exists():
            return Exists(*_inside(formula, terms))
        case ForAll():
            return ForAll(*_inside(formula, terms))
        case Count(_, _, comparison, number):
            return Count(*_inside(formula, terms), comparison, number)


def told_apart(formula: Formula, taken: Iterable[str]) -> Formula:
    """A formula in which no bound variable is called like one around it, or one that is taken."""
    match formula:
        case Truth() | Atom() | Equality():
            return formula
        case Not(operand):
            return Not(told_apart(operand, taken))
        case And(formulas):
            return And(tuple(told_apart(f, taken) for f in formulas))
        case Or(formulas):
            return Or(tuple(told_apart(f, taken) for f in formulas))
        case Implies(premise, conclusion):
            return Implies(told_apart(premise, taken), told_apart(conclusion, taken))
        case Exists(variables, body) | ForAll(variables, body) | Count(variables, body):
            own, terms = renamed(variables, taken)
            inner = {*taken, *(variable.name for variable in own)}
            body = told_apart(replaced(body, terms) if terms else body, inner)
            if isinstance(formula, Count):
                return Count(own, body, formula.comparison, formula.number)
            return type(formula)(own, body)


def renamed(
    variables: Iterable[TypedVariable], taken: Iterable[str]
) -> tuple[tuple[TypedVariable, ...], dict[str, Term]]:
    """Variables with other names than those that are taken, and what stands for the old ones."""
    known = set(taken)
    found: list[TypedVariable] = []
    terms: dict[str, Term] = {}
    for variable in variables:
        name = variable.name
        if name in known:
            name = next(n for i in count(2) if (n := f"{variable.name}{i}") not in known)
            terms[variable.name] = Variable(name)
        known.add(name)
        found.append(TypedVariable(name, variable.types))
    return tuple(found), terms


def _inside(
    formula: Quantified, terms: Mapping[str, Term]
) -> tuple[tuple[TypedVariable, ...], Formula]:
    """The variables and the body of a quantified formula, with terms put in."""
    own = {variable.name for variable in formula.variables}
    inner = {name: term for name, term in terms.items() if name not in own}
    caught = {term.name for term in inner.values() if isinstance(term, Variable)}
    if not own & caught:
        return formula.variables, replaced(formula.formula, inner)
    free = free_variables(formula.formula) - own
    variables, new = renamed(formula.variables, own | free | caught)
    return variables, replaced(formula.formula, {**inner, **new})
