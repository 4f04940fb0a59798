"""What the rddlsim server itself needs for a turn, by the number of state fluents.

    python benchmarks/serving.py [TURNS]

A client of rddlsim that waits for nothing plays rounds on a ring of lamps; the time is that of the
server from a message to its answer, in milliseconds: the median, and the 95th of 100.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from xml.etree import ElementTree

import numpy as np

import menid_plan
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.simulated import Simulated
from menid_plan.exchange.lifted import lifted
from menid_plan.exchange.rddl import rddl
from menid_plan.servers.play import Player
from menid_plan.servers.rddlsim import Session

DOMAIN = """
domain ring
type lamp
predicate on(lamp)
action press(l: lamp) {
  rule press { outcomes { lit: 0.5 on(l)  dark: 0.5 not on(l) } }
}
problem all for ring
object LAMPS: lamp
"""


class Client:
    """Answers at once, in the place of a connection, and keeps how long the server took."""

    def __init__(self, turns: int) -> None:
        self.turns = turns
        self.times: list[float] = []
        self._messages = self._said()
        self._asked = time.perf_counter()

    def _said(self) -> Iterator[str]:
        yield "<session-request/>"
        yield "<round-request/>"
        press = (
            "<actions><action><action-name>press</action-name><action-arg>l0</action-arg>"
            "<action-value>true</action-value></action></actions>"
        )
        for turn in range(self.turns):
            yield "<actions/>" if turn % 2 else press

    def receive(self) -> ElementTree.Element:
        """The next message; the server's time begins."""
        message = ElementTree.fromstring(next(self._messages))
        self._asked = time.perf_counter()
        return message

    def send(self, data: bytes) -> None:
        """The server's time ends."""
        if data.find(b"<turn>") >= 0:
            self.times.append(1000 * (time.perf_counter() - self._asked))


def main(turns: int) -> None:
    print("fluents    median      95 %   (ms of the server's own for a turn)")
    for lamps in (10, 49, 200):
        names = ", ".join(f"l{k}" for k in range(lamps))
        document = menid_plan.parse(DOMAIN.replace("LAMPS", names))
        domain, problem = document.domain, document.problem
        assert domain is not None
        assert problem is not None
        written = rddl(lifted(domain, problem, split=False), "prost", turns // 2)
        player = Player(EnvironmentSpec(domain.target, Simulated(), domain, problem))
        client = Client(turns)
        session = Session(client, written, player, 1, 1e6)  # type: ignore[arg-type]
        results = session.run()
        assert not results.failure, results.failure
        times = np.array(client.times[1:])
        fluents = len(session._fluents)
        print(f"{fluents:7} {np.median(times):9.3f} {np.percentile(times, 95):9.3f}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else 2000)
