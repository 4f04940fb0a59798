"""PPDDL, read back by a reader that knows the language and nothing of our exporter."""

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
from menid_plan.exchange.ppddl import _shares

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
    export = menid("export", "ppddl", *files, "-o", str(tmp_path / "out"))
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
    assert menid("export", "ppddl", "goal.menid", "-o", "out").exit_code == 0
    text = (tmp_path / "out" / "domain.pddl").read_text()
    assert "(probabilistic 0.333333 (lit) 0.333333 (worn))" in text
    assert "(decrease (reward) 2)" in text
    found, states = value(tmp_path / "out", 200, 1.0)
    assert found == pytest.approx(-6, abs=1e-4)
    assert states == 4


def test_shares_that_are_rounded_never_exceed_1() -> None:
    shares = _shares({"a": 0.0000005001, "b": 0.4999997499, "c": 0.49999975})
    assert sum(Fraction(text) for text in shares.values()) <= 1
    assert shares["a"] == "0.000001"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("predicate worn", "predicate Lit2\npredicate lit2\npredicate worn", "`Lit2` and `lit2`"),
        ("worn", "increase", "`increase` is a word of PPDDL itself"),
        ("worn", "sunk", "`sunk` is a word of PPDDL itself"),
    ],
)
def test_names_that_ppddl_cannot_have(
    menid: Callable[..., Result], tmp_path: Path, old: str, new: str, said: str
) -> None:
    (tmp_path / "goal.menid").write_text(GOAL.replace(old, new))
    result = menid("export", "ppddl", "goal.menid", "-o", "out")
    assert result.exit_code == 4, result.stderr
    assert said in result.stderr
    assert not (tmp_path / "out").exists()


def test_two_actions_of_one_name(menid: Callable[..., Result], tmp_path: Path) -> None:
    (tmp_path / "two.menid").write_text(
        """domain d
predicate lit
action a_b(x: object) { rule r { outcomes { on: 1 lit } } }
action a(x: object) { rule r { outcomes { on: 1 lit } } }
problem p for d
object c, b_c: object
goal lit
"""
    )
    assert menid("export", "ppddl", "two.menid", "-o", "out").exit_code == 0
    names = re.findall(r"\(:action (\S+)", (tmp_path / "out" / "domain.pddl").read_text())
    assert sorted(names) == ["a_b_b_c", "a_b_c", "a_b_c_2", "a_c"]


def test_a_model_with_too_many_states_is_refused(
    menid: Callable[..., Result], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("menid_plan.exchange.ppddl.MAX_TRANSITIONS", 3)
    (tmp_path / "goal.menid").write_text(GOAL)
    result = menid("export", "ppddl", "goal.menid", "-o", "out")
    assert result.exit_code == 6
    assert "transitions: PPDDL is written state by state, up to 3 of them" in result.stderr
