"""`menid study estimators`: errors of all estimators, and what is earned by them."""

from __future__ import annotations

import csv
import json
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result

import menid_plan
from conftest import ROOT
from menid_plan.experience.store import Store
from menid_plan.learning.estimators import ESTIMATORS, estimator
from menid_plan.studies import pieces, random_rules, runs
from menid_plan.studies.estimator_tables import tables
from menid_plan.studies.estimators import (
    BASE,
    CANDIDATES,
    DRIVE,
    PAIRS,
    RANDOM,
    EstimatorStudy,
    Found,
    bank_frequencies,
    relative,
)
from menid_plan.studies.random_rules import (
    CASES,
    TARGET_ONLY,
    ErrorTask,
    RewardTask,
    drawn_errors,
    moved,
    root_mean_squares,
    squared_errors,
)

Menid = Callable[..., Result]
Made = tuple[EstimatorStudy, Path, Found]

DRIVE_FILES = ROOT / "domains" / "hdd"


BANK = DRIVE_FILES / "bank.sqlite"


def study(bank: Path = BANK, **more: Any) -> EstimatorStudy:
    domain = menid_plan.read(DRIVE_FILES / "domain.menid").domain
    problem = menid_plan.read(DRIVE_FILES / "drive.menid").problem
    assert domain is not None
    assert problem is not None
    settings = {"hours": 0.02, "runs": 2, "random_runs": 3, "repetitions": 5, **more}
    return EstimatorStudy(domain, problem, bank, **settings)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bank with three executions of each action in each state and environment, quickly read."""
    path = tmp_path_factory.mktemp("bank") / "bank.sqlite"
    taken: Counter[tuple[object, ...]] = Counter()
    kept = []
    with Store.read(BANK) as whole:
        for each in whole:
            place = each.environment, each.state, each.action
            taken[place] += 1
            if taken[place] <= 3:
                kept.append(each)
    made = study()
    with Store.create(path, made.domain, made.problem) as store:
        store.add(kept)
    return path


SHORT = (
    "--hours",
    "0.02",
    "--runs",
    "2",
    "--random-runs",
    "3",
    "--repetitions",
    "5",
    "--jobs",
    "1",
)


@pytest.fixture(scope="module")
def short(small: Path, tmp_path_factory: pytest.TempPathFactory) -> Made:
    file = tmp_path_factory.mktemp("estimators") / "estimators-runs.jsonl"
    made = study(small)
    return made, file, made.execute(file, 1)


# --------------------------------------------------------------------------------------- random rules


# The errors that are known of three outcomes, truths from Dir(2), m = 10 and u = .5, by 4000 truths: of
# the target only, decreasing-m, robust, power prior and precision grid. They are means over draws with
# a standard error of .001 to .002, as are those of 2000 truths, and it is not known in which direction
# the test was off: a difference of .008 is four or more of them.
KNOWN = {
    (300, 0.0, 10): (0.197, 0.043, 0.109, 0.053, 0.098),
    (300, 0.1, 50): (0.104, 0.120, 0.104, 0.096, 0.095),
    (300, 0.3, 20): (0.153, 0.368, 0.192, 0.239, 0.208),
    (300, 0.3, 200): (0.053, 0.197, 0.053, 0.057, 0.055),
    (3000, 0.3, 500): (0.033, 0.275, 0.033, 0.033, 0.034),
}


@pytest.mark.parametrize(("n2", "gap", "n1"), KNOWN)
def test_known_errors(n2: int, gap: float, n1: int) -> None:
    found = ErrorTask(3, n2, (gap,), (n1,), 2000, 1).run()["errors"]
    names = (TARGET_ONLY, BASE, "robust", "power-prior", "precision-grid")
    assert [found[name][0] for name in names] == pytest.approx(KNOWN[n2, gap, n1], abs=0.008)


def test_errors_by_hand() -> None:
    """Two of the target's four ended well, all of the test's ten; the truth is .5."""
    squares = dict(
        zip(
            (TARGET_ONLY, *CANDIDATES),
            squared_errors(np.array([[2.0, 2.0], [10.0, 0.0]]), np.array([0.5, 0.5])).tolist(),
            strict=True,
        )
    )
    assert squares[TARGET_ONLY] == squares["empirical"] == 0.0
    assert squares["pooled"] == pytest.approx(2 * (12 / 14 - 0.5) ** 2)
    weight = 10 / math.sqrt(5)
    assert squares[BASE] == pytest.approx(2 * ((2 + 10 * weight) / (4 + 10 * weight) - 0.5) ** 2)
    # The weight of the component with the test's counts, by the definition of the robust prior:
    # B(13, 3) / B(11, 1) against B(3, 3) / B(1, 1).
    with_test, without = 0.98 * (1 / 1365) / (1 / 11), 0.02 * (1 / 30)
    share = with_test / (with_test + without)
    mean = share * 13 / 16 + (1 - share) * 0.5
    assert squares["robust, u .98"] == pytest.approx(2 * (mean - 0.5) ** 2)


def test_root_mean_squares_and_their_intervals() -> None:
    columns = 1 + len(CANDIDATES)
    found = root_mean_squares(np.array([[[4.0] * columns], [[16.0] * columns]]))
    assert set(found["errors"]) == {TARGET_ONLY, *CANDIDATES}
    assert found["errors"]["robust"] == [pytest.approx(math.sqrt(10.0))]
    # The mean of the squares has the standard error 6 / sqrt(2); its root, by the chain rule, half of
    # that over the root.
    wanted = 1.96 * 6.0 / math.sqrt(2.0) / (2.0 * math.sqrt(10.0))
    assert found["halves"]["robust"] == [pytest.approx(wanted)]
    nothing = root_mean_squares(np.zeros((3, 1, columns)))
    assert nothing["errors"]["robust"] == nothing["halves"]["robust"] == [0.0]


@pytest.mark.parametrize("outcomes", [2, 3, 5])
@pytest.mark.parametrize("gap", [0.0, 0.1, 0.3])
def test_tests_are_off_by_the_gap(outcomes: int, gap: float) -> None:
    rng = np.random.default_rng(0)
    truths = rng.dirichlet([2.0] * outcomes, 300)
    found = moved(truths, gap, rng)
    assert found.sum(axis=1) == pytest.approx(np.ones(300))
    assert (found >= 0.0).all()
    assert 0.5 * np.abs(found - truths).sum(axis=1) == pytest.approx(np.full(300, gap), abs=1e-12)
    if gap:
        towards = (found - truths).argmax(axis=1)
        assert set(towards.tolist()) == set(range(outcomes))


def test_no_room_for_a_gap() -> None:
    with pytest.raises(ValueError, match=r"for a gap of 0\.6"):
        moved(np.array([[0.5, 0.5]]), 0.6, np.random.default_rng(0))


def test_a_right_test_helps_and_a_wrong_one_is_found_out() -> None:
    right = ErrorTask(3, 300, (0.0,), (10,), 500, 0).run()["errors"]
    wrong = ErrorTask(3, 300, (0.3,), (500,), 500, 0).run()["errors"]
    for name in set(CANDIDATES) - {"empirical"}:
        assert right[name][0] < 0.8 * right[TARGET_ONLY][0]
    for name in ("robust", "sam", "power-prior", "precision-grid", "subsets"):
        assert wrong[name][0] < 1.2 * wrong[TARGET_ONLY][0]
    assert wrong[BASE][0] > 2.0 * wrong[TARGET_ONLY][0]


def test_known_distributions() -> None:
    certain = np.array([1.0, 0.0])
    (found,) = drawn_errors([(certain, np.array([0.0, 1.0]))], 100, (0, 4), 3, 0)
    errors = dict(zip((TARGET_ONLY, *CANDIDATES), found.transpose(2, 0, 1), strict=True))
    # Nothing is random here: four successes in the target, a hundred failures in the test.
    assert errors["empirical"].tolist() == [[0.5, 0.0]] * 3
    assert errors["pooled"] == pytest.approx(np.array([[2.0, 2 * (100 / 104) ** 2]] * 3))


# ------------------------------------------------------------------------------------- random actions


def test_all_meet_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two that do the same, all is the same; and the one without tests heeds no lie."""
    monkeypatch.setattr(
        random_rules,
        "_makers",
        lambda: {"empirical": estimator("empirical"), **dict.fromkeys("ab", estimator("pooled"))},
    )
    found = {case: RewardTask(case, 3, 0).run() for case in CASES}
    for case in CASES:
        assert found[case]["a"] == found[case]["b"]
        assert found[case]["empirical"] == found["right"]["empirical"]
        early, late = found[case]["empirical"].values()
        assert early[1] + late[1] == 120  # executions of 30 s, without a test, in an hour
        assert early[0] + late[0] == 20
        assert sum(each[1] for each in found[case]["a"].values()) < 120
    assert found["right"]["a"] != found["permuted"]["a"]


def test_right_tests_pay_and_lies_cost(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sums over 12 hours, of which each gains or loses far more than 12 runs differ by chance."""
    makers = {name: estimator(name) for name in ("empirical", BASE)}
    monkeypatch.setattr(random_rules, "_makers", lambda: makers)
    total = {
        case: {
            name: sum(
                row[name]["successes"][1] - 5 * row[name]["failures"][1]
                for row in (RewardTask(case, number, 1).run() for number in range(12))
            )
            for name in makers
        }
        for case in ("right", "permuted")
    }
    assert total["right"][BASE] > total["right"]["empirical"] + 300
    assert total["permuted"][BASE] < total["permuted"]["empirical"] - 300


# -------------------------------------------------------------------------------------- the hard drive


def test_the_bank_is_the_truth() -> None:
    for pair in PAIRS:
        found = bank_frequencies(BANK, pair)
        assert len(found) == 2 * 57
        for columns in found.values():
            assert [column.sum() for column in columns] == pytest.approx([1.0, 1.0])
    lever = next(key for key in found if (key.action, key.values) == ("lever", ("n8",)))
    assert found[lever][0][0] == pytest.approx(1.0)  # the best place on the robot


def test_penalties_are_reckoned_as_they_are_learned_with(small: Path, tmp_path: Path) -> None:
    """Thompson sampling does the same whatever a failure costs, so that one run tells of all."""
    made = study(small, hours=0.1)
    wanted = next(
        each for each in made._wanted() if each.name == "drive-robot-coarse-0.1-power-prior-0"
    )
    grid = 60.0 * np.array(made.minutes)
    of = {}
    for penalty in (0.0, 5.0, 10.0):
        params = {"win": 1.0, "fail": penalty}
        run = runs.run(replace(wanted, params=params), grid, tmp_path / f"{penalty:g}")
        of[penalty] = np.array(run.reward)
        assert run.steps >= run.executed[-1] > 0
        assert of[penalty][-1] == pytest.approx(
            run.successes - penalty * (run.steps - run.successes), abs=max(1.0, penalty)
        )
    assert of[0.0] - of[5.0] == pytest.approx((of[0.0] - of[10.0]) / 2.0)


def test_rewards_are_compared_run_by_run(short: Made) -> None:
    made, file, found = short
    rows = {row["name"]: row for row in map(json.loads, file.read_text().splitlines())}
    lies = [rows[f"reward: permuted, {number}"] for number in range(3)]
    (shown,) = (
        each
        for each in found.rewards
        if (each.actions, each.tests, each.penalty, each.minutes) == (RANDOM, "permuted", 5.0, 60)
    )
    earned = {
        name: np.array([r[name]["successes"][1] - 5 * r[name]["failures"][1] for r in lies])
        for name in CANDIDATES
    }
    assert shown.rewards["sam"].mean == pytest.approx(earned["sam"].mean())
    differences = earned["sam"] - earned[BASE]
    assert shown.more["sam"].mean == pytest.approx(differences.mean())
    # Student's t for two degrees of freedom: 4.302653.
    assert shown.more["sam"].half == pytest.approx(
        4.302653 * differences.std(ddof=1) / math.sqrt(3.0), rel=1e-6
    )
    assert BASE not in shown.more
    drive = [each for each in found.rewards if each.actions == DRIVE]
    assert {each.tests for each in drive} == {
        "fine by coarse", "robot by coarse", "robot by coarse and fine",
    }  # fmt: skip
    runs_of = [rows[f"drive-fine-coarse-0.02-robust-u-98-{number}"] for number in range(2)]
    (planned,) = (e for e in drive if (e.tests, e.penalty) == ("fine by coarse", 5.0))
    assert planned.rewards["robust, u .98"].mean == pytest.approx(
        np.mean([run["reward"][-1] for run in runs_of])
    )
    assert made.minutes == (1.2,)


def test_runs_of_one_number_share_a_seed() -> None:
    wanted = list(study(runs=2)._wanted())
    assert len({each.name for each in wanted}) == len(wanted) == 3 * len(CANDIDATES) * 2
    assert len({each.settings.seed for each in wanted}) == 2
    assert {each.settings.estimator for each in wanted} == set(ESTIMATORS)
    for each in wanted:
        assert (each.settings.test_time == 0.0) == (each.settings.estimator == "empirical")


# --------------------------------------------------------------------------------------- the whole


def test_what_is_there_is_not_done_again(
    short: Made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, file, found = short
    lines = file.read_bytes().splitlines(keepends=True)
    # A kill has cut one line; a run, an error and a reward are missing.
    kinds = ("drive-", "error:", "reward:")
    missing = [next(i for i, x in enumerate(lines) if f'"name": "{k}'.encode() in x) for k in kinds]
    rest = [line for i, line in enumerate(lines) if i not in missing]
    copy = tmp_path / "runs.jsonl"
    copy.write_bytes(b"".join(rest) + lines[missing[0]][:30])
    done = []
    real = pieces._results

    def counted(work: Any, jobs: int) -> Any:
        for name, row in real(work, jobs):
            done.append(name)
            yield name, row

    monkeypatch.setattr(pieces, "_results", counted)
    again = made.execute(copy, 1)
    assert sorted(name.split()[0].split("-")[0] for name in done) == ["drive", "error:", "reward:"]
    assert sorted(copy.read_bytes().splitlines()) == sorted(file.read_bytes().splitlines())
    assert made.as_json(again) == made.as_json(found)
    assert list(tables(again)) == list(tables(found))
    replace(made, random_runs=4).execute(copy, 1)
    assert len(done) == 3 + len(CASES)


def test_in_several_processes(short: Made, tmp_path: Path) -> None:
    made, file, _ = short
    other = tmp_path / "runs.jsonl"
    made.execute(other, 2)
    assert sorted(other.read_bytes().splitlines()) == sorted(file.read_bytes().splitlines())


def test_a_file_of_another_seed_is_refused(short: Made, tmp_path: Path) -> None:
    made, file, _ = short
    copy = tmp_path / "runs.jsonl"
    copy.write_bytes(file.read_bytes())
    with pytest.raises(pieces.RunsError, match="has runs with other settings"):
        replace(made, seed=1).execute(copy, 1)
    assert copy.read_bytes() == file.read_bytes()


def test_relative_errors_are_geometric_means(short: Made) -> None:
    _, _, found = short
    one = next(each for each in found.errors if each.rules == RANDOM)
    half = {name: tuple(0.5 * v for v in one.errors[TARGET_ONLY]) for name in CANDIDATES}
    double = {name: tuple(4.0 * v for v in one.errors[TARGET_ONLY]) for name in CANDIDATES}
    shown = [
        replace(one, errors={**columns, TARGET_ONLY: one.errors[TARGET_ONLY]})
        for columns in (half, double)
    ]
    assert relative(shown)["sam"] == pytest.approx(math.sqrt(2.0))


def test_command(menid: Menid, tmp_path: Path, small: Path) -> None:
    pytest.importorskip("matplotlib")
    command = ("study", "estimators", *SHORT, "--bank", str(small), "-o")
    result = menid(*command, "out")
    assert result.exit_code == 0, result.output
    assert max(map(len, result.stdout.splitlines())) <= 80
    files = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    images = {name for name in files if name.endswith(".png")}
    assert images == {"errors.png", "rewards-random.png", "rewards-drive.png"}
    assert all(files[name].startswith(b"\x89PNG") for name in images)
    known = json.loads(files["estimators.json"])
    assert known["settings"]["repetitions"] == 5
    errors = {
        (each["rules"], each["outcomes"], each["tests"], each["gap"], each["N2"], n1, name): value
        for each in known["errors"]
        for name, values in each["error"].items()
        for n1, value in zip(each["N1"], values, strict=True)
    }
    rows = list(csv.DictReader(files["errors.csv"].decode().splitlines()))
    assert len(rows) == len(errors)
    for row in rows:
        place = *(row[key] for key in ("rules", "outcomes", "tests", "gap")), int(row["N2"])
        value = errors[(*place, int(row["N1"]), row["estimator"])]
        assert float(row["error"]) == pytest.approx(value, rel=1e-5, abs=1e-6)
    rows = list(csv.DictReader(files["rewards.csv"].decode().splitlines()))
    rewards = {
        (each["actions"], each["tests"], f"{each['penalty']:g}", f"{each['minutes']:g}"): each
        for each in known["rewards"]
    }
    assert len(rows) == len(rewards) * len(CANDIDATES)
    for row in rows:
        each = rewards[tuple(row[key] for key in ("actions", "tests", "penalty", "minutes"))]
        mean = each["reward"][row["estimator"]]["mean"]
        assert float(row["reward"]) == pytest.approx(mean, rel=1e-5, abs=1e-6)
        more = each[f"more than {BASE}"].get(row["estimator"])
        assert (row["more"] == "") == (more is None) == (row["estimator"] == BASE)
        if more is not None:
            assert float(row["more"]) == pytest.approx(more["mean"], rel=1e-5, abs=1e-6)
    again = menid(*command, "again", "--json")
    assert json.loads(again.stdout) == known
    for path in (tmp_path / "again").iterdir():
        assert path.read_bytes() == files[path.name]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--penalties", "x"), "--penalties: `x` is no list of numbers"),
        (("--penalties", "nan"), "they must be finite, and not below 0"),
        (("--repetitions", "0"), "--repetitions"),
        (("--random-runs", "0"), "--random-runs"),
        (("--hours", "0"), "--hours"),
        (("--bank", "nothing.sqlite"), "nothing.sqlite"),
    ],
)
def test_wrong_usage(menid: Menid, options: tuple[str, ...], message: str) -> None:
    result = menid("study", "estimators", "-o", "out", *options)
    assert result.exit_code == 2, result.output
    assert message in result.stderr
    assert not Path("out").exists()
