"""Servers in processes of their own, and connections to them that do not stay open."""

from __future__ import annotations

import json
import re
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import pytest

RUN = "from menid_plan.cli.main import main; main()"
_OPEN: list[socket.socket | BinaryIO] = []


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    """Connections end with the test."""
    yield
    while _OPEN:
        _OPEN.pop().close()


def connected(port: int) -> socket.socket:
    """A connection to a server."""
    found = socket.create_connection(("127.0.0.1", port))
    found.settimeout(20)
    _OPEN.append(found)
    return found


def lines_of(connection: socket.socket) -> BinaryIO:
    """What comes in, to be read line by line; without being closed it would keep the connection."""
    found = connection.makefile("rb")
    _OPEN.append(found)
    return found


@contextmanager
def serving(folder: Path, *arguments: str) -> Iterator[tuple[int, subprocess.Popen[str]]]:
    """`menid serve` in a folder: the port that it listens on, and its process."""
    process = subprocess.Popen(
        [sys.executable, "-c", RUN, "serve", *arguments, "--port", "0"],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert process.stderr is not None
        found = None
        while found is None:
            line = process.stderr.readline()
            assert line
            found = re.fullmatch(r"listening on 127\.0\.0\.1:(\d+)\n", line)
        yield int(found[1]), process
    finally:
        process.kill()
        process.communicate()


def ended(process: subprocess.Popen[str], code: int) -> list[dict[str, Any]]:
    """What a server that has come to its end printed, with this exit code."""
    out, err = process.communicate(timeout=30)
    assert process.returncode == code, err
    assert "Traceback" not in err
    decoder, found = json.JSONDecoder(), []
    while out.strip():
        value, end = decoder.raw_decode(out := out.lstrip())
        found.append(value)
        out = out[end:]
    return found
