"""Stratification: the sign of an occurrence, the order of derived predicates, negative cycles."""

from __future__ import annotations

from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from menid_plan.errors import MeaningError
from menid_plan.grounding.semantics import Semantics
from menid_plan.model.domain import DerivedPredicate, Domain, Problem
from menid_plan.model.formulas import Count, Formula, Implies, Not
from menid_plan.model.strata import negative_cycles, occurrences, strata
from models import atom, both, either, exists, forall, var

P, Q, R = atom("p"), atom("q"), atom("r")
X = var("x")


def count(comparison: str, formula: Formula) -> Count:
    return Count((X,), formula, comparison, 1)  # type: ignore[arg-type]


def domain(**formulas: Formula) -> Domain:
    return Domain("d", derived=tuple(DerivedPredicate(n, (), f) for n, f in formulas.items()))


def names(groups: list[list[DerivedPredicate]]) -> list[list[str]]:
    return [[p.name for p in group] for group in groups]


@pytest.mark.parametrize(
    ("formula", "negative"),
    [
        (P, False),
        (Not(P), True),
        (Not(Not(P)), False),
        (Implies(P, Q), True),
        (Implies(Q, P), False),
        (Implies(Implies(P, Q), Q), False),
        (Not(Implies(Q, P)), True),
        (exists(X, P), False),
        (forall(X, P), False),
        (exists(X, Not(P)), True),
        (either(Q, both(Q, Not(P))), True),
        (count(">", P), False),
        (count(">=", P), False),
        (count("<", P), True),
        (count("<=", P), True),
        (Not(count("<", P)), False),
        (count("<", Not(P)), False),
        (count("=", P), True),
        (count("!=", P), True),
        (count("=", Not(P)), True),
        (Not(count("!=", P)), True),
    ],
)
def test_the_sign_of_an_occurrence(formula: Formula, negative: bool) -> None:
    assert [sign for name, sign in occurrences(formula) if name == "p"] == [negative]


def test_occurrences_come_in_order_and_with_repeats() -> None:
    formula = Implies(both(P, Q), either(P, Not(R)))
    assert list(occurrences(formula)) == [("p", True), ("q", True), ("p", False), ("r", True)]


def test_what_others_depend_on_comes_first() -> None:
    assert names(strata(domain(p=Q, q=R, r=atom("basic")))) == [["r"], ["q"], ["p"]]


def test_predicates_share_a_group_only_if_they_depend_on_each_other() -> None:
    groups = strata(domain(p=Q, q=either(P, R), r=R, s=Not(P)))
    assert names(groups) == [["r"], ["p", "q"], ["s"]]


def test_a_negative_occurrence_of_an_earlier_group_is_no_violation() -> None:
    assert negative_cycles(domain(p=Not(Q), q=both(Q, Not(R)), r=atom("basic"))) == []


def test_double_negation_is_no_violation() -> None:
    assert negative_cycles(domain(p=Not(Not(P)))) == []


def test_a_predicate_under_its_own_negation() -> None:
    (cycle,) = negative_cycles(domain(p=Not(P)))
    assert (cycle.culprit.name, cycle.negated.name, str(cycle)) == ("p", "p", "p -> p")


def test_the_cycle_starts_with_the_one_that_negates() -> None:
    (cycle,) = negative_cycles(domain(p=Q, q=count("=", R), r=P, s=Not(P)))
    assert (cycle.culprit.name, cycle.negated.name) == ("q", "r")
    assert [p.name for p in cycle.predicates] == ["q", "r", "p"]


def test_every_group_in_violation_is_reported() -> None:
    cycles = negative_cycles(domain(p=Not(P), q=Not(R), r=Q, s=atom("basic")))
    assert sorted(map(str, cycles)) == ["p -> p", "q -> r -> q"]


def test_a_violation_has_no_semantics() -> None:
    with pytest.raises(MeaningError, match=r"`q` depends on itself .* `r`: q -> r -> q"):
        Semantics(domain(q=Not(R), r=Q), Problem("x", "d"))


@pytest.mark.parametrize("last", [atom("basic"), atom("p0"), Not(atom("p0"))])
def test_long_chains(last: Formula) -> None:
    size = 10_000
    chain = {f"p{i}": atom(f"p{i + 1}") for i in range(size - 1)}
    long = domain(**chain, **{f"p{size - 1}": last})
    groups = strata(long)
    assert sum(map(len, groups)) == size
    assert groups[0][0].name == ("p0" if len(groups) == 1 else f"p{size - 1}")
    assert [len(c.predicates) for c in negative_cycles(long)] == [size] * isinstance(last, Not)


@settings(deadline=None)
@given(
    st.lists(
        st.lists(st.tuples(st.integers(0, 4), st.booleans()), max_size=3), min_size=5, max_size=5
    )
)
def test_cycles_and_order_agree_with_reachability(graph: list[list[tuple[int, bool]]]) -> None:
    """Compared with the transitive closure of who depends on whom, by Warshall's algorithm."""
    formulas = {
        f"p{i}": either(*(Not(atom(f"p{j}")) if negative else atom(f"p{j}") for j, negative in row))
        for i, row in enumerate(graph)
    }
    reaches = [[any(j == k for j, _ in graph[i]) for k in range(5)] for i in range(5)]
    for via, i, j in product(range(5), repeat=3):
        reaches[i][j] = reaches[i][j] or (reaches[i][via] and reaches[via][j])
    groups = names(strata(domain(**formulas)))
    place = {name: index for index, group in enumerate(groups) for name in group}
    for i, j in product(range(5), repeat=2):
        together = i == j or (reaches[i][j] and reaches[j][i])
        assert (place[f"p{i}"] == place[f"p{j}"]) == together
        if reaches[i][j]:
            assert place[f"p{j}"] <= place[f"p{i}"]
    violating = {
        frozenset(groups[place[f"p{i}"]])
        for i, row in enumerate(graph)
        for j, negative in row
        if negative and (i == j or reaches[j][i])
    }
    cycles = negative_cycles(domain(**formulas))
    assert {frozenset(groups[place[c.culprit.name]]) for c in cycles} == violating
    for cycle in cycles:
        for one, other in zip(
            cycle.predicates, (*cycle.predicates[1:], cycle.culprit), strict=True
        ):
            assert other.name in {name for name, _ in occurrences(one.formula)}
        assert (cycle.negated.name, True) in occurrences(cycle.culprit.formula)
