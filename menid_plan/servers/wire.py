"""Messages over a connection: bounded in size and in time, and XML without tricks."""

from __future__ import annotations

import socket
import time
from xml.etree import ElementTree

from menid_plan.errors import MenidError

MOST = 1 << 20  # bytes of a message


class ProtocolError(MenidError):
    """The other side does not keep to the protocol, is too slow, or is gone."""

    exit_code = 5


class Wire:
    """One side of a connection. A message has to be whole in so many seconds."""

    def __init__(self, connection: socket.socket, seconds: float) -> None:
        self._socket, self._seconds = connection, seconds
        self._rest = b""

    def receive(self) -> ElementTree.Element | None:
        """The next message, up to a NUL; None where the other side has closed the connection."""
        until = time.monotonic() + self._seconds
        while b"\0" not in self._rest:
            if len(self._rest) > MOST:
                raise ProtocolError(f"a message has more than {MOST} bytes")
            left = until - time.monotonic()
            if left <= 0:
                raise ProtocolError(f"no whole message came within {self._seconds:g} s")
            self._socket.settimeout(left)
            try:
                data = self._socket.recv(65536)
            except TimeoutError:
                continue
            except OSError as error:
                raise ProtocolError(f"the connection broke: {error.strerror}") from error
            if not data:
                if self._rest.strip():
                    raise ProtocolError("the connection ended in the middle of a message")
                return None
            self._rest += data
        message, _, self._rest = self._rest.partition(b"\0")
        if len(message) > MOST:
            raise ProtocolError(f"a message has more than {MOST} bytes")
        return parsed(message)

    def send(self, data: bytes) -> None:
        """Send a message as it is."""
        self._socket.settimeout(self._seconds)
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise ProtocolError(f"the connection broke: {error.strerror or error}") from error


def parsed(message: bytes) -> ElementTree.Element:
    """The XML of a message; ProtocolError if it is none, or declares entities."""
    try:
        text = message.decode()
        if "<!" in text:
            raise ProtocolError("a message has declarations in its XML, which are not read")
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
