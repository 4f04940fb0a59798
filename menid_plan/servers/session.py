"""A session with one client, whatever the protocol: its time, its results, and how it fails."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from contextlib import suppress
from xml.etree import ElementTree

from menid_plan.errors import MenidError
from menid_plan.servers.play import Player, Results
from menid_plan.servers.wire import ProtocolError, Wire, element


class Session(ABC):
    """One session with one client; ``seconds`` is how long it may take in all."""

    def __init__(self, wire: Wire, player: Player, rounds: int, seconds: float) -> None:
        self._wire, self._player, self._rounds = wire, player, rounds
        self._until = time.monotonic() + seconds
        self.results = Results()

    def run(self) -> Results:
        """Play the session to its end; what is wrong with the client ends it, and is in the results."""
        try:
            self._play()
        except MenidError as error:
            self.results.failure = str(error)
            with suppress(ProtocolError):  # nobody may be there to be told
                self._send(element("error", error))
        return self.results

    @abstractmethod
    def _play(self) -> None:
        """Play all rounds."""

    @abstractmethod
    def _next(self) -> ElementTree.Element | None:
        """The next message; None where the client has closed the connection."""

    @abstractmethod
    def _send(self, message: ElementTree.Element) -> None:
        """Send a message."""

    def _receive(self) -> ElementTree.Element | None:
        """The next message, while there is time."""
        if not self._left():
            raise ProtocolError("the session has taken all of its time")
        return self._next()

    def _expect(self, tag: str) -> ElementTree.Element:
        """The next message, which has to be of that kind."""
        message = self._receive()
        if message is None or message.tag != tag:
            came = "nothing" if message is None else f"`{message.tag}`"
            raise ProtocolError(f"{came} came where `{tag}` is due")
        return message

    def _left(self) -> int:
        """Milliseconds that the session has left."""
        return max(int(1000 * (self._until - time.monotonic())), 0)
