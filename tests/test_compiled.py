"""Kernels: what they take and give, what they may not do, and how their code is kept."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from menid_plan import compiled
from menid_plan.compiled import Kernel, kernel

FACTOR = 3


@kernel(inline=True)
def scaled(value: float) -> float:
    return value * FACTOR


@kernel()
def total(values: np.ndarray) -> float:
    found = 0.0
    for i in range(len(values)):
        found += scaled(values[i])
    return found


@kernel("f8(f8[::1], b1)")
def total_or_none(values: np.ndarray, wanted: bool) -> float:
    return total(values) if wanted else 0.0


@kernel("UniTuple(i8, 2)(i4[:, ::1], u8)")
def shape(table: np.ndarray, more: int) -> tuple[int, int]:
    table[0, 1] = 7
    return table.shape[0] + more, table.shape[1]


@kernel("f8(f8[::1])")
def allocates(values: np.ndarray) -> float:
    return np.empty(len(values)).sum()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(compiled, "_folders", lambda: (tmp_path / "nowhere" / "x", tmp_path))
    (tmp_path / "nowhere").write_text("a file, so that no folder can be made here")
    return tmp_path


def fresh(made: object) -> Kernel:
    assert isinstance(made, Kernel)
    again = Kernel(made.function, made.signature, made.inline)
    again.dispatcher = made.dispatcher  # Numba need not compile it again
    return again


def test_kernels_call_kernels_and_know_numbers() -> None:
    assert total_or_none(np.arange(4.0), True) == 18
    assert total_or_none(np.arange(4.0), False) == 0


def test_tables_and_several_results() -> None:
    table = np.zeros((2, 5), np.int32)
    assert shape(table, 40) == (42, 5)
    assert table[0, 1] == 7


@pytest.mark.parametrize(
    "values", [np.arange(4), np.zeros((2, 2)), np.arange(8.0)[::2], np.zeros(3, np.float32)]
)
def test_other_arrays_are_refused(values: np.ndarray) -> None:
    with pytest.raises(TypeError, match="takes a 1-d array of float64"):
        total_or_none(values, True)


def test_the_number_of_arguments_is_checked() -> None:
    with pytest.raises(TypeError, match="takes 2 arguments, got 1"):
        total_or_none(np.zeros(1))  # type: ignore[call-arg]


def test_what_allocates_is_no_kernel(folder: Path) -> None:
    with pytest.raises(TypeError, match=r"is no kernel: (.|\n)*empty"):
        allocates(np.zeros(3))


def test_code_is_kept_and_mended(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert fresh(total_or_none)(np.ones(2), True) == 6
    (kept,) = folder.glob("*.o")
    content = kept.read_bytes()

    def compiles(self: Kernel) -> bytes:
        raise AssertionError("compiled again")

    with monkeypatch.context() as patch:
        patch.setattr(Kernel, "_compile", compiles)
        assert fresh(total_or_none)(np.ones(3), True) == 9
    for broken in (content[:-9], content[:40] + b"?" + content[41:], b""):
        kept.write_bytes(broken)
        assert fresh(total_or_none)(np.ones(3), True) == 9
        assert len(kept.read_bytes()) == len(content)


def test_what_a_change_replaces_goes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fresh(total_or_none)(np.ones(2), True)
    monkeypatch.setattr(Kernel, "key", "another")
    fresh(total_or_none)(np.ones(2), True)
    (kept,) = folder.glob("*.o")
    assert kept.name.endswith("-another.o")


def test_the_key_depends_on_what_a_kernel_uses(monkeypatch: pytest.MonkeyPatch) -> None:
    before = fresh(scaled).key
    monkeypatch.setitem(globals(), "FACTOR", 4)
    assert fresh(scaled).key != before


def test_no_folder_can_be_written(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(compiled, "_folders", lambda: (tmp_path / "file",))
    assert fresh(total_or_none)(np.ones(2), True) == 6


def test_two_processes_may_compile_at_once(tmp_path: Path) -> None:
    program = (
        "import numpy as np, pathlib; from menid_plan import compiled;"
        f"compiled._folders = lambda: (pathlib.Path({str(tmp_path)!r}),);"
        "from menid_solvers.row_kernels import expect;"
        "out = np.zeros(1);"
        "expect(np.array([0, 1]), np.array([0, 1], np.int32), np.zeros(1, np.int32),"
        " np.zeros(1, np.int32), np.array([0, 1]), np.ones(1), np.ones(1, bool), np.full(1, 5.0), out);"
        "print(out[0])"
    )
    running = [
        subprocess.Popen(
            [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, env=os.environ
        )
        for _ in range(2)
    ]
    assert [process.communicate()[0].strip() for process in running] == ["5.0", "5.0"]
    assert len(list(tmp_path.glob("*"))) == 1
