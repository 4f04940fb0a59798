"""Episodes under policies: rewards by hand, means against solved values, what `menid simulate` says."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result

import menid_plan
from conftest import ROOT
from menid_plan.cli.tasks import Display
from menid_plan.errors import MeaningError
from menid_plan.planning import Task
from menid_plan.policy import file_chooser
from menid_plan.policy_file import policy_text, read_policy
from menid_plan.simulation import MAX_STEPS, Estimate, chooser, online, stationary

Menid = Callable[..., Result]

# Every part of a reward is a power of two, so that a sum tells its parts.
WALK = """
domain walk
environment real: target
environment ideal: test
predicate here(place)
predicate broken
type place
constant a, b, c: place
reward 1 when here(a)
reward 1 / 2 when broken
action go cost 2 {
  rule start {
    when here(a)
    outcomes real ideal {
      on:    P  1  not here(a), here(b)  reward 4
      fall:  Q  0  broken, not here(a)   reward 8
      noise: R  0
    }
  }
  rule end { when here(b) outcomes { on: 1 here(c), not here(b) } }
}
problem short for walk
init here(a)
goal here(c) reward 16
dead-end reward 32
"""


def walk(p: float, q: float, more: str = "") -> str:
    text = WALK.replace(" P ", f" {p} ").replace(" Q ", f" {q} ")
    return text.replace(" R ", f" {1 - p - q:g} ") + more


def task_of(text: str, **options: Any) -> Task:
    document = menid_plan.parse(text)
    assert document.domain is not None
    assert document.problem is not None
    task = Task(document.domain, document.problem, **options)
    task.build()
    return task


def written(menid: Menid, tmp_path: Path, text: str, *arguments: str) -> dict[str, Any]:
    (tmp_path / "a.menid").write_text(text)
    result = menid("simulate", "a.menid", "--policy", "value-iteration", "--json", *arguments)
    assert result.exit_code == 0, result.output
    found: dict[str, Any] = json.loads(result.output)
    return found


@pytest.mark.parametrize(
    ("text", "options", "rewards", "ends"),
    [
        # in a 1 + on 4 - cost 2; then - cost 2 + goal 16
        (walk(1, 0), [], [3, 14], ["", "goal"]),
        # in a 1 + fall 8 - cost 2 + dead end 32
        (walk(0, 1), [], [39], ["dead end"]),
        # noise pays nothing of its own: in a 1 - cost 2, until the horizon
        (walk(0, 0, "horizon 3"), [], [-1, -1, -1], ["", "", ""]),
        # the sink is a dead end
        (walk(0, 0), ["--noise", "sink"], [31], ["sink"]),
        # the horizon ends it before the goal
        (walk(1, 0, "horizon 1"), [], [3], [""]),
        (walk(0, 1), ["--env", "ideal"], [3, 14], ["", "goal"]),
        (walk(1, 0, "init here(c)"), [], [], []),  # starts in the goal: pays nothing
        (walk(1, 0, "horizon 0"), [], [], []),
    ],
)
def test_every_part_of_the_reward(
    text: str, options: list[str], rewards: list[int], ends: list[str], menid: Menid, tmp_path: Path
) -> None:
    found = written(menid, tmp_path, text, "--episodes", "2", "--trace", *options)
    for trace in found["traces"]:
        assert [step["reward"] for step in trace] == rewards
        assert [step["ends"] for step in trace] == ends
    assert found["mean"] == sum(rewards)
    assert found["standard_error"] == 0
    assert found["value"] == pytest.approx(sum(rewards), abs=1e-6)
    assert found["steps"] == len(rewards)
    assert found["goal_rate"] == float("goal" in ends or "init here(c)" in text)
    assert found["cut"] == 0


def test_discounts(menid: Menid, tmp_path: Path) -> None:
    found = written(menid, tmp_path, walk(1, 0, "discount 0.5"), "--episodes", "1")
    assert found["mean"] == 3 + 14 / 2
    assert found["standard_error"] is None
    assert written(menid, tmp_path, walk(1, 0, "discount 0"))["mean"] == 3


def test_a_trace_says_what_happened(menid: Menid, tmp_path: Path) -> None:
    (tmp_path / "a.menid").write_text(walk(1, 0))
    arguments = ("simulate", "a.menid", "--policy", "value-iteration", "--episodes", "1", "--trace")
    result = menid(*arguments)
    assert result.output.startswith(
        "episode 1: here(a)\n"
        "   1  go, by rule start\n"
        "      on, reward 3: - here(a), + here(b)\n"
        "   2  go, by rule end\n"
        "      on, reward 14: - here(b), + here(c)\n"
        "      in the goal after 2 steps, return 17\n"
        "\n"
    )
    assert json.loads(menid(*arguments, "--json").output)["traces"] == [
        [
            {"action": "go", "rule": "start", "binding": {}, "outcome": "on", "reward": 3.0,
             "added": ["here(b)"], "deleted": ["here(a)"], "ends": ""},
            {"action": "go", "rule": "end", "binding": {}, "outcome": "on", "reward": 14.0,
             "added": ["here(c)"], "deleted": ["here(b)"], "ends": "goal"},
        ]
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "options", "line"),
    [
        (walk(0, 1), [], "in a dead end after 1 step, return 39"),
        (walk(0, 0, "horizon 3"), [], "at the horizon after 3 steps, return -3"),
        (walk(0, 0), ["--noise", "sink"], "      noise, reward 31: falls into the sink"),
        (walk(0, 0), ["--noise", "sink"], "in the sink after 1 step, return 31"),
        (walk(0.0001, 0), ["--max-steps", "2"], "      noise, reward -1: nothing changes"),
        (walk(0.0001, 0), ["--max-steps", "2"], "cut off after 2 steps, return -2"),
        (walk(1, 0, "init here(c)"), [], "in the goal after 0 steps, return 0"),
    ],
)
def test_how_an_episode_ends(
    text: str, options: list[str], line: str, menid: Menid, tmp_path: Path
) -> None:
    (tmp_path / "a.menid").write_text(text)
    result = menid(
        "simulate", "a.menid", "--policy", "value-iteration", "--episodes", "1", "--trace", *options
    )
    assert result.exit_code == 0, result.output
    assert line in result.output


def test_lines_of_traces_are_short(menid: Menid) -> None:
    lake = str(ROOT / "domains/slippery-grid/lake.menid")
    result = menid("simulate", lake, "--policy", "value-iteration", "--episodes", "3", "--trace")
    assert result.exit_code == 0
    assert max(map(len, result.output.splitlines())) <= 80
    assert "move(south), by rule on-firm-ground (d = south, c = c11, t = c21)" in result.output


def test_rewards_once_the_goal_is_out_of_reach_are_told_apart(menid: Menid, tmp_path: Path) -> None:
    # Half of the episodes fall into a pit where every step costs 1 for ever: the value is that of
    # the steps before, 0.5 * 1 + 0.5 * (1 - 4) = -1.
    text = (
        "domain d predicate p predicate pit reward -1 when pit action a {"
        " rule r { when not pit outcomes { o: 0.5 p reward 1 f: 0.5 pit reward -3 } }"
        " rule s { when pit outcomes { o: 1 nothing } } }"
        " problem t for d goal p"
    )
    found = written(menid, tmp_path, text, "--episodes", "4000", "--max-steps", "100")
    assert found["objective"] == "goal-then-reward"
    assert found["value"] == pytest.approx(-1)
    assert abs(found["objective_mean"] + 1) < 4 * found["objective_error"]
    assert found["mean"] == pytest.approx(found["objective_mean"] - 99 * found["cut"] / 4000)
    assert found["cut"] == round(4000 * (1 - found["goal_rate"]))
    for objective, value, key in [("goal-probability", 0.5, "goal_rate"), ("reward", None, "mean")]:
        other = written(menid, tmp_path, text, "--objective", objective, "--max-steps", "50")
        assert other["objective_mean"] == other[key]
        assert value is None or other["value"] == pytest.approx(value)
    result = menid("simulate", "a.menid", "--policy", "value-iteration", "--objective", "steps")
    assert result.exit_code == 1
    assert "infeasible" in result.output


def test_the_goal_is_out_of_reach_when_too_few_steps_are_left(menid: Menid, tmp_path: Path) -> None:
    # Two steps to go, and each pays 1 and succeeds with 1/2: with a horizon of 2, who fails at first
    # cannot make it any more. 1 + 1/2 * 1 is counted.
    text = (
        "domain d predicate p predicate q reward 1 when true action a {"
        " rule r { when not p outcomes { o: 0.5 p f: 0.5 nothing } }"
        " rule s { when p outcomes { o: 0.5 q f: 0.5 nothing } } }"
        " problem t for d goal q horizon 2"
    )
    found = written(
        menid, tmp_path, text, "--episodes", "4000", "--objective", "goal-then-reward"
    )  # fmt: skip
    assert found["mean"] == 2
    assert found["value"] == pytest.approx(1.5)
    assert abs(found["objective_mean"] - 1.5) < 4 * found["objective_error"]
    assert abs(found["goal_rate"] - 0.25) < 4 * found["goal_rate_error"]


SHIPPED = [
    "assembly/peg", "assembly/pin", "blocks/tidy-up", "blocks/turn-over", "exploding-blocks/swap",
    "exploding-blocks/unstack", "greenhouse/long-bench", "greenhouse/two-pots", "hdd/bench",
    "hdd/drive", "hdd/line", "maintenance/plant", "maintenance/workshop", "rescue/corridor",
    "rescue/house", "slippery-grid/lake", "slippery-grid/pond", "stones/brook", "stones/river",
    "tireworld/triangle-1", "tireworld/triangle-2", "tireworld/triangle-3",
]  # fmt: skip
LARGE = {"blocks/tower", "exploding-blocks/tower"}  # over 60,000 states


def test_no_shipped_problem_is_forgotten() -> None:
    folders = ROOT / "domains"
    files = {str(path.relative_to(folders).with_suffix("")) for path in folders.glob("*/*.menid")}
    assert {name for name in files if not name.endswith("/domain")} == {*SHIPPED, *LARGE}


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_problems_earn_what_was_solved(name: str) -> None:
    document = menid_plan.read(ROOT / "domains" / f"{name}.menid")
    domain = document.domain
    if domain is None:
        domain = menid_plan.read((ROOT / "domains" / name).parent / "domain.menid").domain
    assert domain is not None
    assert document.problem is not None
    task = Task(domain, document.problem)
    task.build()
    solution = task.solve(task.solver("value-iteration"))
    policy = task.policy(solution)
    again = read_policy(policy_text(policy), domain, document.problem, "p.json")
    assert again == policy
    simulator = task.simulator()
    hopeless = solution.objective == "goal-then-reward"
    drawn = [
        simulator.run(choose, 2500, np.random.default_rng(5), max_steps=400, hopeless=hopeless)
        for choose in (chooser(solution), file_chooser(again, simulator, "p.json"))
    ]
    assert np.array_equal(drawn[0].returns, drawn[1].returns)
    assert np.array_equal(drawn[0].steps, drawn[1].steps)
    estimate = drawn[0].of_objective(solution.objective)
    assert abs(estimate.mean - solution.value) <= 4 * estimate.error + 1e-6
    if solution.goal_probability is not None and not drawn[0].cut.any():
        rate = Estimate.of(drawn[0].goal)
        assert abs(rate.mean - solution.goal_probability[0]) <= 4 * rate.error + 1e-6
    if not drawn[0].cut.any():
        assert drawn[0].lacking == 0


def test_the_same_seed_gives_the_same_episodes(menid: Menid) -> None:
    pond = str(ROOT / "domains/slippery-grid/pond.menid")
    assert menid("solve", pond, "-o", "p.json").exit_code == 0

    def simulated(*arguments: str) -> dict[str, Any]:
        result = menid("simulate", pond, "--json", "--trace", "--episodes", "50", *arguments)
        assert result.exit_code == 0, result.output
        found: dict[str, Any] = json.loads(result.output)
        return found

    by_solver = simulated("--policy", "value-iteration")
    assert by_solver["policy_value"] is None
    assert by_solver == simulated("--policy", "value-iteration", "--seed", "0")
    by_file = simulated("--policy", "p.json")
    assert by_file["value"] is None
    assert by_file["policy_value"] == by_solver["value"]
    assert by_file["policy_lower"] <= by_file["policy_value"] <= by_file["policy_upper"]
    values = [key for key in by_file if key == "value" or key.startswith("policy_")]
    for found in (by_solver, by_file):
        assert found["policy_status"] == "solved"
        assert found["differs"] == {}
        for key in values:
            del found[key]
    assert by_file == by_solver
    other = simulated("--policy", "p.json", "--seed", "1")
    assert other["traces"] != by_file["traces"]
    assert other["seed"] == 1
    online_policy = simulated("--policy", "thompson", "--episodes", "2")
    assert online_policy["value"] is None


def test_cut_episodes(menid: Menid, tmp_path: Path) -> None:
    endless = "domain d action a { rule r { outcomes { o: 1 nothing } } } problem t for d"
    found = written(menid, tmp_path, endless, "--max-steps", "7", "--episodes", "3")
    assert (found["cut"], found["steps"], found["max_steps"]) == (3, 7, 7)
    assert found["goal_rate"] is None
    assert "cut          3 after 7 steps\n" in (
        menid("simulate", "a.menid", "--policy", "value-iteration", "--max-steps", "7",
              "--episodes", "3").output.replace("; what is left out of each is at most 0", "")
    )  # fmt: skip
    paying = endless.replace("o: 1", "o: 1 nothing reward 2", 1).replace("2 nothing", "2")
    # 0.9^153 / (1 - 0.9) is the first power below a millionth; 2 a step is 20 in all.
    found = written(menid, tmp_path, f"{paying} discount 0.9", "--episodes", "3")
    assert found["max_steps"] == 153
    assert found["value"] - found["mean"] == pytest.approx(20 * 0.9**153, rel=1e-3)
    text = menid("simulate", "a.menid", "--policy", "value-iteration").output
    assert "1000 after 153 steps; what is left out of each is at most 2e-06" in text
    (tmp_path / "a.menid").write_text(paying)
    result = menid("simulate", "a.menid", "--policy", "value-iteration")
    assert result.exit_code == 1
    assert "unbounded" in result.output


def test_a_policy_in_another_environment(menid: Menid, tmp_path: Path) -> None:
    (tmp_path / "a.menid").write_text(walk(0.5, 0.25, "init here(a)"))
    assert menid("solve", "a.menid", "--env", "ideal", "-o", "p.json").exit_code == 0
    own = json.loads(menid("simulate", "a.menid", "--policy", "p.json", "--json").output)
    assert (own["environment"], own["goal_rate"]) == ("ideal", 1)
    real = ("simulate", "a.menid", "--policy", "p.json", "--env", "real")
    found = menid(*real)
    assert found.exit_code == 0, found.output
    assert "policy       p.json, for reward\nenvironment  real\n" in found.output
    said = (
        "differs      the policy was made for environment ideal, here real. "
        "So the mean may rightly be another"
    )
    assert said in " ".join(found.output.split()).replace("differs ", "differs      ")
    other = json.loads(menid(*real, "--json").output)
    assert other["goal_rate"] < 1
    assert other["differs"] == {"environment": {"made": "ideal", "now": "real"}}
    assert (other["policy_value"], other["policy_status"]) == (own["policy_value"], "solved")


def test_params_and_noise_are_those_of_the_file(menid: Menid, tmp_path: Path) -> None:
    (tmp_path / "a.menid").write_text(
        "domain d param pay = 1 action a { rule r { outcomes { o: 0.5 nothing reward pay"
        " noise: 0.5 } } } problem t for d horizon 2"
    )
    made = menid("solve", "a.menid", "--set", "pay=8", "--noise", "sink", "-o", "p.json")
    assert "value             6.0" in made.output
    options = ("simulate", "a.menid", "--policy", "p.json", "--json", "--episodes", "4000")
    own = json.loads(menid(*options).output)
    assert abs(own["mean"] - 6) < 4 * own["standard_error"]
    assert (own["policy_value"], own["differs"]) == (6, {})
    assert own["policy_lower"] <= 6 <= own["policy_upper"]
    other = json.loads(menid(*options, "--set", "pay=1", "--noise", "stay").output)
    assert abs(other["mean"] - 1) < 4 * other["standard_error"]
    assert other["differs"] == {
        "noise": {"made": "sink", "now": "stay"}, "param pay": {"made": "8.0", "now": "1.0"},
    }  # fmt: skip
    # What is said again differs in nothing.
    assert json.loads(menid(*options, "--set", "pay=8").output)["differs"] == {}


def test_the_mean_is_compared_with_the_value_of_the_file(menid: Menid, tmp_path: Path) -> None:
    (tmp_path / "a.menid").write_text(walk(0.5, 0.25))
    assert menid("solve", "a.menid", "-o", "p.json").exit_code == 0
    simulate = ("simulate", "a.menid", "--policy", "p.json")
    text = " ".join(menid(*simulate).output.split())
    found = json.loads(menid(*simulate, "--json").output)
    away = abs(found["mean"] - found["policy_value"]) / found["standard_error"]
    value = f"{found['policy_value']:.6g}"
    assert (
        f"value {value} by the file, for the mean return, which is {away:.1f} standard err" in text
    )
    assert "differs" not in text
    # Another objective is another mean, but the file's value is compared by its own.
    other = json.loads(menid(*simulate, "--objective", "goal-probability", "--json").output)
    assert other["objective_mean"] == other["goal_rate"]
    assert other["differs"] == {"objective": {"made": "reward", "now": "goal-probability"}}
    text = " ".join(menid(*simulate, "--objective", "goal-probability").output.split())
    assert (
        f"value {value} by the file, for the mean return, which is {away:.1f} standard err" in text
    )
    assert "made for objective reward, here goal-probability" in text
    assert "rightly" not in text


def test_a_mean_without_spread_is_told_beside_the_value(menid: Menid, tmp_path: Path) -> None:
    (tmp_path / "a.menid").write_text(walk(1, 0))
    assert menid("solve", "a.menid", "-o", "p.json").exit_code == 0
    simulate = ("simulate", "a.menid", "--policy", "p.json", "--episodes")
    assert "for the mean return; every episode gives 17\n" in menid(*simulate, "2").output
    assert menid(*simulate, "1").output.endswith("for the mean return\n")


def test_values_of_files_that_are_infinite_or_not_known(menid: Menid, tmp_path: Path) -> None:
    text = "domain d action a { rule r { outcomes { o: 1 nothing reward R } } } problem t for d"
    file = tmp_path / "p.json"
    (tmp_path / "a.menid").write_text(text.replace("R", "-1") + " discount 0.5")
    assert menid("solve", "a.menid", "-o", "p.json").exit_code == 0
    known = json.loads(file.read_text())
    for reward, status, value in (("1", "unbounded", "inf"), ("-1", "infeasible", "-inf")):
        (tmp_path / "a.menid").write_text(text.replace("R", reward))
        bounds = {"value": value, "lower": value, "upper": value}
        file.write_text(json.dumps({**known, "status": status, **bounds}))
        simulate = ("simulate", "a.menid", "--policy", "p.json", "--max-steps", "5")
        assert f"value        {value} by the file, for the mean return\n" in menid(*simulate).output
        found = json.loads(menid(*simulate, "--json").output)
        assert (found["policy_value"], found["policy_status"]) == (None, status)
    # Where every policy loses for ever any of them may be tried.
    simulate = ("simulate", "a.menid", "--policy", "value-iteration", "--max-steps", "5")
    assert "value        -inf by the solver" in menid(*simulate).output
    unsure = {"status": "limit", "value": None, "lower": "-inf", "upper": 3}
    file.write_text(json.dumps({**known, **unsure}))
    output = menid("simulate", "a.menid", "--policy", "p.json", "--max-steps", "5").output
    assert "p.json, for reward; its solver stopped early\n" in output
    assert "not known by the file, for the mean return, but between -inf and 3\n" in output


def test_options_of_a_solver(menid: Menid, tmp_path: Path) -> None:
    (tmp_path / "a.menid").write_text(walk(0.5, 0.25))
    simulate = ("simulate", "a.menid", "--episodes", "2", "--policy")
    assert (
        menid(*simulate, "thompson", "--option", "redraw=5", "--option", "warm=false").exit_code
        == 0
    )
    result = menid(*simulate, "thompson", "--option", "draws=5")
    assert result.exit_code == 2
    assert "`thompson` has no option `draws`; its options: redraw, epsilon, warm" in result.output


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--policy", "magic"], 2, "`magic` is neither a file nor a solver; the solvers are: "),
        (["--policy", "none.json"], 2, "none.json: No such file"),
        (["--policy", "."], 2, ""),
        (["--policy", "p.json", "--option", "tie=1"], 2, "--option is for a solver"),
        (["--policy", "p.json", "--epsilon", "1"], 2, "--epsilon is for a solver"),
        (["--policy", "p.json", "--max-seconds", "1"], 2, "--max-seconds is for a solver"),
        (["--policy", "policy-iteration", "--max-seconds", "1"], 2, "has no option --max-seconds"),
        (["--policy", "thompson", "--max-seconds", "1"], 2, "`thompson` has no option --max-s"),
        (["--policy", "p.json", "--env", "moon"], 3, "there is no environment `moon`"),
        (["--policy", "value-iteration", "--episodes", "0"], 2, "--episodes"),
        (["--policy", "value-iteration", "--max-steps", "0"], 2, "--max-steps"),
        (["--policy", "value-iteration", "--seed", "-1"], 2, "--seed"),
        (["--policy", "value-iteration", "--max-states", "1"], 6, "more than 1 states"),
        ([], 2, "--policy"),
    ],
)
def test_wrong_usage(
    arguments: list[str], code: int, message: str, menid: Menid, tmp_path: Path
) -> None:
    (tmp_path / "a.menid").write_text(walk(0.5, 0.25))
    assert menid("solve", "a.menid", "-o", "p.json").exit_code == 0
    result = menid("simulate", "a.menid", *arguments)
    assert result.exit_code == code, result.output
    assert message in result.output


# ------------------------------------------------------------------------- the Python interface


def test_outcomes_come_as_often_as_written() -> None:
    task = task_of(
        "domain d action a { rule r { outcomes { a: 0.5 nothing b: 0 nothing c: 0.3 nothing"
        " e: 0.2 nothing noise: 0 } } } problem t for d horizon 1"
    )
    drawn = task.simulator().run(
        stationary(np.zeros(1, np.int32)), 40_000, np.random.default_rng(1), trace=True
    )
    assert drawn.traces is not None
    slots = task.structure.slot(drawn.traces.transition)
    rate = np.bincount(slots, minlength=5) / 40_000
    assert rate[1] == rate[4] == 0
    assert np.all(np.abs(rate - [0.5, 0, 0.3, 0.2, 0]) < 4 * np.sqrt(0.25 / 40_000))


def test_a_chance_beyond_the_sum_gives_the_last_that_can_happen() -> None:
    class Highest(np.random.Generator):
        def random(self, size: int) -> Any:  # type: ignore[override]
            return np.full(size, np.nextafter(1, 0))

    tenths = " ".join(f"o{i}: 0.1 nothing" for i in range(10))  # the sum is below 1
    task = task_of(
        f"domain d action a {{ rule r {{ outcomes {{ {tenths} z: 0 nothing noise: 0 }} }} }}"
        " problem t for d horizon 1"
    )
    drawn = task.simulator().run(
        stationary(np.zeros(1, np.int32)), 2, Highest(np.random.PCG64(1)), trace=True
    )
    assert drawn.traces is not None
    assert task.structure.slot(drawn.traces.transition).tolist() == [9, 9]


def test_online_policies_are_asked_state_by_state() -> None:
    task = task_of(walk(0.5, 0.25))
    solution = task.solve(task.solver("value-iteration"))
    asked = []

    class Policy:
        def action(self, state: int, seconds: float | None = None) -> int:
            asked.append(state)
            return int(solution.policy[state])

    simulator = task.simulator()
    drawn = [
        simulator.run(choose, 20, np.random.default_rng(3))
        for choose in (online(Policy()), chooser(solution))
    ]
    assert np.array_equal(drawn[0].returns, drawn[1].returns)
    assert len(asked) == drawn[0].steps.sum()


def test_a_policy_without_an_action_is_an_error() -> None:
    task = task_of(walk(1, 0))
    with pytest.raises(MeaningError, match=r"no action in the state here\(a\), which an episode"):
        task.simulator().run(stationary(np.full(3, -1, np.int32)), 2, np.random.default_rng(1))
    task = task_of(walk(1, 0, "horizon 5"))
    with pytest.raises(MeaningError, match=r"no action with 5 steps left in the state here\(a\)"):
        task.simulator().run(stationary(np.full(3, -1, np.int32)), 2, np.random.default_rng(1))


def test_goal_distance() -> None:
    task = task_of(walk(0.5, 0.25))
    distance = {
        menid_state: int(d)
        for menid_state, d in zip(
            (task.structure.state(n) for n in range(task.structure.states)),
            task.simulator().goal_distance(),
            strict=True,
        )
    }
    shown = {", ".join(map(str, sorted(s))): d for s, d in distance.items()}  # type: ignore[arg-type]
    assert shown.pop("broken") > MAX_STEPS
    assert shown == {"here(a)": 2, "here(b)": 1, "here(c)": 0}


def test_interrupted_episodes_are_cut(menid: Menid, monkeypatch: pytest.MonkeyPatch) -> None:
    def simulating(display: Display, steps: int, running: int) -> None:
        assert running == 20
        if steps == 7:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Display, "simulating", simulating)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    text = "domain d action a { rule r { outcomes { o: 1 nothing reward 2 } } } problem t for d "
    try:
        for more, left in (("discount 0.5", "; what is left"), ("horizon 9", "; what they")):
            Path("a.menid").write_text(text + more)
            arguments = ("simulate", "a.menid", "--policy", "value-iteration", "--episodes", "20")
            result = menid(*arguments)
            assert result.exit_code == 6
            assert result.stderr == "menid: interrupted after 7 steps of every episode\n"
            assert "steps        7 +- 0\n" in result.stdout
            assert f"cut          20 after 7 steps{left}" in result.stdout
            found = json.loads(menid(*arguments, "--json").stdout)
            assert (found["cut"], found["max_steps"]) == (20, 7)
        assert found["mean"] == 14
    finally:
        signal.signal(signal.SIGINT, before)
