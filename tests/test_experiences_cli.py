"""`menid experiences`: the summary, JSON lines out and in, and what is said of bad ones."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result

from menid_plan.experience.lines import LineError, read_lines, write_lines
from menid_plan.experience.record import Experience, Explanation
from menid_plan.experience.store import Store
from menid_plan.grounding.state import GroundAction
from models import state
from test_store import BOTH, DARK, TEXT, test_of

Menid = Callable[..., Result]

SHARED = replace(DARK, weights=(0.1, 0.7, 0.2))
SEEN = [
    test_of(0, environment="room", reward=-2.5, duration=30.0, seed=2**64 + 1),
    test_of(0),
    test_of(1, explanation=SHARED, state=state("worn left", "joined left right")),
    test_of(2, explanation=None, after=state()),
    Experience("sketch", state(), GroundAction("rest"), state(), 1.0, 0.1 + 0.2, 7, 1e9,
               Explanation("any", (), (1.0, 0.0)), 0),
]  # fmt: skip


@pytest.fixture
def lamp(menid: Menid) -> Menid:
    """Runs `menid` beside lamp.menid, run.store and run.jsonl, which holds what the store does."""
    Path("lamp.menid").write_text(TEXT, encoding="utf-8")
    with Store.create("run.store", *BOTH, seed=7, settings={"m": 10}) as store:
        store.add(SEEN)
    Path("run.jsonl").write_text("".join(write_lines(BOTH[0], SEEN)), encoding="utf-8")
    return menid


def test_the_summary(lamp: Menid) -> None:
    result = lamp("experiences", "run.store")
    assert result.output == (
        "domain lamp, problem evening, seed 7\n\n"
        "environment  role    executions  seconds  reward  explained  noise  unexplained\n"
        "room         target           1       30    -2.5          1      0            0\n"
        "model        test             3     0.75                1.8    0.2            1\n"
        "sketch       test             1      0.3       1          1      0            0\n\n"
        "rule                 environment  outcomes\n"
        "press.dark for left  room         on 1, wears 0, noise 0\n"
        "                     model        on 1.1, wears 0.7, noise 0.2\n"
        "rest.any             sketch       slept 1, noise 0\n"
    )


def test_the_summary_as_json(lamp: Menid) -> None:
    data = json.loads(lamp("experiences", "run.store", "--json").output)
    assert (data["domain"], data["problem"], data["seed"]) == ("lamp", "evening", 7)
    assert data["settings"] == {"m": 10}
    assert data["environments"][1] == {
        "environment": "model", "role": "test", "executions": 3, "seconds": 0.75, "reward": None,
        "rewarded": 0, "explained": 1.8, "noise": 0.2, "unexplained": 1,
    }  # fmt: skip
    assert data["rules"][0] == {
        "action": "press", "rule": "dark", "values": ["left"], "environment": "room",
        "outcomes": {"on": 1.0, "wears": 0.0, "noise": 0.0},
    }  # fmt: skip


def test_an_empty_store(lamp: Menid) -> None:
    Store.create("empty.store", *BOTH).close()
    result = lamp("experiences", "empty.store")
    assert result.exit_code == 0
    assert "rule" not in result.output
    assert lamp("experiences", "empty.store", "--export", "-").output == ""


def test_there_and_back(lamp: Menid) -> None:
    assert lamp("experiences", "run.store", "--export", "-").output == Path("run.jsonl").read_text()
    assert lamp("experiences", "run.store", "--export", "out.jsonl").output == ""
    assert Path("out.jsonl").read_bytes() == Path("run.jsonl").read_bytes()
    arguments = ("--import", "out.jsonl", "--domain", "lamp.menid")
    result = lamp("experiences", "new.store", *arguments)
    assert (result.output, result.exit_code) == ("imported 5 experiences\n", 0)
    with Store.read("new.store") as store:
        assert list(store) == SEEN
    result = lamp("experiences", "new.store", "--import", "-", input=Path("out.jsonl").read_bytes())
    assert result.output == "imported 0 experiences, 5 were there already\n"
    result = lamp("experiences", "new.store", *arguments, "--json")
    assert json.loads(result.output) == {"imported": 0, "there_already": 5, "executions": 5}


def test_domain_and_problem_in_two_files(lamp: Menid) -> None:
    domain, _, problem = TEXT.partition("problem")
    Path("domain.menid").write_text(domain, encoding="utf-8")
    Path("evening.menid").write_text("problem" + problem, encoding="utf-8")
    files = ("--domain", "domain.menid", "evening.menid")
    result = lamp("experiences", "new.store", "--import", "run.jsonl", *files)
    assert result.output == "imported 5 experiences\n"


def test_lines_that_a_store_has_otherwise(lamp: Menid) -> None:
    text = Path("run.jsonl").read_text().replace('"seed": 1000', '"seed": 999')
    result = lamp("experiences", "run.store", "--import", "-", input=text)
    assert result.exit_code == 3
    assert "has test 0 of `press(left)` in `model` already" in result.output
    assert result.output.startswith(
        "menid: `standard input`, line 2: the store `run.store` has test"
    )
    Path("gap.jsonl").write_text("\n\n" + text, encoding="utf-8")
    assert (
        "`gap.jsonl`, line 4: " in lamp("experiences", "run.store", "--import", "gap.jsonl").output
    )
    Path("other.menid").write_text(TEXT.replace("0.7", "0.5").replace("0.3", "0.5"))
    arguments = ("--import", "run.jsonl", "--domain", "other.menid")
    assert lamp("experiences", "run.store", *arguments).exit_code == 0
    Path("other.menid").write_text(TEXT.replace("0.3 worn(s)", "0.3 not worn(s)"))
    result = lamp("experiences", "run.store", *arguments)
    assert result.exit_code == 3
    assert "a store of another domain" in result.output
    assert "rule `press.dark` differs" in result.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run.store", "--export", "-", "--import", "run.jsonl"], "do not go together"),
        (["run.store", "lamp.menid"], "one argument too many"),
        (["run.store", "--domain", "lamp.menid"], "--domain goes with --import only"),
        (["new.store", "--import", "run.jsonl"], "a new one needs --domain DOMAIN PROBLEM"),
        (["new.store", "--import", "none.jsonl"], "does not exist"),
        ([], "Missing argument 'STORE'"),
    ],
)
def test_wrong_usage(lamp: Menid, arguments: list[str], message: str) -> None:
    result = lamp("experiences", *arguments)
    assert result.exit_code == 2
    assert message in result.output
    assert not Path("new.store").exists()


def test_what_is_no_store(lamp: Menid) -> None:
    for options in ((), ("--json",), ("--export", "-"), ("--import", "run.jsonl")):
        result = lamp("experiences", "lamp.menid", *options)
        assert result.exit_code == 3
        assert result.output == "menid: `lamp.menid` is no store of experiences\n"
    result = lamp("experiences", "none.store")
    assert (result.exit_code, result.output) == (3, "menid: there is no store `none.store`\n")
    assert not Path("lamp.menid.lock").exists()


def test_while_a_run_writes(lamp: Menid) -> None:
    with Store.resume("run.store"):
        assert lamp("experiences", "run.store").exit_code == 0
        result = lamp("experiences", "run.store", "--import", "run.jsonl")
        assert result.exit_code == 5
        assert "another process writes to the store" in result.output


GOOD: dict[str, Any] = json.loads(next(write_lines(BOTH[0], [test_of(4, explanation=SHARED)])))


def changed(key: str, value: Any) -> str:
    data = json.loads(json.dumps(GOOD))
    inside = data["explanation"] if key in ("rule", "values", "weights") else data
    inside[key] = value
    return json.dumps(data)


def without(key: str) -> str:
    data = json.loads(json.dumps(GOOD))
    del (data["explanation"] if key in ("rule", "values", "weights") else data)[key]
    return json.dumps(data)


BAD = [
    ("{", "column 2: no JSON"),
    ("\xff", "no UTF-8"),
    ("[" * 100_000, "nested too deep"),
    ('{"seed": ' + "1" * 5000 + "}", "a number too long"),
    ("[]", "the JSON is no object"),
    ("{}", "`environment` is missing"),
    ('{"seed": 1, "seed": 2}', "`seed` stands twice"),
    *((without(key), f"`{key}` is missing") for key in GOOD),
    *((without(key), f"`{key}` is missing") for key in GOOD["explanation"]),
    (changed("speed", 1), "an experience has no `speed`"),
    (changed("environment", "garden"), '`environment` is "garden", and not one of: room, model'),
    (changed("environment", ["room"]), "`environment` is"),
    (changed("role", "target"), '`role` is "target", and that of `model` is test'),
    (changed("number", -1), "`number` is -1, not a whole number >= 0"),
    (changed("number", 1.0), "`number` is 1.0, not"),
    (changed("number", True), "`number` is true, not"),
    (changed("number", 2**63), "`number` is"),
    (changed("seed", "1"), '`seed` is "1", not a whole number'),
    (changed("seed", None), "`seed` is null"),
    (changed("state", "lit"), "`state` is no list of atoms"),
    (changed("state", [1]), "`state` is no list of atoms"),
    (changed("state", ["dark"]), "`state`: atom `dark`: unknown predicate `dark`"),
    (changed("state", ["worn(up)"]), "`state`: atom `worn(up)`: unknown object `up`"),
    (changed("state", ["worn"]), "`state`: atom `worn`"),
    (changed("state", ["worn(left"]), "`state`: atom `worn(left`"),
    (changed("state", ["lit, worn(left)"]), "`state`: `lit, worn(left)` is not one atom"),
    (changed("state", [""]), "`state`: `` is not one atom"),
    (changed("state", ["lit", " lit"]), "`state`: atom `lit` stands twice"),
    (changed("state", ["__import__('os')"]), "`state`: atom"),
    (changed("after", ["dark"]), "`after`: atom `dark`: unknown predicate `dark`"),
    (changed("action", "pull(left)"), "`action`: `pull(left)`: unknown action `pull`"),
    (changed("action", "press(up)"), "`action`: `press(up)`: unknown object `up`"),
    (changed("action", "press"), "`action`: `press`"),
    (changed("action", ""), "`action`: ``"),
    (changed("action", None), "`action` is null"),
    (changed("reward", "1"), '`reward` is "1", not a finite number'),
    (changed("reward", True), "`reward` is true"),
    (changed("reward", float("nan")), "`reward` is NaN, not a finite number"),
    (changed("reward", 10**400), "`reward` is 1000"),
    (changed("duration", -1), "`duration` is -1, not a finite number >= 0"),
    (changed("duration", None), "`duration` is null"),
    (changed("when", float("inf")), "`when` is Infinity"),
    (changed("explanation", []), "`explanation` is neither null nor an object"),
    (changed("explanation", {**GOOD["explanation"], "why": 1}), "an explanation has no `why`"),
    (changed("rule", "any"), '`rule` is "any", and not one of `press`: dark'),
    (changed("rule", 1), "`rule` is 1"),
    (
        changed("values", []),
        '`values` is [], and those of rule `dark` in `press(left)` are ["left"]',
    ),
    (changed("values", ["right"]), "`values` is"),
    (changed("weights", [1, 0, 0]), "`weights` is no object of numbers"),
    (changed("weights", {"off": 1}), "`weights`: rule `dark` has no outcome `off`"),
    (changed("weights", {"on": 2, "wears": -1}), "`weights.wears` is -1, not"),
    (changed("weights", {"on": 0.5}), "`weights` sum to 0.5, not 1"),
]


@pytest.mark.parametrize(("line", "message"), BAD, ids=[f"{i}" for i in range(len(BAD))])
def test_bad_lines(line: str, message: str) -> None:
    lines = [json.dumps(GOOD).encode(), b"", line.encode("latin-1")]
    reading = read_lines(lines, *BOTH, "some.jsonl")
    assert next(reading) == test_of(4, explanation=SHARED)
    with pytest.raises(LineError) as caught:
        next(reading)
    assert str(caught.value).startswith("`some.jsonl`, line 3: ")
    assert message in str(caught.value)
    assert len(str(caught.value)) < 300


def test_nothing_is_imported_half(lamp: Menid) -> None:
    good = Path("run.jsonl").read_text()
    new = json.dumps(GOOD) + "\n"
    Path("bad.jsonl").write_text(new + good + changed("seed", 0.5) + "\n", encoding="utf-8")
    result = lamp("experiences", "run.store", "--import", "bad.jsonl")
    assert result.exit_code == 3
    assert "`bad.jsonl`, line 7: `seed` is 0.5" in result.output
    with Store.read("run.store") as store:
        assert list(store) == SEEN
    result = lamp(
        "experiences", "new.store", "--import", "bad.jsonl", "--domain", "lamp.menid", "--json"
    )
    assert result.exit_code == 3
    assert not list(Path().glob("new.store*"))


@pytest.mark.parametrize("ending", ["", "-wal", "-shm", ".lock"])
def test_a_store_is_not_written_over(lamp: Menid, ending: str) -> None:
    before = Path("run.store").read_bytes()
    Path("link").symlink_to("run.store")
    for store in ("run.store", "link"):
        result = lamp("experiences", store, "--export", f"run.store{ending}")
        assert result.exit_code == 2
        assert f"cannot write `run.store{ending}`: " in result.output
    if not ending:
        for target in ("link", "./run.store"):
            assert lamp("experiences", "run.store", "--export", target).exit_code == 2
    assert Path("run.store").read_bytes() == before


def test_a_new_store_is_not_what_is_imported(lamp: Menid) -> None:
    Path("empty").touch()
    for options in (("--domain", "lamp.menid"), ()):
        assert lamp("experiences", "empty", "--import", "empty", *options).exit_code == 2
    assert Path("empty").read_bytes() == b""


def test_the_folder_of_a_run(lamp: Menid) -> None:
    Path("out").mkdir()
    result = lamp("experiences", "out")
    assert (result.exit_code, result.output) == (
        3, "menid: there is no store `out/experiences.sqlite`\n"
    )  # fmt: skip
    Path("run.store").rename("out/experiences.sqlite")
    assert "domain lamp, problem evening, seed 7" in lamp("experiences", "out").output
    result = lamp("experiences", "out", "--export", "out/experiences.sqlite")
    assert result.exit_code == 2


def test_a_failed_export_leaves_the_old_file(lamp: Menid) -> None:
    Path("out.jsonl").write_text("old", encoding="utf-8")
    import sqlite3

    connection = sqlite3.connect("run.store")
    connection.execute("DELETE FROM states WHERE atoms LIKE '%joined%'")
    connection.commit()
    connection.close()
    result = lamp("experiences", "run.store", "--export", "out.jsonl")
    assert result.exit_code == 3
    assert "damaged" in result.output
    assert Path("out.jsonl").read_text() == "old"
    assert not list(Path().glob(".menid.*"))
