"""Facts that exclude each other: which are found, and that packing them as numbers changes nothing."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import menid_plan
from menid_plan.grounding import exclusive
from menid_plan.grounding import ground as grounding
from menid_plan.grounding.ground import GroundProblem, ground
from menid_plan.grounding.state import SINK
from menid_plan.model.domain import Domain, Problem
from menid_plan.model.formulas import GroundAtom
from strategies import domains_with_problems
from test_explore import SMALL, compare

HEAD = """
domain d
type thing, place
constant a, b: thing
constant p, q, r, s: place
predicate at(thing, place)
predicate held(thing)
predicate lost(thing)
predicate road(place, place)
predicate lit(place)
"""
PROBLEM = """
problem t for d
init road(p, q), road(q, r), road(r, s), road(s, p)
"""
MOVE = """
action move(x: thing) { rule move {
  the f: place where at(x, f)
  the t: place where road(f, t)
  outcomes { moved: 0.7 not at(x, f), at(x, t) stuck: 0.3 nothing }
} }
"""


@pytest.fixture(autouse=True)
def packed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pack small problems too, groups of two, and those of which every fact is asked for."""
    monkeypatch.setattr(grounding, "FEW", 0)
    monkeypatch.setattr(exclusive, "LEAST", 2)
    monkeypatch.setattr(grounding, "BESIDES", 1.0)


def grounded(domain: str, problem: str = PROBLEM + "init at(a, p), at(b, r)") -> GroundProblem:
    document = menid_plan.parse(HEAD + domain + problem)
    assert document.domain is not None
    assert document.problem is not None
    return ground(document.domain, document.problem)


def checked(domain: str, problem: str = PROBLEM + "init at(a, p), at(b, r)") -> list[list[str]]:
    """The groups of a problem that was compared with the definition in every state."""
    document = menid_plan.parse(HEAD + domain + problem)
    assert document.domain is not None
    assert document.problem is not None
    for noise in ("stay", "sink"):
        structure = compare(document.domain, document.problem, noise)  # type: ignore[arg-type]
        assert structure is not None
        assert structure.states > 1
    return [list(map(str, group)) for group in structure.problem.layout.groups]


def test_a_place_for_each_thing() -> None:
    assert checked(MOVE) == [
        [f"at({thing}, {place})" for place in "pqrs"] for thing in "ab"
    ]  # fmt: skip
    assert grounded(MOVE).layout.bits == 6


def test_a_place_or_held_or_lost() -> None:
    carry = """
    action take(x: thing) { rule take {
      the f: place where at(x, f)
      outcomes { taken: 0.8 not at(x, f), held(x)  fell: 0.1 not at(x, f), lost(x)  noise: 0.1 }
    } }
    action put(x: thing, t: place) { rule put {
      when held(x)
      outcomes { put: 1 not held(x), at(x, t) }
    } }
    """
    found = checked(MOVE + carry)
    assert [len(group) for group in found] == [6, 6]
    assert found[0] == [*(f"at(a, {place})" for place in "pqrs"), "held(a)", "lost(a)"]


@pytest.mark.parametrize(
    "domain",
    [
        # It is added without anything deleted.
        "action copy(x: thing) { rule r { the f: place where at(x, f) the t: place where road(f, t)"
        " outcomes { copied: 1 at(x, t) } } }",
        # What is deleted need not have held.
        "action jump(x: thing) { rule r { outcomes { jumped: 1 not at(x, p), at(x, q) } } }",
        # Two effects of one outcome add one each.
        "action split(x: thing) { rule r { when at(x, p)"
        " outcomes { split: 1 not at(x, p), at(x, q), at(x, s) } } }",
        "action split(x: thing) { rule r { when at(x, p) outcomes { split: 1 not at(x, p), at(x, q),"
        " if lit(p) { at(x, s) } } } }"
        " action light { rule r { outcomes { o: 1 lit(p) } } }",
        # It is deleted only sometimes.
        "action move(x: thing) { rule r { when at(x, p) outcomes { o: 1 at(x, q),"
        " if lit(p) { not at(x, p) } } } }"
        " action light { rule r { outcomes { o: 1 lit(p) } } }",
    ],
)
def test_what_may_hold_twice_is_no_group(domain: str) -> None:
    found = checked(domain)
    assert not any(
        "at(a, p)" in group and len(group) > 1 and "at(a, q)" in group for group in found
    )


def test_what_holds_twice_in_the_beginning_is_no_group() -> None:
    assert checked(MOVE, PROBLEM + "init at(a, p), at(a, q), at(b, r)") == [
        [f"at(b, {place})" for place in "pqrs"]
    ]


REST = """
derived near(x: thing, t: place) = at(x, t) or exists u: place (road(u, t) and lit(u) and near(x, u))
derived together = exists t: place (at(a, t) and at(b, t))
reward 1 when not at(a, q) and not together
action light(t: place) { rule light {
  when near(a, t) and not at(b, t) and count x: thing (at(x, t)) < 2
  outcomes { lit: 0.5 lit(t) out: 0.5 not lit(t) }
} }
action shake { rule shake {
  when not held(a) and lit(p)
  outcomes {
    swept: 0.5
      forall x: thing, f: place, t: place where at(x, f) and road(f, t) and lit(t)
      { not at(x, f), at(x, t) }
    gone:  0.4 not at(a, p), not at(b, q), not lit(p)
    noise: 0.1
  }
} }
action wait(x: thing) {
  rule here { the f: place where at(x, f) and lit(f) outcomes { o: 1 not lit(f) } }
  rule else { otherwise outcomes { o: 1 lit(q) } }
}
"""


def test_all_that_may_be_asked_of_a_packed_fact() -> None:
    assert [len(group) for group in checked(MOVE + REST)] == [4, 4]


def test_simpler_conditions() -> None:
    """One thing is at one place: neither a count nor a rule for two places is left."""
    problem = grounded(MOVE)
    assert len(problem.tables.op) == 1
    assert len(problem.rules) == 8


def test_states_that_no_step_leads_to_have_no_words() -> None:
    problem = grounded(MOVE)
    at = [GroundAtom("at", (thing, place)) for thing in "ab" for place in "pq"]
    roads = problem.always
    assert roads
    words = problem.pack(roads | {at[0], at[2]})
    assert words is not None
    assert problem.unpack(words) == roads | {at[0], at[2]}
    empty = problem.pack(roads)
    assert empty is not None
    assert problem.unpack(empty) == roads
    assert problem.pack(roads | {at[0], at[1]}) is None
    assert problem.pack(frozenset({at[0]})) is None
    assert problem.pack(roads | {GroundAtom("held", ("a",))}) is None


@pytest.mark.parametrize("path", SMALL, ids=lambda path: path.stem)
def test_shipped_problems(path: Path) -> None:
    document = menid_plan.read(path)
    assert document.domain is not None
    assert document.problem is not None
    compare(document.domain, document.problem, "stay")


@settings(
    max_examples=60, deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture,
        HealthCheck.data_too_large],
)  # fmt: skip
@given(domains_with_problems())
def test_any_domain(pair: tuple[Domain, Problem]) -> None:
    for noise in ("stay", "sink"):
        compare(*pair, noise, limit=60)  # type: ignore[arg-type]


EFFECTS = [
    "not at(x, f)", "at(x, t)", "not at(x, t)", "held(x)", "not held(x)", "lost(x)", "at(x, p)",
    "not at(x, f), at(x, t)", "if lit(f) { not at(x, f), at(x, t) }",
    "if at(x, t) { not at(x, t) }", "if not at(x, t) { lit(t) }", "lit(f)", "not lit(f)",
    "forall y: thing, u: place where at(y, u) and road(u, t) { not at(y, u), at(y, t) }",
    "forall u: place where at(x, u) { not at(x, u) }", "not at(x, f), held(x)",
]  # fmt: skip
CONDITIONS = [
    "true", "at(x, f)", "at(x, f) and road(f, t)", "not held(x)", "held(x)", "not at(x, t)",
    "lit(f) or at(x, f)", "count y: thing (at(y, f)) = 1", "at(x, f) and not lit(t)",
    "exists u: place (at(x, u) and road(u, t))",
]  # fmt: skip


@st.composite
def carriers(draw: st.DrawFn) -> str:
    """Actions that move things between places, mostly in ways that keep each at one."""
    text = ""
    for number in range(draw(st.integers(1, 4))):
        condition = draw(st.sampled_from(CONDITIONS))
        outcomes = []
        for index in range(draw(st.integers(1, 2))):
            effects = draw(st.lists(st.sampled_from(EFFECTS), min_size=1, max_size=3))
            outcomes.append(f"o{index}: {{}} {', '.join(dict.fromkeys(effects))}")
        share = 1 / len(outcomes)
        text += (
            f"action a{number}(x: thing, f, t: place) {{ rule r {{ when {condition} outcomes {{ "
            + " ".join(outcome.replace("{}", str(share), 1) for outcome in outcomes)
            + " } } }\n"
        )
    return text


@settings(
    max_examples=30, deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)  # fmt: skip
@given(carriers())
def test_any_way_to_carry(text: str) -> None:
    problem = "init road(p, q), road(q, r), road(r, p)"
    document = menid_plan.parse(f"{HEAD}{text} problem t for d {problem}, at(a, p), held(b)")
    assert document.domain is not None, document.diagnostics
    assert document.problem is not None, document.diagnostics
    structure = compare(document.domain, document.problem, "stay", 60)
    if structure is None:
        return
    for number in range(structure.states):
        state = structure.state(number)
        assert state is not SINK
        for group in structure.problem.layout.groups:
            assert len(state.intersection(group)) <= 1
