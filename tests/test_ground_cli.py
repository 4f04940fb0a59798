"""`menid ground`: counts, limits, and files that other tools read."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import Result

from conftest import ROOT

Menid = Callable[..., Result]
TRIANGLE = str(ROOT / "domains" / "tireworld" / "triangle-1.menid")


def test_counts(menid: Menid) -> None:
    result = menid("ground", TRIANGLE, "--json")
    assert result.exit_code == 0
    counts = json.loads(result.output)
    # 80 states, by Little and Thiebaux's p01; 2 of them are dead ends.
    assert (counts["states"], counts["dead_ends"]) == (80, 2)
    assert set(counts["seconds"]) == {"startup", "ground", "explore"}
    text = menid("ground", TRIANGLE).output
    assert "states       80\n" in text
    assert "dead ends    2\n" in text


def test_only_what_happens_is_followed(menid: Menid, tmp_path: Path) -> None:
    (tmp_path / "a.menid").write_text(
        "domain d predicate p predicate q environment r: target environment s: test param x = 1"
        " action a { rule one { outcomes r s { i: (x) 1 p j: (1 - x) 0 q } } } problem t for d"
    )
    assert json.loads(menid("ground", "a.menid", "--json").output)["states"] == 2
    set_ = json.loads(menid("ground", "a.menid", "--json", "--set", "x=0.5").output)
    assert set_["states"] == 4
    other = menid("ground", "a.menid", "--json", "--set", "x=0.5", "--env", "s")
    assert json.loads(other.output)["states"] == 2


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (
            ["--env", "nowhere"],
            3,
            "there is no environment `nowhere`; the domain has: world, model",
        ),
        (["--set", "x=1"], 3, "there is no param `x`"),
        (["--set", "x"], 2, "`x` is not of the form NAME=NUMBER"),
        (["--max-states", "10"], 6, "more than 10 states can be reached"),
        (["--max-states", "0"], 2, ""),
    ],
)
def test_bad_input(arguments: list[str], code: int, message: str, menid: Menid) -> None:
    result = menid("ground", TRIANGLE, *arguments)
    assert result.exit_code == code
    assert message in result.output


def test_a_param_that_spoils_a_column(menid: Menid, tmp_path: Path) -> None:
    (tmp_path / "a.menid").write_text(
        "domain d predicate p param x = 1 action a { rule one { outcomes { i: (x) p } } }"
        " problem t for d"
    )
    result = menid("ground", "a.menid", "--set", "x=0.5")
    assert result.exit_code == 3
    assert "rule a.one, environment `target`: sums to 0.5, not 1" in result.output


def test_prism_files(menid: Menid, tmp_path: Path) -> None:
    (tmp_path / "a.menid").write_text(
        "domain d predicate p predicate q reward 2 when q action a cost 1 { rule one { when not p"
        " outcomes { i: 0.25 p reward 4 j: 0.5 q noise: 0.25 } } } problem t for d goal p reward 8"
    )
    result = menid("ground", "a.menid", "-o", "out")
    assert result.exit_code == 0
    told = "".join(f"wrote out.{s}\n" for s in ("tra", "sta", "lab", "srew", "trew"))
    assert result.stdout.endswith(f" MB\n{told}")
    assert result.stderr == ""
    files = {s: (tmp_path / f"out.{s}").read_text().splitlines() for s in ("tra", "sta", "lab")}
    # State 0: nothing; 1: p, the goal; 2: q; 3: p and q, the goal.
    assert files["sta"][:3] == ["(p,q)", "0:(false,false)", "1:(true,false)"]
    assert files["sta"][3:] == ["2:(false,true)", "3:(true,true)"]
    assert files["tra"] == [
        "4 4 7",
        "0 0 0 0.25 a",
        "0 0 1 0.25 a",
        "0 0 2 0.5 a",
        "1 0 1 1",
        "2 0 2 0.75 a",
        "2 0 3 0.25 a",
        "3 0 3 1",
    ]
    assert files["lab"] == [
        '0="init" 1="deadlock" 2="goal" 3="dead_end"',
        "0: 0",
        "1: 2",
        "3: 2",
    ]
    assert (tmp_path / "out.srew").read_text().splitlines() == ["4 1", "2 2.0"]
    # On average a step pays 0.25 (4 + 8) - 1 = 2 beyond the reward of its state.
    rewards = (tmp_path / "out.trew").read_text().splitlines()
    assert rewards[0] == "4 4 5"
    assert rewards[1:4] == ["0 0 0 2.0", "0 0 1 2.0", "0 0 2 2.0"]


def test_what_is_written_is_told_beside_the_json(menid: Menid) -> None:
    result = menid("ground", TRIANGLE, "-o", "model.drn", "--json")
    assert json.loads(result.stdout)["states"] == 80
    assert result.stderr == "wrote model.drn\n"


def test_the_limit_says_how_many_states_were_found(menid: Menid) -> None:
    result = menid("ground", TRIANGLE, "--max-states", "10")
    found = re.search(r"(\d+) (?:states )?were found", result.output)
    assert found is not None
    assert 10 < int(found[1]) <= 80  # they are counted by stretches


def test_storm_reads_the_drn_file(menid: Menid, tmp_path: Path) -> None:
    stormpy = pytest.importorskip("stormpy", reason="the extra `storm` is not installed")
    assert menid("ground", TRIANGLE, "-o", "model.drn").exit_code == 0
    model = stormpy.build_model_from_drn(str(tmp_path / "model.drn"))
    assert model.nr_states == 80
    (formula,) = stormpy.parse_properties('Pmax=? [F "goal"]')
    assert stormpy.model_checking(model, formula).get_value(0) == pytest.approx(1)


def test_all_files_of_a_model_are_written_or_none(menid: Menid, tmp_path: Path) -> None:
    (tmp_path / "out.tra").write_text("a model")
    (tmp_path / "out.trew").mkdir()
    result = menid("ground", TRIANGLE, "-o", "out")
    assert result.exit_code == 2
    assert "out.trew" in result.output
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.tra", "out.trew"]
    assert (tmp_path / "out.tra").read_text() == "a model"


@pytest.mark.parametrize("name", [".", "/", "there", "there/"])
def test_a_folder_is_no_name_of_a_model(menid: Menid, tmp_path: Path, name: str) -> None:
    (tmp_path / "there").mkdir()
    result = menid("ground", TRIANGLE, "-o", name)
    assert result.exit_code == 2
    assert "is no name of a file" in result.output
    assert [path.name for path in tmp_path.iterdir()] == ["there"]


def test_a_folder_that_is_not_there_is_told_before_the_search(
    menid: Menid, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr("menid_plan.planning.explore")
    result = menid("ground", TRIANGLE, "-o", "nowhere/out")
    assert result.exit_code == 2
    assert "there is no folder `nowhere`" in result.output


def test_the_ending_drn_may_be_in_capitals(menid: Menid, tmp_path: Path) -> None:
    assert menid("ground", TRIANGLE, "-o", "model.DRN").exit_code == 0
    assert (tmp_path / "model.DRN").read_text().startswith("@type: MDP")
