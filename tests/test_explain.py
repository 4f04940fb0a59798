"""What `menid explain` tells of a state: which rule covers, why others do not, what changes."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from menid_plan.errors import LimitError, MeaningError
from menid_plan.grounding.explain import RuleExplanation, explain, explain_action
from menid_plan.grounding.reasons import conjuncts, why_not
from menid_plan.grounding.semantics import Semantics
from menid_plan.grounding.state import GroundAction, State
from menid_plan.model.domain import DerivedPredicate, Domain, Environment, Problem, Type
from menid_plan.model.formulas import FALSE, TRUE, Count, Exists, Formula, Implies, Not
from menid_plan.model.rules import Action, Rule
from menid_plan.model.text import formula_text
from menid_plan.model.variables import bound, replaced
from models import (
    add,
    at_least,
    atom,
    both,
    delete,
    either,
    equal,
    exists,
    forall,
    hdd,
    number,
    objects,
    outcome,
    rule,
    state,
    sure,
    the,
    var,
)

X, Y, V = var("x", "block"), var("y", "block"), var("v", "block")
A = GroundAction("a", ("b1",))


def semantics(*rules: Rule, names: str = "b1 b2", **options: object) -> Semantics:
    derived = (DerivedPredicate("clear", (X,), Not(exists(Y, atom("on", "?y", "?x")))),)
    domain = Domain(
        "d",
        types=(Type("block"),),
        environments=(Environment("robot", "target"), Environment("fine", "test")),
        derived=derived,
        actions=(Action("a", rules, (X,)),),
    )
    return Semantics(domain, Problem("x", "d", objects=objects(block=names), **options))  # type: ignore[arg-type]


def the_rule(meaning: Semantics, now: State, name: str = "r") -> RuleExplanation:
    explained = explain_action(meaning, now, A)
    return next(r for r in explained.rules if r.rule == name)


# Reasons ------------------------------------------------------------------------------------------

FACTS = state("p b1", "q", "on b1 b2")


@pytest.mark.parametrize(
    ("formula", "reason"),
    [
        (atom("p", "b2"), "`p(b2)` does not hold"),
        (Not(atom("p", "b1")), "`p(b1)` holds"),
        (equal("b1", "b2"), "`b1` and `b2` are different objects"),
        (Not(equal("b1", "b1")), "both sides of `b1 != b1` are the same object"),
        (FALSE, "`false` never holds"),
        (both(atom("q"), atom("s")), "`s` does not hold"),
        (both(atom("p", "b2"), atom("q"), atom("s")),
         "`p(b2)` does not hold, and `s` does not hold"),
        (either(atom("s"), atom("p", "b2")), "none of `s`, `p(b2)` holds"),
        (Implies(atom("q"), atom("s")), "`q` holds and `s` does not"),
        (exists(X, atom("s", "?x")), "no x: block satisfies `s(x)`"),
        (Not(exists(X, atom("on", "?x", "b2"))),
         "`exists x: block (on(x, b2))` holds, with x = b1"),
        (forall(X, atom("p", "?x")), "`forall x: block (p(x))` is false for x = b2"),
        (at_least(2, X, atom("p", "?x")), "the count in `count x: block (p(x)) >= 2` is 1"),
        (atom("clear", "b2"),
         "`clear(b2)` does not hold because `exists y: block (on(y, b2))` holds, with y = b1"),
        (Not(atom("clear", "b1")), "`clear(b1)` holds"),
        (Not(Not(atom("s"))), "`not s` holds"),
    ],
)  # fmt: skip
def test_why_not(formula: Formula, reason: str) -> None:
    meaning = semantics(sure())
    world = meaning.complete(FACTS)
    assert not meaning.holds(formula, world)
    assert why_not(meaning, formula, world) == reason


def test_the_definition_of_a_derived_predicate_is_followed_once() -> None:
    """Each ``above`` says why in terms of the next, which is not explained in turn."""
    chain = exists(Y, both(atom("on", "?x", "?y"), atom("top", "?y")))
    meaning = semantics(sure())
    domain = replace(
        meaning.domain, derived=(DerivedPredicate("top", (X,), both(chain, atom("top", "?x"))),)
    )
    recursive = Semantics(domain, meaning.problem)
    assert why_not(recursive, atom("top", "b1"), FACTS) == (
        "`top(b1)` does not hold because no y: block satisfies `on(b1, y) and top(y)`, "
        "and `top(b1)` does not hold"
    )


def test_objects_take_the_place_of_free_variables_everywhere() -> None:
    formula = both(
        either(atom("p", "?x"), Not(equal("?x", "?v"))),
        Implies(exists(Y, atom("on", "?x", "?y")), forall(Y, atom("on", "?y", "?v"))),
        Count((Y,), atom("on", "?x", "?y"), "<", 3),
        TRUE,
        atom("p", "x"),
    )
    assert formula_text(replaced(formula, bound({"x": "b1", "v": "b2"}))) == (
        "(p(b1) or b1 != b2) and "
        "(exists y: block (on(b1, y)) implies forall y: block (on(y, b2))) and "
        "count y: block (on(b1, y)) < 3 and true and p(x)"
    )


def test_nested_conjunctions_are_told_apart() -> None:
    parts = conjuncts(both(atom("p"), both(atom("q"), either(atom("r"), atom("s")))))
    assert [formula_text(part) for part in parts] == ["p", "q", "r or s"]


# Rules --------------------------------------------------------------------------------------------


def test_a_rule_that_covers_says_with_what() -> None:
    one = sure("r", references=(the(atom("on", "?v", "?x"), V),))
    explained = the_rule(semantics(one), state("on b2 b1"))
    assert explained.covers
    assert explained.reason == "covers with x = b1, v = b2"
    (reference,) = explained.references
    assert reference.reason == "`the v: block where on(v, b1)` is v = b2"
    assert explained.failed == ()


def test_a_reference_to_nothing() -> None:
    one = sure("r", references=(the(atom("on", "?v", "?x"), V),))
    explained = the_rule(semantics(one), state())
    assert not explained.covers
    assert explained.reason == "nothing satisfies `the v: block where on(v, b1)`"


def test_a_reference_to_several_lists_the_first_of_them() -> None:
    one = sure("r", references=(the(atom("on", "?v", "?x"), V),), when=FALSE)
    meaning = semantics(one, names="b1 b2 b3 b4 b5")
    explained = the_rule(meaning, state("on b2 b1", "on b3 b1"))
    assert explained.reason == (
        "`the v: block where on(v, b1)` is ambiguous: 2 candidates (v = b2; v = b3)"
    )
    explained = the_rule(meaning, state(*(f"on b{i} b1" for i in range(1, 6))))
    (reference,) = explained.references
    assert (reference.count, len(reference.candidates)) == (5, 3)
    assert explained.reason.endswith("5 candidates (v = b1; v = b2; v = b3; and 2 more)")


def test_references_after_one_that_fails_are_not_tried() -> None:
    chain = (
        the(atom("on", "?v", "?x"), V),
        the(atom("on", "?w", "?v"), var("w", "block")),
        the(atom("on", "?u", "?w"), var("u", "block")),
    )
    explained = the_rule(semantics(sure("r", references=chain)), state("on b2 b1"))
    assert [r.count for r in explained.references] == [1, 0]
    assert explained.reason == "nothing satisfies `the w: block where on(w, b2)`"


def test_every_conjunct_that_fails_is_told() -> None:
    when = both(atom("p", "?x"), atom("q"), both(Not(atom("s")), TRUE))
    explained = the_rule(semantics(sure("r", when=when)), state("s", "q"))
    assert explained.failed == (
        ("p(b1)", "`p(b1)` does not hold"),
        ("not s", "`s` holds"),
    )
    assert explained.reason == "`p(b1)` does not hold; `s` holds"


def test_the_otherwise_rule_says_which_other_covers() -> None:
    meaning = semantics(sure("p", when=atom("p")), sure("rest", otherwise=True))
    assert the_rule(meaning, state("p"), "rest") == RuleExplanation("rest", False, "`p` covers")
    assert the_rule(meaning, state(), "rest") == RuleExplanation(
        "rest", True, "no other rule covers"
    )
    assert explain_action(meaning, state(), A).rule == "rest"


def test_a_conflict_is_told_and_not_raised() -> None:
    meaning = semantics(sure("one"), sure("two", when=atom("q")), sure("rest", otherwise=True))
    explained = explain_action(meaning, state("q"), A)
    assert not explained.applies
    assert explained.rule is None
    assert explained.outcomes == ()
    assert [(r.rule, r.covers) for r in explained.rules] == [
        ("one", True),
        ("two", True),
        ("rest", False),
    ]
    assert explained.conflict == (
        "`a(b1)` is covered by rules `one` (x = b1) and `two` (x = b1) in the state q"
    )
    assert explained.rules[2].reason == "`one` and `two` cover"
    assert explain_action(meaning, state(), A).conflict == ""


# Outcomes -----------------------------------------------------------------------------------------


def test_outcomes_tell_real_changes_only() -> None:
    one = rule(
        "r",
        outcome("change", 0.5, add("p", "?x"), add("q"), delete("s"), delete("t")),
        outcome("same", 0.5, add("q"), delete("t")),
    )
    change, same, noise = explain_action(semantics(one), state("q", "s"), A).outcomes
    assert (change.add, change.delete) == (tuple(state("p b1")), tuple(state("s")))
    assert [o.changes_nothing for o in (change, same, noise)] == [False, True, True]


def test_unknown_probabilities_are_none() -> None:
    one = rule("r", outcome("u", (1.0,)), environments=("fine",))
    outcomes = explain_action(semantics(one), state(), A).outcomes
    assert [o.probability for o in outcomes] == [
        {"robot": None, "fine": 1.0},
        {"robot": None, "fine": 0.0},
    ]


def test_an_outcome_says_where_the_episode_ends() -> None:
    one = rule(
        "r",
        outcome("won", 0.5, add("g")),
        outcome("lost", 0.3, add("p")),
        outcome("on", 0.2),
        when=Not(atom("p")),
    )
    meaning = semantics(one, goal=atom("g"), goal_reward=number(5), dead_end_reward=number(-7))
    outcomes = explain_action(meaning, state(), A).outcomes
    assert [(o.ends, o.reward.total) for o in outcomes] == [
        ("goal", 5),
        ("dead end", -7),
        ("", 0),
        ("", 0),
    ]
    sinking = Semantics(meaning.domain, meaning.problem, noise="sink")
    noise = explain_action(sinking, state(), A).outcomes[-1]
    assert (noise.ends, noise.reward.total, noise.changes_nothing) == ("sink", -7, False)


# The whole ----------------------------------------------------------------------------------------


def test_all_instances_or_those_asked_for() -> None:
    meaning = semantics(sure(when=atom("p", "?x")))
    explained = explain(meaning, state("p b2"))
    assert [(str(a.action), a.applies) for a in explained.actions] == [
        ("a(b1)", False),
        ("a(b2)", True),
    ]
    assert [str(a.action) for a in explain(meaning, state(), [A]).actions] == ["a(b1)"]
    with pytest.raises(MeaningError, match="there is no action `push`"):
        explain(meaning, state(), [GroundAction("push")])


def test_the_json_of_the_example() -> None:
    meaning = Semantics(*hdd())
    shown = explain(
        meaning, meaning.initial_state | state("loose board"), [GroundAction("lever", ("n1",))]
    ).as_json()
    assert json.loads(json.dumps(shown)) == {
        "state": ["in(board, tray)", "loose(board)"],
        "derived": [],
        "goal": False,
        "dead_end": False,
        "actions": [
            {
                "action": "lever(n1)",
                "applies": True,
                "rule": "already-loose",
                "conflict": None,
                "rules": [
                    {"rule": "seated", "covers": False, "reason": "`loose(board)` holds"},
                    {
                        "rule": "already-loose",
                        "covers": True,
                        "reason": "covers with e = n1, p = board, b = tray",
                    },
                ],
                "outcomes": [
                    {
                        "name": "freed",
                        "add": ["on-table(board)"],
                        "delete": ["in(board, tray)", "loose(board)"],
                        "reward": pytest.approx(0.9),
                        "reward_parts": {
                            "state": 0.0,
                            "outcome": 1,
                            "cost": 0.1,
                            "goal": 0.0,
                            "dead_end": 0.0,
                        },
                        "probability": {"robot": 0.9, "fine": 0.9, "coarse": 0.9},
                        "ends": "goal",
                    },
                    *(
                        {
                            "name": name,
                            "add": [],
                            "delete": [],
                            "reward": pytest.approx(-0.1),
                            "reward_parts": {
                                "state": 0.0,
                                "outcome": 0.0,
                                "cost": 0.1,
                                "goal": 0.0,
                                "dead_end": 0.0,
                            },
                            "probability": dict.fromkeys(("robot", "fine", "coarse"), probability),
                            "ends": "",
                        }
                        for name, probability in (("held", 0.1), ("noise", 0.0))
                    ),
                ],
            }
        ],
    }


def test_a_goal_state_and_its_derived_atoms() -> None:
    explained = explain(Semantics(*hdd()), state("on-table board"))
    assert explained.is_goal
    assert not explained.is_dead_end
    assert [str(a) for a in explained.derived] == ["clear(board)", "done"]
    assert len(explained.actions) == 20
    assert not any(a.applies for a in explained.actions)


ATOMS = ["in board tray", "loose board", "on-table board", "in spare tray", "loose spare"]


@settings(deadline=None)
@given(st.sets(st.sampled_from(ATOMS)))
def test_the_explanation_agrees_with_the_semantics(facts: set[str]) -> None:
    domain, problem = hdd()
    meaning = Semantics(domain, replace(problem, objects=(*problem.objects, *objects(pcb="spare"))))
    now = state(*facts)
    ground = GroundAction("lever", ("n1",))
    covering = meaning.covering(now, ground)
    explained = explain_action(meaning, now, ground)
    assert explained.rule == (covering.rule.name if covering else None)
    assert {r.rule for r in explained.rules if r.covers} == ({explained.rule} - {None})
    for one in explained.rules:
        unresolved = any(not reference.resolves for reference in one.references)
        assert one.covers is not (unresolved or bool(one.failed))
    for shown in explained.outcomes:
        assert covering is not None
        (real,) = [o for o in covering.rule.outcomes if o.name == shown.name]
        assert (now - set(shown.delete)) | set(shown.add) == meaning.successor(covering, real, now)
        assert not set(shown.add) & now
        assert set(shown.delete) <= now


def test_a_limit_is_not_swallowed() -> None:
    wide = tuple(var(f"y{i}") for i in range(20))
    one = sure("r", references=(the(Not(Exists(wide, FALSE)), V),))
    meaning = semantics(one)
    limited = Semantics(meaning.domain, meaning.problem, work_limit=1000)
    with pytest.raises(LimitError, match="1000 steps"):
        explain_action(limited, state(), A)
