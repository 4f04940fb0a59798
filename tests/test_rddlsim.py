"""A client of rddlsim plays rounds; one that breaks the protocol ends its session, and no more."""

from __future__ import annotations

import base64
import socket
import subprocess
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from xml.etree import ElementTree

import pytest
from click.testing import Result

import servers
from conftest import ROOT
from servers import closed, connected, ended

Menid = Callable[..., Result]


__all__ = ["closed"]  # a fixture of every test

LAMP = """
domain lamps
environment there: target
environment here: test
type lamp
predicate on(lamp)
predicate dead(lamp)
action press(l: lamp) cost 1 {
  rule press {
    when not on(l) and not dead(l)
    outcomes there here { lit: 0.75 0.9999 on(l) reward 2  blown: 0.25 0.0001 dead(l) }
  }
}
problem two for lamps
object hall-lamp, sum: lamp
goal on(hall-lamp) and on(sum) reward 10
horizon 4
"""
FILES = ("lamps.menid",)
# The names in RDDL, where `sum` is an operator.
HALL, SUM = "hall_lamp", "sum_2"


class Client:
    """Says what it is told to, and reads whole messages."""

    def __init__(self, port: int) -> None:
        self.socket = connected(port)
        self.rest = b""

    def say(self, text: str) -> None:
        self.socket.sendall(text.encode() + b"\0")

    def hear(self) -> ElementTree.Element | None:
        while b"\0" not in self.rest:
            data = self.socket.recv(65536)
            if not data:
                return None
            self.rest += data
        message, _, self.rest = self.rest.partition(b"\0")
        assert message.startswith(b"<?xml")
        return ElementTree.fromstring(message)

    def heard(self, tag: str) -> ElementTree.Element:
        message = self.hear()
        assert message is not None, f"the server closed where {tag} is due"
        assert message.tag == tag, ElementTree.tostring(message)
        return message

    def begin(self) -> ElementTree.Element:
        self.say("<session-request><problem-name>two</problem-name><client-name>mine</client-name>"
                 "<input-language>rddl</input-language></session-request>")  # fmt: skip
        return self.heard("session-init")

    def round(self) -> ElementTree.Element:
        self.say("<round-request><execute-policy>yes</execute-policy></round-request>")
        self.heard("round-init")
        return self.heard("turn")


def act(name: str = "", *arguments: str) -> str:
    if not name:
        return "<actions/>"
    listed = "".join(f"<action-arg>{each}</action-arg>" for each in arguments)
    return (
        f"<actions><action><action-name>{name}</action-name>{listed}"
        "<action-value>true</action-value></action></actions>"
    )


def observed(turn: ElementTree.Element) -> dict[tuple[str, ...], str]:
    return {
        (each.findtext("fluent-name") or "", *(a.text or "" for a in each.findall("fluent-arg"))): (
            each.findtext("fluent-value") or ""
        )
        for each in turn.findall("observed-fluent")
    }


def play(client: Client, prefer: str = HALL) -> float:
    """A round: press what is off, one phase after the other; the sum of what was paid."""
    turn, paid = client.round(), 0.0
    while turn.tag == "turn":
        paid += float(turn.findtext("immediate-reward") or "nan")
        seen = observed(turn)
        lamps = [prefer, *({HALL, SUM} - {prefer})]
        off = [x for x in lamps if seen["on", x] == seen["dead", x] == "false"]
        waiting = seen["applying",] == "true"
        client.say(act("press", off[0]) if off and not waiting else act())
        message = client.hear()
        assert message is not None
        turn = message
    assert turn.tag == "round-end", ElementTree.tostring(turn)
    paid += float(turn.findtext("immediate-reward") or "nan")
    assert float(turn.findtext("round-reward") or "nan") == pytest.approx(paid)
    return paid


def serving(
    folder: Path, *options: str
) -> AbstractContextManager[tuple[int, subprocess.Popen[str]]]:
    (folder / "lamps.menid").write_text(LAMP, encoding="utf-8")
    return servers.serving(folder, "rddlsim", "lamps.menid", *options)


def test_a_whole_session(tmp_path: Path) -> None:
    with serving(tmp_path, "--rounds", "40", "--seed", "3") as (port, process):
        client = Client(port)
        first = client.begin()
        assert first.findtext("num-rounds") == "40"
        task = base64.b64decode(first.findtext("task") or "").decode()
        assert "domain lamps {" in task
        assert "instance two {" in task
        client.say("<resource-request/>")
        assert client.heard("resource-notification").findtext("memory-left") == "0"
        rewards = [play(client) for _ in range(40)]
        last = client.heard("session-end")
        assert float(last.findtext("total-reward") or "") == pytest.approx(sum(rewards))
        (found,) = ended(process, 0)
    assert found["client"] == "mine"
    assert found["rewards"] == rewards
    assert found["failure"] == ""
    # 2 for each lamp that is lit, less 1 for each press; 10 where both are.
    assert set(rewards) <= {12.0, 0.0, -2.0}
    assert 0 < found["goal_rate"] < 1
    assert found["goal_rate"] == rewards.count(12.0) / 40
    assert found["mean"] == pytest.approx(sum(rewards) / 40)
    assert found["error"] > 0


def test_all_fluents_are_told_and_phases_alternate(tmp_path: Path) -> None:
    with serving(tmp_path, "--rounds", "1", "--env", "here") as (port, _):
        client = Client(port)
        client.begin()
        before = observed(client.round())
        assert before["applying",] == before["doing_press", HALL] == "false"
        assert before["outcome_press",].startswith("@press_")
        client.say(act("press", HALL))
        between = observed(client.heard("turn"))
        assert between.keys() == before.keys()
        assert between["applying",] == between["doing_press", HALL] == "true"
        assert between["on", HALL] == "false"
        client.say(act())
        turn = client.heard("turn")
        after = observed(turn)
        assert turn.findtext("immediate-reward") == "1.0"
        assert after["on", HALL] == after["applied",] == "true"
        assert after["applying",] == after["doing_press", HALL] == "false"


def test_a_client_without_headers(tmp_path: Path) -> None:
    with serving(tmp_path, "--rounds", "1") as (port, _):
        client = Client(port)
        client.say("<session-request><client-name>c</client-name><no-header/></session-request>")
        data = b""
        while not data.endswith(b"</session-init>"):
            data += client.socket.recv(65536)
        assert data.startswith(b"<session-init>")
        assert b"\0" not in data


BEGIN = "<session-request><client-name>c</client-name></session-request>"
ROUND = "<round-request/>"


@pytest.mark.parametrize(
    ("said", "failure"),
    [
        ([], "nothing came where `session-request` is due"),
        (["<actions/>"], "`actions` came where `session-request` is due"),
        (["<session-request>"], "a message is no XML"),
        (["\udcff\udcfe"], "a message is no XML"),
        (['<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>'], "declarations in its XML, or comments"),
        ([BEGIN, "<actions/>"], "`actions` came where a round begins"),
        ([BEGIN], "the client ended the session early"),
        ([BEGIN, ROUND, ROUND], "`round-request` came where actions are due"),
        ([BEGIN, ROUND], "the client ended the session in the middle of a round"),
        ([BEGIN, ROUND, act("press", "nobody")], "`press` has no arguments `nobody`"),
        ([BEGIN, ROUND, act("press")], "`press` has no arguments ``"),
        ([BEGIN, ROUND, act("jump", HALL)], "there is no action `jump`"),
        ([BEGIN, ROUND, act()], "no action was sent where one has to be executed"),
        (
            [BEGIN, ROUND, act("press", HALL), act("press", SUM)],
            "an action was sent in the second phase",
        ),
        (
            [BEGIN, ROUND, act("press", HALL), act(), act("press", HALL)],
            "`press(hall_lamp)` does not apply in this state",
        ),
        (
            [BEGIN, ROUND, f"<actions>{2 * act('press', HALL)[9:-10]}</actions>"],
            "2 actions were sent at once",
        ),
    ],
)
def test_a_client_that_breaks_the_protocol(tmp_path: Path, said: list[str], failure: str) -> None:
    with serving(tmp_path, "--rounds", "1", "--sessions", "2", "--env", "here") as (port, process):
        client = Client(port)
        for text in said:
            client.socket.sendall(text.encode("utf-8", "surrogateescape") + b"\0")
        client.socket.shutdown(socket.SHUT_WR)
        while (message := client.hear()) is not None:
            last = message
        if said:
            assert last.tag == "error"
            assert failure in (last.text or "")
        again = Client(port)
        again.begin()
        assert play(again) == 12.0
        bad, good = ended(process, 5)
    assert failure in bad["failure"]
    assert good["failure"] == ""
    assert good["goal_rate"] == 1.0


def test_a_client_that_is_slow_or_says_too_much(tmp_path: Path) -> None:
    options = ("--rounds", "1", "--sessions", "4", "--patience", "0.5")
    with serving(tmp_path, *options) as (port, process):
        slow = Client(port)
        start = time.monotonic()
        try:
            while time.monotonic() - start < 15:
                slow.socket.sendall(b" ")
                time.sleep(0.05)
        except OSError:
            pass
        assert time.monotonic() - start < 10
        long = Client(port)
        with suppress(OSError):
            for _ in range(4000):
                long.socket.sendall(b"<" * 65536)
            raise AssertionError("it reads on and on")
        gone = Client(port)
        gone.socket.sendall(b"<session-request>")
        gone.socket.close()
        silent = Client(port)
        message = silent.heard("error")
        assert "no whole message came within 0.5 s" in (message.text or "")
        found = ended(process, 5)
    assert [each["failure"] for each in found] == [
        "no whole message came within 0.5 s",
        "a message has more than 1048576 bytes",
        "the connection ended in the middle of a message",
        "no whole message came within 0.5 s",
    ]


def test_a_scene_behind_the_protocol(tmp_path: Path) -> None:
    """Any environment of a run file plays: here the outcome bank of the scenes."""
    hdd = ROOT / "domains" / "hdd"
    files = (str(hdd / "domain.menid"), str(hdd / "drive.menid"), "--run", str(hdd / "bank.toml"))
    with servers.serving(tmp_path, "rddlsim", *files, "--rounds", "1", "--horizon", "2") as (
        port,
        server,
    ):
        client = Client(port)
        client.begin()
        client.round()
        client.say(act("lever_seated", "n8", "tray", "board"))
        client.heard("turn")
        client.say(act())
        turn = client.heard("turn")
        assert observed(turn)["on_table", "board"] == "true"
        assert float(turn.findtext("immediate-reward") or "") == 1.0
        for _ in range(2):
            client.say(act())
            last = client.hear()
        assert last is not None
        assert last.tag == "round-end"
        client.heard("session-end")
        (found,) = ended(server, 0)
    assert found["goal_rate"] == 1.0


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        (["--env", "elsewhere", "--horizon", "3"], 3, "`elsewhere`"),
        (["--port", "70000"], 2, "--port"),
        (["--patience", "0"], 2, "--patience"),
    ],
)
def test_what_is_refused(
    menid: Menid, tmp_path: Path, options: list[str], code: int, message: str
) -> None:
    (tmp_path / "lamps.menid").write_text(LAMP, encoding="utf-8")
    result = menid("serve", "rddlsim", *FILES, *options)
    assert result.exit_code == code, result.output
    assert message in result.stderr


def test_a_port_that_is_taken(menid: Menid, tmp_path: Path) -> None:
    (tmp_path / "lamps.menid").write_text(LAMP, encoding="utf-8")
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        result = menid("serve", "rddlsim", *FILES, "--port", str(port))
    assert result.exit_code == 5
    assert f"port {port} of 127.0.0.1: " in result.stderr
    assert "choose another port" in result.stderr


def test_a_horizon_is_needed(menid: Menid, tmp_path: Path) -> None:
    (tmp_path / "lamps.menid").write_text(LAMP.replace("horizon 4", ""), encoding="utf-8")
    result = menid("serve", "rddlsim", *FILES)
    assert result.exit_code == 2
    assert "give --horizon" in result.stderr
