"""PPDDL that is read: what it means as MENID, and what is said of what can't be read."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest
from click.testing import Result

import menid_plan
from conftest import ROOT
from menid_plan.language.write import write
from menid_plan.model.domain import Domain, Problem
from menid_plan.planning import Task
from menid_plan.ppddl.menid import menid as to_menid
from menid_plan.ppddl.read import read
from menid_plan.ppddl.tables import TooLargeError
from menid_plan.solving import Objective
from menid_plan.source import SourceFile

DOMAIN = """
(define (domain d) (:requirements :adl :mdp)
  (:types a b - thing thing)
  (:constants c a1 - a)
  (:predicates (p ?x - thing) (q ?x - a ?y - thing) (r) (s))
  (:action go :parameters (?x - a) :precondition {pre} :effect {effect}))
"""
PROBLEM = """
(define (problem one) (:domain d) (:objects a2 - a b1 - b) (:init {init})
  (:goal {goal}) {more})
"""


def documents(*texts: str, problem: str | None = None) -> tuple[Domain, Problem]:
    """What the texts are in MENID, once it was written and read again."""
    found = read([SourceFile(f"{i}.pddl", text) for i, text in enumerate(texts)], problem)
    assert not found.diagnostics, [d.message for d in found.diagnostics]
    assert found.domain is not None
    assert found.problem is not None
    domain, made, _ = to_menid(found.domain, found.problem)
    read_domain = menid_plan.parse(write(domain)).domain
    read_problem = menid_plan.parse(write(made), read_domain).problem
    assert read_domain is not None
    assert read_problem is not None
    return read_domain, read_problem


def small(
    effect: str, pre: str = "()", init: str = "(r)", goal: str = "(s)", more: str = ""
) -> Task:
    domain = DOMAIN.format(effect=effect, pre=pre)
    return Task(*documents(domain, PROBLEM.format(init=init, goal=goal, more=more)))


def first_step(task: Task, action: str = "go(c)") -> dict[tuple[str, float], float]:
    """What one action leads to in the initial state: the atoms that hold then, and what is paid."""
    task.build()
    structure, mdp = task.structure, task.mdp
    for row in range(int(mdp.state_row[mdp.initial]), int(mdp.state_row[mdp.initial + 1])):
        if str(structure.action(row)) == action:
            span = slice(int(mdp.row_transition[row]), int(mdp.row_transition[row + 1]))
            reward = round(float(mdp.row_reward[row]), 9)
            found: dict[tuple[str, float], float] = {}
            for number, chance in zip(
                mdp.next_state[span].tolist(), mdp.row_probabilities(row).tolist(), strict=True
            ):
                state = structure.state(number)
                assert isinstance(state, frozenset)
                key = (" ".join(sorted(map(str, state))), reward)
                found[key] = round(found.get(key, 0.0) + chance, 9)
            return found
    raise AssertionError(f"{action} does not apply")


def value(task: Task, objective: Objective) -> float:
    task.build()
    solution = task.solve(task.solver("value-iteration"), objective)
    return float(solution.lower[solution.initial])


@pytest.mark.parametrize(
    ("effect", "result"),
    [
        # What is left of 1 is no change.
        ("(probabilistic 0.25 (s))", {("r s", 0): 0.25, ("r", 0): 0.75}),
        ("(probabilistic 1/4 (s) .5 (not (r)))", {("r s", 0): 0.25, ("", 0): 0.5, ("r", 0): 0.25}),
        # What is added wins over what is deleted.
        ("(and (s) (not (s)) (not (r)) (r))", {("r s", 0): 1}),
        # Nested chances are multiplied, those side by side are independent.
        (
            "(probabilistic 0.5 (probabilistic 0.5 (s)) 0.5 (not (r)))",
            {("r s", 0): 0.25, ("r", 0): 0.25, ("", 0): 0.5},
        ),
        (
            "(and (probabilistic 0.5 (s)) (probabilistic 0.5 (not (r))))",
            {("r s", 0): 0.25, ("s", 0): 0.25, ("r", 0): 0.25, ("", 0): 0.25},
        ),
        # Conditions, around a chance and in it, are those before the step.
        ("(when (r) (probabilistic 0.5 (s)))", {("r s", 0): 0.5, ("r", 0): 0.5}),
        ("(when (s) (probabilistic 0.5 (not (r))))", {("r", 0): 1}),
        ("(probabilistic 0.5 (and (not (r)) (when (r) (s))))", {("s", 0): 0.5, ("r", 0): 0.5}),
        ("(and (when (r) (s)) (when (s) (not (r))))", {("r s", 0): 1}),
        # Everything, and a chance for everything.
        ("(forall (?y - b) (p ?y))", {("p(b1) r", 0): 1}),
        ("(forall (?y - a) (when (not (= ?y ?x)) (q ?x ?y)))", {("q(c, a1) q(c, a2) r", 0): 1}),
        (
            "(forall (?y - (either a b)) (when (not (= ?y c)) (when (not (= ?y a1))"
            " (probabilistic 0.5 (p ?y)))))",
            {("p(a2) p(b1) r", 0): 0.25, ("p(a2) r", 0): 0.25, ("p(b1) r", 0): 0.25, ("r", 0): 0.25},
        ),
        # A variable may be called like one around it.
        ("(forall (?x - a) (p ?x))", {("p(a1) p(a2) p(c) r", 0): 1}),
        ("(when (exists (?x - b) (not (p ?x))) (p ?x))", {("p(c) r", 0): 1}),
        # Rewards: for sure, by chance, where something holds, for each of which it holds.
        ("(and (s) (increase (reward) 3) (decrease (reward) 1/2))", {("r s", 2.5): 1}),
        ("(probabilistic 0.5 (increase (reward) 3))", {("r", 1.5): 1}),
        ("(when (r) (decrease (reward) 2))", {("r", -2): 1}),
        ("(when (s) (decrease (reward) 2))", {("r", 0): 1}),
        ("(forall (?y - a) (when (not (p ?y)) (decrease (reward) 2)))", {("r", -6): 1}),
        ("(forall (?y - a) (decrease (reward) 2))", {("r", -6): 1}),
        ("(probabilistic 0.5 (when (r) (and (s) (increase (reward) 4))))",
         {("r s", 2): 0.5, ("r", 2): 0.5}),
    ],
)  # fmt: skip
def test_effects(effect: str, result: dict[tuple[str, float], float]) -> None:
    assert first_step(small(effect)) == result


@pytest.mark.parametrize(
    ("formula", "holds"),
    [
        ("(and)", True),
        ("()", True),
        ("(or)", False),
        ("r", True),
        ("(not (s))", True),
        ("(or (s) (r))", True),
        ("(imply (r) (s))", False),
        ("(imply (s) (r))", True),
        ("(exists (?y - b) (p ?y))", True),
        ("(forall (?y - thing) (p ?y))", False),
        ("(forall (?y - b) (imply (p ?y) (r)))", True),
        ("(and (= ?x c) (not (= ?x a1)))", True),
        ("(exists (?y ?z - a ?w - b) (and (not (= ?y ?z)) (p ?w)))", True),
    ],
)
def test_conditions(formula: str, holds: bool) -> None:
    task = small("(s)", pre=formula, init="(r) (p b1)")
    if holds:
        assert first_step(task) == {("p(b1) r s", 0): 1}
    else:
        with pytest.raises(AssertionError, match="does not apply"):
            first_step(task)


def test_what_is_best() -> None:
    text = "(probabilistic 0.5 (s) 0.25 (and (not (r)) (decrease (reward) 8)))"
    reward = small(text, pre="(r)", more="(:goal-reward 100) (:metric maximize (reward))")
    # s = .5 (100) + .25 (-8) + .25 s
    assert value(reward, "reward") == pytest.approx((50 - 2) / 0.75)
    assert value(reward, "goal-probability") == pytest.approx(0.5 / 0.75)
    steps = small("(probabilistic 0.5 (s))", more="(:metric minimize (total-time))")
    assert value(steps, "reward") == pytest.approx(-2)
    none = small(text, pre="(r)", more="(:metric maximize (goal-achieved))")
    assert value(none, "reward") == 0
    cost = DOMAIN.replace("(:action", "(:functions (cost))\n(:action").format(
        effect="(and (probabilistic 0.5 (s)) (increase (cost) 3) (increase (reward) 1))", pre="()"
    )
    problem = PROBLEM.format(init="(= (cost) 0)", goal="(s)", more="(:metric minimize (cost))")
    assert value(Task(*documents(cost, problem)), "reward") == pytest.approx(-6)


def test_what_every_action_pays_is_a_reward_of_states() -> None:
    paid = "(forall (?y - a) (when (p ?y) (decrease (reward) 1)))"
    text = DOMAIN.format(effect=f"(and (s) {paid})", pre="()").rstrip()[:-1]
    text += f"(:action wait :effect (and {paid} (decrease (reward) 5))))"
    domain, problem = documents(text, PROBLEM.format(init="(p c) (p a1)", goal="(s)", more=""))
    assert len(domain.rewards) == 1
    assert [len(action.rules) for action in domain.actions] == [1, 1]
    assert first_step(Task(domain, problem)) == {("p(a1) p(c) s", -2): 1}
    assert first_step(Task(domain, problem), "wait") == {("p(a1) p(c)", -7): 1}


def test_effects_that_exclude_each_other_share_a_draw() -> None:
    parts = " ".join(
        f"(when (and (p {one}) (not (p {other}))) (probabilistic 0.5 (s)))"
        for one, other in (("a1", "c"), ("c", "a1"))
    )
    task = small(f"(and {parts})", init="(p a1)")
    assert first_step(task) == {("p(a1) s", 0): 0.5, ("p(a1)", 0): 0.5}
    assert len(task.domain.actions[0].rules[0].outcomes) == 3  # two, and noise


def test_a_chance_for_what_is_related_to_the_parameters() -> None:
    """Too many things for one table, but few that a relation which never changes picks."""
    domain = """
    (define (domain roads) (:requirements :adl :probabilistic-effects) (:types city)
      (:predicates (at ?c - city) (detour ?c ?d - city))
      (:action drive :parameters (?c ?d - city) :precondition (at ?c) :effect
        (and (not (at ?c)) (probabilistic 0.8 (at ?d) 0.2
          (forall (?e - city) (when (detour ?c ?e) (forall (?f - city) (when (detour ?e ?f)
            (probabilistic 0.5 (at ?e) 0.5 (at ?f))))))))))
    """
    names = [f"c{i}" for i in range(20)]
    roads = " ".join(f"(detour {a} {b})" for a, b in pairwise(names))
    problem = f"""
    (define (problem far) (:domain roads) (:objects {" ".join(names)} - city)
      (:init (at c0) {roads}) (:goal (at c19)))
    """
    task = Task(*documents(domain, problem))
    after = {
        next(word for word in atoms.split(") ") if word.startswith("at")).rstrip(")"): chance
        for (atoms, _), chance in first_step(task, "drive(c0, c5)").items()
    }
    assert after == {"at(c5": 0.8, "at(c1": 0.1, "at(c2": 0.1}


def test_names_become_those_of_menid() -> None:
    domain = """
    (define (domain The-Domain-) (:requirements :adl)
      (:types rule) (:constants when - rule)
      (:predicates (count ?x - rule) (a--b) (a-b))
      (:action for :parameters (?when ?x-- - rule) :effect (and (count ?when) (a--b) (a-b))))
    """
    problem = "(define (problem P) (:domain the-domain-) (:init) (:goal (COUNT when)))"
    made, task = documents(domain, problem)
    assert made.name == "the-domain"
    assert [p.name for p in made.predicates] == ["count-2", "a-b", "a-b-2"]
    assert [o.name for o in made.constants] == ["when-2"]
    assert [a.name for a in made.actions] == ["for-2"]
    names = [v.name for v in made.actions[0].parameters]
    assert len(set(names)) == 2
    assert value(Task(made, task), "goal-probability") == 1


def test_one_of_several_problems() -> None:
    domain = DOMAIN.format(effect="(s)", pre="()")
    two = PROBLEM.format(init="", goal="(s)", more="")
    text = domain + two + two.replace("problem one", "problem Two")
    assert documents(text, problem="two")[1].name == "two"
    several = read([SourceFile("d", text)])
    assert [d.code for d in several.diagnostics] == ["P102"]
    none = read([SourceFile("d", text)], "three")
    assert "there is no problem `three`; there are: one, two" in none.diagnostics[0].message


RIGHT = DOMAIN.format(effect="(s)", pre="()") + PROBLEM.format(init="", goal="(s)", more="")


@pytest.mark.parametrize(
    ("old", "new", "code", "message"),
    [
        ("(s))", "(s) $)", "P001", "the character `$` has no meaning"),
        ("(:predicates", "(:predicates (", "P002", "is never closed"),
        ("(define (problem", "hello (define (problem", "P002", "expected `(define ...)`"),
        ("(s)))\n\n", "(s)))) \n\n", "P002", "one `)` too many"),
        ("(s)", "(and" * 200 + ")" * 200, "P003", "nested more than 100 deep"),
        ("(define (domain d)", "(define (thing d)", "P101", "`(define (domain NAME) ...)`"),
        ("(:constants", "(:constance", "P101", "`(:constance ...)` is no part of a domain"),
        ("(:init", "(:start", "P101", "`(:start ...)` is no part of a problem"),
        ("(:goal (s))", "(:goal (s) (r))", "P103", "expected `(:goal FORMULA)`, found 2 parts"),
        ("(:goal (s))", "(:goal (not))", "P103", "expected `(not FORMULA)`, found no parts"),
        (":effect (s)", ":effect (probabilistic 0.5)", "P103", "(probabilistic NUMBER EFFECT"),
        (":effect (s)", ":efect (s)", "P101", "expected one of `:parameters`"),
        (":effect (s)", ":effect (t)", "P201", "unknown predicate `t`"),
        ("?x - thing) (q", "?x - thin) (q", "P201", "unknown type `thin`"),
        (":effect (s)", ":effect (p ?y)", "P201", "unknown variable `?y`"),
        (":effect (s)", ":effect (p a7)", "P201", "unknown object `a7`"),
        ("(r) (s))", "(r) (r) (s))", "P202", "predicate `r` is declared twice"),
        ("a2 - a", "a2 - a a1 - b", "P202", "object `a1` is declared twice"),
        (":effect (s)", ":effect (p ?x ?x)", "P203", "takes 1 arguments, not 2"),
        (":effect (s)", ":effect (forall (?y - b) (q ?y ?x))", "P204", "`?y` is of type b"),
        (":effect (s)", ":effect (probabilistic 1/0 (s))", "P205", "`1/0` is no number"),
        (":effect (s)", ":effect (probabilistic 1.5 (s))", "P206", "is not between 0 and 1"),
        (":effect (s)", ":effect (probabilistic 1.0000000001 (s))", "P206", "probability 1.0000000001"),
        (":effect (s)", f":effect (probabilistic 1{'0' * 400} (s))", "P205", "is too large"),
        (":effect (s)", f":effect (probabilistic 1/1{'0' * 400} (s))", "P205", "is too small"),
        (":effect (s)", f":effect (increase (reward) (* {9 * 10**200} {10**200}))", "P205", "large"),
        ("(:goal (s))", f"(:goal (s)) (:goal-reward {10**309})", "P205", "is too large"),
        (":effect (s)", ":effect (probabilistic 1e-3 (s))", "P205", "`1e-3` is no number"),
        (":effect (s)", ":effect (probabilistic -0.5 (s))", "P205", "`-0.5` is no number"),
        (":effect (s)", ":effect (probabilistic .6 (s) .6 (r))", "P206", "add up to 1.2"),
        ("a b - thing thing", "a b - thing thing - a", "P207", "is above itself"),
        ("(:domain d)", "(:domain e)", "P208", "the problem is for `e`"),
        ("(:domain d)", "", "P103", "lacks `(:domain NAME)`"),
        (":effect (s)", ":effect (oneof (s) (r))", "P301", "an outcome without a probability"),
        (":effect (s)", ":effect (assign (reward) 3)", "P301", "numeric fluents"),
        (":precondition ()", ":precondition (> (reward) 3)", "P301", "fluents in conditions"),
        ("(:init ", "(:init (probabilistic 0.5 (r)) ", "P301", "probabilistic initial state"),
        ("(:constants", "(:derived (r) (s)) (:constants", "P301", "derived predicates"),
        ("b1 - b", "b1 - (either a b)", "P301", "of several types"),
        ("(:goal (s))", "(:goal (s)) (:metric maximize (+ (reward) 1))", "P301", "several fluents"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_with_its_place(old: str, new: str, code: str, message: str) -> None:
    assert old in RIGHT
    found = read([SourceFile("d.pddl", RIGHT.replace(old, new, 1))])
    assert found.domain is None
    assert found.problem is None
    first = found.diagnostics[0]
    assert (first.code, message in first.message) == (code, True), first
    assert first.span.line > 0


def test_all_errors_are_told_at_once() -> None:
    text = RIGHT.replace("(p ?x - thing)", "(p ?x - thin)").replace("(:goal (s))", "(:goal (t))")
    found = read([SourceFile("d.pddl", text)])
    assert {d.code for d in found.diagnostics} == {"P201"}
    assert len(found.diagnostics) == 2


def test_not_every_fault_is_told() -> None:
    many = RIGHT.replace("(:init ", f"(:init {'() ' * 500_000}")
    found = read([SourceFile("d", many)]).diagnostics
    assert len(found) == 101
    assert (found[-1].code, found[-1].message) == (
        "P004",
        "more than 100 faults: the rest is not read",
    )


def test_names_that_are_too_long_for_menid() -> None:
    long, other = "n" * 600, "n" * 599 + "m"
    domain = f"(define (domain d) (:predicates ({long}) ({other})) (:action a :effect ({long})))"
    problem = f"(define (problem p) (:domain d) (:goal (and ({long}) (not ({other})))))"
    made, task = documents(domain, problem)
    assert len({p.name for p in made.predicates}) == 2
    assert all(len(p.name) <= 255 for p in made.predicates)
    assert value(Task(made, task), "goal-probability") == 1


def test_what_makes_too_many_outcomes_is_refused() -> None:
    many = " ".join(f"(probabilistic 0.5 (p{i}))" for i in range(12))
    predicates = " ".join(f"(p{i})" for i in range(12))
    text = f"""
    (define (domain d) (:requirements :adl :mdp) (:predicates {predicates})
      (:action go :effect (and {many})))
    (define (problem p) (:domain d) (:init) (:goal (p0)))
    """
    with pytest.raises(TooLargeError, match="more than 2000 outcomes"):
        documents(text)


def test_the_command(menid: Callable[..., Result], tmp_path: Path) -> None:
    (tmp_path / "d.pddl").write_text(DOMAIN.format(effect="(probabilistic 1/3 (s))", pre="()"))
    (tmp_path / "p.pddl").write_text(PROBLEM.format(init="(r)", goal="(s)", more=""))
    result = menid("import", "ppddl", "d.pddl", "p.pddl", "-o", "out")
    assert result.exit_code == 0, result.output
    assert "s:         1/3  s\n" in (tmp_path / "out" / "domain.menid").read_text()
    solved = menid("solve", "out/domain.menid", "out/problem.menid", "--objective", "steps")
    assert "value             3.0" in solved.stdout
    wrong = menid("import", "ppddl", "p.pddl", "-o", "out")
    assert wrong.exit_code == 3
    assert "there is no domain" in wrong.stderr
    (tmp_path / "d.pddl").write_text(DOMAIN.format(effect="(t)", pre="()"))
    wrong = menid("import", "ppddl", "d.pddl", "p.pddl", "-o", "other")
    assert wrong.exit_code == 3
    assert "d.pddl:6:62: error[P201]: unknown predicate `t`" in wrong.stderr
    assert not (tmp_path / "other").exists()


def test_the_page_has_every_code() -> None:
    source = "\n".join(p.read_text() for p in (ROOT / "menid_plan" / "ppddl").glob("*.py"))
    page = (ROOT / "docs" / "ppddl.md").read_text()
    codes = sorted(set(re.findall(r"\bP[0-9]{3}\b", source)))
    assert re.findall(r"^\| (P[0-9]{3}) \|", page, re.MULTILINE) == codes
