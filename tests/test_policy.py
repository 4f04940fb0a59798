"""Policies as values and files: what they say, that they are read back equal, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result

import menid_plan
from conftest import ROOT
from menid_plan.errors import LimitError
from menid_plan.grounding.state import GroundAction
from menid_plan.mdp.model import MDP
from menid_plan.model.formulas import GroundAtom
from menid_plan.planning import Task
from menid_plan.policy import Policy, PolicyError, decisions
from menid_plan.policy_file import policy_text, read_policy
from menid_plan.solving import Solution, StepPolicy

Menid = Callable[..., Result]

# A lamp, which goes on with 1/2, and the horizon is too short to wait with one step left: then the
# certain 1 of resting is better than half of 1.5.
LAMP = """
domain lamp
predicate lit
predicate fixed(thing)
type thing
param prize = 3
action press {
  rule press { when not lit outcomes { on: 0.5 lit off: 0.5 nothing } }
}
action rest {
  rule rest { when not lit outcomes { slept: 1 nothing reward 1 } }
  rule glow { when lit outcomes { shone: 1 nothing reward prize } }
}
problem evening for lamp
object wall: thing
init fixed(wall)
"""


def solved(text: str, name: str = "value-iteration", **options: Any) -> tuple[Task, Solution]:
    document = menid_plan.parse(text)
    assert document.domain is not None
    assert document.problem is not None
    task = Task(document.domain, document.problem, **options)
    task.build()
    return task, task.solve(task.solver(name))


def evening(horizon: int = 4) -> tuple[Task, Policy]:
    task, solution = solved(f"{LAMP} horizon {horizon}")
    return task, task.policy(solution)


def test_a_policy_of_a_horizon_says_what_to_do_by_the_steps_left() -> None:
    # One step left: 0 by pressing, 1 by resting. Two: 1/2 * 3 + 1/2 * 1 = 2 by pressing, 2 by resting
    # (the first action wins a tie). Three: 1/2 * 6 + 1/2 * 2 = 4, and 1 + 2 = 3.
    _, policy = evening()
    dark, lit = (GroundAtom("fixed", ("wall",)),), GroundAtom("lit")
    said = {
        left: str(policy.action(frozenset(dark), left)) for left in range(1, 5)
    }  # fmt: skip
    assert said == {1: "rest", 2: "press", 3: "press", 4: "press"}
    assert str(policy.action(frozenset({*dark, lit}), 3)) == "rest"
    assert policy.action(frozenset({*dark, lit}), 4) is None  # the lamp is dark at first
    assert policy.action(frozenset(), 2) is None  # `fixed(wall)` always holds
    assert policy.always == frozenset(dark)
    assert [(e.left, str(e.action)) for e in policy.entries] == [
        ((2, 4), "press"), ((1, 1), "rest"), ((1, 3), "rest"),
    ]  # fmt: skip
    with pytest.raises(ValueError, match="steps left"):
        policy.action(frozenset(dark))


def test_a_long_horizon_is_a_short_file() -> None:
    task, solution = solved(f"{LAMP} horizon 1000000 discount 0.5")
    assert solution.steps is not None
    assert len(solution.steps.offsets) < 1000  # nothing changes from there on
    policy = task.policy(solution)
    assert len(policy.entries) <= 4
    assert policy.entries[0].left is not None
    assert policy.entries[0].left[1] == 1_000_000


def test_runs_bridge_the_steps_at_which_a_state_is_not_reached() -> None:
    # Two states that are left in turn: each is reached at every other step.
    mdp = MDP.of_rows(
        np.array([0, 1, 2]), np.zeros(2, np.int32), np.zeros(2), np.array([0, 1, 2], np.int32),
        np.array([1, 0], np.int32), np.ones(2), np.zeros(2, np.bool_), horizon=5,
    )  # fmt: skip
    steps = StepPolicy(mdp.state_row, np.zeros((5, 2), np.uint8), 5)
    both = np.zeros(2)
    solution = Solution(
        "solved", "reward", 0, both, both, np.array([0, 1], np.int32), 1, 0.0, steps=steps
    )
    found = decisions(mdp, solution)
    assert found.state.tolist() == [0, 1]
    assert list(zip(found.least.tolist(), found.most.tolist(), strict=True)) == [(1, 5), (2, 4)]


def test_a_horizon_without_its_policy_is_refused() -> None:
    task, solution = solved(f"{LAMP} horizon 3")
    document = menid_plan.parse(f"{LAMP} horizon 3")
    assert document.problem == task.problem
    solver = task.solver("value-iteration", policy_bytes=1)
    with pytest.raises(LimitError, match=r"no policy to write: .*too much room"):
        task.policy(task.solve(solver))
    assert solution.steps is not None


@pytest.mark.parametrize("horizon", [0, 1, 4])
def test_files_are_read_back_equal(horizon: int) -> None:
    task, policy = evening(horizon)
    text = policy_text(policy)
    assert read_policy(text, task.domain, task.problem, "p.json") == policy
    assert policy_text(read_policy(text.encode(), task.domain, task.problem, "p.json")) == text


def test_infinities_and_what_is_not_known() -> None:
    task, solution = solved(LAMP)  # rewards without end
    text = policy_text(task.policy(solution))
    assert json.loads(text)["value"] == "inf"
    policy = read_policy(text, task.domain, task.problem, "p.json")
    assert policy.value == float("inf")
    data = json.loads(policy_text(policy))
    data["value"] = None
    again = read_policy(json.dumps(data), task.domain, task.problem, "p.json")
    assert np.isnan(again.value)
    assert json.loads(policy_text(again))["value"] is None


def change(*place: Any) -> Callable[[Any], None]:
    """Sets what is at a place of the JSON to the last argument."""

    def apply(data: Any) -> None:
        *way, last, value = place
        for key in way:
            data = data[key]
        data[last] = value

    return apply


def drop(*place: Any) -> Callable[[Any], None]:
    def apply(data: Any) -> None:
        *way, last = place
        for key in way:
            data = data[key]
        del data[last]

    return apply


WRONG: list[tuple[Callable[[Any], None], str]] = [
    (change("format", "menid policy 9"), '`format` is "menid policy 9", not "menid policy 1"'),
    (drop("states"), "this is no policy: `states` is missing"),
    (change("colour", 1), "a policy has no `colour`"),
    (change("domain", "camp"), 'the policy is for the domain "camp", not `lamp`'),
    (change("problem", ["x"]), 'the policy is for the problem ["x"], not `evening`'),
    (change("environment", "moon"), '`environment` is "moon", and not one of: target'),
    (change("environment", {}), "`environment` is {}, and not one of: target"),
    (change("params", []), "`params` is not an object of numbers"),
    (change("params", "prise", 1), "`params` has `prise`, which is no param of the domain"),
    (change("params", "prize", "x"), '`prize` is "x", not a number'),
    (change("params", "prize", "inf"), "`params`: `prize` is not finite"),
    (change("noise", "stays"), '`noise` is "stays", and not one of: stay, sink'),
    (change("objective", 3), "`objective` is 3, and not one of: reward, "),
    (change("status", None), "`status` is null, and not one of: "),
    (change("value", True), "`value` is true, not a number"),
    (change("lower", None), "`lower` is null, not a number"),
    (change("upper", 10**400), "not a number"),
    (change("lower", "inf"), "`lower` must not be above `value`"),
    (change("upper", -1), "nor that above `upper`"),
    (change("value", float("inf")), "no JSON: `Infinity`; infinities are written as words"),
    (change("horizon", None), "`horizon` is null, and that of the problem is 4"),
    (change("horizon", 5), "`horizon` is 5, and that of the problem is 4"),
    (change("always", {}), "`always` is not a list of atoms"),
    (change("always", ["fixed(roof)"]), "`always`: atom `fixed(roof)`: unknown object `roof`"),
    (change("states", "x"), "`states` is not a list of entries"),
    (change("states", 0, []), "entry 1: not an object"),
    (drop("states", 1, "state"), "entry 2: `state` is missing"),
    (drop("states", 1, "action"), "entry 2: `action` is missing"),
    (drop("states", 1, "left"), "entry 2: `left` is missing"),
    (change("states", 1, "lift", 1), "entry 2: an entry has no `lift`"),
    (change("states", 1, "state", "lit"), "entry 2: `state` is not a list of atoms"),
    (change("states", 1, "state", [5]), "entry 2: 5 is no atom"),
    (change("states", 1, "state", ["lid"]), "entry 2: atom `lid`: unknown predicate `lid`"),
    (change("states", 1, "state", ["lit(wall)"]), "entry 2: atom `lit(wall)`: "),
    (change("states", 1, "state", ["lit("]), "entry 2: atom `lit(`: "),
    (change("states", 1, "state", [""]), "entry 2: atom `` is not one atom"),
    (change("states", 1, "state", ["lit, fixed(wall)"]), "entry 2: atom `lit, fixed(wall)` is not"),
    (change("states", 1, "state", ["lit", " lit"]), "entry 2: atom ` lit` stands twice"),
    (change("states", 1, "state", ["fixed(wall)"]), "entry 2: atom `fixed(wall)` stands in `alwa"),
    (change("states", 1, "action", None), "entry 2: null is no action"),
    (change("states", 1, "action", "dance"), "entry 2: action `dance`: unknown action `dance`"),
    (change("states", 1, "action", "rest(wall)"), "entry 2: action `rest(wall)`: "),
    (change("states", 1, "left", 1), "entry 2: `left` is 1, and not the least and the most steps"),
    (change("states", 1, "left", [0, 1]), "between 1 and the horizon 4"),
    (change("states", 1, "left", [1, 5]), "between 1 and the horizon 4"),
    (change("states", 1, "left", [True, 1]), "entry 2: `left` is [true, 1]"),
    (change("states", 1, "left", [1, 2]), "entry 2 is for a state of entry 1 again"),
    (change("states", 2, "action", "press"), "entry 3: `press` does not apply in its state"),
    (drop("states", 2), "`p.json` has no action with 3 steps left in the state lit, which an"),
]


@pytest.mark.parametrize(("spoil", "message"), WRONG, ids=[message for _, message in WRONG])
def test_wrong_files(
    spoil: Callable[[Any], None], message: str, menid: Menid, tmp_path: Path
) -> None:
    _, policy = evening()
    data = json.loads(policy_text(policy))
    spoil(data)
    (tmp_path / "p.json").write_text(json.dumps(data))
    (tmp_path / "a.menid").write_text(f"{LAMP} horizon 4")
    result = menid("simulate", "a.menid", "--policy", "p.json")
    assert result.exit_code == 3, result.output
    assert message in result.output
    assert "menid: `p.json`" in result.output


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"", "line 1, column 1: no JSON"),
        (b"{\n 3}", "line 2, column 2: no JSON"),
        (b"\xff\xfe\xfa", "no UTF-8 text"),
        (b"[" * 100_000, "nested too deep"),
        (b"9" * 10_000, "a number too long"),
        (b"[]", "the JSON is no object"),
        (b"{}", "`format` is missing"),
        (LAMP.encode(), "no JSON"),
    ],
)
def test_files_that_are_no_policies(text: bytes, message: str) -> None:
    task, _ = evening()
    with pytest.raises(PolicyError, match=r"^`p\.json`: ") as raised:
        read_policy(text, task.domain, task.problem, "p.json")
    assert message in str(raised.value)


def test_a_range_of_steps_needs_a_horizon() -> None:
    task, solution = solved(f"{LAMP} discount 0.5")
    data = json.loads(policy_text(task.policy(solution)))
    data["states"][0]["left"] = [1, 1]
    with pytest.raises(PolicyError, match="no `left`: the problem has no horizon"):
        read_policy(json.dumps(data), task.domain, task.problem, "p.json")


def test_atoms_may_be_written_in_any_way_of_the_language() -> None:
    text = (ROOT / "domains/greenhouse/domain.menid").read_text()
    text += (ROOT / "domains/greenhouse/two-pots.menid").read_text()
    task, solution = solved(text)
    policy = task.policy(solution)
    data = json.loads(policy_text(policy))
    first = data["states"][0]
    first["state"] = [atom.replace("(", " ( ") for atom in reversed(first["state"])]
    first["action"] = first["action"].replace("(", "( ")
    assert read_policy(json.dumps(data), task.domain, task.problem, "p.json") == policy
    assert policy.entries[0].action == GroundAction("drive", ("fern",))
