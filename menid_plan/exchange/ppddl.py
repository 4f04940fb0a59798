"""PPDDL in the subset that its readers agree on (Younes and Littman 2004 for the language).

An action pays what it costs and what its outcome brings by changing ``(reward)``; the rewards of
states are paid by every action. What is left of the sum of an action's chances is no change.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from menid_plan.exchange.flat import Call, Flat, NotExpressibleError, value_of
from menid_plan.exchange.names import changed, names_for
from menid_plan.exchange.numbers import Numbers
from menid_plan.model.domain import OBJECT
from menid_plan.model.expressions import Expression
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
    Term,
    Truth,
    TypedVariable,
    Variable,
    subformulas,
)
from menid_plan.model.rules import Action, ConditionalEffect, Effect, Literal, Outcome, Rule

WIDTH = 100

RESERVED = frozenset(
    "and or not imply exists forall when probabilistic increase decrease assign scale-up scale-down"
    " either object number define domain problem goal reward total-time goal-achieved minimize"
    " maximize".split()
)

# An expression: a word, or a list of expressions.
Sexp: TypeAlias = "str | list[Sexp]"


@dataclass(frozen=True, slots=True)
class Written:
    """The texts of a domain and a problem, and what the names in them stand for.

    ``predicates`` and ``objects`` have the names that these got; ``calls`` has for the name of each
    action the names of its parameters, and what it stands for; ``renamed`` has, by the new ones, names
    that were changed since PPDDL has other uses for them, and ``rounded``, by the old ones, numbers
    that had to be changed by more than a little; ``sunk`` is the predicate that holds once noise has
    led out of the model, empty if it can't.
    """

    domain: str
    problem: str
    predicates: Mapping[str, str]
    objects: Mapping[str, str]
    calls: Mapping[str, tuple[tuple[str, ...], Call]]
    renamed: Mapping[str, str]
    rounded: Mapping[str, str]
    sunk: str = ""


def ppddl(flat: Flat) -> Written:
    """The texts of a flat problem.

    Discount and horizon have no place in the language and are told in a comment. Raises
    NotExpressibleError for a reward of dead ends, which an action can't know that it leads to.
    """
    return _Writer(flat).written()


class _Writer:
    def __init__(self, flat: Flat) -> None:
        d, p = flat.domain, flat.problem
        self.flat, self._domain, self._problem = flat, d, p
        self._types = names_for(((t.name, t.name) for t in d.types), RESERVED)
        self._types[OBJECT] = OBJECT
        self._predicates = names_for(((q.name, q.name) for q in d.predicates), RESERVED)
        objects = (*d.constants, *p.objects)
        self._objects = names_for(((o.name, o.name) for o in objects), RESERVED)
        self._actions = names_for(((a.name, a.name) for a in d.actions), RESERVED)
        self._variables: dict[str, str] = {}
        self._numbers = Numbers()

    def written(self) -> Written:
        p = self._problem
        if value_of(p.dead_end_reward):
            raise NotExpressibleError("PPDDL has no reward for dead ends", p.span)
        domain = "\n".join(self._domain_lines()) + "\n"
        problem = "\n".join(self._problem_lines()) + "\n"
        calls = {
            self._actions[a.name].lower(): (
                tuple(v.name for v in a.parameters), self.flat.calls[a.name]
            )
            for a in self._domain.actions
        }  # fmt: skip
        return Written(
            domain, problem, self._predicates, self._objects, calls, self._renamed,
            self._numbers.rounded, self.flat.sunk,
        )  # fmt: skip

    @property
    def _renamed(self) -> dict[str, str]:
        given = (self._types, self._predicates, self._objects, self._actions)
        return {new: old for names in given for new, old in changed(names).items()}

    # --------------------------------------------------------------------------------------- texts

    def _domain_lines(self) -> Iterator[str]:
        d = self._domain
        used = self._used_objects()
        yield from _comment(d.doc)
        yield from _comment("\n".join(f"{n} was called {old}." for n, old in self._renamed.items()))
        yield f"(define (domain {_name(d.name)})"
        yield "  (:requirements :adl :probabilistic-effects :rewards)"
        if d.types:
            yield "  (:types"
            for each in d.types:
                yield f"    {self._types[each.name]} - {self._types[each.parent]}"
            yield "  )"
        if used:
            yield "  (:constants"
            for thing in d.constants:
                if thing.name in used:
                    yield f"    {self._objects[thing.name]} - {self._types[thing.type]}"
            yield "  )"
        yield "  (:predicates"
        for predicate in d.predicates:
            arguments = (
                f"?x{i} - {_text(self._type(types))}"
                for i, types in enumerate(predicate.arguments, 1)
            )
            yield f"    ({' '.join([self._predicates[predicate.name], *arguments])})"
        yield "  )"
        for action in d.actions:
            yield from self._action(action)
        yield ")"

    def _problem_lines(self) -> Iterator[str]:
        d, p = self._domain, self._problem
        used = self._used_objects()
        yield from _comment(p.doc)
        if p.discount is not None:
            yield f"; discount {p.discount:g}"
        if p.horizon is not None:
            yield f"; horizon {p.horizon}"
        yield f"(define (problem {_name(p.name)})"
        yield f"  (:domain {_name(d.name)})"
        rest = [o for o in (*d.constants, *p.objects) if o.name not in used]
        if rest:
            yield "  (:objects"
            for each in rest:
                yield f"    {self._objects[each.name]} - {self._types[each.type]}"
            yield "  )"
        yield "  (:init"
        for atom in sorted(set(p.init)):
            names = (self._objects[name] for name in atom.arguments)
            yield f"    ({' '.join([self._predicates[atom.predicate], *names])})"
        yield "  )"
        if p.goal is not None:
            yield from _laid_out([":goal", self._formula(p.goal)], 2)
            reward = value_of(p.goal_reward)
            if reward:
                text = self._numbers.text(abs(reward))
                yield f"  (:goal-reward {text if reward > 0 else f'(- {text})'})"
        yield "  (:metric maximize (reward))"
        yield ")"

    def _used_objects(self) -> set[str]:
        """The objects that the domain speaks of by name."""
        formulas: list[Formula] = [reward.condition for reward in self._domain.rewards]
        for action in self._domain.actions:
            (rule,) = action.rules
            formulas.append(rule.condition)
            for outcome in rule.outcomes:
                formulas += [e.condition for e in outcome.effects if not isinstance(e, Literal)]
                formulas += [literal.atom for literal in outcome.literals]
        return {name for formula in formulas for name in _objects_in(formula)}

    def _action(self, action: Action) -> Iterator[str]:
        (rule,) = action.rules
        self._variables = {}
        parameters = self._typed(action.parameters)
        yield from _comment(action.doc, 2)
        yield f"  (:action {self._actions[action.name]}"
        yield f"    :parameters {_text(parameters)}"
        yield from _laid_out(self._formula(rule.condition), 4, ":precondition ")
        yield from _laid_out(self._effect(action, rule), 4, ":effect ")
        yield "  )"

    # ------------------------------------------------------------------------------------- effects

    def _effect(self, action: Action, rule: Rule) -> Sexp:
        parts = list(self._pay(action.cost, -1))
        for each in self._domain.rewards:
            for paid in self._pay(each.reward):
                known = dict(self._variables)
                variables = self._typed(each.variables)
                some: Sexp = paid
                if each.condition != Truth(True):
                    some = ["when", self._formula(each.condition), paid]
                parts.append(["forall", variables, some] if variables else some)
                self._variables = known
        chances = [value_of(outcome.cells[0]) for outcome in rule.outcomes]
        changes = [self._outcome(outcome) for outcome in rule.outcomes]
        together: dict[str, tuple[Sexp, float]] = {}
        for chance, change in zip(chances, changes, strict=True):
            if chance > 0:
                before = together.get(_text(change), (change, 0.0))[1]
                together[_text(change)] = (change, before + chance)
        unchanged = together.pop("(and)", None)  # what is left of 1 is no change
        if len(together) == 1 and unchanged is None:
            ((change, _),) = together.values()
            parts += change[1:] if change[0] == "and" else [change]
        elif together:
            chosen = [chance for _, chance in together.values()]
            texts = self._numbers.shares(chosen, whole=unchanged is None)
            choice: list[Sexp] = ["probabilistic"]
            for (change, _), text in zip(together.values(), texts, strict=True):
                choice += [text, change]
            parts.append(choice)
        return _all(parts)

    def _pay(self, expression: Expression | None, sign: int = 1) -> Iterator[Sexp]:
        """The effect that pays so much, unless it is 0."""
        value = sign * value_of(expression)
        text = self._numbers.text(abs(value))
        if text != "0":
            yield ["increase" if value > 0 else "decrease", ["reward"], text]

    def _outcome(self, outcome: Outcome) -> Sexp:
        parts: list[Sexp] = []
        for effect in outcome.effects:
            known = dict(self._variables)
            parts += self._changes(effect)
            self._variables = known
        return _all([*parts, *self._pay(outcome.reward)])

    def _changes(self, effect: Effect) -> list[Sexp]:
        match effect:
            case Literal():
                return [self._literal(effect)]
            case ConditionalEffect(condition, literals):
                inner = _all([self._literal(each) for each in literals])
                return [["when", self._formula(condition), inner]]
        variables = self._typed(effect.variables)
        inner = _all([self._literal(each) for each in effect.effects])
        if effect.condition != Truth(True):
            inner = ["when", self._formula(effect.condition), inner]
        return [["forall", variables, inner]]

    def _literal(self, literal: Literal) -> Sexp:
        atom = self._formula(literal.atom)
        return atom if literal.positive else ["not", atom]

    # ------------------------------------------------------------------------------------ formulas

    def _formula(self, formula: Formula) -> Sexp:
        match formula:
            case Truth(value):
                return ["and"] if value else ["or"]
            case Atom(predicate, arguments):
                return [self._predicates[predicate], *map(self._term, arguments)]
            case Equality(left, right):
                return ["=", self._term(left), self._term(right)]
            case Not(operand):
                return ["not", self._formula(operand)]
            case And(formulas):
                return ["and", *map(self._formula, formulas)]
            case Or(formulas):
                return ["or", *map(self._formula, formulas)]
            case Implies(left, right):
                return ["imply", self._formula(left), self._formula(right)]
            case Exists(variables, body) | ForAll(variables, body):
                word = "exists" if isinstance(formula, Exists) else "forall"
                known = dict(self._variables)
                found: Sexp = [word, self._typed(variables), self._formula(body)]
                self._variables = known
                return found
            case Count():  # pragma: no cover - a flat problem has none
                raise AssertionError(formula)

    def _term(self, term: Term) -> Sexp:
        if isinstance(term, Variable):
            return f"?{self._variables[term.name]}"
        return self._objects[term.name]

    def _typed(self, variables: Iterable[TypedVariable]) -> list[Sexp]:
        """Declares variables, which have names from then on that nothing around them has."""
        found: list[Sexp] = []
        for variable in variables:
            (name,) = names_for([(0, variable.name)], self._variables.values()).values()
            self._variables = {**self._variables, variable.name: name}
            found += [f"?{name}", "-", self._type(variable.types)]
        return found

    def _type(self, types: Sequence[str]) -> Sexp:
        names: list[Sexp] = [self._types[each] for each in types]
        return names[0] if len(names) == 1 else ["either", *names]


def _name(name: str) -> str:
    return names_for([(name, name)], RESERVED)[name]


def _objects_in(formula: Formula) -> Iterator[str]:
    """The objects that a formula names."""
    for each in subformulas(formula):
        match each:
            case Atom(_, arguments):
                yield from (term.name for term in arguments if isinstance(term, Constant))
            case Equality(left, right):
                yield from (term.name for term in (left, right) if isinstance(term, Constant))


def _all(parts: list[Sexp]) -> Sexp:
    return parts[0] if len(parts) == 1 else ["and", *parts]


# ------------------------------------------------------------------------------------------- layout


def _comment(text: str, indent: int = 0) -> Iterator[str]:
    for line in text.splitlines():
        yield f"{' ' * indent}; {line}".rstrip()


def _text(expression: Sexp) -> str:
    if isinstance(expression, str):
        return expression
    return f"({' '.join(map(_text, expression))})"


def _laid_out(expression: Sexp, indent: int, head: str = "") -> Iterator[str]:
    """The lines of an expression, on one line where it fits."""
    space = " " * indent
    text = f"{space}{head}{_text(expression)}"
    if len(text) <= WIDTH or isinstance(expression, str):
        yield text
        return
    # What comes before the first list stays on the first line, and so do declared variables.
    first = next(
        (i for i, each in enumerate(expression) if i and not isinstance(each, str)), len(expression)
    )
    if expression[0] in ("exists", "forall", "when", ":goal") and len(expression) > first + 1:
        first += 1
    if expression[0] == "probabilistic":
        yield f"{space}{head}(probabilistic"
        for chance, change in zip(expression[1::2], expression[2::2], strict=True):
            yield from _laid_out(change, indent + 2, f"{_text(chance)} ")
    else:
        yield f"{space}{head}({' '.join(map(_text, expression[:first]))}"
        for each in expression[first:]:
            yield from _laid_out(each, indent + 2)
    yield f"{space})"
