"""Short constructors for models in tests, and the example domain of the reference.

A term is a string: ``?x`` is the variable x, any other the constant or object of that name.
"""

from __future__ import annotations

from menid_plan.model.domain import (
    DerivedPredicate,
    Domain,
    Environment,
    Object,
    Param,
    Predicate,
    Problem,
    StateReward,
    Type,
)
from menid_plan.model.expressions import Expression, Minus, Number, ParamName
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
    GroundAtom,
    Not,
    Or,
    Term,
    TypedVariable,
    Variable,
)
from menid_plan.model.rules import Action, Effect, Literal, Outcome, Reference, Rule


def term(text: str) -> Term:
    return Variable(text[1:]) if text.startswith("?") else Constant(text)


def atom(predicate: str, *terms: str) -> Atom:
    return Atom(predicate, tuple(map(term, terms)))


def equal(left: str, right: str) -> Equality:
    return Equality(term(left), term(right))


def both(*formulas: Formula) -> And:
    return And(formulas)


def either(*formulas: Formula) -> Or:
    return Or(formulas)


def var(name: str, *types: str) -> TypedVariable:
    return TypedVariable(name, types or ("object",))


def exists(variable: TypedVariable, formula: Formula) -> Exists:
    return Exists((variable,), formula)


def forall(variable: TypedVariable, formula: Formula) -> ForAll:
    return ForAll((variable,), formula)


def at_least(number: int, variable: TypedVariable, formula: Formula) -> Count:
    return Count((variable,), formula, ">=", number)


def add(predicate: str, *terms: str) -> Literal:
    return Literal(atom(predicate, *terms))


def delete(predicate: str, *terms: str) -> Literal:
    return Literal(atom(predicate, *terms), positive=False)


def fact(predicate: str, *objects: str) -> GroundAtom:
    return GroundAtom(predicate, objects)


def state(*facts: str) -> frozenset[GroundAtom]:
    """``state("in board tray", "done")``."""
    return frozenset(fact(*text.split()) for text in facts)


def number(value: float | str | None) -> Expression:
    assert value is not None
    if isinstance(value, str):
        return ParamName(value)
    return Number(value) if value >= 0 else Minus(Number(-value))


def outcome(
    name: str,
    cells: float | tuple[float, ...] | None,
    *effects: Effect,
    reward: float | str | None = None,
) -> Outcome:
    values = () if cells is None else cells if isinstance(cells, tuple) else (cells,)
    return Outcome(
        name, tuple(map(number, values)), effects, None if reward is None else number(reward)
    )


def rule(name: str, *outcomes: Outcome, when: Formula = TRUE, **options: object) -> Rule:
    """A rule; the noise outcome is put at the end if it is not given."""
    if not outcomes or outcomes[-1].name != "noise":
        outcomes = (*outcomes, Outcome("noise"))
    return Rule(name, outcomes, condition=when, **options)  # type: ignore[arg-type]


def the(formula: Formula, *variables: TypedVariable) -> Reference:
    return Reference(variables, formula)


def sure(name: str = "r", *effects: Effect, when: Formula = TRUE, **options: object) -> Rule:
    """A rule with one outcome, of probability 1."""
    return rule(name, outcome("done", 1, *effects), when=when, **options)


def objects(**by_type: str) -> tuple[Object, ...]:
    """``objects(pcb="board", bay="tray t2")``."""
    return tuple(Object(name, t) for t, names in by_type.items() for name in names.split())


def hdd() -> tuple[Domain, Problem]:
    """The domain and problem that open the language's reference."""
    in_bay = atom("in", "?p", "?b")
    where_in = the(in_bay, var("p", "pcb"), var("b", "bay"))
    freed = (delete("in", "?p", "?b"), add("on-table", "?p"))
    seated = rule(
        "seated",
        Outcome("freed", tuple(map(Number, (0.55, 0.50, 0.70))), freed, ParamName("win")),
        Outcome(
            "shifted",
            tuple(map(Number, (0.15, 0.20, 0.10))),
            (add("loose", "?p"),),
            Minus(ParamName("fail")),
        ),
        Outcome("held", tuple(map(Number, (0.25, 0.25, 0.15))), (), Minus(ParamName("fail"))),
        Outcome("noise", tuple(map(Number, (0.05, 0.05, 0.05))), (), Minus(ParamName("fail"))),
        per=("e",),
        references=(where_in,),
        when=Not(atom("loose", "?p")),
        environments=("robot", "fine", "coarse"),
    )
    already_loose = rule(
        "already-loose",
        Outcome(
            "freed",
            (Number(0.9),),
            (delete("in", "?p", "?b"), delete("loose", "?p"), add("on-table", "?p")),
            ParamName("win"),
        ),
        outcome("held", 0.1),
        references=(where_in,),
        when=atom("loose", "?p"),
    )
    p = var("p", "pcb")
    domain = Domain(
        "hdd",
        types=(
            Type("part"),
            Type("pcb", "part"),
            Type("bay", "part"),
            *map(Type, ("edge", "sway", "spot", "pressure")),
        ),
        params=(Param("win", Number(1)), Param("fail", Number(5))),
        environments=(
            Environment("robot", "target"),
            Environment("fine", "test"),
            Environment("coarse", "test"),
        ),
        predicates=(
            Predicate("in", (("pcb",), ("bay",))),
            Predicate("loose", (("pcb",),)),
            Predicate("on-table", (("part",),)),
        ),
        derived=(
            DerivedPredicate("clear", (p,), Not(exists(var("b", "bay"), in_bay))),
            DerivedPredicate("done", (), forall(p, atom("clear", "?p"))),
        ),
        rewards=(
            StateReward(
                Minus(Number(1)), exists(p, both(atom("loose", "?p"), atom("on-table", "?p")))
            ),
        ),
        actions=(Action("lever", (seated, already_loose), (var("e", "edge"),), cost=Number(0.1)),),
    )
    problem = Problem(
        "one-drive",
        "hdd",
        params=(Param("fail", Number(10)),),
        objects=objects(
            pcb="board",
            bay="tray",
            edge=" ".join(f"n{i}" for i in range(1, 21)),
            pressure="weak strong",
        ),
        init=(fact("in", "board", "tray"),),
        goal=atom("done"),
        horizon=40,
        discount=0.99,
    )
    return domain, problem
