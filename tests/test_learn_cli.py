"""`menid learn`: what it prints, its options, bad input, full disks, a terminal."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import Result

import menid_plan
from learning_runs import LEVERS, stored
from menid_plan.experience.store import Store

Menid = Callable[..., Result]

RUN_FILE = """\
[environment.bench]
kind = "simulated"
duration = 20
[environment.model]
kind = "simulated"
[workers]
number = 0
[learn]
test_time = 4
steps = 12
seed = 3
"""

# What is told of one rule.
LEARNED = (
    r"  (pull\.dry for \w+|finish\.ready): (\w+ [\d.]+,? )+"
    r"\(seen: bench (?P<bench>\d+), model \d+\)"
)

PROGRAM = """\
import json, sys
mode = sys.argv[1]
for line in sys.stdin:
    request = json.loads(line)
    if request["type"] == "hello":
        answer = {"type": "hello", "protocol": 1}
    elif request["type"] == "execute":
        answer = {"type": "execution", "state": [], "duration": 1}
        if mode == "rubbish":
            print("Segmentation fault (just kidding)", flush=True)
            continue
        if mode == "nan":
            print('{"type": "execution", "state": [], "reward": NaN}', flush=True)
            continue
        if mode == "unknown":
            answer["state"] = ["flying(left)"]
    elif request["type"] == "close":
        break
    else:
        answer = {"type": "state", "state": request.get("state") or []}
    print(json.dumps(answer), flush=True)
"""


@pytest.fixture
def levers(menid: Menid) -> Menid:
    """Runs `menid` beside levers.menid and run.toml."""
    Path("levers.menid").write_text(LEVERS, encoding="utf-8")
    Path("run.toml").write_text(RUN_FILE, encoding="utf-8")
    Path("program.py").write_text(PROGRAM, encoding="utf-8")
    return menid


def learn(menid: Menid, *options: str, run: str = "run.toml", out: str = "out") -> Result:
    return menid("learn", "levers.menid", "--run", run, "-o", out, *options)


def steps(folder: str = "out") -> int:
    return sum(each.environment == "bench" for each in stored(Path(folder)))


def test_what_it_prints_and_writes(levers: Menid) -> None:
    result = learn(levers)
    assert result.exit_code == 0
    assert result.stderr == ""
    lines = result.stdout.splitlines()
    assert re.fullmatch(
        r"12 steps in \d episodes?, \d of them to the goal; reward -?\d+ in 0:0\d:\d\d", lines[0]
    )
    assert lines[1] == "  bench (target): 12 executions, 0:04:00"
    assert re.fullmatch(r"  model \(test\): \d+ executions, 0:00:\d\d", lines[2])
    assert lines[3] == "learned of what was executed in bench:"
    learned = [re.fullmatch(LEARNED, line) for line in lines[4:-2]]
    seen = [int(match["bench"]) for match in learned if match]
    assert 0 < len(seen) == len(learned)
    assert sum(seen) == 12
    assert seen == sorted(seen, reverse=True)
    assert lines[-2].startswith("best first action by what was learned: pull(")
    assert lines[-1] == "wrote out/learned.menid"
    assert sorted(path.name for path in Path("out").iterdir()) == [
        "curve.csv", "events.jsonl", "experiences.sqlite", "experiences.sqlite.lock",
        "learned.menid", "settings.json",
    ]  # fmt: skip
    settings = json.loads(Path("out/settings.json").read_text(encoding="utf-8"))
    assert settings["learn"]["test_time"] == 4.0
    assert settings["environments"]["bench"]["kind"] == "simulated"
    assert menid_plan.read("out/learned.menid").domain is not None
    events = Path("out/events.jsonl").read_text(encoding="utf-8").splitlines()
    assert [json.loads(event)["event"] for event in events] == ["starts", "ended"]


def test_json(levers: Menid) -> None:
    found = json.loads(learn(levers, "--json").stdout)
    assert found["steps"] == 12
    assert found["environments"]["bench"] == {
        "role": "target", "executions": 12, "seconds": 240.0, "failed": 0,
    }  # fmt: skip
    assert found["seconds"] == 240.0 + found["environments"]["model"]["seconds"]
    assert found["objective"] == "reward"
    solved = levers("solve", "out/learned.menid", "task.menid", "--json")
    assert solved.exit_code == 2  # there is no such file
    Path("task.menid").write_text("problem task" + LEVERS.partition("problem task")[2])
    solved = json.loads(levers("solve", "out/learned.menid", "task.menid", "--json").stdout)
    assert solved["value"] == pytest.approx(found["value"], abs=1e-5)


@pytest.mark.parametrize(
    ("options", "key", "value"),
    [
        (["--test-time", "7"], "test_time", 7.0),
        (["--m", "3"], "estimator_options", {"m": 3.0}),
        (["--estimator", "robust"], "estimator", "robust"),
        (["--solver", "value-iteration"], "solver", "value-iteration"),
        (["--seed", "9"], "seed", 9),
        (["--steps", "2"], "steps", 2),
        (["--episodes", "1"], "episodes", 1),
        (["--hours", "0.02"], "hours", 0.02),
    ],
)
def test_options_come_before_the_run_file(
    levers: Menid, options: list[str], key: str, value: object
) -> None:
    assert learn(levers, *options).exit_code == 0
    settings = json.loads(Path("out/settings.json").read_text(encoding="utf-8"))["learn"]
    assert settings[key] == value
    if key in ("episodes", "hours"):
        assert settings["steps"] is None  # one limit on the line stands for all in the file


def test_the_curve_is_a_png_and_takes_no_file_of_the_run(levers: Menid) -> None:
    learn(levers, "--steps", "1")
    for name in ("out/experiences.sqlite", "curve.pdf"):
        result = learn(levers, "--steps", "2", "--resume", "--curve", name)
        assert result.exit_code == 2
        assert "the file's ending must be .png" in result.stderr
    assert steps() == 1


def test_the_curve_is_drawn(levers: Menid) -> None:
    pytest.importorskip("matplotlib", reason="the extra `draw` is not installed")
    result = learn(levers, "--curve", "curve.png")
    assert result.exit_code == 0, result.stderr
    assert result.stdout.endswith("wrote curve.png\n")
    assert Path("curve.png").read_bytes().startswith(b"\x89PNG")
    # A run of no steps has a curve, too.
    assert learn(levers, "--steps", "0", "--curve", "none.png", out="none").exit_code == 0
    assert Path("none.png").exists()


def test_a_curve_that_cannot_be_written_is_told_before_the_run(levers: Menid) -> None:
    result = learn(levers, "--curve", "nowhere/curve.png")
    assert result.exit_code == 2
    assert "there is no folder `nowhere`" in result.stderr
    assert not Path("out").exists()


def test_resume_goes_on(levers: Menid) -> None:
    assert learn(levers, "--steps", "5").exit_code == 0
    assert learn(levers, "--steps", "5").exit_code == 3
    result = learn(levers, "--resume", "--workers", "1")
    assert result.exit_code == 0
    learn(levers, out="other")
    assert stored(Path("out")) == stored(Path("other"))
    assert Path("out/curve.csv").read_bytes() == Path("other/curve.csv").read_bytes()


# ------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("tset_time = 3", "run.toml: learn.tset_time: unknown key; did you mean `test_time`?"),
        ('delta = "small"', "run.toml: learn.delta: expected a number"),
        ("epsilon = 1.5", "run.toml: learn.epsilon: expected a number between 0 and 1"),
        ("epsilon = 1e-9", "run.toml: learn.epsilon: expected at least 1e-07"),
        ("lanes = 0", "run.toml: learn.lanes: expected at least 1"),
        ('stop = "never"', 'run.toml: learn.stop: expected "delta" or "gap" or "best"'),
        (
            'estimator = "robbust"',
            "run.toml: learn.estimator: there is no estimator `robbust`; did",
        ),
        ("estimator_options = { w = 1 }", "run.toml: learn.estimator_options: the estimator `decr"),
        ("estimator_options = { m = [1, 2] }", "run.toml: learn.estimator_options: "),
        ('estimator_options = { m = "x" }', "run.toml: learn.estimator_options: "),
        ('solver = "tomson"', "run.toml: learn.solver: there is no solver `tomson`"),
        ("solver_options = { x = 1 }", "run.toml: learn.solver_options: the solver `thompson` has"),
        ("solver_options = { redraw = 0 }", "run.toml: learn.solver_options: "),
        ("hours = -1", "run.toml: learn.hours: expected at least 0"),
    ],
)
def test_wrong_settings_name_the_key(levers: Menid, line: str, message: str) -> None:
    key = line.partition(" =")[0]
    kept = [each for each in RUN_FILE.splitlines() if not each.startswith(f"{key} =")]
    Path("run.toml").write_text("\n".join([*kept, line]) + "\n", encoding="utf-8")
    result = learn(levers)
    assert result.exit_code == 3
    assert message in result.stderr
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--estimator", "x"], "learn.estimator: there is no estimator `x`"),
        (["--solver", "x"], "learn.solver: there is no solver `x`"),
        (["--estimator", "empirical", "--m", "3"], "has no option `m`"),
        (["--set", "nothing=3"], "nothing"),
    ],
)
def test_wrong_options(levers: Menid, options: list[str], message: str) -> None:
    result = learn(levers, *options)
    assert result.exit_code == 3
    assert message in result.stderr
    assert not Path("out").exists()


def test_an_objective_that_the_problem_does_not_have(levers: Menid) -> None:
    Path("levers.menid").write_text(LEVERS.replace("goal done reward 10\n", ""), encoding="utf-8")
    Path("run.toml").write_text(RUN_FILE + 'objective = "goal-probability"\n', encoding="utf-8")
    result = learn(levers)
    assert result.exit_code == 3
    assert "run.toml: learn.objective: problem `task` has no goal" in result.stderr
    assert not Path("out").exists()


def test_a_problem_that_is_over_at_once(levers: Menid) -> None:
    text = LEVERS.replace("problem task for levers", "problem task for levers\ninit done")
    Path("levers.menid").write_text(text, encoding="utf-8")
    result = learn(levers)
    assert result.exit_code == 3
    assert "an episode is over in the very state in which episodes begin" in result.stderr


def test_a_run_that_did_not_start_can_be_put_right(levers: Menid) -> None:
    right = Path("run.toml").read_text(encoding="utf-8")
    wrong = right.replace(
        '"simulated"\nduration', '"simulated"\nsettings.column = "nowhere"\nduration'
    )
    for resume in ((), ("--resume",)):
        Path("run.toml").write_text(wrong, encoding="utf-8")
        result = learn(levers, out=f"out{len(resume)}")
        assert result.exit_code == 3
        assert result.stderr.startswith(
            "menid: run.toml: environment.bench.settings.column: `nowhere`"
        )
        Path("run.toml").write_text(right, encoding="utf-8")
        assert learn(levers, *resume, out=f"out{len(resume)}").exit_code == 0
        assert steps(f"out{len(resume)}") == 12


@pytest.mark.parametrize("how", ["missing", "empty"])
def test_a_run_whose_store_is_lost(levers: Menid, how: str) -> None:
    assert learn(levers).exit_code == 0
    curve = Path("out/curve.csv").read_bytes()
    store = Path("out/experiences.sqlite")
    store.unlink()
    if how == "empty":
        store.write_bytes(b"")
    result = learn(levers, "--resume")
    assert result.exit_code == 3
    assert f"is {how}, though curve.csv tells of 12 steps" in result.stderr
    assert "learn anew in another folder" in result.stderr
    assert learn(levers).exit_code == 3  # nor is it replaced
    assert Path("out/curve.csv").read_bytes() == curve


def test_a_store_of_another_domain(levers: Menid) -> None:
    learn(levers)
    other = LEVERS.replace("0.6 0.8", "0.5 0.8").replace("0.3 0.2", "0.4 0.2")
    Path("levers.menid").write_text(other, encoding="utf-8")
    result = learn(levers, "--resume")
    assert result.exit_code == 3
    assert "a store of another domain" in result.stderr
    Path("levers.menid").write_text(LEVERS, encoding="utf-8")
    assert learn(levers, "--resume").exit_code == 0


def test_settings_that_changed(levers: Menid) -> None:
    learn(levers)
    result = learn(levers, "--resume", "--test-time", "5")
    assert result.exit_code == 3
    assert "learn.test_time = 4.0, and is to be resumed with 5.0" in result.stderr


@pytest.mark.parametrize(
    ("out", "code"), [("run.toml", 2), ("run.toml/out", 2), ("/proc/none/out", 2)]
)
def test_folders_that_cannot_be(levers: Menid, out: str, code: int) -> None:
    result = learn(levers, out=out)
    assert result.exit_code == code
    assert result.stderr


def test_a_run_that_another_process_goes_on_with(levers: Menid) -> None:
    learn(levers, "--steps", "3")
    before = Path("out/settings.json").read_bytes()
    with Store.resume("out/experiences.sqlite"):
        result = learn(levers, "--resume")
    assert result.exit_code == 5
    assert "another process writes" in result.stderr
    assert Path("out/settings.json").read_bytes() == before


@pytest.mark.parametrize(
    ("mode", "message"),
    [
        ("rubbish", "Segmentation fault (just kidding)"),
        ("nan", "`reward` is nan"),
        ("unknown", "flying"),
    ],
)
@pytest.mark.parametrize("role", ["target", "test"])
def test_programs_that_answer_nonsense(levers: Menid, mode: str, message: str, role: str) -> None:
    program = f"""\
kind = "process"
retries = 1
[environment.NAME.settings]
command = ["{{python}}", "program.py", "{mode}"]
"""
    name, other = ("bench", "model") if role == "target" else ("model", "bench")
    Path("run.toml").write_text(
        f"[environment.{name}]\n{program.replace('NAME', name)}\n"
        f'[environment.{other}]\nkind = "simulated"\n[workers]\nnumber = 1\n'
        "[learn]\nsteps = 3\ntest_time = 2\n",
        encoding="utf-8",
    )
    result = learn(levers)
    assert message in result.stderr
    if role == "target":
        assert result.exit_code == 5
        assert steps() == 0
    else:
        assert result.exit_code == 0
        assert steps() == 3
        assert re.search(
            r"model \(test\): 0 executions, 0:00:00, \d+ attempts failed", result.stdout
        )
        assert result.stderr.count("attempt") <= 10 + 1
    assert levers("experiences", "out/experiences.sqlite").exit_code == 0


@pytest.mark.skipif(os.name == "nt", reason="limits the size of files")
@pytest.mark.parametrize("room", [3_000, 50_000])
def test_a_full_disk(tmp_path: Path, levers: Menid, room: int) -> None:
    def limited(*options: str, room: int = room) -> subprocess.CompletedProcess[str]:
        program = (
            f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({room}, {room}));"
            "from menid_plan.cli.main import main; main()"
        )
        return subprocess.run(
            [sys.executable, "-c", program, "learn", "levers.menid", "--run", "run.toml", "-o",
             "out", *options],
            capture_output=True, check=False, text=True, timeout=60,
        )  # fmt: skip

    first = limited("--steps", "150")
    assert first.returncode == 5, first.stderr
    assert "cannot" in first.stderr
    assert "Traceback" not in first.stderr
    resume = ["--resume"] if Path("out/experiences.sqlite").exists() else []
    assert limited("--steps", "150", *resume, room=10**8).returncode == 0
    assert learn(levers, "--steps", "150", out="roomy").exit_code == 0
    assert stored(Path("out")) == stored(Path("roomy"))
    for name in ("curve.csv", "learned.menid"):
        assert (Path("out") / name).read_bytes() == (Path("roomy") / name).read_bytes()


PRINTS = """\
import os, sys
import gymnasium

class Env(gymnasium.Env):
    def reset(self, seed=None, options=None):
        print("pybullet build time")
        os.write(1, b"from C\\n")
        return 0, {}
    def step(self, action):
        if QUITS:
            sys.exit(4)
        return 0, 0.0, False, False, {}

def atoms(env, observation): return []
def action(env, name, arguments): return 0
"""

GYM = """\
[environment.bench]
kind = "simulated"
duration = 20
[environment.model]
kind = "gymnasium"
duration = 1
retries = 0
settings = { make = "env.py:Env", atoms = "env.py:atoms", action = "env.py:action" }
[learn]
test_time = 2
steps = 2
"""


def ran(*options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", "from menid_plan.cli.main import main; main()", "learn",
         "levers.menid", "--run", "run.toml", "-o", "out", *options],
        capture_output=True, check=False, text=True, timeout=60,
    )  # fmt: skip


@pytest.mark.parametrize("workers", ["0", "1"])
def test_an_environment_that_prints_or_ends_the_program(levers: Menid, workers: str) -> None:
    pytest.importorskip("gymnasium")
    Path("run.toml").write_text(GYM, encoding="utf-8")
    Path("env.py").write_text(f"QUITS = False\n{PRINTS}", encoding="utf-8")
    found = ran("--json", "--workers", workers)
    assert json.loads(found.stdout)["steps"] == 2
    assert "pybullet build time\n" in found.stderr
    assert "from C\n" in found.stderr
    Path("out").rename("before")
    Path("env.py").write_text(f"QUITS = True\n{PRINTS}", encoding="utf-8")
    found = ran("--workers", workers)
    assert found.returncode == 0, found.stderr
    assert "attempt 1: it called sys.exit(4)" in found.stderr
    assert all(line.count("environment `model`") <= 1 for line in found.stderr.splitlines())
    assert "Fatal" not in found.stderr


def test_a_target_that_does_not_start_is_named(levers: Menid) -> None:
    Path("stub.py").write_text("raise SystemExit(3)\n", encoding="utf-8")
    text = '[environment.bench]\nkind = "process"\nsettings.command = ["{python}", "stub.py"]\n'
    Path("run.toml").write_text(text, encoding="utf-8")
    result = learn(levers)
    assert result.exit_code == 5
    assert result.stderr.startswith(
        "menid: environment `bench`: the program ended with exit code 3"
    )


def test_schedulers_and_workers_that_cannot_be(levers: Menid) -> None:
    text = Path("run.toml").read_text(encoding="utf-8")
    Path("run.toml").write_text(text.replace("number = 0", 'scheduler = "foo"'), encoding="utf-8")
    result = learn(levers)
    assert result.exit_code == 3
    assert result.stderr == (
        "menid: run.toml: workers.scheduler: expected an address such as tcp://HOST:8786, not `foo`\n"
    )
    Path("run.toml").write_text(text.replace("number = 0", "number = 100000"), encoding="utf-8")
    result = learn(levers)
    assert result.exit_code == 3
    assert "run.toml: workers.number: expected at most 1024, not 100000" in result.stderr
    assert learn(levers, "--workers", "100000").exit_code == 2


def test_a_goal_that_is_out_of_reach_is_told(levers: Menid) -> None:
    text = LEVERS.replace("works:  0.9 0.9 0.9", "works:  0.0 0.0 0.0").replace(
        "breaks: 0.1 0.1 0.1", "breaks: 1.0 1.0 1.0"
    )
    Path("levers.menid").write_text(text, encoding="utf-8")
    Path("run.toml").write_text(
        RUN_FILE + 'objective = "goal-then-reward"\nestimator = "empirical"\n', encoding="utf-8"
    )
    result = learn(levers, "--test-time", "0", "--steps", "100")
    assert re.search(r"goal-then-reward \S+, goal probability 0(\.\d+)?\n", result.stdout)


@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_a_run_that_is_terminated_ends_as_by_ctrl_c(levers: Menid) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", "from menid_plan.cli.main import main; main()", "learn",
         "levers.menid", "--run", "run.toml", "-o", "out", "--steps", "10000000"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    deadline = time.monotonic() + 50
    while time.monotonic() < deadline:
        curve = Path("out/curve.csv")
        if curve.exists() and curve.stat().st_size > 500:
            break
        time.sleep(0.05)
    process.terminate()
    _, said = process.communicate(timeout=30)
    assert process.returncode == 6
    assert "interrupted; --resume goes on with this run" in said
    assert Path("out/learned.menid").exists()


@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_a_signal_before_the_run_has_begun(levers: Menid, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object, **__: object) -> None:
        signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr("menid_plan.learning.run.Planner", interrupt)
    before = signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        result = learn(levers)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert result.exit_code == 6
    assert result.stderr == "menid: interrupted\n"
    assert not Path("out").exists()


# ------------------------------------------------------------------------------------- clocks, views


def test_the_real_clock(levers: Menid) -> None:
    Path("run.toml").write_text(
        RUN_FILE.replace("steps = 12", 'hours = 0.00015\nclock = "real"'), encoding="utf-8"
    )
    begun = time.monotonic()
    first = json.loads(learn(levers, "--json").stdout)
    assert 0.54 <= first["seconds"] <= time.monotonic() - begun
    # An hour is an hour: after a break there is nothing left of it, but perhaps the time from the end
    # of the last step to where the loop looked at the clock.
    time.sleep(0.1)
    again = json.loads(learn(levers, "--json", "--resume").stdout)
    assert again["steps"] - first["steps"] in (0, 1)
    assert 0.54 <= again["seconds"] <= first["seconds"] + 0.01
    more = json.loads(learn(levers, "--json", "--resume", "--hours", "0.0003").stdout)
    assert 1.08 <= more["seconds"] < 1.6
    assert more["steps"] > first["steps"]


def test_lines_where_there_is_no_terminal(levers: Menid, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("menid_plan.cli.learn._View.EVERY", 0.0)
    lines = learn(levers).stderr.splitlines()
    rest = "reward 0, 0 steps, 0 episodes; executions: bench 0"
    assert lines[0] == f"0:00:01 on the virtual clock: {rest}, model 1"  # within a test too
    assert lines[4] == f"0:00:04 on the virtual clock: {rest}, model 4"
    assert lines[-1].startswith("0:0")


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs a pseudo-terminal")
@pytest.mark.parametrize("columns", [40, 80])
def test_a_table_on_a_terminal(levers: Menid, columns: int) -> None:
    import pty

    pid, terminal = pty.fork()
    if pid == 0:  # pragma: no cover - another process
        os.environ.update(TERM="xterm", COLUMNS=str(columns), LINES="40")
        os.execv(
            sys.executable,
            [sys.executable, "-c", "from menid_plan.cli.main import main; main()", "learn",
             "levers.menid", "--run", "run.toml", "-o", "out", "--steps", "150"],
        )  # fmt: skip
    seen = b""
    while True:
        try:
            data = os.read(terminal, 65536)
        except OSError:
            break
        if not data:
            break
        seen += data
    os.close(terminal)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", seen.decode())
    assert "150 steps in" in text
    if columns == 40:
        assert re.search(r"environment +time +done", text)
        assert re.search(r"bench +0:\d\d:\d\d +\d+", text)
        assert "…" not in text
        return
    assert re.search(
        r"0:\d\d:\d\d on the virtual clock  reward -?\d+  \d+ steps?  \d+ episodes?", text
    )
    assert re.search(r"environment +role +executions +time +failed", text)
    assert re.search(r"bench +target +\d+ +0:\d\d:\d\d +0", text)
    assert re.search(r"least sure in the target +delta", text)
    assert re.search(r"pull\.dry for (left|right) +0\.\d\d\d", text)
    assert max(len(line.rstrip()) for line in text.splitlines()) <= 100
