"""The loop against hand-written traces: marks, tests, executions, and what goes wrong."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import menid_plan
from conftest import ROOT
from environments_faulty import Faulty
from learning_runs import (
    BROKEN,
    ONE_LEVER,
    READY,
    Journey,
    Scripted,
    Untouchable,
    bound,
    run_of,
    stored,
    told,
)
from menid_plan.environments.interface import EnvironmentFailedError
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.runfile import Bound
from menid_plan.environments.simulated import Simulated
from menid_plan.experience.record import DistributionKey
from menid_plan.learning.loop import StuckError
from menid_plan.learning.run import Run
from menid_plan.model.formulas import GroundAtom

NOT_HERE = frozenset({READY, BROKEN})


class Stage:
    """A target and tests that write into one diary."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.marks: list[str] = []

    def kind(self, *script: str, **options: Any) -> Scripted:
        return Scripted(str(self.folder / "diary"), script, **options)

    def run(self, target: Any, tests: dict[str, Any], **options: Any) -> Run:
        spec = options.pop("spec", {})
        run = run_of(self.folder / "run", bound(target, tests, **spec), watch=self.note, **options)
        self.loop = run.loop
        run.learn()
        return run

    def note(self, _: object) -> None:
        self.marks.append(" ".join(sorted(map(str, self.loop.marked))))

    @property
    def diary(self) -> list[str]:
        return (self.folder / "diary").read_text(encoding="utf-8").splitlines()

    @property
    def events(self) -> list[dict[str, Any]]:
        text = (self.folder / "run" / "events.jsonl").read_text(encoding="utf-8")
        return [json.loads(line) for line in text.splitlines()]


@pytest.fixture
def stage(tmp_path: Path) -> Stage:
    return Stage(tmp_path)


def test_the_trace_of_algorithm_1(stage: Stage) -> None:
    # T = 10 and 4 s a test: 3 tests at a time, the last of which begins with 2 s left. The exact
    # deltas at .05: [0 0 0] .54, [2 1 0] .51, [5 1 0] .44; [3 0 0] .66, [6 0 0] .47.
    model = stage.kind(
        "moves", "moves", "sticks", *3 * ["works"], *3 * ["moves"], "works", duration=4.0
    )
    bench = stage.kind("moves", "works", "moves", "works", "moves", "works", duration=30.0)
    run = stage.run(bench, {"model": model}, steps=6, test_time=10.0, delta=0.5)
    assert stage.diary == [
        "model pull(left) moves",
        "model pull(left) moves",
        "model pull(left) sticks",
        "bench pull(left) moves",  # it is marked
        "model finish works",
        "model finish works",
        "model finish works",
        "bench finish works",
        "model pull(left) moves",  # the mark is gone, and .51 > .5
        "model pull(left) moves",
        "model pull(left) moves",
        "bench pull(left) moves",
        "model finish works",
        "model finish works",
        "model finish works",
        "bench finish works",
        "bench pull(left) moves",  # .44 and .47 will do
        "bench finish works",
    ]
    assert stage.marks == [
        "pull(left)", "", "finish", "", "pull(left)", "", "finish", "", "", "",
    ]  # fmt: skip
    assert told(stored(stage.folder / "run")) == stage.diary
    rows = (stage.folder / "run" / "curve.csv").read_text(encoding="utf-8").splitlines()
    assert rows[:5] == [
        "seconds,reward,steps,episodes,tests,what",
        "12.0,0.0,0,0,3,test",
        "42.0,-1.0,1,0,3,step",
        "54.0,-1.0,1,0,6,test",
        "84.0,8.0,2,1,6,step",
    ]
    assert rows[-1] == "228.0,24.0,6,3,12,step"
    assert run.loop.progress.successes == 3


def test_another_action_may_become_the_best_by_a_test(stage: Stage) -> None:
    model = stage.kind(*3 * ["sticks"], *3 * ["moves"], "works", duration=4.0)
    stage.run(stage.kind("moves", "works"), {"model": model}, steps=2, test_time=10.0, delta=0.5)
    assert stage.diary[:7] == [
        *3 * ["model pull(left) sticks"], *3 * ["model pull(right) moves"], "bench pull(right) moves",
    ]  # fmt: skip
    assert stage.marks[:3] == ["pull(left)", "pull(left) pull(right)", "pull(left)"]


def test_without_test_time_no_test_environment_is_touched(stage: Stage) -> None:
    tests = {"model": Untouchable(), "sketch": Untouchable()}
    stage.run(stage.kind("moves", "works"), tests, steps=2, test_time=0.0)
    assert stage.diary == ["bench pull(left) moves", "bench finish works"]


@pytest.mark.parametrize(
    ("policy", "rounds"),
    [
        ("cheapest-first", "sketch bench sketch bench model bench model bench bench bench"),
        ("paper", "sketch model bench sketch model bench bench bench bench bench"),
    ],
)
def test_several_tests(stage: Stage, policy: Any, rounds: str) -> None:
    kinds = {
        "model": stage.kind("sticks", "sticks", "moves", duration=9.0),
        "sketch": stage.kind("sticks", "sticks", "moves", duration=9.0),
    }
    # What executions cost comes from here. Three tests are not enough ([1 2 0] .51), six are.
    durations = {"model": 4.0, "sketch": 3.5}
    environments = bound(stage.kind("sticks"), kinds, durations, ONE_LEVER)
    run_of(
        stage.folder / "run", environments, steps=6, test_time=10.0, delta=0.5, allocate=policy
    ).learn()
    names = [line.split()[0] for line in stage.diary]
    found = [name for i, name in enumerate(names) if name == "bench" or name != names[i - 1]]
    assert " ".join(found) == rounds


def test_lanes_share_the_time(stage: Stage) -> None:
    model = stage.kind("moves", duration=4.0)
    run = stage.run(
        stage.kind("moves"), {"model": model}, steps=1, test_time=10.0, lanes=2, delta=0.5
    )
    assert stage.diary.count("model pull(left) moves") == 6  # 4 + 4 + 4 in each of two
    assert run.loop.clock.seconds == 13.0
    assert run.loop.progress.spent == {"model": 24.0, "bench": 1.0}


def test_no_more_tests_where_test_and_target_differ_by_more(stage: Stage) -> None:
    model = stage.kind("moves", duration=4.0)
    environments = bound(stage.kind("sticks"), {"model": model}, problem=ONE_LEVER)
    run_of(
        stage.folder / "run", environments, steps=5, test_time=10.0, delta=0.01, stop="gap"
    ).learn()
    # It moves in the test and sticks in the target: they differ by 1 once it was tried there.
    assert stage.diary == [*3 * ["model pull(left) moves"], *5 * ["bench pull(left) sticks"]]


@pytest.mark.parametrize(
    ("options", "tests"),
    [
        ({}, 10),  # nothing is known of two levers: all the time is used
        ({"epsilon": 0.9}, 0),  # the one that is best more often is so in more than a tenth
        ({"problem": ONE_LEVER}, 0),  # there is nothing to choose
    ],
)
def test_no_more_tests_once_the_best_action_is_known(
    stage: Stage, options: dict[str, Any], tests: int
) -> None:
    problem = {"problem": options.pop("problem")} if "problem" in options else {}
    environments = bound(stage.kind("moves"), {"model": stage.kind("moves")}, **problem)
    run_of(
        stage.folder / "run", environments, steps=1, test_time=10.0, delta=0.01, stop="best",
        **options,
    ).learn()  # fmt: skip
    assert stage.diary == [*tests * ["model pull(left) moves"], "bench pull(left) moves"]


# ------------------------------------------------------------------------------------- failures


def test_tests_that_fail_are_counted_told_and_passed_over(stage: Stage) -> None:
    said: list[str] = []
    model = stage.kind("fail", "moves", "fail", "fail", "fail", "moves", duration=4.0)
    run = stage.run(
        stage.kind("moves", "works"), {"model": model}, steps=1, test_time=10.0, delta=0.5,
        spec={"retries": 1}, reported=said.append,
    )  # fmt: skip
    # The first attempt fails and the second does not; then one test is given up, and two are not.
    assert [line for line in stage.diary if line.startswith("model")] == [
        "model pull(left) fail", "model pull(left) moves", "model pull(left) fail",
        "model pull(left) fail", "model pull(left) fail", "model pull(left) moves",
        "model pull(left) moves",
    ]  # fmt: skip
    experiences = stored(stage.folder / "run")
    assert [e.number for e in experiences if e.environment == "model"] == [0, 2, 3]
    assert run.failed == {"model": 4}
    assert len(said) == 4
    assert said[0].endswith("attempt 1: the gripper is stuck")
    assert sum(event["event"] == "given up" for event in stage.events) == 1


def test_a_test_that_always_fails_does_not_hold_up_the_run(stage: Stage) -> None:
    run = stage.run(
        stage.kind("moves", "works"), {"model": stage.kind("fail")}, steps=2, test_time=10.0,
        spec={"retries": 0},
    )  # fmt: skip
    assert told(stored(stage.folder / "run")) == ["bench pull(left) moves", "bench finish works"]
    assert run.failed == {"model": 6}  # three in a row, for each of the two actions
    assert run.loop.clock.seconds == 2.0


def test_a_test_that_cannot_be_put_into_the_state(stage: Stage) -> None:
    said: list[str] = []
    run = stage.run(
        stage.kind("moves"), {"model": stage.kind("cannot-reset")}, steps=1, test_time=10.0,
        reported=said.append,
    )  # fmt: skip
    assert len(stored(stage.folder / "run")) == 1
    assert run.failed == {"model": 1}
    assert "the door is locked" in said[0]


@pytest.mark.parametrize("fault", ["exit", "hang", "unknown-atom", "nan", "list", "raise"])
def test_tests_that_crash_hang_or_tell_nonsense(stage: Stage, fault: str) -> None:
    spec = {"retries": 0, "timeout": 0.1}
    run = stage.run(
        stage.kind("moves", "works"), {"model": Faulty(fault, every=2)}, steps=1, test_time=2.0,
        spec=spec, workers=1,
    )  # fmt: skip
    seen = [e for e in stored(stage.folder / "run") if e.environment == "model"]
    assert all(e.seed % 2 for e in seen)
    assert run.failed["model"] >= 1


@pytest.mark.parametrize("script", ["fail", "nan", "unknown", "cannot-reset"])
def test_a_target_that_fails_ends_the_run_which_can_be_resumed(stage: Stage, script: str) -> None:
    bench = stage.kind("sticks", *3 * [script], "moves")
    with pytest.raises(EnvironmentFailedError, match="bench"):
        stage.run(bench, {}, steps=3, test_time=0.0)
    assert len(stored(stage.folder / "run")) == 1
    assert stage.events[-1]["event"] == "failed"
    if script == "cannot-reset":
        return  # one that the script repeats
    run = run_of(stage.folder / "run", bound(bench, {}), steps=3, test_time=0.0, resume=True)
    run.learn()
    assert len(stored(stage.folder / "run")) == 3


# ------------------------------------------------------------------------- what is seen and learned


def test_noise_and_what_follows_from_it(stage: Stage) -> None:
    # What no outcome describes, and a state of which the domain's model knows nothing: broken, ready.
    bench = stage.kind("odd", "moves", "works")
    run = stage.run(bench, {}, steps=3, test_time=0.0)
    assert told(stored(stage.folder / "run")) == [
        "bench pull(left) noise", "bench pull(right) moves", "bench finish works",
    ]  # fmt: skip
    assert stored(stage.folder / "run")[0].after == NOT_HERE
    # Nothing applies there, so it is a dead end.
    assert (run.loop.progress.episodes, run.loop.progress.successes) == (2, 1)
    assert "noise:  1" in (stage.folder / "run" / "learned.menid").read_text(encoding="utf-8")


HALLWAY = """\
domain hallway
predicate a
predicate lost
predicate home
action go cost 1 {
  rule known { when not lost and not home outcomes { there: home } }
  rule lost { when lost outcomes { back: not lost } }
}
problem walk for hallway
goal home reward 5
discount 0.9
"""


def test_a_state_that_the_model_does_not_contain(tmp_path: Path) -> None:
    document = menid_plan.parse(HALLWAY)
    assert document.domain is not None
    assert document.problem is not None
    lost = menid_plan.parse("problem p for hallway init lost, a", document.domain).problem
    assert lost is not None
    strange, home = frozenset(lost.init), frozenset({GroundAtom("home")})
    kind = Journey((strange, frozenset({GroundAtom("a")}), home))
    spec = EnvironmentSpec("target", kind, document.domain, document.problem, "target")
    environments = Bound(document.domain, document.problem, spec, ())
    run_of(tmp_path / "run", environments, steps=3, test_time=0.0).learn()
    seen = stored(tmp_path / "run")
    # `a` is in no state that the domain foresees: both the rule and what it leads to are known.
    assert [(e.explanation.rule, e.explanation.weights) for e in seen if e.explanation] == [
        ("known", (0.0, 1.0)), ("lost", (1.0, 0.0)), ("known", (0.0, 1.0)),
    ]  # fmt: skip


def test_an_environment_may_pay_itself(stage: Stage) -> None:
    run = stage.run(stage.kind("moves", "works", reward=2.5), {}, steps=2, test_time=0.0)
    assert run.loop.progress.reward == 5.0


# -------------------------------------------------------------------------------------- episodes


def test_episodes_end_at_goals_and_dead_ends(stage: Stage) -> None:
    bench = stage.kind("moves", "works", "moves", "breaks", "moves")
    run = stage.run(bench, {}, episodes=2, test_time=0.0)
    assert stage.diary == [
        "bench pull(left) moves", "bench finish works", "bench pull(left) moves",
        "bench finish breaks",
    ]  # fmt: skip
    assert (run.loop.progress.episodes, run.loop.progress.successes) == (2, 1)


def test_an_episode_that_ends_with_the_last_step_counts(stage: Stage) -> None:
    run = stage.run(stage.kind("moves", "works"), {}, steps=2, test_time=0.0)
    assert (run.loop.progress.episodes, run.loop.progress.successes) == (1, 1)
    lines = (run.folder / "curve.csv").read_text().splitlines()
    assert [line.split(",")[2:4] for line in lines[1:]] == [["1", "0"], ["2", "1"]]


def test_episodes_end_after_some_steps(stage: Stage) -> None:
    run = stage.run(stage.kind("sticks"), {}, steps=7, test_time=0.0, episode_steps=3)
    assert run.loop.progress.episodes == 2


def test_episodes_end_at_the_horizon(stage: Stage) -> None:
    environments = bound(stage.kind("sticks"), {})
    problem = replace(environments.problem, horizon=2)
    environments = replace(environments, problem=problem)
    for solver in ("value-iteration", "thompson"):
        run = run_of(stage.folder / solver, environments, steps=7, test_time=0.0, solver=solver)
        run.learn()
        assert run.loop.progress.episodes == 3


def test_episodes_end_where_the_goal_is_out_of_reach_and_nothing_else_counts(stage: Stage) -> None:
    document = menid_plan.read(ROOT / "domains" / "exploding-blocks" / "unstack.menid")
    assert document.domain is not None
    assert document.problem is not None
    spec = EnvironmentSpec("target", Simulated(), document.domain, document.problem, "target")
    run = run_of(
        stage.folder / "run", Bound(document.domain, document.problem, spec, ()), steps=200,
        test_time=0.0, solver="thompson",
    )  # fmt: skip
    run.learn()
    progress = run.loop.progress
    assert progress.episodes > 20
    assert 0 < progress.successes < progress.episodes


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("init done goal done", "episode is over in the very state"),
        ("init broken goal done", "episode is over in the very state"),
    ],
)
def test_a_problem_that_is_over_at_once(stage: Stage, text: str, message: str) -> None:
    environments = bound(stage.kind("moves"), {})
    problem = menid_plan.parse(f"problem p for levers {text}", environments.domain).problem
    assert problem is not None
    with pytest.raises(StuckError, match=message):
        run_of(stage.folder / "run", replace(environments, problem=problem)).learn()


def test_tests_that_take_no_time_end_once_the_distribution_is_known(stage: Stage) -> None:
    kinds = {"model": Simulated(duration=0.0)}
    run = run_of(stage.folder / "run", bound(Simulated(), kinds), steps=3, delta=0.1)
    run.learn()
    executed = run.loop.progress.executions["model"]
    assert 100 < executed < 1000
    tested = [key for key in run.evidence.keys if run.evidence.counts(key)[1].any()]
    assert tested
    assert all(not run.loop._is_unsure(run.bound.tests[0], key) for key in tested)


def test_a_clock_that_stands_still(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("menid_plan.learning.loop.MAX_IDLE", 20)
    with pytest.raises(StuckError, match="have taken no time"):
        stage.run(
            stage.kind("moves", "works", "sticks", duration=0.0), {}, hours=1.0, test_time=0.0
        )


# -------------------------------------------------------------- targets that go on from where they are


def test_a_target_that_cannot_be_repeated_is_reset_at_the_beginning_only(stage: Stage) -> None:
    bench = stage.kind("moves", "works", "sticks", anywhere=False, repeatable=False)
    stage.run(bench, {}, steps=3, test_time=0.0)
    assert stage.diary == [
        "bench reset", "bench pull(left) moves", "bench finish works",
        "bench reset", "bench pull(left) sticks",
    ]  # fmt: skip


def test_such_a_target_may_be_elsewhere_when_the_run_is_resumed(stage: Stage) -> None:
    bench = stage.kind("moves", "sticks", "moves", "works", anywhere=False, repeatable=False)
    stage.run(bench, {}, steps=1, test_time=0.0)
    said: list[str] = []
    for steps in (3, 4):
        run = run_of(
            stage.folder / "run", bound(bench, {}), steps=steps, test_time=0.0, resume=True,
            reported=said.append,
        )  # fmt: skip
        run.learn()
    # It is found empty where it was left ready: that episode is over, and for good.
    assert stage.diary == [
        "bench reset", "bench pull(left) moves",
        "bench reset", "bench pull(left) sticks", "bench pull(left) moves",
        "bench reset", "bench pull(left) works",
    ]  # fmt: skip
    assert [event["step"] for event in stage.events if event["event"] == "broken off"] == [1, 3]
    assert "a new episode begins" in said[0]
    assert len(stored(stage.folder / "run")) == 4


def test_an_update_costs_the_same_however_much_is_known(stage: Stage) -> None:
    """What is counted: estimates that are made anew, and reads of the store."""
    run = run_of(stage.folder / "run", bound(stage.kind("moves"), {}), steps=1)
    run.close()
    evidence = run.evidence
    posterior = evidence.estimator.posterior
    asked: list[int] = []

    class Counted:
        def posterior(self, counts: Any, prior: Any = None) -> Any:
            asked.append(1)
            return posterior(counts, prior)

    evidence.estimator = Counted()  # type: ignore[assignment]
    keys = [DistributionKey("pull", "dry", (lever,)) for lever in ("left", "right")]
    for known in (1, 1000, 100_000):
        evidence.add("bench", keys[0], (float(known), 0.0, 0.0))
        for key in keys:
            evidence.belief(key)
        asked.clear()
        evidence.add("bench", keys[0], (1.0, 0.0, 0.0))
        for key in keys:
            evidence.belief(key)
        assert len(asked) == 1
