"""Every shipped domain is checked, formatted, round-trips, and means something where it starts."""

from __future__ import annotations

import re
from collections import deque
from pathlib import Path

import pytest

import menid_plan
from conftest import ROOT
from menid_plan.grounding.semantics import Semantics
from menid_plan.grounding.state import SINK
from menid_plan.language.files import check_files
from menid_plan.language.layout import layout

FILES = sorted((ROOT / "domains").glob("*/*.menid"))
FOLDERS = sorted(path for path in (ROOT / "domains").iterdir() if path.is_dir())
PROBLEMS = [path for path in FILES if path.name != "domain.menid"]

# How many states a breadth-first search may visit here.
MAX_STATES = 400


def label(path: Path) -> str:
    return str(path.relative_to(ROOT / "domains"))


@pytest.mark.parametrize("path", FILES, ids=label)
def test_checked_formatted_and_read_back_equal(path: Path) -> None:
    (result,) = check_files([path])
    assert result.diagnostics == ()
    text = path.read_text(encoding="utf-8")
    assert layout(text) == text
    document = menid_plan.read(path)
    if document.problem is not None:
        again = menid_plan.parse(menid_plan.write(document.problem), document.domain)
        assert again.problem == document.problem
    else:
        assert document.domain is not None
        assert menid_plan.parse(menid_plan.write(document.domain)).domain == document.domain


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda path: path.name)
def test_each_domain_has_problems_of_different_size(folder: Path) -> None:
    problems = [menid_plan.read(path).problem for path in folder.glob("*.menid")]
    sizes = {len(p.objects) for p in problems if p is not None}
    assert len(sizes) >= 2


@pytest.mark.parametrize("path", PROBLEMS, ids=label)
def test_rules_never_conflict_and_distributions_are_known(path: Path) -> None:
    """Breadth first over some states: covering rules are unique, every outcome has a probability."""
    document = menid_plan.read(path)
    assert document.domain is not None
    assert document.problem is not None
    semantics = Semantics(document.domain, document.problem)
    environments = [e.name for e in document.domain.all_environments]
    start = semantics.initial_state
    seen, queue = {start}, deque([start])
    assert semantics.applicable(start), "nothing applies in the initial state"
    while queue and len(seen) < MAX_STATES:
        state = queue.popleft()
        if semantics.is_final(state):
            continue
        for ground, covering in semantics.applicable(state):  # raises on a conflict
            for environment in environments:
                assert sum(semantics.probabilities(covering, environment)) == pytest.approx(1)
            for transition in semantics.transitions(state, ground, environments[0]):
                if transition.state is not SINK and transition.state not in seen:
                    seen.add(transition.state)
                    queue.append(transition.state)
    assert len(seen) > 1


def test_the_tutorial_ends_with_the_shipped_greenhouse() -> None:
    page = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
    for name, file in (("greenhouse", "domain"), ("two-pots", "two-pots")):
        last = re.findall(rf"```menid name={name}.menid\n(.*?)```", page, re.DOTALL)[-1]
        shipped = ROOT / "domains" / "greenhouse" / f"{file}.menid"
        assert shipped.read_text(encoding="utf-8") == last


def test_the_features_of_the_language_are_all_used() -> None:
    """Somewhere in the shipped files each construct is used for real."""
    texts = "\n".join(path.read_text(encoding="utf-8") for path in FILES)
    for word in (
        "constant", "param", "test", "derived", "per", "the", "where", "otherwise", "nothing", "if",
        "observed", "probabilities", "goal", "horizon", "discount", "dead-end", "implies", "exists",
        "forall", "count", "cost", "noise", "reward", "!=", "..", " | ", "1/3",
    ):  # fmt: skip
        assert word in texts, word
