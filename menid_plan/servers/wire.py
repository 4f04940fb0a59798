"""Messages over a connection: bounded in size and in time, and XML without tricks."""

from __future__ import annotations

import socket
import time
from xml.etree import ElementTree
from xml.parsers import expat

from menid_plan.errors import MenidError

MOST = 1 << 20  # bytes of a message


_DECLARES = "a message has declarations in its XML, or comments, which are not read"


class ProtocolError(MenidError):
    """The other side does not keep to the protocol, is too slow, or is gone."""

    exit_code = 5


class Wire:
    """One side of a connection. A message has to be whole in so many seconds."""

    def __init__(self, connection: socket.socket, seconds: float) -> None:
        self._socket, self._seconds = connection, seconds
        # A message is often sent in two pieces, the second of which is not to wait for an answer.
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._rest = b""

    def receive(self) -> ElementTree.Element | None:
        """The next message, up to a NUL; None where the other side has closed the connection."""
        until = time.monotonic() + self._seconds
        while b"\0" not in self._rest:
            if not self._more(until):
                return None
        message, _, self._rest = self._rest.partition(b"\0")
        if len(message) > MOST:
            raise ProtocolError(f"a message has more than {MOST} bytes")
        return parsed(message)

    def receive_element(self) -> ElementTree.Element | None:
        """The next message, which ends where its element does; None as above."""
        until = time.monotonic() + self._seconds
        ending, fed = _Ending(), 0
        while ending.place is None:
            if not fed:
                self._rest = self._rest.lstrip()
            ending.feed(self._rest[fed:])
            fed = len(self._rest)
            if ending.place is None and not self._more(until):
                return None
        end = ending.place
        if self._rest.startswith(b"</", end):  # an element without an end tag ends there
            end = self._rest.index(b">", end) + 1
        message, self._rest = self._rest[:end], self._rest[end:]
        return parsed(message)

    def _more(self, until: float) -> bool:
        """Wait for more of a message; False where the other side has closed the connection."""
        if len(self._rest) > MOST:
            raise ProtocolError(f"a message has more than {MOST} bytes")
        while True:
            left = until - time.monotonic()
            if left <= 0:
                raise ProtocolError(f"no whole message came within {self._seconds:g} s")
            try:
                self._socket.settimeout(left)
                data = self._socket.recv(65536)
            except TimeoutError:
                continue
            except ConnectionResetError:  # it ended before it had read everything
                data = b""
            except OSError as error:
                raise ProtocolError(f"the connection broke: {error.strerror}") from error
            self._rest += data
            if not data and self._rest.strip():
                raise ProtocolError("the connection ended in the middle of a message")
            return bool(data)

    def send(self, data: bytes) -> None:
        """Send a message as it is."""
        try:
            self._socket.settimeout(self._seconds)
            self._socket.sendall(data)
        except OSError as error:
            raise ProtocolError(f"the connection broke: {error.strerror or error}") from error


class _Ending:
    """Finds where the first element ends in what is fed, piece by piece.

    ``place`` is where its end tag begins, or if it has none, where it ends; None as long as that has
    not come.
    """

    def __init__(self) -> None:
        self.place: int | None = None
        self._depth = 0
        self._parser = expat.ParserCreate("utf-8")
        self._parser.StartElementHandler = self._begins
        self._parser.EndElementHandler = self._ends
        self._parser.StartDoctypeDeclHandler = self._declares

    def feed(self, data: bytes) -> None:
        """Look at some more; ProtocolError for what is no XML, or declares entities."""
        try:
            self._parser.Parse(data, False)
        except expat.ExpatError as error:
            if self.place is None:  # else it is what comes after it
                raise ProtocolError(f"a message is no XML: {error}") from error

    def _begins(self, _name: str, _attributes: object) -> None:
        self._depth += 1

    def _ends(self, _name: str) -> None:
        self._depth -= 1
        if self._depth == 0:
            self.place = self._parser.CurrentByteIndex

    def _declares(self, *_: object) -> None:
        raise ProtocolError(
            "a message has declarations in its XML, or comments, which are not read"
        )


def parsed(message: bytes) -> ElementTree.Element:
    """The XML of a message; ProtocolError if it is none, or declares entities."""
    try:
        text = message.decode().strip()
        if "<!" in text:
            raise ProtocolError(
                "a message has declarations in its XML, or comments, which are not read"
            )
        return ElementTree.fromstring(text)  # noqa: S314 - what it warns of are declarations
    except (ElementTree.ParseError, ValueError) as error:
        raise ProtocolError(f"a message is no XML: {error}") from error


def element(name: str, text: object = "", *children: ElementTree.Element) -> ElementTree.Element:
    """An element of a message."""
    made = ElementTree.Element(name)
    made.text = str(text)
    made.extend(children)
    return made


def words(found: ElementTree.Element, name: str) -> str:
    """The text of a part of a message; empty if there is none."""
    return (found.findtext(name) or "").strip()
