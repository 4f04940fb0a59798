"""Which rule and outcomes explain a step: cases by hand, and generated domains."""

from __future__ import annotations

from itertools import islice

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import menid_plan
from menid_plan.errors import LimitError, MeaningError
from menid_plan.experience.attribution import Attributor, Places
from menid_plan.experience.check import check_state
from menid_plan.experience.record import DistributionKey, Explanation
from menid_plan.grounding.ground import ground
from menid_plan.grounding.semantics import Semantics
from menid_plan.grounding.state import SINK, GroundAction
from menid_plan.grounding.steps import RuleConflict
from menid_plan.model.domain import Domain, Problem
from menid_plan.model.formulas import GroundAtom
from models import state
from strategies import domains_with_problems

TEXT = """
domain workshop

param win = 4

type part
type slot

constant spare: part

environment robot : target
environment model : test

predicate in(part, slot)
predicate loose(part)
predicate tested(part)
predicate fixed(part)

derived free(s: slot) = not exists p: part (in(p, s))

action pull(s: slot) cost 1 {
  rule one-part per s {
    the p: part where in(p, s)
    when not fixed(p)
    outcomes {
      out:    0.5  not in(p, s)              reward win
      freed:  0.3  not in(p, s), tested(p)
      shaken: 0.1  loose(p)
      held:   0.1  nothing
    }
  }
  rule empty {
    when free(s)
    outcomes {
      done: 1  if loose(spare) { not loose(spare) }, forall q: part where loose(q) { tested(q) }
      noise: 0
    }
  }
}

action clash(s: slot) {
  rule first { when free(s)  outcomes { a: 1 nothing } }
  rule second { when not fixed(spare)  outcomes { a: 1 nothing } }
}

problem today for workshop
object a, b: part
object left, right: slot
init in(a, left)
goal free(left)
"""


@pytest.fixture(scope="module")
def both() -> tuple[Domain, Problem]:
    document = menid_plan.parse(TEXT)
    assert document.domain is not None
    assert document.problem is not None
    return document.domain, document.problem


LEFT = GroundAction("pull", ("left",))
RIGHT = GroundAction("pull", ("right",))


def one_part(*weights: float, slot: str = "left") -> Explanation:
    return Explanation("one-part", (slot,), weights)


def test_one_outcome_leads_there(both: tuple[Domain, Problem]) -> None:
    attributor = Attributor(*both)
    explain = attributor.explain
    before = state("in a left")
    assert explain(before, LEFT, state()) == one_part(1, 0, 0, 0, 0)
    assert explain(before, LEFT, state("tested a")) == one_part(0, 1, 0, 0, 0)
    assert explain(before, LEFT, state("in a left", "loose a")) == one_part(0, 0, 1, 0, 0)
    # An outcome that changes nothing explains that nothing changed; it is no noise.
    assert explain(before, LEFT, before) == one_part(0, 0, 0, 1, 0)
    assert explain(before, LEFT, state("fixed a")) == one_part(0, 0, 0, 0, 1)


def test_the_reference_names_the_part(both: tuple[Domain, Problem]) -> None:
    attributor = Attributor(*both)
    before = state("in b right", "in a left")
    assert attributor.explain(before, RIGHT, state("in a left")) == one_part(
        1, 0, 0, 0, 0, slot="right"
    )
    assert attributor.explain(before, RIGHT, state("in b right")).weights[-1] == 1  # type: ignore[union-attr]
    covering = attributor.covering(before, RIGHT)
    assert covering is not None
    assert covering.binding == {"s": "right", "p": "b"}
    assert attributor.distribution(before, RIGHT) == DistributionKey("pull", "one-part", ("right",))


def test_outcomes_that_coincide_share_alike_without_estimates(both: tuple[Domain, Problem]) -> None:
    attributor = Attributor(*both)
    before = state("in a left", "tested a", "loose a")
    # It was tested before: `out` and `freed` both lead there.
    after = state("tested a", "loose a")
    assert attributor.explain(before, LEFT, after) == one_part(0.5, 0.5, 0, 0, 0)
    # It was loose before: `shaken` and `held` both change nothing.
    assert attributor.explain(before, LEFT, before) == one_part(0, 0, 0.5, 0.5, 0)


def test_they_share_in_proportion_to_estimates(both: tuple[Domain, Problem]) -> None:
    attributor = Attributor(*both)
    before, after = state("in a left", "tested a"), state("tested a")
    key = DistributionKey("pull", "one-part", ("left",))
    asked = []

    def chances(distribution: DistributionKey) -> list[float] | None:
        asked.append(distribution)
        return {key: [0.6, 0.2, 0.1, 0.1, 0.0]}.get(distribution)

    found = attributor.explain(before, LEFT, after, chances)
    assert found is not None
    assert found.weights == pytest.approx((0.75, 0.25, 0, 0, 0), rel=1e-15)
    assert asked == [key]
    # Nothing is asked where one outcome alone leads there.
    attributor.explain(before, LEFT, state("in a left", "tested a", "loose a"), chances)
    attributor.explain(before, LEFT, state(), chances)
    assert asked == [key]
    unknown: dict[DistributionKey, list[float]] = {}
    for uniform in (unknown.get, {key: [0.0, 0.0, 1, 0, 0]}.get):
        assert attributor.explain(before, LEFT, after, uniform) == one_part(0.5, 0.5, 0, 0, 0)
    tiny = {key: [3e-320, 1e-320, 1, 0, 0]}.get
    found = attributor.explain(before, LEFT, after, tiny)
    assert found is not None
    assert found.weights[0] == pytest.approx(0.75, rel=1e-3)
    huge = {key: [1e308, 1e308, 1, 0, 0]}.get
    assert attributor.explain(before, LEFT, after, huge) == one_part(0.5, 0.5, 0, 0, 0)


@pytest.mark.parametrize(
    "wrong", [[1.0], [0.5, -0.1, 0, 0, 0], [float("nan"), 1, 0, 0, 0], [float("inf"), 1, 0, 0, 0]]
)
def test_chances_that_are_none(both: tuple[Domain, Problem], wrong: list[float]) -> None:
    with pytest.raises(ValueError, match=r"pull\.one-part for left"):
        Attributor(*both).explain(
            state("in a left", "tested a"), LEFT, state("tested a"), lambda _: wrong
        )


def test_the_first_takes_all(both: tuple[Domain, Problem]) -> None:
    attributor = Attributor(*both, method="first")
    before = state("in a left", "tested a", "loose a")
    chances = {DistributionKey("pull", "one-part", ("left",)): [0.0, 1.0, 0.0, 0.0, 0.0]}.get
    after = state("tested a", "loose a")
    assert attributor.explain(before, LEFT, after, chances) == one_part(1, 0, 0, 0, 0)
    assert attributor.explain(before, LEFT, before, chances) == one_part(0, 0, 1, 0, 0)
    with pytest.raises(ValueError, match="em, first"):
        Attributor(*both, method="last")  # type: ignore[arg-type]


def test_effects_with_conditions_look_at_the_state_before(both: tuple[Domain, Problem]) -> None:
    explain = Attributor(*both).explain

    def empty(*weights: float) -> Explanation:
        return Explanation("empty", (), weights)

    assert explain(state(), RIGHT, state()) == empty(1, 0)
    assert explain(state("loose spare"), RIGHT, state("tested spare")) == empty(1, 0)
    assert explain(state("loose spare"), RIGHT, state("loose spare")) == empty(0, 1)
    after = state("loose b", "tested b")
    assert explain(state("loose b"), RIGHT, after) == empty(1, 0)


def test_what_no_rule_covers_is_not_explained(both: tuple[Domain, Problem]) -> None:
    attributor = Attributor(*both)
    two = state("in a left", "in b left")
    assert attributor.explain(two, LEFT, two) is None
    assert attributor.distribution(two, LEFT) is None
    assert attributor.explain(state("in a left", "fixed a"), LEFT, state()) is None
    assert attributor.reward(two, LEFT, two, None) == 0


def test_two_rules_that_cover_are_an_error(both: tuple[Domain, Problem]) -> None:
    attributor = Attributor(*both)
    for _ in range(2):
        with pytest.raises(RuleConflict, match=r"`first`.*`second`"):
            attributor.explain(state(), GroundAction("clash", ("left",)), state())


def test_rewards_by_shares(both: tuple[Domain, Problem]) -> None:
    attributor = Attributor(*both, params={"win": 10.0})
    before, after = state("in a left", "tested a"), state("tested a")
    shared = attributor.explain(before, LEFT, after)
    # Half of it `out`, which pays 10, and the cost of 1.
    assert attributor.reward(before, LEFT, after, shared) == 0.5 * 10 - 1
    assert attributor.reward(before, LEFT, state("fixed a"), one_part(0, 0, 0, 0, 1)) == -1


BAD_ATOMS = [
    (GroundAtom("inside", ("a", "left")), "`inside(a, left)`: there is no predicate `inside`"),
    (GroundAtom("free", ("left",)), "`free(left)`: `free` is derived"),
    (GroundAtom("in", ("a",)), "`in(a)`: `in` has 2 arguments, not 1"),
    (GroundAtom("in", ("c", "left")), "`in(c, left)`: there is no object `c`"),
    (GroundAtom("in", ("left", "left")), "`in(left, left)`: object `left` is not of type part"),
    ("loose(a)", "'loose(a)' is no atom"),
    (("loose", ("a",)), "('loose', ('a',)) is no atom"),
]


@pytest.mark.parametrize(("atom", "message"), BAD_ATOMS, ids=[m for _, m in BAD_ATOMS])
def test_atoms_that_no_state_has(
    both: tuple[Domain, Problem], atom: GroundAtom, message: str
) -> None:
    attributor = Attributor(*both)
    two = state("in a left", "in b left")
    steps = [(state("in a left") | {atom}, state()), (two, two | {atom}), (state(), {atom})]
    for before, after in steps:
        with pytest.raises(MeaningError) as caught:
            attributor.explain(before, LEFT, frozenset(after))
        assert message in str(caught.value)
    with pytest.raises(MeaningError) as caught:
        check_state(*both, [GroundAtom("loose", ("b",)), atom])
    assert message in str(caught.value)


def test_what_is_no_state_or_action(both: tuple[Domain, Problem]) -> None:
    attributor = Attributor(*both)
    check_state(*both, state("in a left", "loose spare"))
    with pytest.raises(MeaningError, match="no set of atoms"):
        check_state(*both, None)  # type: ignore[arg-type]
    with pytest.raises(MeaningError, match="a frozenset of atoms is asked for"):
        attributor.explain({GroundAtom("loose", ("a",))}, LEFT, state())  # type: ignore[arg-type]
    for action, message in (
        (GroundAction("push"), "there is no action `push`"),
        (GroundAction("pull"), "has 1 arguments, not 0"),
        (GroundAction("pull", ("a",)), "no object `a` of type slot"),
    ):
        with pytest.raises(MeaningError, match=message):
            attributor.explain(state(), action, state())


def test_places_in_a_ground_problem(both: tuple[Domain, Problem]) -> None:
    domain, problem = both
    known = ground(domain, problem)
    places = Places(known)
    for index, distribution in enumerate(known.distributions):
        key = DistributionKey(distribution.action, distribution.rule.name, distribution.values)
        assert places.of(key) == (index, distribution.slots)
        assert str(key) == str(distribution)
    # Nothing ever comes into the right slot, so grounding leaves its distribution out.
    assert places.of(DistributionKey("pull", "one-part", ("left",))) is not None
    assert places.of(DistributionKey("pull", "one-part", ("right",))) is None


@settings(max_examples=30, deadline=None)
@given(domains_with_problems(), st.data())
def test_the_outcome_that_happened_has_a_share(
    pair: tuple[Domain, Problem], data: st.DataObject
) -> None:
    """And noise has one exactly where no outcome leads to the state."""
    domain, problem = pair
    meaning = Semantics(domain, problem, work_limit=50_000)
    attributor = Attributor(domain, problem)
    first = Attributor(domain, problem, method="first")
    current = meaning.initial_state
    for _ in range(3):
        arrived = []
        for action in domain.actions:
            for instance in islice(meaning.instances(action), 6):
                try:
                    covering = meaning.covering(current, instance)
                except (RuleConflict, LimitError):
                    continue
                if covering is None:
                    assert attributor.explain(current, instance, current) is None
                    continue
                ends = [meaning.successor(covering, o, current) for o in covering.rule.outcomes]
                for index, after in enumerate(ends[:-1]):
                    assert after is not SINK
                    chances = [float((index * 7 + i * 5) % 4) for i in range(len(ends))]
                    chances[index] += 0.5
                    found = attributor.explain(current, instance, after, lambda _, c=chances: c)
                    assert found is not None
                    assert found.weights[index] > 0
                    assert found.weights[-1] == 0
                    assert sum(found.weights) == pytest.approx(1)
                    assert all(
                        (w > 0) <= (end == after)
                        for w, end in zip(found.weights, ends, strict=True)
                    )
                    firsts = first.explain(current, instance, after)
                    assert firsts is not None
                    assert firsts.weights[ends.index(after)] == 1
                    assert (found.rule, found.values) == (covering.rule.name, covering.values)
                    arrived.append(after)
                stayed = attributor.explain(current, instance, current)
                assert stayed is not None
                assert stayed.weights[-1] == float(current not in ends[:-1])
        if not arrived:
            return
        current = data.draw(st.sampled_from(arrived))
