"""`menid plan`: planners that play, and planners that fail in every way they do."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import Result

from menid_plan.planners import known, run
from servers import RUN

Menid = Callable[..., Result]

COIN = """
domain coins
type coin
predicate heads(coin)
predicate seen(coin)
action flip(c: coin) cost 1 {
  rule flip { when not seen(c) outcomes { head: 0.5 heads(c), seen(c)  tail: 0.5 seen(c) } }
}
problem two for coins
object one, other: coin
goal exists c: coin (heads(c)) reward 8
horizon 2
"""

# A client of rddlsim that flips the first coin that it has not seen.
CLIENT = """
import socket, sys, time
from xml.etree import ElementTree
link = socket.create_connection(("127.0.0.1", int(sys.argv[1])))
rest = b""
def say(text):
    link.sendall(text.encode() + b"\\0")
def hear():
    global rest
    while b"\\0" not in rest:
        data = link.recv(65536)
        if not data:
            sys.exit(1)
        rest += data
    message, _, rest = rest.partition(b"\\0")
    return ElementTree.fromstring(message)
say("<session-request><client-name>fake</client-name></session-request>")
rounds = int(hear().findtext("num-rounds"))
for _ in range(rounds):
    say("<round-request/>")
    hear()
    message = hear()
    while message.tag == "turn":
        seen = {(f.findtext("fluent-name"), *(a.text for a in f.findall("fluent-arg"))):
                f.findtext("fluent-value") for f in message.findall("observed-fluent")}
        coins = [c for c in ("one", "other") if seen["seen", c] == "false"]
        over = any(seen["heads", c] == "true" for c in ("one", "other"))
        if seen["applying",] == "true" or over or not coins:
            say("<actions/>")
        else:
            say("<actions><action><action-name>flip</action-name><action-arg>" + coins[0]
                + "</action-arg><action-value>true</action-value></action></actions>")
        message = hear()
hear()
"""


@pytest.fixture
def coins(tmp_path: Path) -> Path:
    (tmp_path / "coins.menid").write_text(COIN, encoding="utf-8")
    (tmp_path / "client.py").write_text(CLIENT, encoding="utf-8")
    return tmp_path


def declare(folder: Path, *command: str, rest: str = "") -> None:
    text = f"[planner.fake]\ncommand = {json.dumps(list(command))}\n{rest}"
    (folder / "planners.toml").write_text(text, encoding="utf-8")


def plan(menid: Menid, *options: str) -> Result:
    return menid("plan", "coins.menid", "--with", "fake", "--planners", "planners.toml", *options)


def test_a_planner_that_a_user_declared(menid: Menid, coins: Path) -> None:
    declare(coins, sys.executable, "-c", CLIENT, "{port}")
    result = plan(menid, "--rounds", "60", "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["rounds"] == 60
    assert found["client"] == found["planner"] == "fake"
    # Heads at once, heads at last, or never: each coin costs 1.
    assert set(found["rewards"]) == {7.0, 6.0, -2.0}
    assert found["best"] == pytest.approx(0.5 * 7 + 0.25 * 6 - 0.25 * 2, abs=1e-6)
    assert abs(found["mean"] - found["best"]) < 4 * found["error"]
    assert found["failure"] == ""
    text = plan(menid, "--rounds", "60")
    assert text.stdout.splitlines() == [
        f"fake: reward {found['mean']:.6g} +- {found['error']:.4g} in 60 rounds, "
        f"{found['goal_rate']:.0%} of them to the goal",
        "best reward, by the domain: 4.5",
    ]


def test_the_places_of_a_command(menid: Menid, coins: Path) -> None:
    (coins / "extra.txt").write_text("more")
    script = (
        "import sys, os\n"
        "host, name, domain, instance, folder = sys.argv[2:7]\n"
        "assert host == '127.0.0.1' and name == 'two', sys.argv\n"
        "assert 'domain coins {' in open(domain).read()\n"
        "assert 'instance two {' in open(instance).read()\n"
        "assert os.path.samefile(folder, '.') and open('extra.txt').read() == 'more'\n"
        "assert sys.argv[7] == '{else}', sys.argv\n"
    )
    declare(
        coins, sys.executable, "-c", script + CLIENT, "{port}", "{host}", "{name}", "{domain}",
        "{instance}", "{folder}", "{else}", rest=f"files = ['{coins / 'extra.txt'}']\n",
    )  # fmt: skip
    result = plan(menid, "--rounds", "2")
    assert result.exit_code == 0, result.output


@pytest.mark.parametrize(
    ("script", "message", "said"),
    [
        ("print('no licence')", "it ended with 0 before it asked for the task", "no licence"),
        ("import os; os.abort()", "it ended with -6 before it asked for the task", ""),
        ("import time; print('hm', flush=True); time.sleep(60)", "it was not done after 2 s", "hm"),
        (
            "import socket, sys, time\nlink = socket.create_connection(('127.0.0.1', int(sys.argv[1])))"
            "\nlink.sendall(b'<session-request/>' + bytes(1)); link.recv(99); time.sleep(60)",
            "it was not done after 2 s", "",
        ),
        (
            "import socket, sys\nlink = socket.create_connection(('127.0.0.1', int(sys.argv[1])))\n"
            "link.sendall(b'<session-request/>' + bytes(1))",
            "the client ended the session early", "",
        ),
        (
            CLIENT.replace('coins[0]', '"nothing"'), "`flip` has no arguments `nothing`", "",
        ),
    ],
)  # fmt: skip
def test_planners_that_fail(
    menid: Menid, coins: Path, script: str, message: str, said: str
) -> None:
    declare(coins, sys.executable, "-c", script, "{port}")
    start = time.monotonic()
    result = plan(menid, "--time", "2")
    assert time.monotonic() - start < 15
    assert result.exit_code == 5, result.output
    assert result.stderr.endswith(f"menid: fake failed: {message}\n")
    assert said in result.stderr


def test_files_that_a_planner_is_given_stay_as_they_are(menid: Menid, coins: Path) -> None:
    """Whatever they are called: nothing is written to what is linked."""
    mine = coins / "output"
    mine.write_text("mine")
    declare(coins, sys.executable, "-c", "print('hello')\n" + CLIENT, "{port}",
            rest=f"files = ['{mine}']\n")  # fmt: skip
    assert plan(menid, "--rounds", "1").exit_code == 0
    assert mine.read_text() == "mine"


def test_files_start_from_the_folder_of_the_declarations(menid: Menid, coins: Path) -> None:
    (coins / "sub").mkdir()
    (coins / "sub" / "client.py").write_text(CLIENT)
    declare(coins / "sub", sys.executable, "client.py", "{port}", rest="files = ['client.py']\n")
    (coins / "client.py").unlink()
    options = ("--with", "fake", "--planners", "sub/planners.toml", "--rounds", "1")
    result = menid("plan", "coins.menid", *options)
    assert result.exit_code == 0, result.output


def test_rounds_that_were_finished_count(menid: Menid, coins: Path) -> None:
    hangs = CLIENT.replace(
        "for _ in range(rounds):",
        "for number in range(rounds):\n    number == 3 and time.sleep(60)",
    )
    declare(coins, sys.executable, "-c", hangs, "{port}")
    result = plan(menid, "--time", "4", "--json")
    assert result.exit_code == 5
    found = json.loads(result.stdout)
    assert found["rounds"] == 3
    assert found["failure"] == "it was not done after 4 s"


def test_what_the_goal_is_worth(menid: Menid, coins: Path) -> None:
    declare(coins, sys.executable, "-c", CLIENT, "{port}")
    result = plan(menid, "--rounds", "60", "--goal-reward", "108", "--json")
    found = json.loads(result.stdout)
    assert set(found["rewards"]) == {107.0, 106.0, -2.0}
    assert found["best"] == pytest.approx(0.5 * 107 + 0.25 * 106 - 0.25 * 2)


@pytest.mark.parametrize(
    ("files", "code", "message"),
    [
        (["{0}/client.py", "{0}/x/client.py"], 3, "something else in the folder is called `client.py`"),
        (["{0}/domain.rddl"], 3, "something else in the folder is called `domain.rddl`"),
        (["/"], 3, "something else in the folder is called ``"),
        (["{0}/gone"], 5, "there is no file `"),
    ],
)  # fmt: skip
def test_files_that_can_t_lie_in_the_folder(
    menid: Menid, coins: Path, files: list[str], code: int, message: str
) -> None:
    given = [each.format(coins) for each in files]
    declare(coins, sys.executable, "-c", CLIENT, "{port}", rest=f"files = {given}\n")
    result = plan(menid)
    assert result.exit_code == code, result.output
    assert message in result.stderr


def test_a_planner_that_talks_too_much(
    menid: Menid, coins: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, "MOST_OUTPUT", 100_000)
    declare(coins, sys.executable, "-c", "while True: print('y' * 99)")
    start = time.monotonic()
    result = plan(menid, "--time", "30")
    assert time.monotonic() - start < 15
    assert result.exit_code == 5
    assert result.stderr.endswith("menid: fake failed: it has printed more than 0 MiB\n")
    assert 1000 < len(result.stderr) < 3000


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such signals")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGINT"])
def test_a_signal_ends_the_planner(coins: Path, tmp_path: Path, name: str) -> None:
    """With what it has started; nothing is left behind."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    script = (
        "import os, subprocess, sys, time\n"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'])\n"
        f"open({str(coins / 'new')!r}, 'w').write(f'{{os.getpid()}} {{child.pid}}')\n"
        f"os.rename({str(coins / 'new')!r}, {str(coins / 'pids')!r})\n"
        "time.sleep(60)\n"
    )
    declare(coins, sys.executable, "-c", script)
    command = ["plan", "coins.menid", "--with", "fake", "--planners", "planners.toml"]
    code = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n" + RUN
    process = subprocess.Popen(
        [sys.executable, "-c", code, *command], cwd=coins, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, env={**os.environ, "TMPDIR": str(temporary)},
    )  # fmt: skip
    try:
        until = time.monotonic() + 60
        while not (coins / "pids").exists() and time.monotonic() < until:
            time.sleep(0.05)
        assert list(temporary.iterdir())
        process.send_signal(getattr(signal, name))
        _, said = process.communicate(timeout=30)
        assert "Traceback" not in said
        for pid in (coins / "pids").read_text().split():
            status = Path("/proc", pid, "status")
            assert not status.exists() or "State:\tZ" in status.read_text()
        assert not list(temporary.iterdir())
    finally:
        process.kill()
        process.communicate()


def test_what_a_planner_started_ends_with_it(menid: Menid, coins: Path) -> None:
    child = "import time, pathlib; time.sleep(3); pathlib.Path('{0}').write_text('alive')"
    script = (
        "import subprocess, sys\n"
        f"subprocess.Popen([sys.executable, '-c', {child.format(coins / 'trace')!r}])\n" + CLIENT
    )
    declare(coins, sys.executable, "-c", script, "{port}")
    assert plan(menid, "--rounds", "1").exit_code == 0
    time.sleep(3.5)
    assert not (coins / "trace").exists()


@pytest.mark.parametrize(
    ("text", "code", "message"),
    [
        ("[planner.fake]\ncommand = ['/nowhere/at-all']\n", 5, "`/nowhere/at-all`: No such file"),
        ("[planner.fake]\n", 3, "planner.fake.command: it is missing"),
        ("[planner.fake]\ncommand = []\n", 3, "planner.fake.command: it is empty"),
        ("[planner.fake]\ncommand = ['a']\nprotocol = 'ftp'\n", 3, "planner.fake.protocol"),
        ("[planner.fake]\ncommnd = ['a']\n", 3, "did you mean `command`?"),
        ("[planer.fake]\ncommand = ['a']\n", 3, "did you mean `planner`?"),
        ("planner = 3\n", 3, "expected tables [planner.NAME]"),
        ("[planner]\nfake = 3\n", 3, "planner.fake: expected a table"),
        ("[planner.fakir]\ncommand = ['a']\n", 2, "did you mean `fakir`?"),
        ("[planner\n", 3, "planners.toml: "),
        ("[planner.fake]\ncommand = ['a', '{nome}']\n", 3, "did you mean `name`?"),
        ('[planner.fake]\ncommand = ["a\\u0000b"]\n', 3, "planner.fake: there is a null character"),
    ],
)
def test_declarations_that_do_not_do(
    menid: Menid, coins: Path, text: str, code: int, message: str
) -> None:
    (coins / "planners.toml").write_text(text, encoding="utf-8")
    result = plan(menid)
    assert result.exit_code == code, result.output
    assert message in result.stderr


def test_prost_by_a_folder(menid: Menid, coins: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A program in its place, which looks for the parser where PROST does."""
    home = coins / "prost"
    home.mkdir()
    check = (
        "import os, sys\n"
        "assert os.access('./rddl-parser-release', os.X_OK)\n"
        "assert sys.argv[1:3] == ['two', '-p'] and sys.argv[4].startswith('[Prost '), sys.argv\n"
        "sys.argv[1] = sys.argv[3]\n"
    )
    for name in ("rddl-parser-release", "search-release"):
        program = home / name
        program.write_text(f"#!{sys.executable}\n{check}{CLIENT}", encoding="utf-8")
        program.chmod(0o755)
    monkeypatch.setenv("MENID_PROST", str(home))
    result = menid("plan", "coins.menid", "--with", "prost", "--rounds", "3")
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith("prost: reward ")


def test_prost_is_not_there(menid: Menid, coins: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MENID_PROST", str(coins))
    result = menid("plan", "coins.menid", "--with", "prost")
    assert result.exit_code == 5
    assert f"the folder {coins} that MENID_PROST names" in result.stderr
    monkeypatch.delenv("MENID_PROST")
    monkeypatch.setenv("PATH", str(coins))
    result = menid("plan", "coins.menid", "--with", "prost")
    assert result.exit_code == 5
    assert "in the folders of PATH; build it" in result.stderr


def test_the_doctor_tells_what_is_there(
    menid: Menid, coins: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MENID_PROST", str(coins))
    declare(coins, sys.executable, "{port}", rest="files = ['/nowhere/x']\n")
    with (coins / "planners.toml").open("a") as file:
        file.write(f"[planner.good]\ncommand = [{sys.executable!r}]\n")
        file.write("[planner.gone]\ncommand = ['no-such-program']\n")
    result = menid("doctor", "--planners", "planners.toml", "--json")
    assert result.exit_code == 0, result.output
    found = {each["name"]: each for each in json.loads(result.stdout)}
    assert list(found) == ["prost", "mdpsim-client", "storm", "fake", "good", "gone"]
    there = {name: found[name]["there"] for name in ("prost", "fake", "good", "gone")}
    assert there == {"prost": False, "fake": False, "good": True, "gone": False}
    assert "MENID_PROST names; build it from" in found["prost"]["told"]
    assert "there is no file /nowhere/x" in found["fake"]["told"]
    assert "no-such-program, which is no program in PATH" in found["gone"]["told"]
    text = menid("doctor", "--planners", "planners.toml").stdout
    assert "good: found: declared in planners.toml: " in text


def test_planners_in_the_user_s_own_file(
    menid: Menid, coins: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(known, "user_config_path", lambda *_, **__: coins / "config")
    result = menid("doctor")
    assert f"can be declared in {coins / 'config' / 'planners.toml'}\n" in result.stdout
    assert menid("plan", "coins.menid", "--with", "fake").exit_code == 2
    declare(coins, sys.executable, "-c", CLIENT, "{port}")
    (coins / "config").mkdir()
    (coins / "planners.toml").rename(coins / "config" / "planners.toml")
    assert menid("plan", "coins.menid", "--with", "fake", "--rounds", "1").exit_code == 0


# A client of mdpsim that flips a coin that it has not seen.
PPDDL_CLIENT = """
import socket, sys
from xml.etree import ElementTree
assert "(define (domain coins)" in open(sys.argv[2]).read()
assert "(define (problem two)" in open(sys.argv[3]).read()
assert sys.argv[4] == "two"
link = socket.create_connection(("127.0.0.1", int(sys.argv[1])))
lines = link.makefile("rb")
def ask(text):
    link.sendall(text.encode())
    return ElementTree.fromstring(lines.readline())
first = ask("<session-request><name>fake</name></session-request>")
for _ in range(int(first.findtext("setting/rounds"))):
    ask("<round-request/>")
    message = ElementTree.fromstring(lines.readline())
    while message.tag == "state":
        seen = {a.findtext("term") for a in message if a.findtext("predicate") == "seen"}
        coin = [c for c in ("one", "other") if c not in seen][0]
        message = ask("<act><action><name>flip</name><term>" + coin + "</term></action></act>")
    assert message.tag == "end-round", message.tag
"""


def test_a_planner_that_reads_ppddl(menid: Menid, coins: Path) -> None:
    command = (sys.executable, "-c", PPDDL_CLIENT, "{port}", "{domain}", "{instance}", "{name}")
    declare(coins, *command, rest="protocol = 'mdpsim'\n")
    result = plan(menid, "--rounds", "60", "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["rounds"] == 60
    assert set(found["rewards"]) == {7.0, 6.0, -2.0}
    assert found["best"] == pytest.approx(4.5, abs=1e-6)
    assert abs(found["mean"] - found["best"]) < 4 * found["error"]
    declare(coins, *command)
    result = plan(menid, "--states")
    assert result.exit_code == 2
    assert "this planner reads RDDL" in result.stderr


def test_the_client_of_mdpsim(menid: Menid, coins: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A program of that name in PATH, called as the real one has it."""
    result = menid("plan", "coins.menid", "--with", "mdpsim-client")
    assert result.exit_code == 5
    assert "mdpclient was not found in the folders of PATH; build it" in result.stderr
    script = (
        f"#!{sys.executable}\nimport sys\n"
        "assert sys.argv[1:4:2] == ['-H', '-P'], sys.argv\n"
        "sys.argv[1:] = [sys.argv[4], *sys.argv[5:], 'two']\n"
    )
    program = coins / "mdpclient"
    program.write_text(script + PPDDL_CLIENT, encoding="utf-8")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(coins), prepend=os.pathsep)
    result = menid("plan", "coins.menid", "--with", "mdpsim-client", "--rounds", "3")
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith("mdpsim-client: reward ")


def test_a_solver_plays(menid: Menid, coins: Path) -> None:
    """Its own policy, in the environment; beside it the best of the same objective."""
    result = menid("plan", "coins.menid", "--with", "value-iteration", "--rounds", "400", "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["objective"] == "reward"
    assert set(found["rewards"]) == {7.0, 6.0, -2.0}
    assert found["best"] == pytest.approx(4.5, abs=1e-6)
    assert abs(found["mean"] - 4.5) < 4 * found["error"]
    text = COIN.replace("horizon 2", "") + "discount 1\n"
    (coins / "coins.menid").write_text(text, encoding="utf-8")
    result = menid("plan", "coins.menid", "--with", "policy-iteration", "--rounds", "400")
    assert result.exit_code == 0, result.output
    assert result.stdout.endswith("best goal-then-reward, by the domain: 4.5\n")


def test_a_solver_where_the_environment_does_what_the_domain_does_not_foresee(
    menid: Menid, coins: Path
) -> None:
    """In the domain, a coin never shows heads; in the environment, it does so half of the time."""
    text = COIN.replace("cost 1 {", "cost 1 {\n").replace(
        "outcomes { head: 0.5", "outcomes bad good { head: 0 0.5"
    ).replace("tail: 0.5", "tail: 1 0.5").replace(
        "type coin", "type coin\nenvironment bad : target\nenvironment good : test"
    )  # fmt: skip
    text += "object more: coin\n"
    (coins / "coins.menid").write_text(text.replace("horizon 2", "horizon 3"), encoding="utf-8")
    (coins / "run.toml").write_text(
        "[environment.bad]\nkind = 'simulated'\n[environment.bad.settings]\ncolumn = 'good'\n"
    )
    options = ("--run", "run.toml", "--with", "value-iteration", "--rounds", "200", "--json")
    result = menid("plan", "coins.menid", *options)
    assert result.exit_code == 0, result.output
    assert set(json.loads(result.stdout)["rewards"]) == {7.0, 6.0, 5.0, -3.0}


def test_solvers_that_do_not_play(menid: Menid, coins: Path) -> None:
    result = menid("plan", "coins.menid", "--with", "thompson")
    assert result.exit_code == 4
    assert "decides step by step" in result.stderr
    result = menid("plan", "coins.menid", "--with", "value-iteration", "--grounded")
    assert result.exit_code == 2
    assert "--grounded: the solver `value-iteration` reads no exported files" in result.stderr
    result = menid("plan", "coins.menid", "--with", "valu-iteration")
    assert result.exit_code == 2
    assert "did you mean `value-iteration`?" in result.stderr
    text = COIN.replace("horizon 2", "horizon 2\ndiscount 0.5")
    (coins / "coins.menid").write_text(text, encoding="utf-8")
    for command in (["solve", "--solver"], ["plan", "--with"]):
        result = menid(command[0], "coins.menid", command[1], "policy-iteration")
        assert result.exit_code == 4, result.output
    result = menid("plan", "coins.menid", "--with", "value-iteration", "--rounds", "1")
    assert "best reward, not discounted, by the domain: 4.5\n" in result.stdout
