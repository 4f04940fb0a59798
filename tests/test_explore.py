"""The compiled MDP equals the definition of meaning, state by state."""

from __future__ import annotations

from collections import Counter
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

import menid_plan
from conftest import ROOT
from menid_plan.errors import LimitError, MeaningError
from menid_plan.grounding.ground import GroundProblem, ground
from menid_plan.grounding.semantics import Noise, Semantics
from menid_plan.grounding.state import SINK, NextState
from menid_plan.grounding.steps import RuleConflict
from menid_plan.mdp.explore import Structure, explore
from menid_plan.model.domain import Domain, Problem
from strategies import domains_with_problems

SMALL = [
    path
    for path in sorted((ROOT / "domains").glob("*/*.menid"))
    if path.name != "domain.menid"
    and path.stem not in ("tidy-up", "tower", "lake", "triangle-2", "triangle-3", "plant", "house")
]


def uniform(problem: GroundProblem) -> np.ndarray:
    """A number for each slot, each of them different within its distribution."""
    cells = np.zeros(problem.slots)
    for distribution in problem.distributions:
        slots = distribution.slots
        weights = np.arange(1, len(slots) + 1, dtype=float)
        cells[slots.start : slots.stop] = weights / weights.sum()
    return cells


def compare(domain: Domain, problem: Problem, noise: Noise, limit: int = 3000) -> Structure | None:
    """Explore by the definition and by the kernel; all that they say has to agree."""
    semantics = Semantics(domain, problem, noise=noise)
    compiled = ground(domain, problem)
    cells = uniform(compiled)
    try:
        structure = explore(compiled, noise=noise, max_states=limit)
    except MeaningError:
        # The definition finds a conflict too.
        with pytest.raises(RuleConflict):
            visit(semantics, limit)
        return None
    except LimitError:
        return None
    mdp = structure.fill(cells)
    numbers: dict[NextState, int] = {structure.state(i): i for i in range(structure.states)}
    assert len(numbers) == structure.states, "two numbers for one state"
    assert structure.state(0) == semantics.initial_state
    reached = {semantics.initial_state}
    for state, number in numbers.items():
        rows = range(int(structure.state_row[number]), int(structure.state_row[number + 1]))
        assert bool(structure.goal[number]) == semantics.is_goal(state)
        assert bool(structure.dead_end[number]) == semantics.is_dead_end(state)
        if state is SINK or semantics.is_goal(state) or semantics.is_dead_end(state):
            assert not rows
            continue
        applicable = semantics.applicable(state)
        assert structure.state_reward[number] == pytest.approx(semantics.state_reward(state))
        assert [compiled.actions[mdp.row_action[row]] for row in rows] == [a for a, _ in applicable]
        for row, (_, covering) in zip(rows, applicable, strict=True):
            rule = compiled.rules[structure.row_rule[row]]
            assert rule.rule == covering.rule
            assert dict(rule.binding) == dict(covering.binding)
            span = slice(int(mdp.row_transition[row]), int(mdp.row_transition[row + 1]))
            found = Counter()
            paid = size = 0.0
            for chance, next_state in zip(mdp.probability[span], mdp.next_state[span], strict=True):
                found[structure.state(int(next_state))] += float(chance)
            expected = Counter()
            weights = np.arange(1, len(rule.rule.outcomes) + 1, dtype=float)
            for weight, outcome in zip(weights / weights.sum(), rule.rule.outcomes, strict=True):
                after = semantics.successor(covering, outcome, state)
                reached.add(after)
                expected[after] += float(weight)
                reward = semantics.step_reward(covering, outcome, state, after)
                paid += weight * reward.total
                size += weight * sum(abs(part) for part in astuple(reward))
            assert found == pytest.approx(expected)
            # Parts of very different sizes may be added in another order: 1e22 swallows 1.
            assert mdp.row_reward[row] == pytest.approx(paid, abs=1e-12 * size)
    assert reached == set(numbers)
    return structure


def visit(semantics: Semantics, limit: int) -> None:
    seen, queue = {semantics.initial_state}, [semantics.initial_state]
    while queue and len(seen) <= limit:
        state = queue.pop(0)
        if semantics.is_goal(state):
            continue
        for _, covering in semantics.applicable(state):
            for outcome in covering.rule.outcomes:
                after = semantics.successor(covering, outcome, state)
                if after is not SINK and after not in seen:
                    seen.add(after)
                    queue.append(after)


@pytest.mark.parametrize("noise", ["stay", "sink"])
@pytest.mark.parametrize("path", SMALL, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_shipped_problems(path: Path, noise: Noise) -> None:
    document = menid_plan.read(path)
    assert document.domain is not None
    assert document.problem is not None
    assert compare(document.domain, document.problem, noise) is not None


@settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
@given(domains_with_problems())
def test_generated_problems(pair: tuple[Domain, Problem]) -> None:
    for noise in ("stay", "sink"):
        compare(*pair, noise, limit=60)


# Reachable states and dead ends by an evaluator that shares no code with the kernel.
KNOWN = {
    "blocks/turn-over": (22, 0),
    "blocks/tidy-up": (5617, 0),
    "blocks/tower": (61670, 0),
    "exploding-blocks/unstack": (251, 15),
    "exploding-blocks/swap": (274, 16),
    "exploding-blocks/tower": (87403, 4136),
    "hdd/bench": (3, 0),
    "hdd/drive": (3, 0),
    "hdd/line": (7, 0),
    "maintenance/workshop": (81, 0),
    "maintenance/plant": (52488, 0),
    "rescue/corridor": (26, 3),
    "rescue/house": (7239, 1394),
    "slippery-grid/pond": (32, 0),
    "slippery-grid/lake": (9216, 0),
    "tireworld/triangle-1": (80, 2),
    "tireworld/triangle-2": (2038, 34),
    "tireworld/triangle-3": (42796, 462),
}


@pytest.mark.parametrize("name", KNOWN)
def test_known_counts(name: str) -> None:
    document = menid_plan.read(ROOT / "domains" / f"{name}.menid")
    assert document.domain is not None
    assert document.problem is not None
    structure = explore(ground(document.domain, document.problem))
    assert (structure.states, int(structure.dead_end.sum())) == KNOWN[name]


HEAD = "domain d predicate p predicate q predicate r "


def parsed(text: str) -> GroundProblem:
    document = menid_plan.parse(HEAD + text)
    assert document.domain is not None
    assert document.problem is not None
    return ground(document.domain, document.problem)


def test_a_conflict_names_the_state_and_both_rules_with_their_bindings() -> None:
    problem = parsed(
        "predicate s(object) action a {"
        " rule one { the x: object where s(x) when q outcomes { o: 1 p } }"
        " rule two { when q outcomes { o: 1 p } } } action b { rule b { outcomes { o: 1 q } } }"
        " problem t for d object k: object init s(k)"
    )
    with pytest.raises(MeaningError) as error:
        explore(problem)
    assert str(error.value) == (
        "`a` is covered by rules `one` (x = k) and `two` in the state q, s(k)"
    )


def test_missing_probabilities_name_the_rule_and_the_state() -> None:
    problem = parsed(
        "action a { rule one { when not p outcomes { o: p } } } problem t for d init q"
    )
    happens = np.full(problem.slots, 2, np.uint8)
    with pytest.raises(
        MeaningError, match=r"rule a\.one has no probabilities in .* state q: write"
    ):
        explore(problem, happens)


def test_the_limit_on_states_says_how_far_it_came() -> None:
    bits = " ".join(f"predicate b{i}" for i in range(16))
    actions = " ".join(
        f"action a{i} {{ rule r {{ when not b{i} outcomes {{ o: 1 b{i} }} }} }}" for i in range(16)
    )
    problem = parsed(f"{bits} {actions} problem t for d")
    with pytest.raises(LimitError, match="more than 1000 states can be reached"):
        explore(problem, max_states=1000)
    assert explore(problem).states == 2**16


def test_outcomes_that_never_happen_are_not_followed() -> None:
    problem = parsed(
        "action a { rule one { when not p and not q outcomes { x: 0.5 p y: 0.5 q } } } problem t for d"
    )
    assert explore(problem).states == 3
    assert explore(problem, np.array([1, 0, 0], np.uint8)).states == 2


def test_more_than_64_facts_and_a_recursive_derived_predicate() -> None:
    document = menid_plan.parse(
        "domain d predicate link(object, object) predicate lit(object)"
        " derived reached(x: object) = lit(x) or exists y: object (link(y, x) and reached(y))"
        " action light(x: object) { rule r { when not reached(x) outcomes { o: 1 lit(x) } } }"
        " action cut(x, y: object) { rule r { when link(x, y) outcomes { o: 1 not link(x, y) } } }"
        " problem t for d object o1..o100: object init link(o1, o2), link(o2, o3), link(o3, o1),"
        " lit(o4), link(o4, o5), link(o99, o100) goal forall x: object (lit(x))"
    )
    assert document.domain is not None
    assert document.problem is not None
    problem = ground(document.domain, document.problem)
    assert problem.tables.words == 2
    semantics = Semantics(document.domain, document.problem)
    structure = explore(
        problem, max_states=10**6, happens=_only(problem, {"cut", "o1", "o2", "o3"})
    )
    assert structure.states > 30
    for number in range(0, structure.states, 7):
        state = structure.state(number)
        assert state is not SINK
        rows = range(int(structure.state_row[number]), int(structure.state_row[number + 1]))
        found = [problem.rules[structure.row_rule[row]].action for row in rows]
        assert found == [action for action, _ in semantics.applicable(state)]


def _only(problem: GroundProblem, names: set[str]) -> np.ndarray:
    """Follow the outcomes of `cut` alone: lighting would make 2^100 states."""
    happens = np.zeros(problem.slots, np.uint8)
    for distribution in problem.distributions:
        if distribution.action in names:
            happens[distribution.slots.start : distribution.slots.stop] = 1
    return happens


def test_the_search_calls_nothing_in_python_for_a_state(monkeypatch: pytest.MonkeyPatch) -> None:
    """However many states there are, Python is asked only when an array has to grow."""
    from menid_plan.compiled import Kernel

    calls = 0
    original = Kernel.__call__

    def counted(self: Kernel, *arguments: object) -> object:
        nonlocal calls
        calls += 1
        return original(self, *arguments)

    monkeypatch.setattr(Kernel, "__call__", counted)
    document = menid_plan.read(ROOT / "domains" / "maintenance" / "plant.menid")
    assert document.domain is not None
    assert document.problem is not None
    structure = explore(ground(document.domain, document.problem))
    assert structure.states == 52488
    assert calls < 150
