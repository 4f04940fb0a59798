"""Environments that are programs: the examples, and everything that a program can do wrong."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path
from typing import Any

import pytest

import menid_plan
from conftest import ROOT
from menid_plan.environments.check import check
from menid_plan.environments.interface import CannotResetError, EnvironmentFailedError
from menid_plan.environments.process import Process
from menid_plan.environments.program import Program
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.runfile import read_run_file
from menid_plan.environments.session import Session
from menid_plan.environments.settings import SettingError
from menid_plan.grounding.state import GroundAction
from test_environments_pool import is_alive, wait_until

FOLDER = ROOT / "domains" / "greenhouse"
DOCUMENT = menid_plan.read(FOLDER / "two-pots.menid")
assert DOCUMENT.domain is not None
assert DOCUMENT.problem is not None
INITIAL = frozenset(DOCUMENT.problem.init)
POUR = GroundAction("pour")

HELLO = '{"type": "hello", "protocol": 1}'
STATE = '{"type": "state", "state": ["at(sink)", "full"]}'
DONE = '{"type": "execution", "state": ["at(sink)"], "reward": -1, "duration": 2.5}'


def program(folder: Path, **answers: str) -> Session:
    """A program that answers each type of message with one line, or, after a `!`, runs it."""
    lines = {"hello": HELLO, "reset": STATE, "execute": DONE, "state": STATE, **answers}
    text = f"""
        import json, os, sys, time
        answers = {lines!r}
        for line in sys.stdin:
            answer = answers.get(json.loads(line)["type"])
            if answer is None:
                break
            if answer.startswith("!"):
                exec(answer[1:])
            else:
                print(answer, flush=True)
    """
    (folder / "program.py").write_text(textwrap.dedent(text))
    return started(folder, "{python}", "program.py")


def started(folder: Path, *command: str, timeout: float = 20, **options: object) -> Session:
    return EnvironmentSpec(
        "simulator", Process(command, options=options), DOCUMENT.domain, DOCUMENT.problem,
        folder=folder, timeout=timeout, start_timeout=20,
    ).open()  # fmt: skip


@pytest.mark.parametrize("language", ["run", "node"])
def test_the_examples_keep_to_the_protocol(language: str) -> None:
    if language == "node" and not shutil.which("node"):
        pytest.skip("there is no Node.js here")
    bound = read_run_file(FOLDER / f"{language}.toml").bind(DOCUMENT.domain, DOCUMENT.problem)
    report = check(bound.tests[0], executions=3)
    assert [f for f in report.findings if f.verdict != "pass"] == []
    assert {t.action for t in report.tallies} == {"drive", "fill", "pour"}
    seen = {outcome for tally in report.tallies for outcome in tally.outcomes}
    assert {"drive.arrived", "at-a-tap.filled", "into-the-pot.watered"} <= seen
    assert all(tally.unexplained == 0 for tally in report.tallies)


def test_a_well_behaved_program(tmp_path: Path) -> None:
    session = program(
        tmp_path,
        hello='{"type": "hello", "protocol": 1, "name": "me", "capabilities": {"parallel": false}}',
    )
    able = session.capabilities
    assert (able.note, able.parallel, able.repeatable) == ("me", False, True)
    first = session.reset(None, 2**53 - 1)
    assert sorted(map(str, first)) == ["at(sink)", "full"]
    found = session.execute(POUR)
    assert (found.reward, found.duration) == (-1.0, 2.5)
    assert session.state() == first
    session.close()
    session.close()


def test_the_greeting_says_what_it_is_for(tmp_path: Path) -> None:
    (tmp_path / "keep.py").write_text(
        "import sys\nline = sys.stdin.readline()\nopen('hello.json', 'w').write(line)\n"
        f"print({HELLO!r}, flush=True)\nsys.stdin.read()\n"
    )
    started(tmp_path, "{python}", "keep.py", slip=0.5).close()
    hello = json.loads((tmp_path / "hello.json").read_text())
    assert hello["protocol"] == 1
    assert (hello["domain"], hello["environment"]) == ("greenhouse", "simulator")
    assert hello["objects"]["fern"] == {"types": ["pot", "place", "object"], "attributes": {}}
    assert hello["actions"]["drive"] == ["to"]
    assert hello["predicates"]["full"] == 0
    assert hello["options"] == {"slip": 0.5}
    assert sorted(hello["init"]) == sorted(map(str, INITIAL))


RUBBISH = "x" * 500


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ("rubbish \x1b[2J", "no JSON object in the line `rubbish \N{REPLACEMENT CHARACTER}[2J`"),
        (RUBBISH, f"`{'x' * 80}…`"),
        ("[1]", "no JSON object in the line `[1]`"),
        ("[" * 5000, "no JSON object in the line"),
        ('{"type": "state", "state": []}', "expected a message of type `execution`, got the line"),
        ('{"type": "execution"}', "`state` in `execution` is no list of texts"),
        ('{"type": "execution", "state": [1]}', "`state` in `execution` is no list of texts"),
        ('{"type": "execution", "state": ["in(a)"]}', "there is no predicate `in`"),
        ('{"type": "execution", "state": ["at(moon)"]}', "there is no object `moon`"),
        ('{"type": "execution", "state": ["dry(sink)"]}', "`sink` is not of type pot"),
        ('{"type": "execution", "state": ["all-watered"]}', "`all-watered` is derived"),
        ('{"type": "execution", "state": [], "reward": NaN}', "`reward` is nan, not a finite"),
        ('{"type": "execution", "state": [], "reward": 1e999}', "`reward` is inf, not a finite"),
        ('{"type": "execution", "state": [], "reward": "1"}', '`reward` is no number: "1"'),
        ('{"type": "execution", "state": [], "reward": true}', "`reward` is no number: true"),
        ('{"type": "execution", "state": [], "duration": -2}', "duration of `pour` is negative"),
        (f'{{"type": "execution", "state": [], "duration": 1{"0" * 400}}}', "`duration` is inf"),
        ('{"type": "error", "message": "no water"}', "the program says: no water"),
        ("!sys.exit('out of order')", "the program ended with exit code 1; it said:\n    out of"),
        ("!os.kill(os.getpid(), 9)", "the program ended with signal 9"),
        ("!os.close(1); time.sleep(60)", "the program closed its output"),
        ("!os.write(1, b'x' * (17 * 2**20))", "a line of more than 16 MiB"),
    ],
)
def test_what_a_program_does_wrong_is_told(tmp_path: Path, answer: str, message: str) -> None:
    session = program(tmp_path, execute=answer)
    session.reset(None, 0)
    with pytest.raises(EnvironmentFailedError) as caught:
        session.execute(POUR)
    assert message in str(caught.value)
    assert str(caught.value).startswith("environment `simulator`: ")
    with pytest.raises(EnvironmentFailedError, match="was not reset after a failure"):
        session.execute(POUR)
    session.reset(None, 0)  # it is started again
    session.close()


@pytest.mark.parametrize(
    ("hello", "message"),
    [
        ('{"type": "hello", "protocol": 2}', "the program speaks protocol 2, not 1"),
        ('{"type": "hello"}', "the program speaks protocol None, not 1"),
        ('{"type": "hello", "protocol": 1, "capabilities": 1}', "`capabilities` is no object"),
        (
            '{"type": "hello", "protocol": 1, "capabilities": {"fly": true}}',
            "there is no capability `fly`",
        ),
        (
            '{"type": "hello", "protocol": 1, "capabilities": {"parallel": 1}}',
            "`capabilities.parallel` is neither true nor false",
        ),
        ("!raise RuntimeError('no physics')", "RuntimeError: no physics"),
    ],
)
def test_a_bad_greeting(tmp_path: Path, hello: str, message: str) -> None:
    with pytest.raises(EnvironmentFailedError) as caught:
        program(tmp_path, hello=hello)
    assert message in str(caught.value)


def test_it_may_not_be_put_into_a_state(tmp_path: Path) -> None:
    answer = '{"type": "error", "code": "cannot-reset", "message": "the pot is glued"}'
    session = program(tmp_path, reset=answer)
    for _ in range(2):  # it goes on
        with pytest.raises(CannotResetError, match="the pot is glued"):
            session.reset(INITIAL, 0)
    session.close()


def test_a_line_that_was_not_asked_for(tmp_path: Path) -> None:
    session = program(tmp_path, reset=f"!print({STATE!r} + '\\nhello there', flush=True)")
    session.reset(None, 0)
    time.sleep(0.3)
    with pytest.raises(EnvironmentFailedError, match="not asked for: `hello there`"):
        session.execute(POUR)
    session.close()


def test_a_program_that_hangs(tmp_path: Path) -> None:
    (tmp_path / "hang.py").write_text(
        f"import sys, time\nsys.stdin.readline()\nprint({HELLO!r}, flush=True)\n"
        "print('thinking', file=sys.stderr, flush=True)\ntime.sleep(3600)\n"
    )
    session = started(tmp_path, "{python}", "hang.py", timeout=0.5)
    with pytest.raises(
        EnvironmentFailedError, match=r"no answer within 0\.5 s; it said:\n    think"
    ):
        session.reset(None, 0)
    session.close()


def test_a_program_that_does_not_read(tmp_path: Path) -> None:
    """More than a pipe holds is sent to a program that sleeps; the timeout ends it all the same."""
    (tmp_path / "deaf.py").write_text(
        f"import sys, time\nsys.stdin.readline()\nprint({HELLO!r}, flush=True)\ntime.sleep(3600)\n"
    )
    session = started(tmp_path, "{python}", "deaf.py", timeout=0.5)
    process: Any = session.environment
    with pytest.raises(EnvironmentFailedError, match="no answer within"):
        process._ask({"type": "state", "padding": "x" * 2**20}, "state")
    session.close()


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (("no-such-program",), "settings.command: there is no program `no-such-program`"),
        (("./no-such",), "settings.command: there is no program `./no-such`"),
    ],
)
def test_a_program_that_is_not_there(
    tmp_path: Path, command: tuple[str, ...], message: str
) -> None:
    with pytest.raises(SettingError) as caught:
        started(tmp_path, *command)
    assert message in str(caught.value)
    with pytest.raises(SettingError, match="command: expected a program"):
        Process(())


def test_no_shell(tmp_path: Path) -> None:
    with pytest.raises(EnvironmentFailedError):
        started(tmp_path, "{python}", "-c", "import sys; sys.exit(sys.argv[1])", "$(touch x); y")
    assert not (tmp_path / "x").exists()


GRANDCHILD = f"""
import os, subprocess, sys, time
sys.stdin.readline()
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(3600)"])
open("pids.tmp", "w").write(f"{{os.getpid()}} {{child.pid}}")
os.rename("pids.tmp", "pids")
print({HELLO!r}, flush=True)
time.sleep(3600)
"""


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="there are no process groups here")
def test_closing_ends_the_program_and_all_that_it_started(tmp_path: Path) -> None:
    (tmp_path / "deaf.py").write_text(GRANDCHILD)
    session = started(tmp_path, "{python}", "deaf.py")
    pids = [int(pid) for pid in (tmp_path / "pids").read_text().split()]
    assert all(map(is_alive, pids))
    program: Any = session.environment
    program._program.close(patience=0.1)
    for pid in pids:
        wait_until(lambda pid=pid: not is_alive(pid), 10)
    session.close()


def test_a_program_that_ended_before_it_is_asked_is_not_waited_for(tmp_path: Path) -> None:
    program = Program([sys.executable, "-c", "import sys; sys.exit('no licence')"], tmp_path)
    try:
        wait_until(lambda: not program._lines.empty())
        for _ in range(2):
            with pytest.raises(
                EnvironmentFailedError, match=r"ended with exit code 1[^$]*no licence"
            ):
                program.ask(b"{}\n", 60)
    finally:
        program.close()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the kernel can't do that here")
def test_a_program_ends_with_its_parent(tmp_path: Path) -> None:
    """Even one that hangs, and even if the parent is killed."""
    (tmp_path / "deaf.py").write_text(GRANDCHILD)
    code = (
        "import sys, time; from pathlib import Path;"
        "from menid_plan.environments.program import Program;"
        "p = Program([sys.executable, 'deaf.py'], Path('.')); p.ask(b'{}\\n', 20);"
        "time.sleep(3600)"
    )
    running = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path)
    try:
        wait_until((tmp_path / "pids").exists)
        pid = int((tmp_path / "pids").read_text().split()[0])
        grandchild = int((tmp_path / "pids").read_text().split()[1])
        assert is_alive(pid)
    finally:
        running.kill()
        running.wait()
    wait_until(lambda: not is_alive(pid), 10)
    os.kill(grandchild, signal.SIGKILL)  # its own parent is no program of ours
