"""A client of mdpsim plays rounds; one that breaks the protocol ends its session, and no more."""

from __future__ import annotations

import socket
import subprocess
import time
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from xml.etree import ElementTree

import pytest

import servers
from servers import closed, connected, ended, lines_of

__all__ = ["closed"]  # a fixture of every test

LAMP = """
domain lamps
environment there: target
environment here: test
type lamp
predicate on(lamp)
predicate dead(lamp)
predicate lamp-of(lamp)
action press(l: lamp) cost 1 {
  rule press {
    when not on(l) and not dead(l) and lamp-of(l)
    outcomes there here { lit: 0.75 0.9999 on(l) reward 2  blown: 0.25 0.0001 dead(l) }
  }
}
problem two for lamps
object hall-lamp, Forall: lamp
init lamp-of(hall-lamp), lamp-of(Forall)
goal on(hall-lamp) and on(Forall) reward 10
"""
LAMPS = ("hall-lamp", "Forall_2")  # as they are called in PPDDL, where `forall` is a word


class Client:
    """Says what it is told to, and reads lines."""

    def __init__(self, port: int) -> None:
        self.socket = connected(port)
        self.lines = lines_of(self.socket)

    def say(self, text: str) -> None:
        self.socket.sendall(text.encode())

    def hear(self) -> ElementTree.Element | None:
        line = self.lines.readline()
        return ElementTree.fromstring(line) if line else None

    def heard(self, tag: str) -> ElementTree.Element:
        message = self.hear()
        assert message is not None, f"the server closed where {tag} is due"
        assert message.tag == tag, ElementTree.tostring(message)
        return message

    def begin(self) -> ElementTree.Element:
        self.say("<session-request><name>mine</name><problem>two</problem></session-request>")
        return self.heard("session-init")


def act(name: str, *terms: str) -> str:
    listed = "".join(f"<term>{each}</term>" for each in terms)
    return f"<act><action><name>{name}</name>{listed}</action></act>"


def holds(state: ElementTree.Element) -> set[tuple[str, ...]]:
    return {
        (atom.findtext("predicate") or "", *(term.text or "" for term in atom.findall("term")))
        for atom in state.findall("atom")
    }


def play(client: Client) -> tuple[bool, int]:
    """A round: press what is off; whether the goal was reached, and after how many turns."""
    client.say("<round-request/>")
    client.heard("round-init")
    while (message := client.hear()) is not None and message.tag == "state":
        known = {atom[1] for atom in holds(message)}
        client.say(act("press", next(lamp for lamp in LAMPS if lamp not in known)))
    assert message is not None
    assert message.tag == "end-round"
    assert message.find("state") is not None
    return message.find("goal-reached") is not None, int(message.findtext("turns-used") or "")


def serving(
    folder: Path, *options: str
) -> AbstractContextManager[tuple[int, subprocess.Popen[str]]]:
    (folder / "lamps.menid").write_text(LAMP, encoding="utf-8")
    return servers.serving(folder, "mdpsim", "lamps.menid", "-o", "out", *options)


def test_a_whole_session(tmp_path: Path) -> None:
    with serving(tmp_path, "--rounds", "40", "--seed", "5") as (port, process):
        assert "(define (domain lamps)" in (tmp_path / "out" / "domain.pddl").read_text()
        client = Client(port)
        setting = client.begin().find("setting")
        assert setting is not None
        assert setting.findtext("rounds") == "40"
        assert setting.findtext("allowed-turns") == "1000"
        rounds = [play(client) for _ in range(40)]
        last = client.heard("end-session")
        (found,) = ended(process, 0)
    goals = sum(goal for goal, _ in rounds)
    assert 0 < goals < 40
    assert last.findtext("goals/failed") == str(40 - goals)
    assert last.findtext("goals/reached/successes") == str(goals)
    assert float(last.findtext("metric-average") or "") == pytest.approx(found["mean"])
    assert found["goal_rate"] == goals / 40
    assert found["steps"] == [turns for _, turns in rounds]
    # 2 for each lamp that is lit, less 1 for each press; 10 where both are.
    assert set(found["rewards"]) <= {12.0, 0.0, -2.0}


def test_only_what_can_change_is_told(tmp_path: Path) -> None:
    with serving(tmp_path, "--env", "here") as (port, _):
        client = Client(port)
        client.begin()
        client.say("<round-request/>")
        client.heard("round-init")
        assert holds(client.heard("state")) == set()
        client.say(f"\n  {act('PRESS', 'FORALL_2')}\n")
        assert holds(client.heard("state")) == {("on", "Forall_2")}
        client.say("<done/>")
        last = client.heard("end-round")
        assert last.findtext("turns-used") == "1"
        assert last.find("goal-reached") is None


def test_messages_in_pieces_and_together(tmp_path: Path) -> None:
    with serving(tmp_path, "--env", "here", "--rounds", "1") as (port, process):
        client = Client(port)
        text = (
            "<session-request><name>a &gt; b</name></session-request>\n<round-request></round-request>"
            f"{act('press', 'hall-lamp')}{act('press', 'Forall_2')}"
        )
        for k in range(0, len(text), 7):
            client.say(text[k : k + 7])
            time.sleep(0.002)
        tags = []
        while (message := client.hear()) is not None:
            tags.append(message.tag)
        assert tags == ["session-init", "round-init", "state", "state", "end-round", "end-session"]
        (found,) = ended(process, 0)
    assert found["client"] == "a > b"
    assert found["rewards"] == [12.0]


def test_an_action_that_does_not_apply_ends_the_round(tmp_path: Path) -> None:
    with serving(tmp_path, "--env", "here", "--rounds", "2") as (port, process):
        client = Client(port)
        client.begin()
        client.say("<round-request/>" + 2 * act("press", "hall-lamp"))
        for tag in ("round-init", "state", "state", "error", "end-round"):
            message = client.heard(tag)
            if tag == "error":
                assert message.text == "`(press hall-lamp)` does not apply in this state"
        assert play(client) == (True, 2)
        client.heard("end-session")
        (found,) = ended(process, 0)
    assert found["steps"] == [1, 2]


TWO_RULES = """
domain d
type t
predicate at(t)
predicate p(t)
action go(x: t) {
  rule moves { the h: t where at(h) when h != x outcomes { o: 1 not at(h), at(x) } }
  rule stays { the h: t where at(h) when h = x outcomes { o: 1 p(x) } }
}
problem pr for d
object a, b: t
init at(a)
goal p(b)
"""


@pytest.mark.parametrize(
    ("form", "wrong"),
    [
        ("--lifted", ("go-stays", "b", "b")), ("--lifted", ("go-moves", "b", "b")),
        ("--grounded", ("go-b-stays-b",)), ("--states", ("go_b_2",)),
    ],
)  # fmt: skip
def test_an_action_that_applies_by_another_rule(
    tmp_path: Path, form: str, wrong: tuple[str, ...]
) -> None:
    """`go(b)` applies, but what the file says of the action that was sent does not hold."""
    (tmp_path / "two.menid").write_text(TWO_RULES, encoding="utf-8")
    options = ("mdpsim", "two.menid", form, "--rounds", "1", "-o", "out")
    with servers.serving(tmp_path, *options) as (port, process):
        client = Client(port)
        client.begin()
        assert f"(:action {wrong[0]}\n" in (tmp_path / "out" / "domain.pddl").read_text()
        client.say("<round-request/>" + act(*wrong))
        for tag in ("round-init", "state", "error", "end-round", "end-session"):
            client.heard(tag)
        (found,) = ended(process, 0)
    assert found["steps"] == [0]


def test_the_horizon_is_how_many_turns_there_are(tmp_path: Path) -> None:
    with serving(tmp_path, "--env", "here", "--rounds", "1", "--horizon", "1") as (port, _):
        client = Client(port)
        setting = client.begin().find("setting")
        assert setting is not None
        assert setting.findtext("allowed-turns") == "1"
        assert play(client) == (False, 1)


BEGIN = "<session-request><name>c</name></session-request>"
ROUND = "<round-request/>"


@pytest.mark.parametrize(
    ("said", "failure"),
    [
        ("", "nothing came where `session-request` is due"),
        ("<act/>", "`act` came where `session-request` is due"),
        ("<session-request>", "the connection ended in the middle of a message"),
        ("<a></b>", "a message is no XML"),
        ("hello <a/>", "a message is no XML"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "declarations in its XML, or comments"),
        (BEGIN + "<act/>", "`act` came where a round begins"),
        (BEGIN, "the client ended the session early"),
        (BEGIN + ROUND + ROUND, "`round-request` came where an action is due"),
        (BEGIN + ROUND, "the client ended the session in the middle of a round"),
        (BEGIN + ROUND + act("press", "nobody"), "`press` has no arguments `nobody`"),
        (BEGIN + ROUND + act("press"), "`press` has no arguments ``"),
        (BEGIN + ROUND + act("jump"), "there is no action `jump`"),
    ],
)
def test_a_client_that_breaks_the_protocol(tmp_path: Path, said: str, failure: str) -> None:
    with serving(tmp_path, "--rounds", "1", "--sessions", "2", "--env", "here") as (port, process):
        client = Client(port)
        client.say(said)
        client.socket.shutdown(socket.SHUT_WR)
        last = None
        while (message := client.hear()) is not None:
            last = message
        assert last is not None
        assert last.tag == "error"
        assert failure in (last.text or "")
        again = Client(port)
        again.begin()
        assert play(again) == (True, 2)
        again.heard("end-session")
        bad, good = ended(process, 5)
    assert failure in bad["failure"]
    assert good["failure"] == ""


def test_a_client_that_is_slow_or_says_too_much(tmp_path: Path) -> None:
    options = ("--rounds", "1", "--sessions", "2", "--patience", "0.5")
    with serving(tmp_path, *options) as (port, process):
        slow = Client(port)
        with suppress(OSError):
            for _ in range(300):
                slow.say(" ")
                time.sleep(0.05)
            raise AssertionError("it waits on and on")
        long = Client(port)
        with suppress(OSError):
            long.say("<a>")
            for _ in range(4000):
                long.say("b" * 65536)
            raise AssertionError("it reads on and on")
        found = ended(process, 5)
    assert [each["failure"] for each in found] == [
        "no whole message came within 0.5 s",
        "a message has more than 1048576 bytes",
    ]
