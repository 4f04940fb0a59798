"""Why a formula does not hold in a state, in sentences for the reader of `menid explain`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from menid_plan.grounding.formulas import UNBOUND
from menid_plan.grounding.semantics import Semantics
from menid_plan.grounding.state import Binding, World, binding_text, extended, object_named
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
    Truth,
    TypedVariable,
)
from menid_plan.model.text import formula_text, variables_text
from menid_plan.model.variables import bound, replaced


def conjuncts(formula: Formula) -> Iterator[Formula]:
    """The formulas that a conjunction joins, nested ones too; any other formula alone."""
    if isinstance(formula, And):
        for part in formula.formulas:
            yield from conjuncts(part)
    else:
        yield formula


def failed_conjuncts(
    semantics: Semantics, formula: Formula, world: World, binding: Binding
) -> list[tuple[str, str]]:
    """The conjuncts of a formula that do not hold: the text of each, and why it does not."""
    return [
        (formula_text(part), why_not(semantics, part, world))
        for part in conjuncts(replaced(formula, bound(binding)))
        if not semantics.holds(part, world)
    ]


def why_not(semantics: Semantics, formula: Formula, world: World) -> str:
    """Why a formula without free variables is false in a world, as a sentence without a full stop.

    A derived predicate is followed into its definition once, not further.
    """
    match formula:
        case Atom(predicate, arguments):
            text = f"{_quoted(formula)} does not hold"
            for derived in semantics.domain.derived:
                if derived.name == predicate:
                    objects = [object_named(t, UNBOUND) for t in arguments]
                    binding = extended(UNBOUND, derived.parameters, objects)
                    definition = replaced(derived.formula, bound(binding))
                    return f"{text} because {_directly(semantics, definition, world)}"
            return text
        case And():
            failed = [f for f in conjuncts(formula) if not semantics.holds(f, world)]
            return ", and ".join(why_not(semantics, f, world) for f in failed)
        case _:
            return _directly(semantics, formula, world)


def _directly(semantics: Semantics, formula: Formula, world: World) -> str:
    """Why a formula is false, in terms of its parts and not of what derived predicates say."""
    match formula:
        case Not(Equality(left, right)):
            return f"both sides of `{left.name} != {right.name}` are the same object"
        case Not(Exists(variables, body)):
            found = _first(semantics, variables, body, world)
            return f"{_quoted(Exists(variables, body))} holds, with {found}"
        case Not(operand):
            return f"{_quoted(operand)} holds"
        case And():
            failed = [f for f in conjuncts(formula) if not semantics.holds(f, world)]
            return ", and ".join(_directly(semantics, f, world) for f in failed)
        case Or(formulas):
            return f"none of {', '.join(_quoted(f) for f in formulas)} holds"
        case Implies(premise, conclusion):
            return f"{_quoted(premise)} holds and {_quoted(conclusion)} does not"
        case Exists(variables, body):
            return f"no {variables_text(variables)} satisfies {_quoted(body)}"
        case ForAll(variables, body):
            counterexample = _first(semantics, variables, Not(body), world)
            return f"{_quoted(formula)} is false for {counterexample}"
        case Count(variables, body, _, _):
            count = len(semantics.satisfying(variables, body, world))
            return f"the count in {_quoted(formula)} is {count}"
        case Equality(left, right):
            return f"`{left.name}` and `{right.name}` are different objects"
        case Truth():
            return f"{_quoted(formula)} never holds"
        case Atom():
            return f"{_quoted(formula)} does not hold"


def _first(
    semantics: Semantics, variables: Sequence[TypedVariable], formula: Formula, world: World
) -> str:
    """The binding of the first tuple that satisfies a formula; one is known to."""
    with semantics.formulas.task("a formula"):
        objects = next(semantics.formulas.satisfying(variables, formula, world))
    return binding_text(extended(UNBOUND, variables, objects))


def _quoted(formula: Formula) -> str:
    return f"`{formula_text(formula)}`"
