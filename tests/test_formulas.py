"""Which formulas hold and which atoms are derived: the section Formulas and the least model."""

from __future__ import annotations

import operator
import time
from collections.abc import Iterable, Mapping
from itertools import chain, combinations, product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from menid_plan.errors import LimitError
from menid_plan.grounding.formulas import WORK_LIMIT
from menid_plan.grounding.recent import Recent
from menid_plan.grounding.semantics import Semantics
from menid_plan.grounding.state import state_text
from menid_plan.model.domain import DerivedPredicate, Domain, Object, Problem, Type
from menid_plan.model.formulas import (
    FALSE,
    TRUE,
    Count,
    Exists,
    ForAll,
    Formula,
    GroundAtom,
    Implies,
    Not,
)
from models import (
    at_least,
    atom,
    both,
    either,
    equal,
    exists,
    fact,
    forall,
    objects,
    state,
    var,
)

TYPES = (Type("block"), Type("cube", "block"), Type("robot"), Type("ghost"))


def semantics(*derived: DerivedPredicate, **options: int) -> Semantics:
    domain = Domain("d", types=TYPES, constants=objects(block="floor"), derived=derived)
    problem = Problem("x", "d", objects=objects(cube="a", block="b", robot="r"))
    return Semantics(domain, problem, **options)  # type: ignore[arg-type]


X, Y, Z = var("x", "block"), var("y", "block"), var("z", "block")
CUBE, ROBOT, GHOST, ANY = var("x", "cube"), var("x", "robot"), var("x", "ghost"), var("x")
P = atom("p", "?x")


def test_constants_of_the_domain_come_before_the_objects_of_the_problem() -> None:
    assert semantics().objects == ("floor", "a", "b", "r")


@pytest.mark.parametrize(
    ("variable", "expected"),
    [
        (X, ["floor", "a", "b"]),
        (CUBE, ["a"]),
        (ANY, ["floor", "a", "b", "r"]),
        (GHOST, []),
        (var("x", "robot", "block"), ["floor", "a", "b", "r"]),
        (var("x", "block", "cube"), ["floor", "a", "b"]),
    ],
)
def test_a_variable_ranges_over_the_objects_of_its_types(variable, expected) -> None:  # type: ignore[no-untyped-def]
    assert list(semantics().bindings((variable,))) == [(name,) for name in expected]


def test_several_variables_range_over_tuples_and_may_name_one_object_twice() -> None:
    assert list(semantics().bindings((CUBE, Y))) == [("a", "floor"), ("a", "a"), ("a", "b")]
    assert list(semantics().bindings(())) == [()]


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        (TRUE, True),
        (FALSE, False),
        (atom("p", "a"), True),
        (atom("p", "b"), False),
        (atom("q"), True),
        (atom("s"), False),
        (Not(atom("s")), True),
        (equal("a", "a"), True),
        (equal("a", "b"), False),
        (Not(equal("a", "r")), True),  # of types that have no object in common
        (both(atom("q"), atom("p", "a")), True),
        (both(atom("q"), atom("s")), False),
        (either(atom("s"), atom("q")), True),
        (either(atom("s"), FALSE), False),
        (Implies(atom("s"), FALSE), True),
        (Implies(atom("q"), atom("s")), False),
        (Implies(atom("q"), atom("p", "a")), True),
        (exists(X, P), True),
        (exists(ROBOT, P), False),
        (forall(X, P), False),
        (forall(CUBE, P), True),
        (forall(X, either(P, Not(equal("?x", "a")))), True),
        (exists(GHOST, TRUE), False),
        (forall(GHOST, FALSE), True),
        (Exists((X, GHOST), TRUE), False),
        (ForAll((X, GHOST), FALSE), True),
        (forall(X, exists(Y, atom("on", "?x", "?y"))), False),
        (exists(X, exists(Y, atom("on", "?x", "?y"))), True),
        (exists(Y, forall(CUBE, atom("on", "?x", "?y"))), True),
        (at_least(1, X, P), True),
        (at_least(2, X, P), False),
        (Count((X, Y), TRUE, "=", 9), True),  # tuples, not objects
        (Count((X, Y), Not(equal("?x", "?y")), "=", 6), True),
        (Count((GHOST,), TRUE, "=", 0), True),
    ],
)
def test_hand_computed(formula: Formula, expected: bool) -> None:
    world = state("p a", "q", "on a b")
    assert semantics().holds(formula, world) is expected


@pytest.mark.parametrize("comparison", ["=", "!=", "<", "<=", ">", ">="])
@pytest.mark.parametrize("number", [0, 1, 2, 3, 4])
def test_count_compares(comparison: str, number: int) -> None:
    meaning = {
        "=": operator.eq,
        "!=": operator.ne,
        "<": operator.lt,
        "<=": operator.le,
        ">": operator.gt,
        ">=": operator.ge,
    }[comparison]
    formula = Count((X,), P, comparison, number)  # type: ignore[arg-type]
    assert semantics().holds(formula, state("p a", "p b", "p r")) is meaning(2, number)


def test_a_formula_sees_the_binding_around_it() -> None:
    formula = exists(Y, both(atom("on", "?x", "?y"), Not(equal("?x", "?y"))))
    world = state("on a a", "on b a")
    assert [semantics().holds(formula, world, {"x": name}) for name in "ab"] == [False, True]


def test_a_variable_is_not_the_object_of_its_name() -> None:
    world = state("p a")
    assert semantics().holds(atom("p", "a"), world, {"a": "b"})
    assert not semantics().holds(atom("p", "?a"), world, {"a": "b"})


def test_satisfying_gives_tuples_in_order() -> None:
    found = semantics().satisfying((X, Y), atom("on", "?x", "?y"), state("on b a", "on a b"))
    assert found == [("a", "b"), ("b", "a")]


# Derived predicates -------------------------------------------------------------------------------

ABOVE = DerivedPredicate(
    "above",
    (X, Y),
    either(
        atom("on", "?x", "?y"), exists(Z, both(atom("on", "?x", "?z"), atom("above", "?z", "?y")))
    ),
)


def derived_atoms(meaning: Semantics, *facts: str) -> str:
    return state_text(meaning.complete(state(*facts)) - state(*facts))


def test_a_recursive_derived_predicate_is_the_least_model() -> None:
    expected = "above(a, b), above(a, floor), above(b, floor)"
    assert derived_atoms(semantics(ABOVE), "on a b", "on b floor") == expected


def test_what_supports_only_itself_does_not_hold() -> None:
    loop = DerivedPredicate("p", (), either(atom("q"), atom("basic")))
    back = DerivedPredicate("q", (), atom("p"))
    assert derived_atoms(semantics(loop, back)) == "nothing"
    assert derived_atoms(semantics(loop, back), "basic") == "p, q"


def test_a_cycle_of_facts_ends() -> None:
    expected = "above(a, a), above(a, b), above(b, a), above(b, b)"
    assert derived_atoms(semantics(ABOVE), "on a b", "on b a") == expected


def test_negation_waits_for_the_stratum_below() -> None:
    """``top`` is declared first and negates a predicate that takes several rounds."""
    top = DerivedPredicate("top", (X,), Not(exists(Y, atom("above", "?y", "?x"))))
    covered = DerivedPredicate("covered", (X,), Not(atom("top", "?x")))
    meaning = semantics(covered, top, ABOVE)
    world = meaning.complete(state("on a b", "on b floor"))
    assert {a for a in world if a.predicate in ("top", "covered")} == {
        fact("top", "a"),
        fact("covered", "b"),
        fact("covered", "floor"),
    }


def test_a_count_that_grows_with_its_own_predicate() -> None:
    """An infection: two infected neighbours infect."""
    infected = DerivedPredicate(
        "infected",
        (X,),
        either(
            atom("sick", "?x"),
            at_least(2, Y, both(atom("near", "?x", "?y"), atom("infected", "?y"))),
        ),
    )
    near = ("near b a", "near b floor", "near floor a")
    meaning = semantics(infected)
    assert derived_atoms(meaning, "sick a", *near) == "infected(a)"
    assert derived_atoms(meaning, "sick a", "sick floor", *near) == (
        "infected(a), infected(b), infected(floor)"
    )


def test_states_that_share_atoms_have_derived_atoms_of_their_own() -> None:
    """What is remembered of one state is used for another only as far as both agree."""
    lit = DerivedPredicate(
        "lit", (X,), exists(Y, both(atom("lamp", "?y"), atom("above", "?y", "?x")))
    )
    meaning = semantics(ABOVE, lit)
    tower = ("on a b", "on b floor")
    assert "lit(b), lit(floor)" in derived_atoms(meaning, *tower, "lamp a")
    assert derived_atoms(meaning, *tower, "lamp b").endswith("lit(floor)")
    assert derived_atoms(meaning, "on a b", "lamp a") == "above(a, b), lit(b)"
    assert "lit" not in derived_atoms(meaning, *tower)


def test_what_is_remembered_is_bounded() -> None:
    recent: Recent[int, int] = Recent()
    for number in range(Recent.SIZE):
        recent[number] = -number
    assert recent[0] == 0
    recent[Recent.SIZE] = 1
    assert dict(recent) == {Recent.SIZE: 1}


def test_a_derived_predicate_over_an_empty_type_has_no_atoms() -> None:
    meaning = semantics(DerivedPredicate("p", (GHOST,), TRUE), DerivedPredicate("q", (), TRUE))
    assert derived_atoms(meaning) == "q"


def test_a_parameter_of_two_types() -> None:
    meaning = semantics(DerivedPredicate("p", (var("x", "cube", "robot"),), TRUE))
    assert derived_atoms(meaning) == "p(a), p(r)"


# The limit ----------------------------------------------------------------------------------------


def test_a_formula_that_would_run_away_is_stopped_and_named() -> None:
    wide = tuple(var(f"x{i}") for i in range(30))
    formula = ForAll(wide, Not(equal("?x0", "nobody")))
    goal = Problem("x", "d", objects=objects(block="a b c d"), goal=formula)
    meaning = Semantics(Domain("d", types=TYPES), goal, work_limit=10_000)
    with pytest.raises(LimitError, match=r"the goal takes more than 10000 steps, the work limit"):
        meaning.is_goal(frozenset())


def test_a_derived_predicate_that_would_run_away_is_stopped_and_named() -> None:
    wide = DerivedPredicate("wide", tuple(var(f"x{i}") for i in range(30)), FALSE)
    with pytest.raises(LimitError, match="derived predicate `wide` takes more than 500 steps"):
        semantics(wide, work_limit=500).complete(frozenset())


def test_the_limit_counts_each_call_anew() -> None:
    meaning = semantics(work_limit=10)
    for _ in range(10):
        assert not meaning.holds(exists(X, P), frozenset())


def test_the_default_limit_stops_within_seconds() -> None:
    """Measured on a share of it, generously: machines differ."""
    share = 40
    wide = tuple(var(f"x{i}") for i in range(30))
    meaning = semantics(work_limit=WORK_LIMIT // share)
    began = time.monotonic()
    with pytest.raises(LimitError):
        meaning.holds(ForAll(wide, Not(atom("p", "?x0"))), frozenset())
    assert (time.monotonic() - began) * share < 90


def test_quantifiers_stop_at_the_first_tuple_that_decides() -> None:
    wide = tuple(var(f"x{i}") for i in range(30))
    meaning = semantics(work_limit=10)
    assert meaning.holds(Exists(wide, TRUE), frozenset())
    assert not meaning.holds(ForAll(wide, FALSE), frozenset())


# Properties ---------------------------------------------------------------------------------------

WORLDS = st.frozensets(
    st.sampled_from(
        [fact(p, *args) for p, n in (("p", 1), ("e", 2)) for args in product("ab", repeat=n)]
    )
)


def two_objects(*derived: DerivedPredicate) -> Semantics:
    problem = Problem("x", "d", objects=(Object("a"), Object("b")))
    return Semantics(Domain("d", derived=derived), problem)


@st.composite
def formulas(
    draw: st.DrawFn,
    variables: tuple[str, ...] = (),
    positive: Mapping[str, int] = {"p": 1, "e": 2},
    negative: Mapping[str, int] = {"p": 1, "e": 2},
    depth: int = 3,
) -> Formula:
    """A formula with these free variables in which these predicates occur with these signs."""

    def part(*more: str, turned: bool = False) -> Formula:
        signs = (negative, positive) if turned else (positive, negative)
        return draw(formulas((*variables, *more), *signs, depth=depth - 1))

    terms = st.sampled_from([*(f"?{v}" for v in variables), "a", "b"])
    kinds = ["atom", "atom", "equal"]
    if depth:
        kinds += ["and", "or", "not", "implies", "exists", "forall", "more", "fewer"]
    new = var(f"v{len(variables)}")
    match draw(st.sampled_from(kinds)):
        case "atom" if positive:
            name = draw(st.sampled_from(sorted(positive)))
            return atom(name, *(draw(terms) for _ in range(positive[name])))
        case "and":
            return both(part(), part())
        case "or":
            return either(part(), part())
        case "not":
            return Not(part(turned=True))
        case "implies":
            return Implies(part(turned=True), part())
        case "exists":
            return exists(new, part(new.name))
        case "forall":
            return forall(new, part(new.name))
        case "more":
            return at_least(draw(st.integers(0, 3)), new, part(new.name))
        case "fewer":
            number = draw(st.integers(0, 3))
            return Count((new,), part(new.name, turned=True), "<", number)
        case _:
            return equal(draw(terms), draw(terms))


@settings(deadline=None)
@given(formulas(("x",)), WORLDS)
def test_quantifiers_are_dual_and_count_measures_them(
    body: Formula, world: frozenset[GroundAtom]
) -> None:
    def holds(formula: Formula) -> bool:
        return two_objects().holds(formula, world)

    true_for = [two_objects().holds(body, world, {"x": name}) for name in "ab"]
    assert holds(exists(ANY, body)) is any(true_for)
    assert holds(forall(ANY, body)) is all(true_for)
    assert holds(forall(ANY, body)) is not holds(exists(ANY, Not(body)))
    for number in range(4):
        assert holds(Count((ANY,), body, "=", number)) is (sum(true_for) == number)


@settings(deadline=None)
@given(formulas(), formulas(), WORLDS)
def test_connectives_are_those_of_truth_tables(
    left: Formula, right: Formula, world: frozenset[GroundAtom]
) -> None:
    meaning = two_objects()
    p, q = meaning.holds(left, world), meaning.holds(right, world)
    assert meaning.holds(Not(left), world) is (not p)
    assert meaning.holds(both(left, right), world) is (p and q)
    assert meaning.holds(either(left, right), world) is (p or q)
    assert meaning.holds(Implies(left, right), world) is (q if p else True)


BASIC = {"p": 1, "e": 2}
LOWER = {"d0": 1, "d1": 0}
UPPER = {"d2": 1, "d3": 0}


@st.composite
def programs(draw: st.DrawFn) -> tuple[DerivedPredicate, ...]:
    """Two strata: each is positive in its own predicates, the upper one uses the lower freely."""
    found = []
    for own, below in ((LOWER, BASIC), (UPPER, BASIC | LOWER)):
        for name, arity in own.items():
            variables = ("x",)[:arity]
            body = draw(formulas(variables, own | below, below, depth=2))
            found.append(DerivedPredicate(name, tuple(map(var, variables)), body))
    return tuple(draw(st.permutations(found)))


def subsets(atoms: Iterable[GroundAtom]) -> Iterable[frozenset[GroundAtom]]:
    every = list(atoms)
    picks = chain.from_iterable(combinations(every, n) for n in range(len(every) + 1))
    return map(frozenset, picks)


@settings(deadline=None)
@given(programs(), WORLDS)
def test_complete_is_the_least_closed_set_of_every_stratum(
    program: tuple[DerivedPredicate, ...], world: frozenset[GroundAtom]
) -> None:
    """Compared with the intersection of all sets closed under the formulas, tried one by one."""
    meaning = two_objects(*program)
    expected = world
    for own in (LOWER, UPPER):
        bodies = [
            (
                fact(p.name, *args),
                p.formula,
                {v.name: o for v, o in zip(p.parameters, args, strict=True)},
            )
            for p in program
            if p.name in own
            for args in product("ab", repeat=len(p.parameters))
        ]
        closed = [
            extra
            for extra in subsets(head for head, _, _ in bodies)
            if all(
                head in extra
                for head, body, binding in bodies
                if meaning.holds(body, expected | extra, binding)
            )
        ]
        expected |= frozenset.intersection(*closed)
    assert meaning.complete(world) == expected


@settings(deadline=None)
@given(programs(), WORLDS)
def test_a_derived_atom_holds_exactly_where_its_formula_does(
    program: tuple[DerivedPredicate, ...], world: frozenset[GroundAtom]
) -> None:
    meaning = two_objects(*program)
    model = meaning.complete(world)
    for predicate in program:
        for args in meaning.bindings(predicate.parameters):
            binding = dict(zip((v.name for v in predicate.parameters), args, strict=True))
            assert (fact(predicate.name, *args) in model) is meaning.holds(
                predicate.formula, model, binding
            )


@settings(deadline=None)
@given(programs(), st.lists(WORLDS, min_size=2, max_size=6))
def test_what_was_asked_before_changes_no_answer(
    program: tuple[DerivedPredicate, ...], worlds: list[frozenset[GroundAtom]]
) -> None:
    meaning = two_objects(*program)
    for world in worlds:
        assert meaning.complete(world) == two_objects(*program).complete(world)
