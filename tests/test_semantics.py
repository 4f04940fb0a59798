"""The direct semantics against cases computed by hand, one for each sentence of the reference."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from menid_plan.errors import MeaningError
from menid_plan.grounding.semantics import Semantics
from menid_plan.grounding.state import SINK, GroundAction, State, binding_text, state_text
from menid_plan.grounding.steps import RuleConflict
from menid_plan.model.domain import (
    DerivedPredicate,
    Domain,
    Environment,
    Object,
    Param,
    Problem,
    StateReward,
    Type,
)
from menid_plan.model.expressions import Arithmetic, Number, ParamName
from menid_plan.model.formulas import FALSE, TRUE, Formula, Not
from menid_plan.model.rules import (
    Action,
    Block,
    ConditionalEffect,
    Effect,
    Outcome,
    Rule,
    UniversalEffect,
)
from models import (
    add,
    atom,
    both,
    delete,
    either,
    equal,
    exists,
    fact,
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

ENVIRONMENTS = (Environment("robot", "target"), Environment("fine", "test"))
A = GroundAction("a")
X, Y = var("x"), var("y")


def domain(*rules: Rule, **options: object) -> Domain:
    """A domain with one action ``a`` of these rules, and without parameters unless given."""
    parameters = options.pop("parameters", ())
    cost = options.pop("cost", None)
    action = Action("a", rules, parameters, cost)  # type: ignore[arg-type]
    options.setdefault("types", (Type("block"), Type("ghost")))
    options.setdefault("environments", ENVIRONMENTS)
    options.setdefault("actions", (action,))
    return Domain("d", **options)  # type: ignore[arg-type]


def problem(names: str = "b1 b2", **options: object) -> Problem:
    return Problem("x", "d", objects=objects(block=names), **options)  # type: ignore[arg-type]


def covering_rule(meaning: Semantics, now: State, ground: GroundAction = A) -> str | None:
    covering = meaning.covering(now, ground)
    return covering.rule.name if covering else None


def after(meaning: Semantics, now: State, ground: GroundAction = A) -> State:
    """The one state that a sure action leads to."""
    (transition,) = meaning.transitions(now, ground, "robot")
    assert transition.state is not SINK
    return transition.state


# Which rule covers --------------------------------------------------------------------------------


def test_a_state_is_the_set_of_atoms_that_hold_repeats_are_harmless() -> None:
    init = (fact("p", "b1"), fact("p", "b1"), fact("q"))
    meaning = Semantics(domain(sure()), problem(init=init))
    assert meaning.initial_state == state("p b1", "q")
    assert state_text(meaning.initial_state) == "p(b1), q"


def test_action_instances_come_in_order_of_declaration_and_of_objects() -> None:
    one = Action("b", (sure(),), (var("x", "block"), var("y", "block")))
    other = Action("a", (sure(when=atom("p")),))
    meaning = Semantics(domain(actions=(one, other)), problem())
    applicable = [str(ground) for ground, _ in meaning.applicable(state("p"))]
    assert applicable == ["b(b1, b1)", "b(b1, b2)", "b(b2, b1)", "b(b2, b2)", "a"]
    assert [str(ground) for ground, _ in meaning.applicable(state())] == applicable[:-1]


def test_an_action_over_an_empty_type_has_no_instance() -> None:
    meaning = Semantics(domain(sure(), parameters=(var("x", "ghost"),)), problem())
    assert meaning.applicable(state()) == []


@pytest.mark.parametrize(
    ("now", "resolved"),
    [
        (state(), None),
        (state("on b2"), "v = b2"),
        (state("on b1", "on b2"), None),
        (state("on g"), None),  # no block
    ],
)
def test_a_deictic_reference_needs_exactly_one_tuple(now: State, resolved: str | None) -> None:
    on = sure("r", references=(the(atom("on", "?v"), var("v", "block")),))
    covering = Semantics(domain(on), problem()).covering(now, A)
    assert (binding_text(covering.binding) if covering else None) == resolved


def test_a_reference_sees_all_its_variables_the_parameters_and_earlier_references() -> None:
    left_of = the(both(atom("left", "?v", "?x"), atom("left", "?w", "?v")), var("v"), var("w"))
    then = the(atom("left", "?u", "?w"), var("u"))
    meaning = Semantics(
        domain(sure("r", references=(left_of, then)), parameters=(X,)), problem("b1 b2 b3 b4")
    )
    row = state("left b1 b2", "left b2 b3", "left b3 b4")
    ((ground, covering),) = meaning.applicable(row)
    assert str(ground) == "a(b4)"
    assert covering.binding == {"x": "b4", "v": "b3", "w": "b2", "u": "b1"}


def test_a_tuple_counts_as_a_whole() -> None:
    """Two tuples are several, though each variable alone could name only one or two objects."""
    pair = the(both(atom("on", "?v"), atom("on", "?w")), var("v"), var("w"))
    meaning = Semantics(domain(sure("r", references=(pair,))), problem())
    assert meaning.covering(state("on b1"), A) is not None
    assert meaning.covering(state("on b1", "on b2"), A) is None


@pytest.mark.parametrize(("distinct", "covers"), [(False, False), (True, True)])
def test_variables_range_over_objects_already_named(distinct: bool, covers: bool) -> None:
    """Of two blocks the other is unique only with ``!=``."""
    other: Formula = atom("on", "?v")
    if distinct:
        other = both(other, Not(equal("?v", "?x")))
    meaning = Semantics(
        domain(sure("r", references=(the(other, var("v", "block")),)), parameters=(X,)), problem()
    )
    covering = meaning.covering(state("on b1", "on b2"), GroundAction("a", ("b1",)))
    assert (covering is not None) is covers
    assert covering is None or covering.binding["v"] == "b2"


def test_nothing_resolves_over_an_empty_type() -> None:
    meaning = Semantics(domain(sure("r", references=(the(TRUE, var("v", "ghost")),))), problem())
    assert meaning.covering(state(), A) is None


def test_a_reference_over_one_object_resolves_without_saying_anything() -> None:
    meaning = Semantics(domain(sure("r", references=(the(TRUE, var("v")),))), problem("only"))
    assert meaning.covering(state(), A) is not None


def test_references_and_conditions_see_derived_atoms() -> None:
    derived = DerivedPredicate("free", (X,), Not(atom("held", "?x")))
    free = sure("r", references=(the(atom("free", "?v"), var("v")),), when=atom("free", "?v"))
    meaning = Semantics(domain(free, derived=(derived,)), problem())
    covering = meaning.covering(state("held b1"), A)
    assert covering is not None
    assert covering.binding == {"v": "b2"}


def test_the_condition_sees_parameters_and_references() -> None:
    condition = both(atom("p", "?x"), Not(equal("?x", "?v")))
    one = sure("r", references=(the(atom("on", "?v"), var("v")),), when=condition)
    meaning = Semantics(domain(one, parameters=(X,)), problem())
    now = state("p b1", "p b2", "on b1")
    assert [str(ground) for ground, _ in meaning.applicable(now)] == ["a(b2)"]


def test_otherwise_covers_where_no_other_rule_does() -> None:
    rules = (sure("rest", otherwise=True), sure("p", when=atom("p")), sure("q", when=atom("q")))
    meaning = Semantics(domain(*rules), problem())
    assert covering_rule(meaning, state()) == "rest"
    assert covering_rule(meaning, state("p")) == "p"
    assert covering_rule(meaning, state("q")) == "q"


def test_otherwise_covers_where_the_references_of_the_others_do_not_resolve() -> None:
    found = sure("found", references=(the(atom("on", "?v"), var("v")),))
    meaning = Semantics(domain(found, sure("rest", otherwise=True)), problem())
    assert covering_rule(meaning, state("on b1")) == "found"
    assert covering_rule(meaning, state("on b1", "on b2")) == "rest"


def test_otherwise_is_no_way_out_of_a_conflict() -> None:
    rules = (sure("one"), sure("two"), sure("rest", otherwise=True))
    with pytest.raises(RuleConflict):
        Semantics(domain(*rules), problem()).covering(state(), A)


def test_two_rules_that_cover_are_an_error_that_names_them_their_bindings_and_the_state() -> None:
    reference = the(atom("on", "?v"), var("v"))
    rules = (sure("one", references=(reference,)), sure("two"), sure("never", when=FALSE))
    meaning = Semantics(domain(*rules, parameters=(var("x", "block"),)), problem("b1"))
    with pytest.raises(RuleConflict) as caught:
        meaning.applicable(state("on b1"))
    expected = (
        "`a(b1)` is covered by rules `one` (x = b1, v = b1) and `two` (x = b1) in the state on(b1)"
    )
    assert str(caught.value) == expected
    assert isinstance(caught.value, MeaningError)
    assert str(pickle.loads(pickle.dumps(caught.value))) == expected
    assert covering_rule(meaning, state(), GroundAction("a", ("b1",))) == "two"


def test_rules_of_different_actions_do_not_conflict() -> None:
    meaning = Semantics(domain(actions=(Action("a", (sure(),)), Action("b", (sure(),)))), problem())
    assert [str(ground) for ground, _ in meaning.applicable(state())] == ["a", "b"]


@pytest.mark.parametrize(
    ("ground", "message"),
    [
        (GroundAction("push"), "there is no action `push`"),
        (GroundAction("a"), "`a`: `a` has 1 arguments, not 0"),
        (GroundAction("a", ("rock",)), r"`a\(rock\)`: there is no object `rock` of type block"),
    ],
)
def test_what_is_no_instance_of_an_action(ground: GroundAction, message: str) -> None:
    meaning = Semantics(domain(sure(), parameters=(var("x", "block"),)), problem())
    with pytest.raises(MeaningError, match=message):
        meaning.covering(state(), ground)


# Effects ------------------------------------------------------------------------------------------


def with_effects(*effects: Effect, **options: object) -> Semantics:
    return Semantics(domain(sure("r", *effects), **options), problem())


def test_effects_add_and_delete_and_leave_the_rest() -> None:
    meaning = with_effects(add("p"), delete("q"), delete("absent"))
    assert after(meaning, state("q", "s")) == state("p", "s")


def test_nothing_leaves_the_state() -> None:
    assert after(with_effects(), state("q")) == state("q")


@pytest.mark.parametrize("effects", [(add("p"), delete("p")), (delete("p"), add("p"))])
@pytest.mark.parametrize("now", [state(), state("p")])
def test_the_add_wins(effects: tuple[Effect, ...], now: State) -> None:
    assert after(with_effects(*effects), now) == state("p")


def test_the_add_wins_between_ground_atoms_that_only_the_binding_makes_equal() -> None:
    move = sure("r", delete("at", "?x"), add("at", "?y"))
    meaning = Semantics(domain(move, parameters=(X, Y)), problem())
    assert after(meaning, state("at b1"), GroundAction("a", ("b1", "b1"))) == state("at b1")
    assert after(meaning, state("at b1"), GroundAction("a", ("b1", "b2"))) == state("at b2")


@pytest.mark.parametrize(("now", "then"), [(state("p"), state("p", "q")), (state(), state("s"))])
def test_conditional_effects_happen_where_the_condition_held_before(
    now: State, then: State
) -> None:
    """The second effect does not see what the first one adds."""
    effects = (
        ConditionalEffect(atom("p"), (add("q"),)),
        ConditionalEffect(both(Not(atom("p")), Not(atom("q"))), (add("s"),)),
    )
    assert after(with_effects(*effects), now) == then


def test_a_swap_reads_the_state_before_the_step() -> None:
    swap = (
        ConditionalEffect(atom("p"), (delete("p"), add("q"))),
        ConditionalEffect(atom("q"), (delete("q"), add("p"))),
    )
    assert after(with_effects(*swap), state("p")) == state("q")
    assert after(with_effects(*swap), state("q")) == state("p")
    assert after(with_effects(*swap), state("p", "q")) == state("p", "q")


def test_universal_effects_happen_for_every_binding_that_satisfied_before() -> None:
    """Wet things make their neighbours wet: one step at a time, not along the row."""
    spread = UniversalEffect(
        (X, Y), both(atom("wet", "?x"), atom("near", "?x", "?y")), (add("wet", "?y"),)
    )
    row = ("near b1 b2", "near b2 b3")
    meaning = Semantics(domain(sure("r", spread)), problem("b1 b2 b3"))
    assert after(meaning, state("wet b1", *row)) == state("wet b1", "wet b2", *row)


def test_universal_effects_see_parameters_and_references() -> None:
    effect = UniversalEffect(
        (Y,), Not(equal("?y", "?v")), (add("p", "?x", "?y"), delete("q", "?v"))
    )
    one = sure("r", effect, references=(the(atom("q", "?v"), var("v", "block")),))
    meaning = Semantics(domain(one, parameters=(X,)), problem())
    then = after(meaning, state("q b2"), GroundAction("a", ("b1",)))
    assert then == state("p b1 b1")


def test_conditions_of_effects_see_derived_atoms_of_the_state_before() -> None:
    clear = DerivedPredicate("clear", (X,), Not(exists(Y, atom("on", "?y", "?x"))))
    effects = (
        add("on", "b1", "b2"),
        UniversalEffect((X,), atom("clear", "?x"), (add("seen", "?x"),)),
    )
    then = after(with_effects(*effects, derived=(clear,)), state())
    assert then == state("on b1 b2", "seen b1", "seen b2")


def test_change_gives_what_the_effects_say_before_the_add_wins() -> None:
    meaning = with_effects(add("p"), delete("p"), delete("q"))
    covering = meaning.covering(state("p"), A)
    assert covering is not None
    change = meaning.change(covering, covering.rule.outcomes[0], state("p"))
    assert change == (state("p"), state("p", "q"))


def test_effects_may_name_constants() -> None:
    meaning = with_effects(add("at", "home"), constants=(Object("home"),))
    assert after(meaning, state()) == state("at home")


# Probabilities ------------------------------------------------------------------------------------


def block(environments: str, values: str = "", **rows: tuple[float, ...]) -> Block:
    cells = tuple((name, tuple(map(number, row))) for name, row in rows.items())
    return Block(tuple(environments.split()), tuple(values.split()), cells)


def column(
    one: Rule, environment: str, ground: GroundAction = A, **options: object
) -> tuple[float, ...]:
    meaning = Semantics(domain(one, **options), problem())
    covering = meaning.covering(state(), ground)
    assert covering is not None
    return meaning.probabilities(covering, environment)


def test_a_column_for_each_environment_of_the_head() -> None:
    one = rule(
        "r", outcome("u", (0.5, 0.2)), outcome("v", (0.4, 0.8)), outcome("noise", (0.1, 0.0)),
        environments=("robot", "fine"),
    )  # fmt: skip
    assert column(one, "robot") == (0.5, 0.4, 0.1)
    assert column(one, "fine") == (0.2, 0.8, 0.0)


def test_a_single_column_serves_every_environment_and_noise_without_a_row_is_0() -> None:
    one = rule("r", outcome("u", 0.25), outcome("v", 0.75))
    assert column(one, "robot") == column(one, "fine") == (0.25, 0.75, 0.0)


def test_what_is_more_specific_counts() -> None:
    """``for`` these values, then the rule's block, then the environment's column; never counts."""
    one = rule(
        "r",
        outcome("u", 0.1),
        outcome("v", 0.9),
        per=("x",),
        probabilities=(
            block("robot", u=(0.2,), v=(0.8,)),
            block("robot", "b1", u=(0.3,), v=(0.7,)),
        ),
        observed=(block("robot fine", "b2", u=(99, 99)),),
    )
    at = {name: GroundAction("a", (name,)) for name in ("b1", "b2")}
    assert column(one, "robot", at["b1"], parameters=(X,)) == (0.3, 0.7, 0.0)
    assert column(one, "robot", at["b2"], parameters=(X,)) == (0.2, 0.8, 0.0)
    assert column(one, "fine", at["b1"], parameters=(X,)) == (0.1, 0.9, 0.0)


def test_the_values_of_per_are_in_its_order() -> None:
    one = rule(
        "r", outcome("u", None), per=("y", "x"), probabilities=(block("robot", "b2 b1", u=(1,)),)
    )
    assert column(one, "robot", GroundAction("a", ("b1", "b2")), parameters=(X, Y)) == (1.0, 0.0)
    with pytest.raises(MeaningError, match="environment `robot` for b1, b2"):
        column(one, "robot", GroundAction("a", ("b2", "b1")), parameters=(X, Y))


def test_rows_that_a_block_leaves_out_are_0_and_it_may_have_noise() -> None:
    one = rule(
        "r",
        outcome("u", None),
        outcome("v", None),
        probabilities=(block("robot", v=(0.75,), noise=(0.25,)),),
    )
    assert column(one, "robot") == (0.0, 0.75, 0.25)


@pytest.mark.parametrize(
    "one",
    [
        rule("r", outcome("u", None)),
        rule("r", outcome("u", (1.0,)), environments=("robot",)),
        rule("r", outcome("u", None), observed=(block("fine", u=(3,)),)),
    ],
)
def test_missing_probabilities_are_an_error_naming_rule_and_environment(one: Rule) -> None:
    message = "rule `r` of action `a` has no probabilities in environment `fine`"
    with pytest.raises(MeaningError, match=message):
        column(one, "fine")


def test_an_environment_that_is_not_declared() -> None:
    with pytest.raises(MeaningError, match="there is no environment `lab`"):
        column(sure(), "lab")


def test_a_domain_without_environments_has_one_named_target() -> None:
    assert column(sure(), "target", environments=()) == (1.0, 0.0)


def test_a_column_is_divided_by_its_sum() -> None:
    one = rule("r", outcome("u", 0.5), outcome("v", 0.5 + 8e-7))
    probabilities = column(one, "robot")
    assert math.fsum(probabilities) == pytest.approx(1, abs=1e-15)
    assert probabilities[0] == 0.5 / (1 + 8e-7)


def test_setting_a_param_checks_a_column_again() -> None:
    p = ParamName("p")
    rest = Arithmetic("-", Number(1), p)
    one = rule("r", Outcome("u", (p,)), Outcome("v", (rest,)))
    other = rule("r", Outcome("u", (p,)), outcome("v", 0.5))
    for bad, wrong in ((one, 1.5), (other, 0.6)):
        declared = domain(bad, params=(Param("p", Number(0.5)),))
        for value, fine in ((0.5, True), (wrong, False)):
            meaning = Semantics(declared, problem(), {"p": value})
            covering = meaning.covering(state(), A)
            assert covering is not None
            if fine:
                assert meaning.probabilities(covering, "fine") == (0.5, 0.5, 0.0)
            else:
                with pytest.raises(MeaningError, match=r"`r` of action `a`.*`fine`.*sum to 1"):
                    meaning.probabilities(covering, "fine")


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({"q": 1.0}, "no param `q`"),
        ({"p": math.nan}, "param `p` is nan"),
        ({"p": math.inf}, "param `p` is inf"),
    ],
)
def test_params_that_cannot_be_set(params: dict[str, float], message: str) -> None:
    with pytest.raises(MeaningError, match=message):
        Semantics(domain(sure(), params=(Param("p", Number(0)),)), problem(), params)


def test_a_param_of_the_problem_wins_over_the_domains_and_the_callers_over_both() -> None:
    declared = domain(rule("r", outcome("u", 1, reward="p")), params=(Param("p", Number(1)),))
    set_anew = problem(params=(Param("p", Number(2)),))
    for meaning, expected in (
        (Semantics(declared, problem()), 1),
        (Semantics(declared, set_anew), 2),
        (Semantics(declared, set_anew, {"p": 3}), 3),
    ):
        assert [t.reward for t in meaning.transitions(state(), A, "robot")] == [expected]


def test_division_by_zero_is_an_error() -> None:
    cost = Arithmetic("/", Number(1), ParamName("p"))
    declared = domain(sure(), cost=cost, params=(Param("p", Number(0)),))
    with pytest.raises(MeaningError, match="cost of action `a`: division by zero"):
        Semantics(declared, problem()).transitions(state(), A, "robot")


# Steps --------------------------------------------------------------------------------------------


def test_transitions_keep_outcomes_apart_and_leave_out_those_of_probability_0() -> None:
    one = rule(
        "r",
        outcome("same", 0.5, add("p"), reward=1),
        outcome("never", 0, add("q")),
        outcome("again", 0.25, add("p"), reward=2),
        outcome("noise", 0.25),
    )
    found = Semantics(domain(one), problem()).transitions(state(), A, "robot")
    assert [(t.probability, t.outcome, t.state, t.reward) for t in found] == [
        (0.5, "same", state("p"), 1.0),
        (0.25, "again", state("p"), 2.0),
        (0.25, "noise", state(), 0.0),
    ]


def test_an_action_that_does_not_apply_has_no_transitions() -> None:
    meaning = Semantics(domain(sure(when=atom("p"))), problem())
    assert meaning.transitions(state(), A, "robot") == []


def test_noise_as_a_sink_pays_the_steps_own_reward_and_the_dead_ends() -> None:
    noisy = rule("r", outcome("ok", 0.5), outcome("noise", 0.5, reward=-3))
    declared = domain(noisy, cost=Number(0.5), rewards=(StateReward(Number(10), TRUE),))
    plain, with_dead_end = problem(), problem(dead_end_reward=number(-100))
    for instance, noise, expected in (
        (plain, "stay", (state("q"), 6.5)),
        (with_dead_end, "stay", (state("q"), 6.5)),
        (plain, "sink", (SINK, 6.5)),
        (with_dead_end, "sink", (SINK, -93.5)),
    ):
        meaning = Semantics(declared, instance, noise=noise)  # type: ignore[arg-type]
        last = meaning.transitions(state("q"), A, "robot")[-1]
        assert (last.state, last.reward) == expected


def test_the_sink_is_final_a_dead_end_and_no_goal() -> None:
    meaning = Semantics(domain(sure()), problem(goal=TRUE), noise="sink")
    assert (meaning.is_final(SINK), meaning.is_dead_end(SINK), meaning.is_goal(SINK)) == (
        True,
        True,
        False,
    )
    assert repr(SINK) == "SINK"


def test_a_reward_is_state_plus_outcome_minus_cost() -> None:
    one = rule("r", outcome("u", 1, add("p"), reward=20))
    rewards = (StateReward(number(3), atom("q")), StateReward(number(1000), atom("p")))
    meaning = Semantics(domain(one, cost=Number(0.25), rewards=rewards), problem())
    (transition,) = meaning.transitions(state("q"), A, "robot")
    assert transition.reward == 22.75  # that of the state it is taken in, not of the next


def test_state_rewards_add_up_and_per_counts_bindings() -> None:
    rewards = (
        StateReward(number(1), atom("q")),
        StateReward(number(-10), atom("on", "?x", "?y"), (X, Y)),
        StateReward(number(100), exists(X, exists(Y, atom("on", "?x", "?y")))),
        StateReward(number(5000), TRUE, (var("g", "ghost"),)),
    )
    meaning = Semantics(domain(sure(), rewards=rewards), problem())
    assert meaning.state_reward(state()) == 0
    assert meaning.state_reward(state("q")) == 1
    assert meaning.state_reward(state("q", "on b1 b2", "on b2 b1", "on b1 b1")) == 71


def test_the_goals_reward_is_paid_on_arrival() -> None:
    instance = problem(goal=atom("p"), goal_reward=number(50))
    reached = Semantics(domain(sure("r", add("p"))), instance)
    missed = Semantics(domain(sure("r", add("q"))), instance)
    assert [t.reward for t in reached.transitions(state(), A, "robot")] == [50]
    assert [t.reward for t in missed.transitions(state(), A, "robot")] == [0]


def test_without_a_goal_no_state_is_one() -> None:
    assert not Semantics(domain(sure()), problem()).is_goal(state())


def test_a_goal_may_be_derived() -> None:
    done = DerivedPredicate("done", (), forall(var("x", "block"), atom("on", "?x")))
    meaning = Semantics(domain(sure(), derived=(done,)), problem(goal=atom("done")))
    assert meaning.is_goal(state("on b1", "on b2"))
    assert not meaning.is_goal(state("on b1"))


def test_a_dead_end_is_a_state_in_which_nothing_applies_and_that_is_no_goal() -> None:
    one = sure("r", when=Not(either(atom("p"), atom("g"))))
    meaning = Semantics(domain(one), problem(goal=atom("g"), dead_end_reward=number(-9)))
    assert [meaning.is_dead_end(s) for s in (state(), state("p"), state("g"))] == [
        False,
        True,
        False,
    ]
    assert [meaning.is_final(s) for s in (state(), state("p"), state("g"))] == [False, True, True]


@pytest.mark.parametrize(("effect", "paid"), [("p", -9), ("g", 4), ("s", 0)])
def test_the_dead_ends_reward_is_paid_on_entering(effect: str, paid: float) -> None:
    one = sure("r", add(effect), when=Not(either(atom("p"), atom("g"))))
    instance = problem(goal=atom("g"), goal_reward=number(4), dead_end_reward=number(-9))
    (transition,) = Semantics(domain(one), instance).transitions(state(), A, "robot")
    assert transition.reward == paid


def test_a_conflict_in_the_next_state_is_not_this_steps_error() -> None:
    rules = (
        sure("start", add("p"), when=Not(atom("p"))),
        sure("one", when=atom("p")),
        sure("two", when=atom("p")),
    )
    meaning = Semantics(domain(*rules), problem(dead_end_reward=number(-1)))
    (transition,) = meaning.transitions(state(), A, "robot")
    assert (transition.state, transition.reward) == (state("p"), 0)
    with pytest.raises(RuleConflict):
        meaning.applicable(state("p"))


@pytest.mark.parametrize(("horizon", "final"), [(None, False), (3, False), (2, True), (0, True)])
def test_the_horizon_ends_an_episode(horizon: int | None, final: bool) -> None:
    meaning = Semantics(domain(sure()), problem(horizon=horizon))
    assert meaning.is_final(state(), step=2) is final
    assert meaning.is_final(state()) is (horizon == 0)


def test_the_parts_of_a_reward() -> None:
    meaning = Semantics(
        domain(
            rule("r", outcome("u", 1, add("g"), reward=2)),
            cost=Number(16),
            rewards=(StateReward(number(1), TRUE),),
        ),
        problem(goal=atom("g"), goal_reward=number(4), dead_end_reward=number(8)),
    )
    covering = meaning.covering(state(), A)
    assert covering is not None
    reward = meaning.step_reward(covering, covering.rule.outcomes[0], state(), state("g"))
    parts = (reward.state, reward.outcome, reward.cost, reward.goal, reward.dead_end)
    assert parts == (1, 2, 16, 4, 0)
    assert reward.total == -9
    sunk = meaning.step_reward(covering, covering.rule.outcomes[0], state(), SINK)
    assert (sunk.goal, sunk.dead_end) == (0, 8)


# The example of the reference ---------------------------------------------------------------------


def test_lever_seated_board() -> None:
    meaning = Semantics(*hdd())
    applicable = meaning.applicable(meaning.initial_state)
    assert [str(ground) for ground, _ in applicable] == [f"lever(n{i})" for i in range(1, 21)]
    ground, covering = applicable[2]
    assert str(covering) == "`seated` (e = n3, p = board, b = tray)"
    assert covering.values == ("n3",)
    found = meaning.transitions(meaning.initial_state, ground, "fine")
    assert [(t.probability, t.outcome, t.state) for t in found] == [
        (0.50, "freed", state("on-table board")),
        (0.20, "shifted", state("in board tray", "loose board")),
        (0.25, "held", state("in board tray")),
        (0.05, "noise", state("in board tray")),
    ]
    # The problem sets fail = 10; the goal has no reward of its own.
    assert [t.reward for t in found] == pytest.approx([0.9, -10.1, -10.1, -10.1])
    assert meaning.is_goal(state("on-table board"))


def test_lever_loose_board() -> None:
    meaning = Semantics(*hdd(), noise="sink")
    now = state("in board tray", "loose board")
    found = meaning.transitions(now, GroundAction("lever", ("n7",)), "coarse")
    assert [(t.probability, t.outcome, t.state) for t in found] == [
        (0.9, "freed", state("on-table board")),
        (0.1, "held", now),
    ]
    assert [t.reward for t in found] == pytest.approx([0.9, -0.1])


def test_the_derived_atoms_of_the_example() -> None:
    meaning = Semantics(*hdd())
    assert meaning.complete(meaning.initial_state) == meaning.initial_state
    free = state("on-table board")
    assert meaning.complete(free) == free | state("clear board", "done")
    assert meaning.state_reward(free) == 0
    assert meaning.state_reward(state("on-table board", "loose board")) == -1


def test_a_second_board_in_a_bay_makes_the_reference_ambiguous() -> None:
    declared, instance = hdd()
    more = replace(instance, objects=(*instance.objects, *objects(pcb="spare")))
    meaning = Semantics(declared, more)
    assert len(meaning.applicable(meaning.initial_state)) == 20
    crowded = meaning.initial_state | state("in spare tray")
    assert meaning.applicable(crowded) == []
    assert meaning.is_dead_end(crowded)


# Properties ---------------------------------------------------------------------------------------

FACTS = ["in board tray", "loose board", "on-table board", "in spare tray", "loose spare"]


@settings(deadline=None)
@given(st.sets(st.sampled_from(FACTS)), st.sampled_from(["robot", "fine", "coarse"]))
def test_every_step_is_a_distribution_over_states_of_basic_atoms(
    facts: set[str], environment: str
) -> None:
    declared, instance = hdd()
    meaning = Semantics(
        declared, replace(instance, objects=(*instance.objects, *objects(pcb="spare")))
    )
    now = state(*facts)
    basic = {predicate.name for predicate in declared.predicates}
    applicable = dict(meaning.applicable(now))
    assert bool(applicable) is (len([f for f in facts if f.startswith("in ")]) == 1)
    for ground, covering in applicable.items():
        assert meaning.covering(now, ground) == covering
        found = meaning.transitions(now, ground, environment)
        assert math.fsum(t.probability for t in found) == pytest.approx(1)
        assert {a.predicate for t in found if t.state is not SINK for a in t.state} <= basic


LITERALS = st.lists(
    st.builds(lambda p, o, add_: (add if add_ else delete)(p, o),
              st.sampled_from("pq"), st.sampled_from(["b1", "b2", "?x"]), st.booleans())
)  # fmt: skip


@settings(deadline=None)
@given(LITERALS, st.sets(st.sampled_from(["p b1", "p b2", "q b1", "q b2"])))
def test_the_next_state_has_what_was_added_or_was_there_and_not_deleted(
    effects: list[Effect], facts: set[str]
) -> None:
    now = state(*facts)
    meaning = Semantics(domain(sure("r", *effects), parameters=(X,)), problem())
    ground = GroundAction("a", ("b1",))
    covering = meaning.covering(now, ground)
    assert covering is not None
    added, deleted = meaning.change(covering, covering.rule.outcomes[0], now)
    then = after(meaning, now, ground)
    for f in ("p b1", "p b2", "q b1", "q b2"):
        (one,) = state(f)
        assert (one in then) is (one in added or (one in now and one not in deleted))
        texts = (f"{f[0]} ?x", f) if f.endswith("b1") else (f,)
        said = [
            e for e in effects if any(e in (add(*t.split()), delete(*t.split())) for t in texts)
        ]
        assert (one in added) is any(e.positive for e in said)  # type: ignore[union-attr]
        assert (one in deleted) is any(not e.positive for e in said)  # type: ignore[union-attr]


def test_exploration_of_a_few_hundred_states_is_quick() -> None:
    """Five blocks, stacked at will: 501 configurations, the number of sets of lists of five."""
    block_x, block_y, block_z = (var(v, "block") for v in "xyz")
    clear = DerivedPredicate("clear", (block_x,), Not(exists(block_y, atom("on", "?y", "?x"))))
    table = DerivedPredicate("table", (block_x,), Not(exists(block_y, atom("on", "?x", "?y"))))
    above = DerivedPredicate(
        "above",
        (block_x, block_y),
        exists(
            block_z,
            both(atom("on", "?x", "?z"), either(equal("?z", "?y"), atom("above", "?z", "?y"))),
        ),
    )
    free = both(
        atom("clear", "?x"), atom("clear", "?y"), atom("table", "?x"), Not(equal("?x", "?y"))
    )
    stack = Action("stack", (sure("r", add("on", "?x", "?y"), when=free),), (block_x, block_y))
    down = both(atom("clear", "?x"), atom("on", "?x", "?y"))
    unstack = Action(
        "unstack", (sure("r", delete("on", "?x", "?y"), when=down),), (block_x, block_y)
    )
    declared = domain(actions=(stack, unstack), derived=(clear, table, above))
    meaning = Semantics(declared, problem("b1 b2 b3 b4 b5"))
    seen, pending = {state()}, [state()]
    while pending:
        now = pending.pop()
        assert not any(
            a.predicate == "above" and a.arguments[0] == a.arguments[1]
            for a in meaning.complete(now)
        )
        for ground, _ in meaning.applicable(now):
            then = after(meaning, now, ground)
            if then not in seen:
                seen.add(then)
                pending.append(then)
    assert len(seen) == 501
