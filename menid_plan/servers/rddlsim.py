"""The protocol of rddlsim (Sanner 2010): a planner such as PROST acts in an environment.

What the planner is told is the RDDL of the dialect ``prost``: a step of the environment is two turns.
In the first the planner chooses an action, which is executed at once; what it led to is shown after the
second, in which nothing can be done.
"""

from __future__ import annotations

import base64
import itertools
from collections.abc import Iterator
from xml.etree import ElementTree

from menid_plan.exchange.flat import Call
from menid_plan.exchange.rddl import Written
from menid_plan.exchange.rddl_model import APPLIED, APPLYING
from menid_plan.grounding.state import Binding, GroundAction, State
from menid_plan.servers import session
from menid_plan.servers.play import Player
from menid_plan.servers.wire import ProtocolError, Wire, element, words

HEADER = b'<?xml version="1.0" encoding="UTF-8"?>'


class Session(session.Session):
    """One session with one client."""

    def __init__(
        self, wire: Wire, written: Written, player: Player, rounds: int, seconds: float
    ) -> None:
        """``seconds``: how long the session may take in all."""
        super().__init__(wire, player, rounds, seconds)
        self._written = written
        self._bare = False
        self._fluents = list(_state_fluents(written))
        self._objects = {new: old for old, new in written.objects.items()}

    # ------------------------------------------------------------------------------------ protocol

    def _play(self) -> None:
        request = self._expect("session-request")
        if words(request, "input-language").lower() not in ("", "rddl"):
            raise ProtocolError("the task is there in RDDL alone")
        self._bare = request.find("no-header") is not None
        self.results.client = words(request, "client-name")
        task = base64.b64encode(f"{self._written.domain}\n{self._written.instance}".encode())
        self._send(
            element(
                "session-init", "",
                element("task", task.decode()), element("session-id", 1),
                element("num-rounds", self._rounds), element("time-allowed", self._left()),
            )
        )  # fmt: skip
        while len(self.results.rounds) < self._rounds:
            message = self._receive()
            if message is None:
                raise ProtocolError("the client ended the session early")
            if message.tag == "session-end":
                break
            if message.tag == "resource-request":
                self._tell_resources()
                continue
            if message.tag != "round-request":
                raise ProtocolError(f"`{message.tag}` came where a round begins")
            self._round()
        total = sum(each.reward for each in self.results.rounds)
        self._send(
            element(
                "session-end", "",
                element("instance-name", self._name), element("total-reward", total),
                element("rounds-used", len(self.results.rounds)),
                element("client-name", self.results.client), element("session-id", 1),
                element("time-left", self._left()),
            )
        )  # fmt: skip

    def _round(self) -> None:
        player = self._player
        number = len(self.results.rounds) + 1
        state = player.begin()
        self._send(
            element(
                "round-init", "",
                element("round-num", number), element("round-left", self._rounds - number),
                element("time-left", self._left()),
            )
        )  # fmt: skip
        shown = self._observed(state)
        doing: GroundAction | None = None  # what was executed, and not yet shown
        paid = reward = 0.0
        for turn in range(1, self._written.horizon + 1):
            self._send(
                element(
                    "turn", "",
                    element("turn-num", turn), element("time-left", self._left()),
                    element("immediate-reward", reward), *shown,
                )
            )  # fmt: skip
            chosen = self._actions()
            reward = 0.0
            if doing is not None:
                if chosen is not None:
                    raise ProtocolError("an action was sent in the second phase of a step")
                doing, reward = None, paid
                shown = self._observed(player.state, applied=True)
            elif chosen is None:
                if not player.over and turn < self._written.horizon:
                    raise ProtocolError("no action was sent where one has to be executed")
                shown = self._observed(player.state)
            elif turn == self._written.horizon and self._written.horizon % 2:
                pass  # the last first phase is there for what the end pays
            else:
                name, arguments = chosen
                before = player.state
                call, binding = self._called(name, arguments)
                doing = call.bound(binding)
                if not player.applies(call, binding):
                    listed = f"({', '.join(arguments)})" if arguments else ""
                    raise ProtocolError(f"`{name}{listed}` does not apply in this state")
                paid = player.act(doing)
                shown = self._observed(before, doing=chosen)
        found = player.end()
        self.results.rounds.append(found)
        self._send(
            element(
                "round-end", "",
                element("instance-name", self._name), element("client-name", self.results.client),
                element("round-num", number), element("round-reward", found.reward),
                element("turns-used", self._written.horizon), element("time-left", self._left()),
                element("immediate-reward", reward),
            )
        )  # fmt: skip

    def _actions(self) -> tuple[str, tuple[str, ...]] | None:
        """The action fluent that is to be true, with its objects."""
        while True:
            message = self._receive()
            if message is None:
                raise ProtocolError("the client ended the session in the middle of a round")
            if message.tag != "resource-request":
                break
            self._tell_resources()
        if message.tag != "actions":
            raise ProtocolError(f"`{message.tag}` came where actions are due")
        found = [each for each in message.iter("action") if words(each, "action-value") == "true"]
        if len(found) > 1:
            raise ProtocolError(f"{len(found)} actions were sent at once")
        if not found:
            return None
        arguments = tuple((each.text or "").strip() for each in found[0].findall("action-arg"))
        name = words(found[0], "action-name")
        if name not in self._written.actions:
            raise ProtocolError(f"there is no action `{name}`")
        spaces = self._written.spaces[name]
        fits = len(arguments) == len(spaces)
        if not fits or any(a not in s for a, s in zip(arguments, spaces, strict=True)):
            raise ProtocolError(f"`{name}` has no arguments `{', '.join(arguments)}`")
        return name, arguments

    def _called(self, name: str, arguments: tuple[str, ...]) -> tuple[Call, Binding]:
        parameters, call = self._written.actions[name]
        objects = (self._objects[each] for each in arguments)
        return call, dict(zip(parameters, objects, strict=True))

    def _observed(
        self,
        state: State,
        *,
        doing: tuple[str, tuple[str, ...]] | None = None,
        applied: bool = False,
    ) -> list[ElementTree.Element]:
        """All state fluents: planners keep the old value of one that is missing."""
        names, written = self._written.names, self._written
        true: set[tuple[str, tuple[str, ...]]] = set()
        for atom in state:
            if atom in written.facts:
                true.add((written.facts[atom], ()))
            elif atom.predicate in written.facts:
                arguments = tuple(written.objects[each] for each in atom.arguments)
                true.add((written.facts[atom.predicate], arguments))
        if doing is not None:
            true.add((names[APPLYING], ()))
            true.add((written.doing[doing[0]], doing[1]))
        if applied:
            true.add((names[APPLIED], ()))
        found = []
        for name, arguments in self._fluents:
            values = written.values.get(name)
            value = f"@{values[-1]}" if values else str((name, arguments) in true).lower()
            found.append(
                element(
                    "observed-fluent", "", element("fluent-name", name),
                    *(element("fluent-arg", each) for each in arguments),
                    element("fluent-value", value),
                )
            )  # fmt: skip
        return found

    # ------------------------------------------------------------------------------------ messages

    @property
    def _name(self) -> str:
        return self._player.spec.problem.name

    def _tell_resources(self) -> None:
        left = element("time-left", self._left())
        self._send(element("resource-notification", "", left, element("memory-left", 0)))

    def _next(self) -> ElementTree.Element | None:
        return self._wire.receive()

    def _send(self, message: ElementTree.Element) -> None:
        data = ElementTree.tostring(message)
        self._wire.send(data if self._bare else HEADER + data + b"\0")


def _state_fluents(written: Written) -> Iterator[tuple[str, tuple[str, ...]]]:
    for name, spaces in written.spaces.items():
        if name not in written.actions:
            for arguments in itertools.product(*spaces):
                yield name, arguments
