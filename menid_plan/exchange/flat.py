"""Flat problems: what is left of a problem to be said in the languages of other planners.

A flat problem is a MENID problem like any other, with the same meaning as the one that it was made
from, but without what those languages lack: every action has one rule, without deictic references;
there are no derived predicates, no counts, no params, and one environment.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain, count

from menid_plan.errors import MeaningError, MenidError
from menid_plan.grounding.state import Binding, GroundAction, State, object_named
from menid_plan.grounding.steps import Covering
from menid_plan.model.domain import Domain, Problem
from menid_plan.model.expressions import EvaluationError, Expression, Minus, Number, evaluate
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
    Term,
    Truth,
    conjunction,
)
from menid_plan.model.probabilities import fault
from menid_plan.model.rules import Action, Rule
from menid_plan.source import Span


class NotExpressibleError(MenidError):
    """A language can't say something; the message names what, and where it stands."""

    exit_code = 4

    def __init__(self, what: str, span: Span | None = None) -> None:
        super().__init__(f"{span}: {what}" if span is not None else what)


@dataclass(frozen=True, slots=True)
class Call:
    """What an action of a flat problem stands for: an action of the problem that it was made from.

    ``arguments`` are objects, or parameters of the flat action. It is for one ``rule`` (empty: any),
    in which deictic references name the terms in ``references``, and for one ``state`` (None: any).
    """

    action: str
    arguments: tuple[Term, ...]
    rule: str = ""
    references: tuple[tuple[str, Term], ...] = ()
    state: State | None = None

    def bound(self, binding: Binding) -> GroundAction:
        """The ground action, given the objects of the flat action's parameters."""
        names = tuple(object_named(term, binding) for term in self.arguments)
        return GroundAction(self.action, names)

    def fits(self, covering: Covering, binding: Binding, state: State) -> bool:
        """Whether the flat action applies in a state in which its call is covered like that."""
        return (
            self.rule in ("", covering.rule.name)
            and self.state in (None, state)
            and all(
                covering.binding[name] == object_named(term, binding)
                for name, term in self.references
            )
        )


@dataclass(frozen=True, slots=True, eq=False)
class Flat:
    """A flat problem, and what each of its actions stands for, by the flat action's name.

    ``sunk`` is the predicate that holds once noise has led out of the model; empty if it can't.
    ``facts`` has what predicates stand for that are propositions.
    """

    domain: Domain
    problem: Problem
    calls: Mapping[str, Call]
    sunk: str = ""
    facts: Mapping[str, GroundAtom] = field(default_factory=dict)


# ------------------------------------------------------------------------------------------ numbers


def number(expression: Expression | None, params: Mapping[str, float], what: str) -> Expression:
    """The value of an expression as an expression; 0 for none. MeaningError if it has no value."""
    value = 0.0
    if expression is not None:
        try:
            value = evaluate(expression, params)
        except EvaluationError as error:
            raise MeaningError(f"{what}: {error}") from error
    return Number(value) if value >= 0 else Minus(Number(-value))


def value_of(expression: Expression | None) -> float:
    """The value of an expression of a flat problem, which has no params; 0 for none."""
    return 0.0 if expression is None else evaluate(expression, {})


def distribution(
    action: str, rule: Rule, environment: str, values: tuple[str, ...], params: Mapping[str, float]
) -> list[float]:
    """The probabilities of a rule's outcomes, noise last; they sum to 1.

    Raises MeaningError where nothing is written, or what is written is no distribution.
    """
    name = f"{action}.{rule.name}" + (f" for {', '.join(values)}" if values else "")
    where = f"{rule.span}: " if rule.span else ""
    cells = rule.probability_cells(environment, values)
    if cells is None:
        raise MeaningError(
            f"{where}rule {name} has no probabilities in the environment `{environment}`: write a "
            "column for it, or learn one with `menid learn`"
        )
    reason = fault(cells, params)
    if reason is not None:
        raise MeaningError(f"{where}rule {name}, environment `{environment}`: {reason}")
    chances = [evaluate(cell, params) for cell in cells]
    return [chance / sum(chances) for chance in chances]


# ----------------------------------------------------------------------------------------- formulas


def size_of(formula: Formula) -> int:
    """How many parts a formula has, written out; what stands in several places counts in each."""
    known: dict[int, int] = {}

    def size(each: Formula) -> int:
        if id(each) not in known:
            match each:
                case Truth() | Atom() | Equality():
                    known[id(each)] = 1
                case And(formulas) | Or(formulas):
                    known[id(each)] = 1 + sum(map(size, formulas))
                case Implies(left, right):
                    known[id(each)] = 1 + size(left) + size(right)
                case Not(inner) | Exists(_, inner) | ForAll(_, inner) | Count(_, inner):
                    known[id(each)] = 1 + size(inner)
        return known[id(each)]

    return size(formula)


# ------------------------------------------------------------------------------------------- actions


def unused(name: str, taken: Container[str]) -> str:
    """The name, with a number behind it if it is taken."""
    return next(n for n in chain([name], (f"{name}-{i}" for i in count(2))) if n not in taken)


def only_where(action: Action, condition: Formula) -> Action:
    """A flat action whose rule covers only where a condition holds, too."""
    (rule,) = action.rules
    return replace(
        action, rules=(replace(rule, condition=conjunction([condition, rule.condition])),)
    )
