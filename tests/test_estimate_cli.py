"""`menid estimate`: golden values, the keys of its JSON, and domains that can be planned with."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result

import menid_plan
from learning_runs import DOMAIN, LEVERS, PROBLEM, run_of
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.runfile import Bound
from menid_plan.environments.simulated import Simulated
from menid_plan.model.expressions import evaluate

Menid = Callable[..., Result]

COINS = """\
domain coins
environment real : target
environment sim : test
predicate up
action toss {
  rule toss {
    outcomes { heads: up tails: not up }
    observed real sim { heads: %s 8 tails: %s 2 }
  }
}
"""


def estimated(menid: Menid, *arguments: str) -> Any:
    result = menid("estimate", *arguments, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


@pytest.mark.parametrize(
    ("seen", "value"), [((0, 0), 0.8), ((1, 2), 0.773585), ((50, 49), 0.532110)]
)
def test_golden_values_of_decreasing_m(menid: Menid, seen: tuple[int, int], value: float) -> None:
    Path("coins.menid").write_text(COINS % seen, encoding="utf-8")
    for options in ([], ["--m", "10"], ["--estimator", "decreasing-m", "--m", "10"]):
        (rule,) = estimated(menid, "coins.menid", *options)["rules"]
        assert rule["estimate"][0] == pytest.approx(value, abs=5e-7)
    (rule,) = estimated(menid, "coins.menid", "--m", "0")["rules"]
    assert rule["estimate"][0] == pytest.approx(seen[0] / sum(seen) if sum(seen) else 1 / 3)


def test_the_keys_of_the_json(menid: Menid) -> None:
    Path("coins.menid").write_text(COINS % (1, 2), encoding="utf-8")
    found = estimated(menid, "coins.menid", "--epsilon", "0.05")
    (rule,) = found["rules"]
    assert {"rule", "for", "outcomes", "counts", "delta", "estimate"} <= set(rule)
    assert (rule["rule"], rule["for"]) == ("toss", [])
    assert rule["outcomes"] == ["heads", "tails", "noise"]
    assert rule["counts"] == {"real": [1, 2, 0], "sim": [8, 2, 0]}
    assert rule["delta"]["real"] == pytest.approx(0.514152, abs=1e-6)
    assert sum(rule["estimate"]) == pytest.approx(1)
    assert found["unseen"] == []


def test_the_table(menid: Menid, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    Path("coins.menid").write_text(COINS % (1, 2), encoding="utf-8")
    result = menid("estimate", "coins.menid", "--compare")
    assert result.output == (
        "toss.toss\n"
        "         real    sim estimate\n"
        "heads       1      8   0.7736\n"
        "tails       2      2   0.2264\n"
        "noise       0      0   0.0000\n"
        "delta  0.5142 0.3329\n"
        "agrees          0.54\n"
        "                heads  tails  noise\n"
        "empirical      0.3333 0.6667 0.0000\n"
        "pooled         0.6923 0.3077 0.0000\n"
        "decreasing-m   0.7736 0.2264 0.0000\n"
        "robust         0.4916 0.3982 0.1101\n"
        "sam            0.4358 0.4341 0.1301\n"
        "power-prior    0.5249 0.3769 0.0983\n"
        "precision-grid 0.6165 0.3228 0.0607\n"
        "subsets        0.4916 0.3982 0.1101\n\n"
    )


# A rule for each way in which probabilities can be written, or not.
MANY = """\
domain many
type thing
environment a : target
environment b : test
param half = 0.5
predicate p(thing)
predicate q
predicate r
action one(x: thing) {
  rule single {
    when not p(x)
    outcomes { on: 0.9 p(x) off: 0.1 nothing }
    observed a b { on: 3 5 off: 1 0 }
  }
  rule otherwise-rule { otherwise outcomes { off: 1 not p(x) } observed b { off: 4 } }
}
action two(x: thing) {
  rule per-thing per x {
    when not q
    outcomes a b { on: half 0.6 q off: half 0.4 nothing }
    probabilities a for left { on: 0.2 off: 0.8 }
    probabilities a for right { on: 0.3 off: 0.7 }
    observed a b for left { on: 9 1 off: 1 0 }
  }
  rule bare { when q outcomes { off: not q } }
}
action three(x: thing) {
  rule per-bare per x { when not r outcomes { on: r } observed a for left { on: 2 noise: 1 } }
  rule blocks {
    when r
    outcomes { on: not r off: nothing }
    probabilities a b { on: 0.5 0.5 off: 0.5 0.5 }
    observed a b { on: 0 3 off: 2 1 }
  }
}
problem all for many
object left, right: thing
init r
goal p(left) and q and not r
"""


def test_what_is_written_back(menid: Menid) -> None:
    Path("many.menid").write_text(MANY, encoding="utf-8")
    rules = {
        (rule["rule"], *rule["for"]): rule["estimate"]
        for rule in estimated(menid, "many.menid", "--m", "10", "-o", "learned.menid")["rules"]
    }
    learned = menid_plan.read("learned.menid").domain
    original = menid_plan.read("many.menid").domain
    assert learned is not None
    assert original is not None

    def column(rule: str, environment: str, *values: str) -> list[float]:
        (found,) = [r for action in learned.actions for r in action.rules if r.name == rule]
        cells = found.probability_cells(environment, values)
        assert cells is not None
        return [evaluate(cell, {"half": 0.5}) for cell in cells]

    assert column("single", "a") == rules["single",]
    assert column("single", "b") == [0.9, 0.1, 0.0]
    assert column("otherwise-rule", "a") == rules["otherwise-rule",] == [1.0, 0.0]
    assert column("per-thing", "a", "left") == rules["per-thing", "left"]
    assert column("per-thing", "a", "right") == [0.3, 0.7, 0.0]  # nothing was seen of it
    assert column("per-thing", "a") == [0.5, 0.5, 0.0]
    assert column("per-thing", "b", "left") == [0.6, 0.4, 0.0]
    assert column("per-bare", "a", "left") == rules["per-bare", "left"]
    assert column("per-bare", "a", "right") == [0.5, 0.5]  # no data, and nothing given
    assert column("bare", "a") == [0.5, 0.5]
    assert column("blocks", "a") == rules["blocks",]
    assert column("blocks", "b") == [0.5, 0.5, 0.0]
    # It is right, keeps its counts, and gives the same again; and it can be planned with.
    assert menid("check", "learned.menid").exit_code == 0
    again = estimated(menid, "learned.menid", "--m", "10", "-o", "twice.menid")["rules"]
    assert {(rule["rule"], *rule["for"]): rule["estimate"] for rule in again} == rules
    assert Path("twice.menid").read_bytes() == Path("learned.menid").read_bytes()
    Path("all.menid").write_text("problem all" + MANY.partition("problem all")[2], encoding="utf-8")
    assert menid("solve", "learned.menid", "all.menid").exit_code == 0


def test_given_probabilities_stay_where_the_estimator_learns_nothing(menid: Menid) -> None:
    Path("many.menid").write_text(MANY, encoding="utf-8")
    found = estimated(menid, "many.menid", "--estimator", "empirical", "-o", "learned.menid")
    (rule,) = [rule for rule in found["rules"] if rule["rule"] == "otherwise-rule"]
    assert rule["estimate"] == [1.0, 0.0]  # it was seen in the test alone
    text = Path("learned.menid").read_text(encoding="utf-8")
    assert "observed a b {\n      off:   0 4" in text


@pytest.fixture
def run(tmp_path: Path, menid: Menid) -> Path:
    """The folder of a run in which the sketch stands for the target, beside levers.menid."""
    Path("levers.menid").write_text(LEVERS, encoding="utf-8")
    declared = tuple(
        replace(e, role="target" if e.name == "sketch" else "test") for e in DOMAIN.environments
    )
    specs = [
        EnvironmentSpec(name, Simulated(), DOMAIN, PROBLEM, role)  # type: ignore[arg-type]
        for name, role in (("sketch", "target"), ("model", "test"))
    ]
    environments = Bound(replace(DOMAIN, environments=declared), PROBLEM, specs[0], (specs[1],))
    folder = tmp_path / "run"
    run_of(
        folder, environments, steps=40, test_time=5.0, estimator="robust", prior_weight=2.0,
        estimator_options={"cap": 50.0},
    ).learn()  # fmt: skip
    return folder


def test_a_run_is_estimated_as_it_did_itself(menid: Menid, run: Path) -> None:
    for store in (run, run / "experiences.sqlite"):
        found = estimated(menid, "levers.menid", str(store), "-o", "again.menid")
        assert found["environments"] == ["sketch", "model"]
        assert Path("again.menid").read_bytes() == (run / "learned.menid").read_bytes()
    text = Path("again.menid").read_text(encoding="utf-8")
    assert "environment bench  : test" in text
    assert "environment sketch : target" in text
    other = estimated(menid, "levers.menid", str(run), "--estimator", "empirical")["rules"]
    assert other[0]["estimate"] != found["rules"][0]["estimate"]


def test_it_plans_with_what_was_learned(menid: Menid, run: Path) -> None:
    Path("task.menid").write_text("problem task" + LEVERS.partition("problem task")[2])
    solved = menid("solve", str(run / "learned.menid"), "task.menid", "--json")
    assert solved.exit_code == 0, solved.output
    believed = json.loads(solved.stdout)["value"]
    true = json.loads(menid("solve", "levers.menid", "--env", "sketch", "--json").stdout)["value"]
    assert believed == pytest.approx(true, abs=1.5)
    assert believed != pytest.approx(true, abs=1e-6)


def test_stores_of_other_domains_and_what_is_no_store(menid: Menid, run: Path) -> None:
    Path("coins.menid").write_text(COINS % (1, 2), encoding="utf-8")
    result = menid("estimate", "coins.menid", str(run))
    assert result.exit_code == 3
    assert "a store of another domain: of `levers`" in result.stderr
    result = menid("estimate", "levers.menid", "coins.menid")
    assert result.exit_code == 3
    assert "is no store of experiences" in result.stderr
    Path("empty").mkdir()
    result = menid("estimate", "levers.menid", "empty")
    assert result.exit_code == 3
    assert "there is no store" in result.stderr


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--estimator", "empircal"], "did you mean `empirical`?"),
        (["--estimator", "empirical", "--m", "3"], "has no option `m`"),
        (["--epsilon", "1"], "--epsilon"),
        (["--m", "-1"], "--m"),
        (["--m", "1e308"], "Invalid value for '--m': 1e+308 is too large"),
        (["--m", "nan"], "'--m'"),
        (["--m", "inf", "-o", "out.menid"], "'--m'"),
        (["--prior-weight", "nan"], "Invalid value for '--prior-weight': nan is not a finite"),
        (["--prior-weight", "1e300"], "'--prior-weight'"),
        (["--epsilon", "nan"], "'--epsilon'"),
    ],
)
def test_wrong_options(menid: Menid, options: list[str], message: str) -> None:
    Path("coins.menid").write_text(COINS % (1, 2), encoding="utf-8")
    result = menid("estimate", "coins.menid", *options)
    assert result.exit_code == 2
    assert message in result.stderr


def test_counts_that_are_too_large(menid: Menid) -> None:
    Path("coins.menid").write_text(COINS % ("1e20", 2), encoding="utf-8")
    result = menid("estimate", "coins.menid", "-o", "out.menid")
    assert result.exit_code == 3
    assert "`toss.toss`: the counts observed in `real` sum to more than 1e+12" in result.stderr
    assert not Path("out.menid").exists()


def test_a_store_is_not_written_over(menid: Menid, run: Path) -> None:
    path = run / "experiences.sqlite"
    before = path.read_bytes()
    Path("link").symlink_to(path)
    for given in (run, path, Path("link")):
        for output in (path, Path("link"), Path(f"{path}-wal"), Path(f"{path}.lock")):
            result = menid("estimate", "levers.menid", str(given), "-o", str(output))
            assert result.exit_code == 2
            assert "is an input" in result.stderr
    assert path.read_bytes() == before


def test_a_domain_with_what_was_learned(menid: Menid, run: Path) -> None:
    learned = run / "learned.menid"
    result = menid("estimate", str(learned), str(run), "-o", "again.menid")
    assert result.exit_code == 0
    assert "has counts of rule `pull.dry`" in result.stderr
    assert "so that nothing is counted twice" in result.stderr
    assert Path("again.menid").read_bytes() == learned.read_bytes()


def test_comments_make_no_other_domain(menid: Menid, run: Path) -> None:
    Path("levers.menid").write_text("# Levers.\n\n" + LEVERS + "\n# The end.", encoding="utf-8")
    result = menid("estimate", "levers.menid", str(run))
    assert (result.exit_code, result.stderr) == (0, "")


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"learn": 1}, "`learn`"),
        ({"learn": {"estimator": 1}}, "`estimator`"),
        ({"learn": {"estimator": "none"}}, "there is no estimator `none`"),
        ({"learn": {"estimator_options": {"m": "a"}}}, "m must be a number, not `a`"),
        ({"learn": {"prior_weight": "a"}}, "`prior_weight`"),
        ({"environments": ["sketch"]}, "`environments`"),
        ({"params": {"none": 1}}, "`params.none`"),
    ],
)
def test_settings_of_a_store_that_somebody_changed(
    menid: Menid, run: Path, settings: Any, message: str
) -> None:
    import sqlite3

    connection = sqlite3.connect(run / "experiences.sqlite")
    text = json.dumps(settings)
    connection.execute("UPDATE meta SET value = ? WHERE key = 'settings'", (text,))
    connection.commit()
    connection.close()
    result = menid("estimate", "levers.menid", str(run))
    assert result.exit_code == 3
    assert "is damaged: in its settings " in result.stderr
    assert message in result.stderr


def test_the_same_is_told_of_a_damaged_store(menid: Menid, run: Path) -> None:
    import sqlite3

    connection = sqlite3.connect(run / "experiences.sqlite")
    connection.execute("UPDATE experiences SET reward = 'abc' WHERE id = 2")
    connection.commit()
    connection.close()
    for arguments in (("experiences", str(run)), ("estimate", "levers.menid", str(run))):
        result = menid(*arguments)
        assert result.exit_code == 3
        assert result.stderr == (
            f"menid: the store `{run / 'experiences.sqlite'}` is damaged: "
            "experience 2: its reward is no finite number\n"
        )


def test_nothing_was_seen(menid: Menid) -> None:
    Path("levers.menid").write_text(LEVERS.partition("problem")[0], encoding="utf-8")
    result = menid("estimate", "levers.menid")
    assert result.exit_code == 0
    assert result.output == "never seen: pull.dry, finish.ready\n"
