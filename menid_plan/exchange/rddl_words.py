"""Formulas and numbers in the words of RDDL, with names that its readers accept."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from decimal import Decimal
from textwrap import indent

from menid_plan.exchange.names import names_for
from menid_plan.exchange.rddl_model import APPLIED, APPLYING, PLAYED, STOPPED, Model, drawn
from menid_plan.model.domain import OBJECT
from menid_plan.model.formulas import (
    TRUE,
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
    conjunction,
)

WIDTH = 90

# What pyRDDLGym, PROST and rddlsim keep for themselves.
RESERVED = frozenset(
    "domain instance horizon discount objects requirements types object bool int real pvariables level"
    " default terminal cpfs cdfs reward policy termination forall exists sum prod product argmax argmin"
    " min max avg true false if then else switch case otherwise krondelta diracdelta uniform bernoulli"
    " discrete unnormdiscrete normal poisson exponential exp weibull gamma gama binomial"
    " negativebinomial beta geometric pareto student gumbel laplace cauchy gompertz chisquare"
    " kumaraswamy multivariatenormal multivariatestudent dirichlet dirichelt multinomial det inverse"
    " pinverse cholesky row col abs sgn round floor ceil sqrt cos sin tan acos asin atan cosh sinh tanh"
    " ln log gammaln pow div mod fmod hypot noop time".split()
)


def plain(name: str, taken: Iterable[str] = ()) -> str:
    """A name of RDDL: a hyphen may be taken for a minus there, and none ends with ``_``."""
    return names_for([(0, name.rstrip("-_'"))], (*RESERVED, *taken), hyphen=False)[0]


class Words:
    """Writes the formulas of a model.

    ``names`` has a name for each predicate, and for all else by the keys of `rddl_model`. Beside
    those, ``outcome a`` is the fluent for the outcome that was drawn, ``outcomes a`` its type,
    ``chance a o`` a probability, ``class c`` a type, ``object o`` an object, and ``the o`` holds of
    that object alone. ``classes``, ``types`` and ``named`` collect what formulas spoke of: classes of
    objects, types within them, objects by name.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self.names = _names(model)
        self.classes: dict[str, None] = {}
        self.types: dict[str, None] = {}
        self.named: dict[str, None] = {}
        # Next to the dynamic predicates, nothing that a primed formula speaks of changes.
        self._primed = {predicate.name for predicate in model.dynamic}
        self._object_types = {each.name: each.type for each in model.objects}
        self._variables: dict[str, str] = {}
        self._ranges: dict[str, str] = {}  # the classes of variables

    def formula(self, formula: Formula, *, primed: bool = False) -> str:
        """A formula of this step's state, or ``primed``, of the next one's."""

        def inner(each: Formula) -> str:
            return self.formula(each, primed=primed)

        match formula:
            case Truth(value):
                return "true" if value else "false"
            case Atom():
                return self.atom(formula, primed=primed)
            case Equality(left, right):
                return self._equality(left, right)
            case Not(operand):
                return f"(~{inner(operand)})"
            case And(formulas):
                return infix("^", list(map(inner, formulas)))
            case Or(formulas):
                return infix("|", list(map(inner, formulas)))
            case Implies(left, right):
                return infix("=>", [inner(left), inner(right)])
            case Exists(variables, body):
                with self.declared(variables) as (listed, guard):
                    return _bracketed(f"exists_{{{listed}}}", inner(conjunction([guard, body])))
            case ForAll(variables, body):
                with self.declared(variables) as (listed, guard):
                    whole = body if guard == TRUE else Implies(guard, body)
                    return _bracketed(f"forall_{{{listed}}}", inner(whole))
            case Count():  # pragma: no cover - a flat problem has none
                raise AssertionError(formula)

    def atom(self, atom: Atom, *, primed: bool = False) -> str:
        """An atom. Objects have no names in RDDL: where one is named, there is a guard for it."""
        kind, _, rest = atom.predicate.partition(" ")
        if kind == "drawn" and rest:
            action, _, _ = rest.partition(" ")
            return f"({self.names[f'outcome {action}']} == @{self.names[atom.predicate]})"
        if kind == "is" and rest:
            self.types[rest] = None
        constants = [term.name for term in atom.arguments if isinstance(term, Constant)]
        variables = tuple(
            TypedVariable(f"{i} {name}", self.model.classes.whole((self._object_types[name],)))
            for i, name in enumerate(constants)
        )
        with self.declared(variables) as (listed, _):
            stands = iter(Variable(variable.name) for variable in variables)
            arguments = [next(stands) if isinstance(t, Constant) else t for t in atom.arguments]
            text = self.names[atom.predicate] + ("'" if self._has_prime(atom, primed) else "")
            if arguments:
                text += f"({', '.join(f'?{self._variables[t.name]}' for t in arguments)})"
            if not constants:
                return text
            guards = [
                self._is(Variable(variable.name), name)
                for variable, name in zip(variables, constants, strict=True)
            ]
            return _bracketed(f"exists_{{{listed}}}", infix("^", [*guards, text]))

    def _has_prime(self, atom: Atom, primed: bool) -> bool:
        return primed and atom.predicate in self._primed

    def _is(self, variable: Variable, name: str) -> str:
        self.named[name] = None
        return self.atom(Atom(f"the {name}", (variable,)))

    def _class(self, term: Term) -> str:
        if isinstance(term, Variable):
            return self._ranges[term.name]
        return self.model.classes.of[self._object_types[term.name]]

    def _equality(self, left: Term, right: Term) -> str:
        if self._class(left) != self._class(right):  # what RDDL does not let one ask
            return "false"
        match left, right:
            case Variable(), Variable():
                return f"(?{self._variables[left.name]} == ?{self._variables[right.name]})"
            case Variable(), Constant():
                return self._is(left, right.name)
            case Constant(), Variable():
                return self._is(right, left.name)
        return "true" if left == right else "false"

    @contextmanager
    def declared(self, variables: Iterable[TypedVariable]) -> Iterator[tuple[str, Formula]]:
        """While it lasts, variables have names; gives how they are declared, and their guard."""
        known = self._variables, self._ranges
        listed, guards = [], []
        for variable in variables:
            name = plain(variable.name.split(" ")[-1], self._variables.values())
            self._variables = {**self._variables, variable.name: name}
            range_ = self.model.classes.of[variable.types[0]]
            self._ranges = {**self._ranges, variable.name: range_}
            listed.append(f"?{name} : {self.class_of(variable.types)}")
            guards.append(self.model.guard(variable.types, Variable(variable.name)))
        try:
            yield ", ".join(listed), conjunction(guards)
        finally:
            self._variables, self._ranges = known

    def class_of(self, types: Sequence[str]) -> str:
        """The name of the class that types are of."""
        name = self.model.classes.of[types[0]]
        self.classes[name] = None
        return self.names[f"class {name}"]

    def declaration(self, key: str, types: Iterable[Sequence[str]], what: str) -> str:
        """A line that declares a fluent."""
        arguments = ", ".join(map(self.class_of, types))
        return f"{self.names[key]}{f'({arguments})' if arguments else ''} : {{{what}}};"

    def assignment(self, key: str, objects: Iterable[str], value: str) -> str:
        """A line that gives a fluent of some objects a value."""
        arguments = ", ".join(self.names[f"object {name}"] for name in objects)
        return f"{self.names[key]}{f'({arguments})' if arguments else ''} = {value};"

    @property
    def given(self) -> dict[str, str]:
        """What predicates, objects, actions and types are called, by what they were called."""
        found = {}
        for key, name in self.names.items():
            kind, _, rest = key.partition(" ")
            if not rest or kind in ("object", "act") or (kind == "class" and rest in self.classes):
                found[rest or kind] = name
        return found


def _names(model: Model) -> dict[str, str]:
    wanted = [(p.name, p.name) for p in (*model.dynamic, *model.static)]
    wanted += [(f"object {o.name}", o.name) for o in model.objects]
    wanted += [(f"act {action.name}", action.name) for action in model.actions]
    for name in dict.fromkeys(model.classes.of.values()):
        wanted.append((f"class {name}", "thing" if name == OBJECT else name))
    wanted += [(f"is {name}", f"is_{name}") for name in model.classes.of]
    wanted += [(f"the {o.name}", f"is_{o.name}") for o in model.objects]
    wanted += [(APPLYING, "applying"), (APPLIED, "applied"), (STOPPED, "stopped")]
    wanted.append((PLAYED, "played"))
    for action in model.actions:
        name = action.name
        wanted += [
            (f"{kind} {name}", f"{kind}_{name}") for kind in ("doing", "outcome", "outcomes")
        ]
        for _, outcome in model.outcomes(action):
            wanted.append((drawn(action, outcome).predicate, f"{name}_{outcome.name}"))
            wanted.append((f"chance {name} {outcome.name}", f"P_{name}_{outcome.name}"))
    return names_for(((key, name.rstrip("-_'")) for key, name in wanted), RESERVED, hyphen=False)


# --------------------------------------------------------------------------------------------- texts


def number(value: float) -> str:
    """A number that is not negative, in plain decimals."""
    text = format(Decimal(repr(value)), "f")
    return text if "." in text else f"{text}.0"


def total(terms: Iterable[tuple[float, str]]) -> str:
    """A sum of multiples, each of which is not 0."""
    found: list[str] = []
    for value, text in terms:
        size = text if abs(value) == 1 else f"{number(abs(value))} * {text}"
        sign = "- " if value < 0 else "+ " if found else ""
        found.append(("0.0 " if value < 0 and not found else "") + sign + size)
    return f"({indent(chr(10).join(found), ' ').lstrip()})" if found else "0.0"


def when(condition: str, value: str = "1.0", rest: str = "0.0") -> str:
    """A value where a condition holds."""
    asked = condition if condition.startswith("(") else f"({condition})"
    gap = "" if value.startswith("\n") else " "
    return f"(if {asked} then{gap}{value} else {rest})"


def infix(operator: str, parts: Sequence[str]) -> str:
    """Parts with an operator between them, on one line where they fit."""
    line = f" {operator} ".join(parts)
    if len(line) <= WIDTH and "\n" not in line:
        return f"({line})"
    return "(" + indent(f"\n{operator} ".join(parts), " ").lstrip() + ")"


def _bracketed(head: str, body: str) -> str:
    if len(head) + len(body) <= WIDTH and "\n" not in body:
        return f"({head} [{body}])"
    return f"({head} [\n{indent(body, '  ')}])"
