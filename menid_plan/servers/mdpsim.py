"""The protocol of mdpsim, the server of the probabilistic tracks of 2004 to 2008 (Younes et al. 2005).

A planner has read the PPDDL files itself; it is shown the atoms that hold and can change, and answers
with an action of the domain file.
"""

from __future__ import annotations

import time
from xml.etree import ElementTree

from menid_plan.exchange.flat import Call
from menid_plan.exchange.ppddl import Written
from menid_plan.grounding.state import Binding
from menid_plan.servers import session
from menid_plan.servers.play import Player
from menid_plan.servers.wire import ProtocolError, Wire, element, words


class Session(session.Session):
    """One session with one client."""

    def __init__(
        self, wire: Wire, written: Written, player: Player, rounds: int, turns: int, seconds: float
    ) -> None:
        """``turns``: how many actions a round has at most; ``seconds``: how long all may take."""
        super().__init__(wire, player, rounds, seconds)
        self._written, self._turns = written, turns
        self._objects = {new.lower(): old for old, new in written.objects.items()}
        self._changing = player.spec.domain.changing & written.predicates.keys()

    def _play(self) -> None:
        request = self._expect("session-request")
        self.results.client = words(request, "name")
        self._send(
            element(
                "session-init", "", element("sessionID", 1),
                element(
                    "setting", "", element("rounds", self._rounds),
                    element("allowed-time", self._left()), element("allowed-turns", self._turns),
                ),
            )
        )  # fmt: skip
        while len(self.results.rounds) < self._rounds:
            message = self._receive()
            if message is None:
                raise ProtocolError("the client ended the session early")
            if message.tag != "round-request":
                raise ProtocolError(f"`{message.tag}` came where a round begins")
            self._round()
        rounds = self.results.rounds
        reached = [each for each in rounds if each.goal]
        average = sum(each.reward for each in rounds) / len(rounds)
        self._send(
            element(
                "end-session", "", element("sessionID", 1), element("rounds", len(rounds)),
                element(
                    "goals", "", element("failed", len(rounds) - len(reached)),
                    element("reached", "", element("successes", len(reached))),
                ),
                element("metric-average", average),
            )
        )  # fmt: skip

    def _round(self) -> None:
        player = self._player
        number = len(self.results.rounds) + 1
        begin = time.monotonic()
        player.begin()
        self._send(
            element(
                "round-init", "", element("sessionID", 1), element("round", number),
                element("time-left", self._left()), element("rounds-left", self._rounds - number),
            )
        )  # fmt: skip
        while not player.over and player.round.steps < self._turns:
            self._send(self._state())
            called = self._called()
            if called is None:
                break
            said, call, binding = called
            if not player.applies(call, binding):
                # As mdpsim has it, that ends the round, and not the session.
                self._send(element("error", f"`{said}` does not apply in this state"))
                break
            player.act(call.bound(binding))
        found = player.end()
        self.results.rounds.append(found)
        spent = int(1000 * (time.monotonic() - begin))
        parts = [element("sessionID", 1), element("round", number), self._state()]
        if found.goal:
            parts.append(element("goal-reached"))
        parts += [element("time-spent", spent), element("turns-used", found.steps)]
        self._send(element("end-round", "", *parts))

    def _called(self) -> tuple[str, Call, Binding] | None:
        """What the client does, in its words and what that means; None if it gives the round up."""
        message = self._receive()
        if message is None:
            raise ProtocolError("the client ended the session in the middle of a round")
        if message.tag == "done":
            return None
        action = message.find("action")
        if message.tag == "act" and action is None:
            raise ProtocolError("an `act` came without an action")
        if message.tag != "act" or action is None:
            raise ProtocolError(f"`{message.tag}` came where an action is due")
        name = words(action, "name").lower()
        terms = [(each.text or "").strip().lower() for each in action.findall("term")]
        if name not in self._written.calls:
            raise ProtocolError(f"there is no action `{name}`")
        parameters, call = self._written.calls[name]
        unknown = [each for each in terms if each not in self._objects]
        if unknown or len(terms) != len(parameters):
            raise ProtocolError(f"`{name}` has no arguments `{', '.join(terms)}`")
        objects = (self._objects[each] for each in terms)
        said = f"({' '.join([name, *terms])})"
        return said, call, dict(zip(parameters, objects, strict=True))

    def _state(self) -> ElementTree.Element:
        """The atoms that hold and can change."""
        predicates, objects = self._written.predicates, self._written.objects
        atoms = [
            element(
                "atom", "", element("predicate", predicates[atom.predicate]),
                *(element("term", objects[each]) for each in atom.arguments),
            )
            for atom in sorted(self._player.state)
            if atom.predicate in self._changing
        ]  # fmt: skip
        return element("state", "", *atoms)

    def _next(self) -> ElementTree.Element | None:
        return self._wire.receive_element()

    def _send(self, message: ElementTree.Element) -> None:
        self._wire.send(ElementTree.tostring(message) + b"\n")
