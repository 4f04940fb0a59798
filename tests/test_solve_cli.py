"""`menid solve` on shipped problems, whose values are known by other means."""

from __future__ import annotations

import json
import re
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from conftest import ROOT
from menid_plan.cli.common import load_both
from menid_plan.cli.main import main
from menid_plan.cli.tasks import Display, solver_options
from menid_plan.exchange.drawing import drawing_of
from menid_plan.planning import OptionError, Task

Menid = Callable[..., Result]

# Computed by an evaluator that shares no code with the solvers. The tireworlds are p01 and p02 of
# Little and Thiebaux (2007), the small exploding blocks are their ptiny problems.
KNOWN = {
    "tireworld/triangle-1": ("goal-then-reward", 1, -6.25, "move(l2-1)"),
    "tireworld/triangle-2": ("goal-then-reward", 1, -11.859375, "move(l2-1)"),
    "tireworld/triangle-3": ("goal-then-reward", 1, -19.2177734375, "move(l2-1)"),
    "exploding-blocks/unstack": ("goal-then-reward", 0.6, -4.4, None),
    "exploding-blocks/swap": ("goal-then-reward", 1, -15, None),
    "exploding-blocks/tower": ("goal-then-reward", 0.864, -27.508, None),
    "blocks/turn-over": ("goal-then-reward", 1, -9.55875, "pick(a)"),
    "blocks/tidy-up": ("goal-then-reward", 1, -12.21449, None),
    "hdd/bench": ("reward", None, 0.8451, "lever(n8)"),
    "hdd/drive": ("reward", None, 0.8451, "lever(n8)"),
    "hdd/line": ("reward", None, 2.50926, "lever(n8)"),
    "slippery-grid/pond": ("reward", None, 6.36062, None),
    "slippery-grid/lake": ("reward", None, 10.15873, None),
    "rescue/corridor": ("reward", None, -0.7293, None),
    "rescue/house": ("reward", None, -6.38106, None),
    "maintenance/workshop": ("reward", None, 137.76885, None),
    "maintenance/plant": ("reward", None, 128.14213, None),
}


def solved(menid: Menid, *arguments: str) -> dict[str, Any]:
    result = menid("solve", *arguments, "--json")
    assert result.exit_code == 0, result.output
    found: dict[str, Any] = json.loads(result.stdout)
    return found


def problem(name: str) -> str:
    return str(ROOT / "domains" / f"{name}.menid")


@pytest.mark.parametrize("name", KNOWN)
def test_known_values(name: str, menid: Menid) -> None:
    objective, probability, value, action = KNOWN[name]
    found = solved(menid, problem(name))
    assert found["status"] == "solved"
    assert found["objective"] == objective
    assert found["lower"] <= found["value"] <= found["upper"]
    assert found["upper"] - found["lower"] <= 1e-6
    assert found["value"] == pytest.approx(value, abs=1e-5)
    if probability is not None:
        assert found["goal_probability"] == pytest.approx(probability)
    if action is not None:
        assert found["action"] == action
    assert set(found["seconds"]) == {"startup", "ground", "explore", "solve"}


def test_steps_and_goal_probability(menid: Menid) -> None:
    triangle = problem("tireworld/triangle-1")
    # Each action costs 1 and is a step.
    assert solved(menid, triangle, "--objective", "steps")["value"] == pytest.approx(6.25)
    found = solved(menid, problem("exploding-blocks/unstack"), "--objective", "goal-probability")
    assert found["value"] == pytest.approx(0.6)
    result = menid("solve", problem("exploding-blocks/unstack"), "--objective", "steps")
    assert result.exit_code == 1
    assert "infeasible" in result.output


FEW = """problem few for hdd
object board: pcb
object tray: bay
object n16, n20: edge
object s10: sway
init in(board, tray)
goal done()
horizon 10
discount 0.99
"""


def test_another_environment_and_param(menid: Menid, tmp_path: Path) -> None:
    (tmp_path / "few.menid").write_text(FEW)
    few, bench = (problem("hdd/domain"), "few.menid"), problem("hdd/bench")
    # The lever goes in at n16. The coarse simulation holds n20 for better, where the robot fails, and
    # both simulations shake the board out, for which the robot is too slow.
    assert solved(menid, *few)["action"] == "lever(n16)"
    assert solved(menid, *few, "--env", "fine")["action"] == "shake(s10)"
    (tmp_path / "few.menid").write_text(FEW.replace("object s10: sway\n", ""))
    assert solved(menid, *few, "--env", "fine")["action"] == "lever(n16)"
    assert solved(menid, *few, "--env", "coarse")["action"] == "lever(n20)"
    assert solved(menid, bench, "--set", "fail=0")["value"] > solved(menid, bench)["value"]


def test_the_policy_file_says_what_to_do_in_every_state_it_reaches(
    menid: Menid, tmp_path: Path
) -> None:
    solved(menid, problem("tireworld/triangle-1"), "-o", "policy.json")
    policy = json.loads((tmp_path / "policy.json").read_text())
    assert policy["objective"] == "goal-then-reward"
    first = policy["states"][0]
    assert "vehicle-at(l1-1)" in first["state"]
    assert first["action"] == "move(l2-1)"
    flat = [entry for entry in policy["states"] if {"flat", "has-spare"} <= {*entry["state"]}]
    assert flat
    assert {entry["action"] for entry in flat} == {"change"}


ENDLESS = "action a { rule r { outcomes { o: 1 p } } } problem t for d"
TIE = "action a { rule r { outcomes { o: 1/3 p noise: 2/3 } } } problem t for d goal p discount 0.9"


@pytest.mark.parametrize(
    ("text", "arguments", "code", "message"),
    [
        (ENDLESS, [], 1, "unbounded"),
        (ENDLESS, [], 1, "value             inf, between inf and inf"),
        ("problem t for d goal p", [], 0, "goal probability  0"),
        (f"{ENDLESS} goal q", [], 0, "goal probability  0"),
        (f"{ENDLESS} goal q", ["--objective", "steps"], 1, "infeasible"),
        ("problem t for d", [], 0, "first action      none"),
        ("problem t for d", ["--env", "sim"], 3, "there is no environment `sim`"),
        ("problem t for d", ["--solver", "magic"], 2, "there is no solver `magic`"),
        ("problem t for d", ["--solver", "thompson"], 4, "`thompson` decides step by step"),
        ("problem t for d", ["--epsilon", "0"], 2, "0.0 is not in the range x>0"),
        ("problem t for d", ["--epsilon", "-1"], 2, "-1.0 is not in the range x>0"),
        ("problem t for d", ["--epsilon", "nan"], 2, "nan is not a finite number"),
        ("problem t for d", ["--epsilon", "inf"], 2, "inf is not a finite number"),
        ("problem t for d", ["--epsilon", "few"], 2, "'few' is not a valid float range"),
        (TIE, ["--epsilon", "1e-300"], 6, "cannot bring them within 1e-300 here"),
        ("problem t for d", ["--max-seconds", "0"], 2, "0.0 is not in the range x>0"),
        ("problem t for d", ["--max-seconds", "nan"], 2, "nan is not a finite number"),
        ("problem t for d", ["--max-iterations", "0"], 2, "0 is not in the range x>=1"),
        (
            "problem t for d",
            ["--solver", "policy-iteration", "--max-seconds", "1"],
            2,
            "the solver `policy-iteration` has no option --max-seconds",
        ),
        (TIE, ["--solver", "policy-iteration", "--max-iterations", "9"], 0, "solved"),
        ("problem t for d", ["--set", "x=1"], 3, "there is no param `x`; the domain has: none"),
        ("problem t for d", ["--set", "x=1", "--set", "x=1"], 2, "`x` is set twice"),
        ("problem t for d", ["--option", "tie=1", "--option", "tie=2"], 2, "`tie` is set twice"),
        ("problem t for d discount 0 horizon 0", [], 0, "value             0.0"),
        (f"{ENDLESS} horizon 0", [], 0, "value             0.0"),
        (f"{ENDLESS} discount 0", [], 0, "value             1.0"),
        (f"{ENDLESS} discount 1", [], 1, "unbounded"),
        (f"{ENDLESS} discount 1 horizon 3", [], 0, "value             3.0"),
        (f"{ENDLESS} discount 1.5", [], 3, "discount"),
        (f"{ENDLESS} horizon 5", ["--max-states", "1"], 6, "more than 1 states can be reached"),
    ],
)
def test_odd_problems(
    text: str, arguments: list[str], code: int, message: str, menid: Menid, tmp_path: Path
) -> None:
    (tmp_path / "a.menid").write_text(f"domain d predicate p predicate q reward 1 when true {text}")
    result = menid("solve", "a.menid", *arguments)
    assert result.exit_code == code, result.output
    assert message in result.output


def test_a_solver_that_stops_early_tells_true_bounds(menid: Menid) -> None:
    lake = problem("slippery-grid/lake")
    for limit in (("--max-iterations", "3"), ("--max-seconds", "1e-9")):
        result = menid("solve", lake, "--json", "-o", "p.json", *limit)
        assert result.exit_code == 6
        found = json.loads(result.stdout)
        assert found["status"] == "limit"
        assert found["lower"] <= 10.15873 <= found["upper"]
        assert json.loads(Path("p.json").read_text())["status"] == "limit"
        simulated = menid("simulate", lake, "--policy", "p.json", "--episodes", "20")
        assert simulated.exit_code == 0, simulated.output


def test_a_value_that_is_not_known(menid: Menid) -> None:
    result = menid("solve", problem("tireworld/triangle-1"), "--max-seconds", "1e-9", "--json")
    found = json.loads(result.output)
    if found["status"] == "limit" and found["lower"] is None:
        assert found["value"] is None


LOSING = "action a { rule r { outcomes { o: 1 p reward -3 } } } problem t for d"


@pytest.mark.parametrize(
    ("text", "arguments", "status", "value", "code"),
    [
        (ENDLESS, [], "unbounded", "inf, between inf and inf", 1),
        (LOSING, [], "infeasible", "-inf, between -inf and -inf", 1),
        (LOSING, ["--solver", "policy-iteration"], "infeasible", "-inf, between", 1),
        (f"{ENDLESS} goal q", ["--objective", "steps"], "infeasible", "inf, between inf", 1),
        (f"{LOSING} goal q", [], "solved", "0.0, between 0.0 and 0.0", 0),
        (TIE, ["--max-seconds", "1e-9", "--epsilon", "1e-300"], "limit", None, 6),
    ],
)
def test_infinite_values_are_words_in_the_text_and_null_in_the_json(
    text: str, arguments: list[str], status: str, value: str | None, code: int,
    menid: Menid, tmp_path: Path,
) -> None:  # fmt: skip
    (tmp_path / "a.menid").write_text(f"domain d predicate p predicate q reward 1 when true {text}")
    result = menid("solve", "a.menid", *arguments)
    assert result.exit_code == code
    assert f"status            {status}" in result.output
    assert value is None or f"value             {value}" in result.output
    result = menid("solve", "a.menid", "--json", "-o", "p.json", *arguments)
    assert result.exit_code == code
    found = json.loads(result.stdout, parse_constant=pytest.fail)
    assert found["status"] == status
    if code == 1:
        assert (found["value"], found["lower"], found["upper"]) == (None, None, None)
        assert found["action"] is None
        assert "p.json was not written: no policy is the best\n" in result.stderr
        assert not Path("p.json").exists()
    else:
        assert found["action"] is not None
        assert json.loads(Path("p.json").read_text())["status"] == status


def test_written_files_are_told(menid: Menid) -> None:
    bench = problem("hdd/bench")
    result = menid("solve", bench, "-o", "p.json", "--dot", "a.dot")
    assert result.stdout.endswith("iterations\nwrote p.json\nwrote a.dot\n")
    assert result.stderr == ""
    result = menid("solve", bench, "-o", "p.json", "--dot", "a.dot", "--json")
    json.loads(result.stdout)
    assert result.stderr == "wrote p.json\nwrote a.dot\n"
    # What could be written is told even if the rest could not.
    result = menid("solve", problem("slippery-grid/lake"), "-o", "p.json", "--dot", "a.dot")
    assert result.exit_code == 6
    assert "wrote p.json\nmenid: " in result.output
    assert "wrote a.dot" not in result.output


@pytest.mark.parametrize(
    ("solver", "option", "message"),
    [
        ("value-iteration", "tie=1e-7", ""),
        ("value-iteration", "policy-bytes=1000000", ""),
        ("value-iteration", "max_iterations=500", ""),
        (
            "value-iteration",
            "ties=1",
            "has no option `ties`; its options: epsilon, max_iterations, ",
        ),
        (
            "value-iteration",
            "tie=much",
            "option `tie`: `much` is not what it takes, which is a num",
        ),
        ("value-iteration", "tie=nan", "option `tie`: `nan` is not what it takes, which is a num"),
        ("value-iteration", "policy_bytes=1.5", "`1.5` is not what it takes, which is a whole num"),
        ("value-iteration", "epsilon=0", "the solver `value-iteration`: epsilon must be above 0"),
        ("value-iteration", "tie", "`tie` is not of the form NAME=VALUE"),
        ("value-iteration", "=1", "`=1` is not of the form NAME=VALUE"),
        ("policy-iteration", "tie=1e-12", ""),
        ("thompson", "redraw=2", "decides step by step"),
    ],
)
def test_options_of_a_solver(solver: str, option: str, message: str, menid: Menid) -> None:
    name = "hdd/bench" if solver == "value-iteration" else "tireworld/triangle-1"
    result = menid("solve", problem(name), "--solver", solver, "--option", option)
    assert message in result.output
    if solver != "thompson":
        assert result.exit_code == (2 if message else 0), result.output


def test_an_option_of_a_solver_has_its_effect_and_is_set_once(menid: Menid) -> None:
    lake = problem("slippery-grid/lake")
    result = menid("solve", lake, "--option", "max-iterations=3", "--json")
    assert (result.exit_code, json.loads(result.stdout)["status"]) == (6, "limit")
    result = menid("solve", lake, "--option", "epsilon=0.1", "--epsilon", "0.1")
    assert result.exit_code == 2
    assert "`epsilon` is set twice, by --option and by --epsilon" in result.output


@dataclass(frozen=True)
class Odd:
    switch: bool = False
    word: str = "a"
    either: int | float | None = None
    several: tuple[int, ...] = ()


def test_options_of_a_solver_by_their_types(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("menid_plan.solving.load_solver", lambda _: Odd)
    given = {"switch": "True", "word": "b=c", "either": "0.5"}
    assert solver_options("odd", given) == {"switch": True, "word": "b=c", "either": 0.5}
    assert solver_options("odd", {"either": "5"}) == {"either": 5}
    for name, text, said in (
        ("switch", "yes", "true or false"),
        ("either", "x", "a whole number or a number"),
        ("several", "1", "nothing that can be written on the line"),
    ):
        with pytest.raises(OptionError, match=said):
            solver_options("odd", {name: text})


@pytest.mark.parametrize("command", ["solve", "simulate", "ground"])
def test_one_file_or_standard_input_is_enough(command: str, menid: Menid) -> None:
    text = menid(command, "--help").output
    assert re.search(r"Usage: .* \[DOMAIN\] PROBLEM", text)
    assert "One file may hold both DOMAIN and PROBLEM" in text
    assert "`-`" in text
    both = f"domain d predicate p {ENDLESS} horizon 2"
    more = ["--policy", "value-iteration"] if command == "simulate" else []
    assert menid(command, "-", *more, input=both).exit_code == 0


# -------------------------------------------------------------------------------------- drawings


def test_dot(menid: Menid, tmp_path: Path) -> None:
    (tmp_path / "a.menid").write_text(
        "domain d predicate p predicate q action a cost 1 { rule r { when not p and not q"
        " outcomes { yes: 0.25 p no: 0.5 nothing bad: 0.25 q } } } problem t for d goal p"
    )
    assert menid("solve", "a.menid", "--dot", "a.dot").exit_code == 0
    lines = (tmp_path / "a.dot").read_text().splitlines()
    assert lines[0] == "digraph policy {"
    assert lines[-1] == "}"
    assert '  n0 [label="none of these\\n[a]"];' in lines
    assert "  start -> n0;" in lines
    assert '  n1 [label="p", peripheries=2, fillcolor=honeydew];' in lines
    assert '  n2 [label="q\\ndead end", fillcolor=gray85];' in lines
    assert '  n0 -> n1 [label="yes 0.25"];' in lines
    assert '  n0 -> n0 [label="no 0.5"];' in lines
    assert '  n0 -> n2 [label="bad 0.25"];' in lines


def test_drawings_of_horizons_show_the_steps_left(menid: Menid, tmp_path: Path) -> None:
    (tmp_path / "few.menid").write_text(FEW)
    few = (problem("hdd/domain"), "few.menid", "--env", "fine")
    assert menid("solve", *few, "--dot", "a.dot").exit_code == 0
    text = (tmp_path / "a.dot").read_text()
    assert '[label="in(board, tray)\\n[shake(s10)]\\n1 to 10 left"]' in text
    assert '[label="in(board, tray)\\nloose(board)\\n[lever(n16)]\\n1 to 9 left"]' in text
    # With one step left the episode ends where a loop would begin again.
    assert '  n0 -> n2 [label="freed 0.83"];' in text
    assert '  n0 -> n1 [label="2 to 10 left:\\nshifted 0.15"];' in text
    assert '  n0 -> n0 [label="2 to 10 left:\\nheld 0.01\\nnoise 0.01"];' in text
    assert '  n3 [label="horizon", fillcolor=gray85];' in text
    assert '  n0 -> n3 [label="1 left:\\nshifted 0.15\\nheld 0.01\\nnoise 0.01"];' in text


def test_arrows_of_a_horizon_say_when_they_are_taken(menid: Menid, tmp_path: Path) -> None:
    rest = "domain d action a { rule r { outcomes { r: 1 nothing reward 1 } } } problem t for d"
    (tmp_path / "a.menid").write_text(f"{rest} horizon 8")
    assert menid("solve", "a.menid", "--dot", "a.dot").exit_code == 0
    lines = (tmp_path / "a.dot").read_text().splitlines()
    assert '  n0 -> n0 [label="2 to 8 left"];' in lines
    assert '  n0 -> n1 [label="1 left"];' in lines
    # At every number of steps left, what may come of a decision has probability 1.
    name = problem("hdd/line")
    task = Task(*load_both([name]))
    task.build()
    drawing = drawing_of(task.structure, task.mdp, task.solve(task.solver("value-iteration")))
    for number, node in enumerate(drawing.nodes):
        if not node.left:
            continue
        for left in steps_left(node.left):
            chances = [
                edge.probability
                for edge in drawing.edges
                if edge.source == number and left in steps_left(edge.left or node.left)
            ]
            assert sum(chances) == pytest.approx(1)


def steps_left(text: str) -> range:
    ends = [int(word) for word in re.findall(r"\d+", text)]
    return range(ends[0], ends[-1] + 1)


def test_a_drawing_of_what_is_not_known(menid: Menid, tmp_path: Path) -> None:
    (tmp_path / "a.menid").write_text(f"domain d {OVERFLOW}")
    assert menid("solve", "a.menid", "--dot", "a.dot").exit_code == 6
    assert 'label="d, p: goal-then-reward not known"' in (tmp_path / "a.dot").read_text()


@pytest.mark.parametrize("kind", ["--dot", "--png"])
def test_large_policies_are_not_drawn(kind: str, menid: Menid, tmp_path: Path) -> None:
    result = menid("solve", problem("slippery-grid/lake"), kind, "a.x", "-o", "p.json")
    assert result.exit_code == 6
    assert "at most 60 are drawn" in result.output
    assert "status            solved" in result.output
    assert (tmp_path / "p.json").exists()
    assert not (tmp_path / "a.x").exists()


@pytest.mark.skipif(find_spec("matplotlib") is None, reason="needs the extra `draw`: matplotlib")
@pytest.mark.parametrize("name", ["hdd/bench", "slippery-grid/pond"])
def test_png(name: str, menid: Menid, tmp_path: Path) -> None:
    assert menid("solve", problem(name), "--png", "a.png").exit_code == 0
    data = (tmp_path / "a.png").read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", data[16:24])
    assert 200 < width < 6000
    assert 100 < height < 6000


@pytest.mark.skipif(find_spec("matplotlib") is None, reason="needs the extra `draw`: matplotlib")
@pytest.mark.parametrize(
    "text",
    [
        "problem t for d",
        "problem t for d goal p init p",
        "action a { rule r { outcomes { o: 1 p } } } problem t for d horizon 0",
        "action a { rule r { outcomes { o: 1 p } } } problem t for d horizon 1",
        "action a { rule r { outcomes { o: 0.5 p noise: 0.5 } } } problem t for d goal p horizon 3",
    ],
)
@pytest.mark.parametrize("noise", ["stay", "sink"])
def test_drawings_of_next_to_nothing(text: str, noise: str, menid: Menid, tmp_path: Path) -> None:
    (tmp_path / "a.menid").write_text(f"domain d predicate p {text}")
    result = menid("solve", "a.menid", "--png", "a.png", "--dot", "a.dot", "--noise", noise)
    assert result.exit_code == 0, result.output
    assert (tmp_path / "a.png").stat().st_size > 1000


def test_an_image_needs_matplotlib(menid: Menid, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    result = menid("solve", problem("hdd/bench"), "--png", "a.png", "--dot", "a.dot")
    assert result.exit_code == 5
    assert "pip install 'menid-plan[draw]'" in result.output
    assert Path("a.dot").exists()


# ---------------------------------------------------------------------------- long work, and Ctrl-C

# Two tokens that drift to and fro until both are at the end: sweeps creep.
DRIFT = """
domain slow
type axis
type cell
predicate next(cell, cell)
predicate at(axis, cell)
action drift(a: axis) cost 1 {
  rule inside {
    the c: cell where at(a, c)
    the u: cell where next(c, u)
    the d: cell where next(d, c)
    outcomes { up: 0.5 not at(a, c), at(a, u)  down: 0.5 not at(a, c), at(a, d) }
  }
  rule low {
    the c: cell where at(a, c)
    the u: cell where next(c, u)
    when not exists d: cell (next(d, c))
    outcomes { up: 1 not at(a, c), at(a, u) }
  }
}
problem t for slow
"""


def drift(axes: str, cells: int) -> str:
    roads = "".join(f"init next(c{i}, c{i + 1})\n" for i in range(1, cells))
    starts = "".join(f"init at({axis}, c1)\n" for axis in axes)
    goal = " and ".join(f"at({axis}, c{cells})" for axis in axes)
    objects = f"object {', '.join(axes)}: axis\nobject c1..c{cells}: cell\n"
    return f"{DRIFT}{objects}{roads}{starts}goal {goal}\ndiscount 0.9999999\n"


# Without a terminal, progress is told at once and often.
_MENID = (
    "from menid_plan.cli.main import main; from menid_plan.cli.tasks import Display;"
    "from menid_plan.mdp import explore; explore._BATCH = 3000;"
    "Display.FIRST = Display.EVERY = 0.2; main()"
)


def interrupted(word: str, *arguments: str) -> tuple[str, str, int]:
    """What `menid solve` prints if it gets SIGINT after a line with that word; its exit code."""
    with subprocess.Popen(
        [sys.executable, "-c", _MENID, "solve", *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stderr is not None
        seen = ""
        for line in process.stderr:
            seen += line
            if word in line:
                process.send_signal(signal.SIGINT)
                break
        out, err = process.communicate(timeout=60)
    return out, seen + err, process.returncode


def test_interrupted_while_solving(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.menid").write_text(drift("xy", 120))
    out, err, code = interrupted("solving:", "a.menid", "--json", "-o", "p.json")
    assert code == 6, err
    assert "iterations" in err
    found = json.loads(out)
    assert found["status"] == "limit"
    assert found["states"] == 120 * 120
    assert -1.001e7 <= found["lower"] <= -(119**2) <= found["upper"] <= 0
    policy = json.loads((tmp_path / "p.json").read_text())
    assert policy["status"] == "limit"
    assert policy["lower"] == found["lower"]


def test_interrupted_while_exploring(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.menid").write_text(drift("wxyz", 40))  # 3 million states
    out, err, code = interrupted("exploring:", "a.menid", "-o", "p.json")
    assert code == 6, err
    assert out == ""
    last = err.splitlines()[-1]
    assert re.fullmatch(
        r"menid: interrupted while exploring: \d+ states found, \d+ expanded, \d+ transitions", last
    )
    assert not (tmp_path / "p.json").exists()


def test_a_solver_that_does_not_catch_an_interrupt(
    menid: Menid, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Task, "solve", interrupt)
    result = menid("solve", problem("hdd/bench"), "--json")
    assert result.exit_code == 6
    found = json.loads(result.output)
    assert (found["value"], found["lower"], found["upper"]) == (None, None, None)
    Path("kept.json").write_text("a policy")
    result = menid("solve", problem("hdd/bench"), "-o", "kept.json")
    assert "interrupted before anything was known" in result.output
    assert "kept.json was not written: nothing is known of a policy" in result.output
    assert Path("kept.json").read_text() == "a policy"


def test_a_value_between_very_large_bounds(menid: Menid) -> None:
    text = (
        "domain d predicate p action a { rule r { when not p outcomes { o: 1 p } } }"
        " problem t for d goal p reward 1e308"
    )
    result = menid("solve", "-", "--json", input=text)
    found = json.loads(result.stdout)
    assert found["lower"] <= found["value"] <= found["upper"]


def test_progress_on_a_terminal_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    display = Display()
    display.terminal = True
    display._next = 0.0
    with display:
        display.exploring(3, 2, 5)
        display._next = 0.0
        display.solving(7, -1.0, 2.5)
        display.solving(8, -1.0, 2.5)  # too soon
    said = capsys.readouterr().err
    assert "\n" not in said
    parts = said.split("\r\x1b[K")
    assert parts[1].startswith("exploring: 3 states found, 2 expanded, 5 transitions, ")
    assert parts[2].startswith("solving: 7 iterations, value between -1 and 2.5, ")
    assert parts[3:] == [""]  # cleared


def test_on_a_terminal_the_time_goes_on_though_nothing_new_is_known(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Display, "STILL", 0.01)
    display = Display()
    display.terminal = True
    display._next = 0.0
    with display.during("starting"):  # kernels are compiled meanwhile
        said, end = "", time.monotonic() + 20
        while said.count("starting, ") < 3 and time.monotonic() < end:
            time.sleep(0.02)
            said += capsys.readouterr().err
    assert re.match(r"(\r\x1b\[Kstarting, \d+\.\d s){3}", said)
    assert capsys.readouterr().err.endswith("\r\x1b[K")
    assert "\n" not in said
    display.terminal = False
    with display.during("starting"):
        time.sleep(0.05)
    assert capsys.readouterr().err == ""


def test_short_work_is_silent(menid: Menid) -> None:
    assert menid("solve", problem("hdd/bench")).stderr == ""


def test_the_answer_is_printed_even_if_a_file_cannot_be_written(menid: Menid) -> None:
    result = menid("solve", problem("hdd/bench"), "-o", "/dev/full")
    assert result.exit_code == 2
    assert "status            solved" in result.output
    assert "/dev/full" in result.output


WIDE = (
    "param e = 1e-12 predicate far predicate won predicate lost "
    "action go { rule out { when not far and not won and not lost outcomes { y: 1 far } } "
    "rule back { when far and not won and not lost outcomes { "
    "home: (1 - 2 * e) not far win: (e) won fail: (e) lost } } } "
    "action bet { rule bet { when not far and not won and not lost outcomes { "
    "win: 0.25 won reward 5 fail: 0.75 lost reward 5 } } } problem p for d goal won"
)
CANCEL = (
    "predicate x predicate y action loop { rule g { when not y outcomes { "
    "w: 0.1 x reward 0.9 l: 0.9 not x reward -0.1 } } } "
    "action leave { rule g { when not y outcomes { w: 1 y reward 5 } } } problem p for d"
)
LONG = (
    "predicate won predicate lost action gamble { rule g { when not won and not lost outcomes { "
    "w: 0.5 won l: 0.5 lost } } } action wait { rule g { when not won and not lost outcomes { "
    "w: 1e-16 won l: 0.9999999999999999 nothing } } } "
    "problem p for d goal won horizon 1000000000000000"
)
OVERFLOW = (
    "predicate a predicate won action x cost 1 { rule x { when not a outcomes { "
    "y: 0.5 a n: 0.5 nothing reward 1e308 } } } "
    "action z { rule z { when a and not won outcomes { y: 0.5 won n: 0.5 not a } } } "
    "problem p for d goal won reward 1e308"
)


@pytest.mark.parametrize(
    ("text", "arguments", "code", "status"),
    [
        (WIDE, [], 6, "limit"),  # no row can be told to be the best: nothing is claimed
        (CANCEL, [], 0, "solved"),  # what cancels up to rounding does not add up for ever
        (LONG, ["--objective", "goal-probability"], 6, "limit"),
        (OVERFLOW, [], 6, "limit"),
        (OVERFLOW, ["--solver", "policy-iteration"], 6, "limit"),
    ],
    ids=["wide", "cancel", "long", "overflow", "overflow-pi"],
)
def test_numbers_that_doubles_cannot_tell_apart(
    text: str, arguments: list[str], code: int, status: str, tmp_path: Path
) -> None:
    file = tmp_path / "d.menid"
    file.write_text(f"domain d {text}\n", encoding="utf-8")
    result = CliRunner().invoke(main, ["solve", str(file), "--json", *arguments])
    assert result.exit_code == code, result.output
    found = json.loads(result.stdout)
    assert found["status"] == status
    if text is CANCEL:
        assert found["value"] == pytest.approx(5)
    if text is LONG:
        assert found["lower"] <= 0.548 <= found["upper"]


def test_outputs_are_not_written_over_inputs_or_each_other(tmp_path: Path) -> None:
    file = tmp_path / "d.menid"
    file.write_text(f"domain d {CANCEL}\n", encoding="utf-8")
    before = file.read_text(encoding="utf-8")
    other = str(tmp_path / "x.json")
    for arguments, said in (
        (["-o", str(file)], "is an input"),
        (["-o", other, "--dot", other], "is to be written already"),
        (["-o", str(tmp_path / "none" / "x.json")], "there is no folder"),
    ):
        result = CliRunner().invoke(main, ["solve", str(file), *arguments])
        assert result.exit_code == 2
        assert said in result.output
    assert file.read_text(encoding="utf-8") == before
