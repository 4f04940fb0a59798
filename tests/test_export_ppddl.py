"""`menid export ppddl`: its forms, options and numbers; read by a reader that is not ours."""

from __future__ import annotations

import itertools
import json
import re
from collections import deque
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result

from conftest import ROOT
from menid_plan.exchange.numbers import Numbers

# An expression: a word, or a list of expressions.
Sexp = Any
Facts = frozenset[tuple[str, ...]]


def read(text: str) -> Sexp:
    tokens = deque(re.findall(r"[()]|[^\s()]+", re.sub(r";.*", "", text)))

    def expression() -> Sexp:
        token = tokens.popleft()
        if token != "(":
            return token
        found = []
        while tokens[0] != ")":
            found.append(expression())
        tokens.popleft()
        return found

    found = expression()
    assert not tokens
    return found


def holds(condition: Sexp, state: Facts) -> bool:
    head, *rest = condition
    if head == "and":
        return all(holds(c, state) for c in rest)
    if head == "or":
        return any(holds(c, state) for c in rest)
    if head == "not":
        return not holds(rest[0], state)
    return tuple(condition) in state


# What an effect may do: its chance, what it adds and removes, and what it pays.
Consequence = tuple[float, Facts, Facts, float]


def results(effect: Sexp, state: Facts) -> list[Consequence]:
    nothing: Facts = frozenset()
    head, *rest = effect
    if head == "and":
        found: list[Consequence] = [(1.0, nothing, nothing, 0.0)]
        for part in rest:
            found = [
                (p * q, a | b, r | s, x + y)
                for (p, a, r, x), (q, b, s, y) in itertools.product(found, results(part, state))
            ]
        return found
    if head == "when":
        return results(rest[1], state) if holds(rest[0], state) else [(1.0, nothing, nothing, 0.0)]
    if head == "probabilistic":
        chances = [float(c) for c in rest[::2]]
        assert sum(chances) <= 1 + 1e-12
        found = [(1 - sum(chances), nothing, nothing, 0.0)]
        for chance, part in zip(chances, rest[1::2], strict=True):
            found += [(chance * p, a, r, x) for p, a, r, x in results(part, state)]
        return found
    if head in ("increase", "decrease"):
        assert rest[0] == ["reward"]
        return [(1.0, nothing, nothing, float(rest[1]) * (1 if head == "increase" else -1))]
    if head == "not":
        return [(1.0, nothing, frozenset({tuple(rest[0])}), 0.0)]
    return [(1.0, frozenset({tuple(effect)}), nothing, 0.0)]


def value(folder: Path, horizon: int, discount: float) -> tuple[float, int]:
    """The value of the initial state, and how many states there are."""
    domain = read((folder / "domain.pddl").read_text())
    problem = read((folder / "problem.pddl").read_text())
    parts = {part[0]: part[1:] for part in problem[1:]}
    goal = parts[":goal"][0] if ":goal" in parts else ["or"]
    actions = []
    for part in domain[1:]:
        if part[0] == ":action":
            slots = dict(zip(part[2::2], part[3::2], strict=True))
            assert slots[":parameters"] == []
            actions.append((slots[":precondition"], slots[":effect"]))
    start = frozenset(tuple(atom) for atom in parts[":init"])
    numbers = {start: 0}
    waiting = deque([start])
    rows: list[list[tuple[float, list[tuple[float, int]]]]] = []
    while waiting:
        state = waiting.popleft()
        rows.append([])
        if holds(goal, state):
            continue
        for condition, effect in actions:
            if not holds(condition, state):
                continue
            pays, leads = 0.0, []
            for chance, added, removed, reward in results(effect, state):
                after = state - removed | added
                if chance > 0 and after not in numbers:
                    numbers[after] = len(numbers)
                    waiting.append(after)
                if chance > 0:
                    pays += chance * reward
                    leads.append((chance, numbers[after]))
            rows[-1].append((pays, leads))
    values = np.zeros(len(numbers))
    for _ in range(horizon):
        values = np.array(
            [
                max((r + discount * sum(p * values[s] for p, s in to) for r, to in row), default=0)
                for row in rows
            ]
        )  # fmt: skip
    return float(values[0]), len(numbers)


@pytest.mark.parametrize(
    ("domain", "problem", "horizon", "discount", "options"),
    [
        ("hdd/domain.menid", "hdd/drive.menid", 40, 0.99, []),
        ("hdd/domain.menid", "hdd/drive.menid", 40, 0.99, ["--env", "coarse"]),
        ("hdd/domain.menid", "hdd/drive.menid", 40, 0.99, ["--noise", "sink"]),
        ("hdd/domain.menid", "hdd/line.menid", 60, 0.99, []),
    ],
)
def test_the_value_is_that_of_the_problem(
    menid: Callable[..., Result],
    tmp_path: Path,
    domain: str,
    problem: str,
    horizon: int,
    discount: float,
    options: list[str],
) -> None:
    files = [str(ROOT / "domains" / domain), str(ROOT / "domains" / problem), *options]
    export = menid("export", "ppddl", *files, "--states", "-o", str(tmp_path / "out"))
    assert export.exit_code == 0, export.stderr
    text = (tmp_path / "out" / "problem.pddl").read_text()
    assert f"; discount {discount}" in text
    assert f"; horizon {horizon}" in text
    found, states = value(tmp_path / "out", horizon, discount)
    solved = json.loads(menid("solve", "--json", *files).stdout)
    assert found == pytest.approx(solved["value"], abs=1e-5)
    assert states == solved["states"]


GOAL = """domain d
predicate lit
predicate worn
action press cost 2 {
  rule r {
    when not lit
    outcomes {
      on: 0.3333333  lit
      wears: 0.3333333 worn
      noise: 0.3333334
    }
  }
}
problem p for d
goal lit
"""


def test_a_goal_and_numbers_that_are_no_decimals(
    menid: Callable[..., Result], tmp_path: Path
) -> None:
    (tmp_path / "goal.menid").write_text(GOAL)
    for form in ("--lifted", "--states"):
        assert menid("export", "ppddl", "goal.menid", form, "-o", "out").exit_code == 0
        text = (tmp_path / "out" / "domain.pddl").read_text()
        assert "(probabilistic 0.333333 (lit) 0.333333 (worn))" in text
        assert "(decrease (reward) 2)" in text
    found, states = value(tmp_path / "out", 200, 1.0)
    assert found == pytest.approx(-6, abs=1e-4)
    assert states == 4


def test_numbers_fit_into_fractions_of_32_bits() -> None:
    # Rounded ones add up to 1 at most, or exactly; thirds stay thirds.
    small = Numbers().shares([0.0000005001, 0.4999997499, 0.49999975], whole=False)
    assert sum(map(Fraction, small)) <= 1
    assert small[0] == "0.000001"
    assert Numbers().shares([0.1234567, 0.8765433], whole=True) == ["0.123457", "0.876543"]
    assert Numbers().shares([1 / 3, 2 / 3], whole=True) == ["1/3", "2/3"]
    assert Numbers().shares([1 / 7, 1 / 3], whole=False) == ["1/7", "1/3"]
    assert Numbers().shares([0.25, 0.5], whole=False) == ["0.25", "0.5"]
    for value in (0.1, 12.345678, 123456.789, 2e9):
        assert int(Numbers().text(value).replace(".", "")) < 2**31
    assert [Numbers().text(v) for v in (0.0, 5.0, 100.0, 0.1, 123456.789)] == [
        "0", "5", "100", "0.1", "123457",
    ]  # fmt: skip


def test_numbers_that_change_are_told(menid: Callable[..., Result]) -> None:
    """A chance stays one; what six digits can't hold is not passed over."""
    text = GOAL.replace("0.3333333  lit", "1e-9 lit").replace("0.3333333 worn", "0.25 worn")
    text = text.replace("noise: 0.3333334", "noise: (0.75 - 1e-9)").replace("cost 2", "cost 2e-8")
    text = text.replace("goal lit", "goal lit reward 3000000000")
    for form in ("--lifted", "--grounded", "--states"):
        result, domain, _ = exported(menid, text, form)
        assert "(probabilistic 0.000001 (lit) 0.25 (worn))" in domain
        assert "1e-09 to 0.000001" in result.stderr
        assert "3000000000 to what 32 bits make of it" in result.stderr or form == "--states"
        assert "2e-08 to 0" in result.stderr or form == "--states"
    result, _, _ = exported(menid, GOAL)
    assert result.stderr == ""


def exported(menid: Callable[..., Result], text: str, *options: str) -> tuple[Result, str, str]:
    """The command's result, and the texts of domain and problem."""
    Path("model.menid").write_text(text, encoding="utf-8")
    result = menid("export", "ppddl", "model.menid", *options, "-o", "out")
    if result.exit_code:
        return result, "", ""
    return result, *((Path("out") / n).read_text() for n in ("domain.pddl", "problem.pddl"))


@pytest.mark.parametrize("form", ["--lifted", "--grounded", "--states"])
def test_names_that_ppddl_cannot_have_are_changed(menid: Callable[..., Result], form: str) -> None:
    text = GOAL.replace("predicate worn", "predicate Lit\npredicate increase").replace(
        "worn", "increase"
    )
    text = text.replace("0.3333333 increase", "0.3333333 increase, Lit")
    text = text.replace("domain d\n", "domain define\n").replace("for d\n", "for define\n")
    text = text.replace("action press", "action either").replace("problem p", "problem imply")
    result, domain, problem = exported(menid, text, form)
    assert result.exit_code == 0, result.output
    assert sorted(set(re.findall(r"(?i)\((lit\w*)", domain))) in (
        ["Lit", "lit_2"], ["Lit_2", "lit"],
    )  # fmt: skip
    assert "(increase_2)" in domain
    assert "(:action either_2" in domain
    assert "(define (domain define_2)" in domain
    assert "(define (problem imply_2)" in problem
    assert "(:domain define_2)" in problem


DEICTIC = """domain d
type cup
predicate at(cup)
predicate shut
derived open = not shut
action take(c: cup) {
  rule near per c {
    the x: cup where at(x)
    when open
    outcomes { got: 1 not at(x) reward 2 }
    probabilities target for blue { got: 0.5  noise: 0.5 }
  }
  rule far { otherwise outcomes { shuts: 1 shut } }
}
problem p for d
object blue, red: cup
init at(red)
goal shut reward -1
"""


def test_references_rivals_and_own_numbers(menid: Callable[..., Result]) -> None:
    result, domain, problem = exported(menid, DEICTIC)
    assert result.exit_code == 0
    assert result.stderr == ""
    assert "  (:action take-near-blue\n    :parameters (?x - cup)" in domain
    assert "    :parameters (?c - cup ?x - cup)" in domain
    unique = "(forall (?x2 - cup) (imply (at ?x2) (= ?x2 ?x)))"
    assert unique in domain
    assert "(not (= ?c blue))" in domain
    assert "(probabilistic 0.5 (and (not (at ?x)) (increase (reward) 2)))" in domain
    # The other rule covers where no cup can be named.
    assert ":action take-far" in domain
    assert "(not\n      (exists (?x - cup)" in domain or "(not (exists (?x - cup)" in domain
    assert "(:goal-reward (- 1))" in problem
    assert "(:constants\n    blue - cup\n  )" in domain
    assert "(:objects\n    red - cup\n  )" in problem


def test_the_form_is_chosen_and_said(menid: Callable[..., Result]) -> None:
    chain = DEICTIC.replace(
        "predicate shut\n",
        "predicate shut\npredicate next(cup, cup)\n"
        "derived far(c: cup) = at(c) or exists d: cup (next(c, d) and far(d))\n",
    ).replace("when open", "when open and far(c)")
    result, domain, _ = exported(menid, chain)
    assert result.exit_code == 0
    assert re.fullmatch(
        r"menid: grounded, since model.menid:6:1: the derived predicate `far` is recursive\n",
        result.stderr,
    )
    assert ":action take-red-near-red" in domain
    result, _, _ = exported(menid, chain, "--lifted")
    assert result.exit_code == 4
    assert "model.menid:6:1: the derived predicate `far` is recursive" in result.stderr
    dead = DEICTIC + "dead-end reward -3\n"
    result, domain, _ = exported(menid, dead)
    assert result.exit_code == 0
    assert "menid: state by state, since model.menid:15:1: PPDDL has no reward" in result.stderr


def test_what_a_store_teaches(menid: Callable[..., Result], tmp_path: Path) -> None:
    folder = ROOT / "domains" / "greenhouse"
    run = ["--run", str(folder / "run.toml")]
    problem = str(folder / "two-pots.menid")
    assert menid("learn", problem, *run, "-o", "run", "--steps", "30").exit_code == 0
    learned = ["run/learned.menid", problem]
    assert menid("export", "ppddl", *learned, "-o", "one").exit_code == 0
    result = menid("export", "ppddl", problem, "--store", "run", "-o", "two")
    assert result.exit_code == 0, result.output
    for name in ("domain.pddl", "problem.pddl"):
        assert (tmp_path / "one" / name).read_text() == (tmp_path / "two" / name).read_text()
    options = ["--store", "run", "--estimator", "empirical", "-o", "three"]
    assert menid("export", "ppddl", problem, *options).exit_code == 0
    three = (tmp_path / "three" / "domain.pddl").read_text()
    assert three != (tmp_path / "one" / "domain.pddl").read_text()
    for options, message in (
        (["--estimator", "empirical"], "--estimator needs --store"),
        (["--store", "run", "--env", "simulator"], "is about the target of its run, `robot`"),
    ):
        result = menid("export", "ppddl", problem, *options, "-o", "four")
        assert result.exit_code == 2
        assert message in result.stderr


def test_two_actions_of_one_name(menid: Callable[..., Result]) -> None:
    text = """domain d
predicate lit
action a_b(x: object) { rule r { outcomes { on: 1 lit } } }
action a(x: object) { rule r { outcomes { on: 1 lit } } }
problem p for d
object c, b_c: object
goal lit
"""
    _, domain, _ = exported(menid, text, "--states")
    names = re.findall(r"\(:action (\S+)", domain)
    assert sorted(names) == ["a_b_b_c", "a_b_c", "a_b_c_2", "a_c"]


def test_a_model_with_too_many_states_is_refused(
    menid: Callable[..., Result], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("menid_plan.exchange.ppddl_states.MAX_TRANSITIONS", 3)
    result, _, _ = exported(menid, GOAL, "--states")
    assert result.exit_code == 6
    assert "transitions: PPDDL is written state by state, up to 3 of them" in result.stderr
    assert not Path("out").exists()


def test_probabilities_that_are_missing_are_named(menid: Callable[..., Result]) -> None:
    for form in ("--lifted", "--grounded"):
        result, _, _ = exported(
            menid, GOAL.replace("0.3333333 ", "").replace("0.3333334", ""), form
        )
        assert result.exit_code == 3
        assert "rule press.r has no probabilities in the environment `target`" in result.stderr
