"""A server of this machine alone that has one session after another."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator

from menid_plan.errors import MenidError
from menid_plan.servers.play import Results
from menid_plan.servers.wire import Wire

HOST = "127.0.0.1"


class PortError(MenidError):
    """The port can't be listened on."""

    exit_code = 5


def listening(port: int) -> socket.socket:
    """A socket that listens on a port of the loopback address; 0: on any that is free."""
    try:
        return socket.create_server((HOST, port))
    except OSError as error:
        raise PortError(f"port {port} of {HOST}: {error.strerror}; choose another port") from error


def sessions(
    server: socket.socket, number: int, patience: float, play: Callable[[Wire], Results]
) -> Iterator[Results]:
    """What came of so many sessions, one after another; a message may take ``patience`` seconds."""
    for _ in range(number):
        connection, _ = server.accept()
        with connection:
            yield play(Wire(connection, patience))
