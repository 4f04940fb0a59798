"""The commands as a user calls them: output, JSON and exit codes."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import Result

from conftest import EXAMPLE

Menid = Callable[..., Result]
DOMAIN, PROBLEM = EXAMPLE.split("\nproblem ", 1)
PROBLEM = "problem " + PROBLEM


@pytest.fixture
def files(tmp_path: Path) -> Path:
    (tmp_path / "domain.menid").write_text(DOMAIN)
    (tmp_path / "problem.menid").write_text(PROBLEM)
    (tmp_path / "both.menid").write_text(EXAMPLE)
    return tmp_path


# ------------------------------------------------------------------------------------------- check


@pytest.mark.parametrize(
    "arguments",
    [["both.menid"], ["domain.menid"], ["problem.menid"], ["problem.menid", "domain.menid"]],
)
def test_check_finds_nothing_wrong(arguments: list[str], menid: Menid, files: Path) -> None:
    result = menid("check", *arguments)
    assert result.exit_code == 0
    assert ": ok: " in result.output
    assert json.loads(menid("check", "--json", *arguments).output) == {
        "files": arguments,
        "diagnostics": [],
    }


def test_check_tells_once_of_a_rule_s_blocks_for_other_problems(menid: Menid, files: Path) -> None:
    head = """domain d
type lamp
predicate on(lamp)
action press(l: lamp) {
  rule press per l {
    outcomes { lit: on(l) still: nothing }
"""
    blocks = "".join(
        f"    observed target for {n} {{ lit: 1 }}\n" for n in ("a1", "a2", "a3", "a4", "a5")
    )
    tail = "  }\n}\nproblem p for d\nobject "
    (files / "many.menid").write_text(head + blocks + tail + "a1: lamp\n")
    slip = "    observed target for desklamp { lit: 1 }\n"
    (files / "one.menid").write_text(head + slip + tail + "desk-lamp: lamp\n")
    many, one = (menid("check", f"{name}.menid") for name in ("many", "one"))
    assert many.exit_code == one.exit_code == 0
    assert many.output.count("M502") == one.output.count("M502") == 1
    assert "has blocks for `a2`, `a3`, `a4` and 1 more, which are no objects" in many.output
    assert "hint: the blocks are kept, and not used" in many.output
    assert "has a block for `desklamp`, which is no object of this problem" in one.output
    assert "hint: did you mean `desk-lamp`?" in one.output


def test_check_json_has_lines_and_columns_from_1(menid: Menid, files: Path) -> None:
    (files / "both.menid").write_text("domain d\npredicate p(objct)\nderived q = p\n")
    result = menid("check", "--json", "both.menid")
    assert result.exit_code == 3
    assert json.loads(result.output)["diagnostics"] == [
        {
            "file": "both.menid",
            "line": 2,
            "column": 13,
            "end_line": 2,
            "end_column": 18,
            "severity": "error",
            "code": "M202",
            "message": "unknown type `objct`; did you mean `object`?",
            "hint": "write `object`, or declare `objct`",
        },
        {
            "file": "both.menid",
            "line": 3,
            "column": 13,
            "end_line": 3,
            "end_column": 14,
            "severity": "error",
            "code": "M302",
            "message": "`p` takes 1 argument, not 0",
            "hint": "declared as p(?)",
        },
    ]


def test_check_reads_standard_input(menid: Menid, files: Path) -> None:
    assert menid("check", "-", input=EXAMPLE).exit_code == 0
    # A problem from standard input has its domain in the current folder.
    assert menid("check", "-", input=PROBLEM).exit_code == 0
    result = menid("check", "-", input=EXAMPLE.replace("horizon 40", "horizon 4.5"))
    assert result.exit_code == 3
    assert "<stdin>:" in result.output


def test_a_problem_finds_its_domain_by_its_name(menid: Menid, files: Path) -> None:
    (files / "domain.menid").rename(files / "drives.menid")
    (files / "other.menid").write_text("domain other")
    assert menid("check", "problem.menid").exit_code == 0
    (files / "drives.menid").unlink()
    (files / "both.menid").unlink()
    result = menid("check", "problem.menid")
    assert result.exit_code == 3
    assert "the domain `hdd` was not found" in result.output
    (files / "elsewhere").mkdir()
    (files / "elsewhere" / "d.menid").write_text(DOMAIN)
    assert menid("check", "problem.menid", "elsewhere/d.menid").exit_code == 0


def test_a_broken_domain_does_not_hide_the_errors_of_its_problem(menid: Menid, files: Path) -> None:
    (files / "domain.menid").write_text(DOMAIN.replace("param win = 1", "param win = one"))
    (files / "problem.menid").write_text(PROBLEM.replace("in(board", "inside(board"))
    output = menid("check", "problem.menid").output
    assert "domain.menid:4:13: error[M205]: unknown param `one`" in output
    assert "unknown predicate `inside`" in output
    assert output.count("error[") == 2


def test_check_of_a_missing_file_is_wrong_usage(menid: Menid) -> None:
    assert menid("check", "no.menid").exit_code == 2
    assert menid("check").exit_code == 2


# --------------------------------------------------------------------------------------------- fmt

UGLY = EXAMPLE.replace("  ", " ").replace("param win = 1\nparam", "param win = 1 param")


def test_fmt_in_place_check_and_diff(menid: Menid, files: Path) -> None:
    path = files / "both.menid"
    path.write_text(UGLY)
    path.chmod(0o640)
    result = menid("fmt", "--check", "both.menid")
    assert result.exit_code == 1
    assert "would change both.menid" in result.output
    result = menid("fmt", "--diff", "both.menid")
    assert result.exit_code == 1
    assert "-param win = 1 param fail = 5\n+param win = 1\n+param fail = 5\n" in result.output
    assert path.read_text() == UGLY
    assert menid("fmt", "both.menid").exit_code == 0
    assert path.read_text() == EXAMPLE
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert menid("fmt", "--check", "both.menid").exit_code == 0
    assert sorted(os.listdir(files)) == ["both.menid", "domain.menid", "problem.menid"]


def test_fmt_of_standard_input(menid: Menid) -> None:
    result = menid("fmt", "-", input=UGLY)
    assert (result.exit_code, result.output) == (0, EXAMPLE)
    assert menid("fmt", "--check", "-", input=UGLY).exit_code == 1


def test_fmt_leaves_a_file_with_errors_untouched(menid: Menid, files: Path) -> None:
    broken = UGLY.replace("loose(p)", "lose(p)", 1)
    (files / "both.menid").write_text(broken)
    (files / "domain.menid").write_text(DOMAIN.replace("  ", " "))
    result = menid("fmt", "both.menid", "domain.menid")
    assert result.exit_code == 3
    assert "both.menid: left as it is" in result.output
    assert (files / "both.menid").read_text() == broken
    assert (files / "domain.menid").read_text() == DOMAIN  # the good one is formatted all the same


def test_fmt_replaces_a_file_in_one_step(
    menid: Menid, files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = files / "both.menid"
    path.write_text(UGLY)

    def no_replace(source: str, target: str) -> None:
        raise OSError(28, "No space left on device", target)

    monkeypatch.setattr(os, "replace", no_replace)
    result = menid("fmt", "both.menid")
    assert result.exit_code == 2
    assert "No space left on device" in result.output
    assert path.read_text() == UGLY
    assert sorted(os.listdir(files)) == ["both.menid", "domain.menid", "problem.menid"]


def test_fmt_keeps_links_and_line_ends(menid: Menid, files: Path) -> None:
    path = files / "both.menid"
    path.write_bytes(UGLY.replace("\n", "\r\n").encode())
    link = files / "link.menid"
    link.symlink_to(path)
    assert menid("fmt", "link.menid").exit_code == 0
    assert link.is_symlink()
    assert path.read_bytes() == EXAMPLE.replace("\n", "\r\n").encode()


# -------------------------------------------------------------------------------------------- show


def test_show_is_plain_and_fits_80_columns(menid: Menid, files: Path) -> None:
    result = menid("show", "both.menid")
    assert result.exit_code == 0
    lines = result.output.splitlines()
    assert max(map(len, lines)) <= 80
    assert "\x1b" not in result.output
    assert "    outcome robot fine coarse effects                   reward" in lines
    assert "    shifted  0.15  0.2    0.1 loose(p)                  -fail" in lines
    assert "    n1 3/0/5/0 12/4/9/0 140/20/31/2" in lines
    assert "objects        board: pcb" in lines


def test_show_puts_counts_beside_probabilities(menid: Menid, files: Path) -> None:
    (files / "a.menid").write_text(
        "domain d predicate p environment r: target environment s: test action a { rule x {"
        " outcomes r { up: 1/3 p down: 2/3 nothing } observed r s { up: 4 9 down: 0 12.5 } } }"
    )
    lines = menid("show", "a.menid").output.splitlines()
    assert "    up      1/3 (4)    ? (9) p" in lines
    assert "    down    2/3 (0) ? (12.5) nothing" in lines


def test_show_json_and_output_file(menid: Menid, files: Path) -> None:
    result = menid("show", "--json", "-o", "shown.json", "both.menid")
    assert (result.exit_code, result.output) == (0, "")
    shown = json.loads((files / "shown.json").read_text())
    rule = shown["domain"]["actions"][0]["rules"][0]
    assert rule["outcomes"][0] == {
        "name": "freed",
        "cells": ["0.55", "0.5", "0.7"],
        "effects": ["not in(p, b)", "on-table(p)"],
        "reward": "win",
    }
    assert rule["observed"] == [
        {
            "for": ["n1"],
            "environments": ["robot", "fine", "coarse"],
            "rows": {
                "freed": ["3", "12", "140"],
                "shifted": ["0", "4", "20"],
                "held": ["5", "9", "31"],
                "noise": ["0", "0", "2"],
            },
        }
    ]
    assert shown["problem"]["horizon"] == 40


# ----------------------------------------------------------------------------------------- explain


@pytest.mark.parametrize(
    "given", [["both.menid"], ["domain.menid", "problem.menid"], ["problem.menid"]]
)
def test_explain_an_action(given: list[str], menid: Menid, files: Path) -> None:
    result = menid("explain", "--json", *given, "lever(n1)")
    assert result.exit_code == 0
    explained = json.loads(result.output)
    assert explained["state"] == ["in(board, tray)"]
    (action,) = explained["actions"]
    assert (action["action"], action["applies"], action["rule"]) == ("lever(n1)", True, "seated")
    assert [(r["rule"], r["covers"]) for r in action["rules"]] == [
        ("seated", True),
        ("already-loose", False),
    ]
    assert "`loose(board)` does not hold" in action["rules"][1]["reason"]
    freed = action["outcomes"][0]
    assert freed["name"] == "freed"
    assert freed["add"] == ["on-table(board)"]
    assert freed["delete"] == ["in(board, tray)"]
    # win 1 - cost 0.1; a failure pays -fail, which the problem sets to 10.
    assert freed["reward"] == pytest.approx(0.9)
    assert action["outcomes"][2]["reward"] == pytest.approx(-10.1)
    assert freed["probability"] == pytest.approx({"robot": 0.55, "fine": 0.5, "coarse": 0.7})
    assert [o["name"] for o in action["outcomes"]] == ["freed", "shifted", "held", "noise"]


def test_explain_a_state(menid: Menid, files: Path) -> None:
    result = menid("explain", "both.menid")
    assert "applies: 20 of 20" in result.output
    result = menid("explain", "both.menid", "--state", "on-table(board)")
    assert "derived: clear(board), done" in result.output
    assert "goal: holds here" in result.output
    assert "nothing satisfies `the p: pcb, b: bay where in(p, b)`" in result.output
    result = menid("explain", "both.menid", "--state", "")
    assert "state: no atom holds" in result.output


def test_explain_text_of_one_action(menid: Menid, files: Path) -> None:
    result = menid("explain", "both.menid", "--state", "in(board, tray), loose(board)", "lever(n2)")
    assert result.output.splitlines() == [
        "state: in(board, tray), loose(board)",
        "",
        "lever(n2) applies, by rule already-loose",
        "  rule seated does not cover",
        "    `the p: pcb, b: bay where in(p, b)` is p = board, b = tray",
        "    `not loose(board)` fails: `loose(board)` holds",
        "  rule already-loose covers",
        "    `the p: pcb, b: bay where in(p, b)` is p = board, b = tray",
        "",
        "  outcome  robot  fine  coarse  reward  changes",
        "  freed      0.9   0.9     0.9     0.9  + on-table(board), - in(board, tray), -",
        "                                        loose(board) (arrives in the goal)",
        "  held       0.1   0.1     0.1    -0.1  nothing",
        "  noise        0     0       0    -0.1  nothing",
        "  included in the rewards: -0.1 for the cost of the action",
    ]


def test_explain_ambiguous_reference_and_conflict(menid: Menid, files: Path) -> None:
    (files / "a.menid").write_text(
        "domain d predicate p(object) predicate q action a { rule one { the x: object where p(x)"
        " outcomes { y: 1 q } } rule two { when exists x: object (p(x)) outcomes { y: 1 q } } }"
        " problem t for d object b, c: object init p(b), p(c)"
    )
    result = menid("explain", "a.menid", "a")
    assert "is ambiguous: 2 candidates (x = b; x = c)" in result.output
    assert result.exit_code == 0
    result = menid("explain", "a.menid", "a", "--state", "p(b)")
    assert result.exit_code == 3
    assert "covered by rules `one` (x = b) and `two` in the state p(b)" in result.output
    explained = json.loads(menid("explain", "a.menid", "a", "--state", "p(b)", "--json").output)
    assert explained["actions"][0]["applies"] is False


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["levr(n1)"], "error[M215]: unknown action `levr`; did you mean `lever`?"),
        (["lever(n21)"], "error[M204]: unknown object `n21`"),
        (["lever(tray)"], "error[M303]: `tray` is of type `bay`, but `lever` asks for `edge`"),
        (["lever"], "error[M302]: `lever` takes 1 argument, not 0"),
        (["lever(n1"], "error[M101]"),
        ([""], "error[M215]: an action is asked for"),
        (["--state", "in(board tray)"], "error[M101]"),
        (["--state", "clear(board)"], "error[M304]"),
        (["--state", "in(board, tray),"], "error[M101]"),
        (["--state", "in(b, %)"], "error[M003]"),
    ],
)
def test_explain_of_bad_input(
    arguments: list[str], message: str, menid: Menid, files: Path
) -> None:
    result = menid("explain", "both.menid", *arguments)
    assert result.exit_code == 3
    assert message in result.output


def test_explain_without_a_problem_is_wrong_usage(menid: Menid, files: Path) -> None:
    assert menid("explain", "domain.menid").exit_code == 2
    assert menid("explain", "lever(n1)").exit_code == 2
    assert menid("explain", "no.menid").exit_code == 2


def test_explain_stops_at_the_work_limit(menid: Menid, files: Path) -> None:
    variables = ", ".join(f"x{i}: object" for i in range(12))
    (files / "a.menid").write_text(
        f"domain d predicate p(object) derived deep = forall {variables} (not p(x0) or not p(x1))"
        " action a { rule r { when deep outcomes { o: 1 nothing } } }"
        " problem t for d object o1..o20: object"
    )
    result = menid("explain", "a.menid")
    assert result.exit_code == 6
    assert "the work limit" in result.output


def test_explain_of_too_many_instances_asks_for_one(menid: Menid, files: Path) -> None:
    (files / "a.menid").write_text(
        "domain d predicate p(object) action a(x, y: object) { rule r { when p(x) outcomes {"
        " o: 1 not p(x) } } } problem t for d object o1..o200: object init p(o1)"
    )
    result = menid("explain", "a.menid")
    assert result.exit_code == 6
    assert "more than 10000 action instances" in result.output
    assert menid("explain", "a.menid", "a(o1, o2)").exit_code == 0


# -------------------------------------------------------------------------------------------- init


def test_init_writes_files_that_check_cleanly(menid: Menid, tmp_path: Path) -> None:
    result = menid("init", "lamp")
    assert result.exit_code == 0
    both = ["lamp/domain.menid", "lamp/problem.menid"]
    assert menid("check", *both).exit_code == 0
    assert menid("fmt", "--check", *both).exit_code == 0
    explained = json.loads(menid("explain", "--json", *both).output)
    assert any(action["applies"] for action in explained["actions"])
    before = (tmp_path / both[0]).read_text()
    assert before.count("#") > 5
    result = menid("init", "lamp")
    assert result.exit_code == 2
    assert "exists already" in result.output
    assert menid("init", "other", "-o", "lamp").exit_code == 2


@pytest.mark.parametrize("name", ["two words", "action", "2x", "a-", ""])
def test_init_refuses_what_is_no_name(name: str, menid: Menid, tmp_path: Path) -> None:
    assert menid("init", name).exit_code == 2
    assert list(tmp_path.iterdir()) == []


# -------------------------------------------------------------------------------------- everything


def test_help_of_every_command(menid: Menid) -> None:
    listing = menid("--help").output
    for name in ("check", "explain", "fmt", "ground", "init", "show"):
        assert name in listing
        assert menid(name, "--help").exit_code == 0
    assert menid("--version").output.startswith("menid, version ")
    assert menid("nonsense").exit_code == 2


# ------------------------------------------------------------------------- what once went wrong


def test_params_of_a_problem_and_a_broken_table(menid: Menid, tmp_path: Path) -> None:
    (tmp_path / "domain.menid").write_text(
        "domain d predicate p param a = 1"
        " action x { rule r { outcomes { l: 0.5 p  m: s nothing } } }"
    )
    (tmp_path / "p.menid").write_text("problem z for d param a = 2")
    for command in ("check", "fmt", "show", "explain"):
        result = menid(command, "p.menid")
        assert result.exit_code == 3
        assert "unknown param `s`" in result.output
        assert "M424" not in result.output


def test_the_domain_that_is_given_is_the_one_that_is_used(menid: Menid, files: Path) -> None:
    (files / "other").mkdir()
    (files / "other" / "domain.menid").write_text("domain other")
    result = menid("explain", "other/domain.menid", "problem.menid")
    assert result.exit_code == 3
    assert "the problem is for `hdd`, the domain is `other`" in result.output


def test_problems_use_the_domain_of_their_own_folder(menid: Menid, tmp_path: Path) -> None:
    for folder, predicate in (("v1", "p"), ("v2", "q")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "domain.menid").write_text(f"domain d predicate {predicate}")
        (tmp_path / folder / "t.menid").write_text(f"problem t for d init {predicate}")
    both = ["v1/domain.menid", "v1/t.menid", "v2/domain.menid", "v2/t.menid"]
    assert menid("check", *both).exit_code == 0
    assert menid("check", "v1/t.menid", "v2/t.menid").exit_code == 0


@pytest.mark.parametrize("total", ["0.999999", "1.000001", "0.9999989", "1.0000011"])
def test_a_column_sums_to_1_within_a_millionth(total: str, menid: Menid) -> None:
    rest = f"{float(total) - 0.5:.7f}"
    text = (
        f"domain d predicate p action a {{ rule r {{ outcomes {{ o: 0.5 p n: {rest} nothing }} }} }}"
        " problem t for d"
    )
    good = total in ("0.999999", "1.000001")
    assert menid("check", "-", input=text).exit_code == (0 if good else 3)
    if good:
        assert menid("explain", "-", "a", input=text).exit_code == 0


def test_output_is_written_in_one_step(
    menid: Menid, files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (files / "old.txt").write_text("old")

    def no_replace(source: str, target: str) -> None:
        raise OSError(28, "No space left on device", target)

    monkeypatch.setattr(os, "replace", no_replace)
    assert menid("show", "both.menid", "-o", "old.txt").exit_code == 2
    assert (files / "old.txt").read_text() == "old"


def test_an_error_in_one_row_leaves_quantified_effects_of_others_alone(menid: Menid) -> None:
    text = (
        "domain d predicate p predicate q(object) action x { rule r { outcomes {"
        " a: 0.5 forall y: object where q(y) { p }  b: 0.5 p and p } } }"
    )
    result = menid("check", "-", input=text)
    assert result.output.count("error[") == 1
    assert "effects are separated by commas" in result.output


@pytest.mark.parametrize("word", ["goal", "init", "action", "type", "rule"])
def test_a_reserved_word_as_the_name_of_a_rule(word: str, menid: Menid) -> None:
    text = f"domain d predicate p action a {{ rule {word} {{ outcomes {{ o: 1 p }} }} }}"
    result = menid("check", "-", input=text)
    assert result.output.count("error[") == 1
    assert f"error[M102]: `{word}` is a reserved word" in result.output


# Sends SIGINT as soon as a module is looked for, before anything else can.
_INTERRUPT = """
import os, signal, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == last:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), signal.SIGINT)
last = sys.argv.pop(1)
import menid_plan
sys.meta_path.insert(0, Finder())
from menid_plan.cli.main import main
main()
"""


@pytest.mark.parametrize(
    "module",
    ["click", "menid_plan.cli.common", "menid_plan.cli.solve", "menid_plan.planning", "numpy"],
)
def test_an_interrupt_while_modules_are_loaded_is_one_line(module: str, files: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _INTERRUPT, module, "solve", str(files / "both.menid")],
        capture_output=True, check=False, text=True,
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (6, "", "menid: interrupted\n")
