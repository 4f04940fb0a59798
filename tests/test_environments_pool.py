"""Workers: the same results in any number of them, and what becomes of crashes and hangs."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import CancelledError
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

import menid_plan
from conftest import ROOT
from environments_faulty import Faulty
from menid_plan.environments.interface import CannotResetError, EnvironmentFailedError, Execution
from menid_plan.environments.pool import (
    Counts,
    ExecutionFailedError,
    ExecutionFuture,
    Failure,
    Pool,
    in_order,
)
from menid_plan.environments.process import Process
from menid_plan.environments.recorded import Recorded
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.simulated import Simulated
from menid_plan.errors import MenidError
from menid_plan.grounding.state import GroundAction

DOCUMENT = menid_plan.read(ROOT / "domains" / "hdd" / "bench.menid")
assert DOCUMENT.domain is not None
assert DOCUMENT.problem is not None
INITIAL = frozenset(DOCUMENT.problem.init)
LEVER = GroundAction("lever", ("n8",))
N = 12


def spec(kind: Any, **options: Any) -> EnvironmentSpec:
    return EnvironmentSpec("coarse", kind, DOCUMENT.domain, DOCUMENT.problem, **options)


def submitted(pool: Pool, n: int = N) -> list[ExecutionFuture]:
    return [pool.submit("coarse", INITIAL, LEVER, seed=k, number=k) for k in range(n)]


def results(pool: Pool, n: int = N) -> list[Execution]:
    return [future.result() for future in in_order(reversed(submitted(pool, n)))]


@pytest.fixture(scope="module")
def expected() -> list[Execution]:
    with Pool([spec(Simulated())], workers=0) as pool:
        return results(pool)


@pytest.mark.parametrize("workers", [1, 2])
def test_any_number_of_workers_gives_the_same(expected: list[Execution], workers: int) -> None:
    with Pool([spec(Simulated())], workers) as pool:
        assert pool.workers == workers
        assert results(pool) == expected
        assert pool.counts == {"coarse": Counts(executions=N)}


def test_what_environments_print_does_no_harm(expected: list[Execution]) -> None:
    with Pool([spec(Faulty("print"))], 1) as pool:
        assert results(pool, 3) == expected[:3]


@pytest.mark.parametrize(
    ("fault", "trouble"), [("exit", "crashes"), ("segfault", "crashes"), ("fail", "errors")]
)
def test_a_worker_that_crashes_costs_one_attempt(
    tmp_path: Path, expected: list[Execution], fault: str, trouble: str
) -> None:
    failures: list[Failure] = []
    faulty = Faulty(fault, every=7, once=str(tmp_path))
    with Pool([spec(faulty)], 2, failed=failures.append) as pool:
        assert results(pool) == expected  # as if nothing had happened
        assert pool.counts["coarse"] == Counts(executions=N, **{trouble: 2})
    assert sorted(f.number for f in failures) == [0, 7]
    assert {f.attempt for f in failures} == {1}
    if fault == "exit":
        assert "executing `lever(n8)`, its process ended with exit code 3" in str(failures[0])
    if fault == "segfault":
        assert "SIGSEGV" in failures[0].message


def test_a_worker_that_hangs_is_replaced(tmp_path: Path, expected: list[Execution]) -> None:
    failures: list[Failure] = []
    faulty = Faulty("hang", every=N, once=str(tmp_path))
    with Pool([spec(faulty, timeout=0.2)], 2, failed=failures.append) as pool:
        assert results(pool) == expected
        assert pool.counts["coarse"] == Counts(executions=N, timeouts=1)
    assert "took more than 0.2 s" in failures[0].message


@pytest.mark.parametrize("workers", [0, 1])
def test_after_so_many_retries_it_is_given_up(expected: list[Execution], workers: int) -> None:
    with Pool([spec(Faulty("fail", every=2), retries=1)], workers) as pool:
        futures = submitted(pool, 4)
        with pytest.raises(ExecutionFailedError) as caught:
            futures[0].result()
        assert len(caught.value.failures) == 2
        assert str(caught.value).endswith(
            "environment `coarse`: execution 0, `lever(n8)`, failed 2 times; last: "
            "the gripper is stuck"
        )
        assert [f.result() for f in futures[1::2]] == expected[1:4:2]
        assert pool.counts["coarse"] == Counts(executions=2, errors=4, given_up=2)


def test_what_was_not_recorded_is_not_asked_for_again(tmp_path: Path) -> None:
    (tmp_path / "seen.jsonl").write_text('{"state": [], "action": "lever(n8)", "after": []}\n')
    failures: list[Failure] = []
    bank = spec(Recorded("seen.jsonl"), folder=tmp_path)
    with Pool([bank], 0, failed=failures.append) as pool:
        with pytest.raises(ExecutionFailedError, match="nothing was recorded"):
            submitted(pool, 1)[0].result()
        assert pool.counts["coarse"] == Counts(errors=1, given_up=1)
    assert len(failures) == 1


def test_an_environment_that_does_not_start() -> None:
    with (
        Pool([spec(Faulty("start"), retries=0)], 1) as pool,
        pytest.raises(ExecutionFailedError, match="it does not start"),
    ):
        submitted(pool, 1)[0].result()


@pytest.mark.parametrize("workers", [0, 1])
def test_what_no_retry_mends_is_not_tried_again(workers: int) -> None:
    with Pool([spec(Faulty("cannot-reset"))], workers) as pool:
        with pytest.raises(CannotResetError, match="not there"):
            submitted(pool, 1)[0].result()
        assert pool.counts["coarse"] == Counts()
    with Pool([spec(Simulated(column="rbot"))], workers) as pool:
        with pytest.raises(MenidError, match=r"environment\.coarse\.settings\.column") as caught:
            submitted(pool, 1)[0].result()
        assert caught.value.exit_code == 3


def test_one_copy_at_most(tmp_path: Path, expected: list[Execution]) -> None:
    diary = tmp_path / "diary"
    with Pool([spec(Faulty(diary=str(diary), parallel=False))], 2) as pool:
        assert results(pool) == expected
    assert len(diary.read_text().split()) == 1


def test_no_more_copies_at_once_than_asked_for(expected: list[Execution]) -> None:
    with Pool([spec(Simulated(), workers=1)], 2) as pool:
        assert results(pool) == expected


def test_the_rest_is_dropped() -> None:
    with Pool([spec(Simulated())], 1) as pool:
        futures = submitted(pool, 200)
        first: Iterator[ExecutionFuture] = in_order(futures)
        assert next(first).number == 0
        first.close()  # type: ignore[attr-defined]
        assert futures[-1].cancelled()
    pool.close()
    with pytest.raises(RuntimeError, match="closed"):
        submitted(pool, 1)


def test_closing_ends_what_runs() -> None:
    with Pool([spec(Faulty("hang"))], 1) as pool:
        future, waiting = submitted(pool, 2)
        while not future.running():
            time.sleep(0.01)
        time.sleep(0.1)
        begin = time.monotonic()
    assert time.monotonic() - begin < 20
    assert waiting.cancelled()
    with pytest.raises(CancelledError):
        future.result()


def test_what_the_caller_does_with_a_failure_may_fail_too() -> None:
    def broken(_: Failure) -> None:
        raise OSError("the disk is full")

    with Pool([spec(Faulty("fail"))], 1, failed=broken) as pool:
        for future in submitted(pool, 2):  # the lane goes on
            with pytest.raises(OSError, match="the disk is full"):
                future.result()


def test_ctrl_c_is_no_result() -> None:
    def interrupted(_: Failure) -> None:
        raise KeyboardInterrupt

    with (
        Pool([spec(Faulty("fail"))], 0, failed=interrupted) as pool,
        pytest.raises(KeyboardInterrupt),
    ):
        submitted(pool, 1)


def test_programs_see_the_callers_surroundings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What makes workers find modules must not reach programs, which may be of another Python."""
    monkeypatch.delenv("PYTHONPATH", raising=False)
    program = tmp_path / "program.py"
    program.write_text("import os, sys\nsys.exit('path ' + repr(os.environ.get('PYTHONPATH')))\n")
    kind = Process(("{python}", "program.py"))
    with (
        Pool([spec(kind, folder=tmp_path, retries=0)], 1) as pool,
        pytest.raises(ExecutionFailedError, match="path None"),
    ):
        submitted(pool, 1)[0].result()


def test_an_unknown_environment() -> None:
    with Pool([spec(Simulated())], 0) as pool, pytest.raises(KeyError):
        pool.submit("corse", INITIAL, LEVER, 0)


# --------------------------------------------------------------------- workers outlive no parent

PARENT = """
import sys, time
import menid_plan
from environments_faulty import Faulty
from menid_plan.environments.pool import Pool
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.grounding.state import GroundAction
document = menid_plan.read(sys.argv[1])
kind = Faulty(sys.argv[2], diary=sys.argv[3])
spec = EnvironmentSpec("coarse", kind, document.domain, document.problem)
pool = Pool([spec], 2, *sys.argv[4:])
for k in range(2):
    pool.submit("coarse", frozenset(document.problem.init), GroundAction("lever", ("n8",)), k)
    time.sleep(0.2)
time.sleep(3600)
"""


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
        status = Path(f"/proc/{pid}/stat")
        # A zombie has ended; whoever inherited it will notice.
        return not status.exists() or status.read_text().rpartition(")")[2].split()[0] != "Z"
    except (ProcessLookupError, FileNotFoundError):
        return False


def wait_until(condition: Any, seconds: float = 30) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="there is no SIGKILL here")
@pytest.mark.parametrize("fault", ["", "hang"])
def test_workers_end_with_their_parent(tmp_path: Path, fault: str) -> None:
    check_that_workers_end(tmp_path / "diary", fault)


def check_that_workers_end(diary: Path, fault: str, *scheduler: str) -> None:
    problem = ROOT / "domains" / "hdd" / "bench.menid"
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, problem, fault, diary, *scheduler],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        stderr=subprocess.DEVNULL,
    )
    wanted = 2 if fault else 1  # one that does not hang may do both
    try:
        wait_until(lambda: diary.exists() and len(diary.read_text().split()) >= wanted)
    finally:
        parent.kill()
        parent.wait()
    for pid in map(int, diary.read_text().split()):
        assert pid != parent.pid
        wait_until(lambda pid=pid: not is_alive(pid), 10)


# ------------------------------------------------------------------------------------------ Dask


@pytest.mark.skipif(not find_spec("distributed"), reason="needs the extra `dask`")
@pytest.mark.filterwarnings("default")
def test_on_a_dask_scheduler(tmp_path: Path, expected: list[Execution]) -> None:
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=1, threads_per_worker=2, host="127.0.0.1", dashboard_address=None,
        processes=False, protocol="tcp",
    ) as cluster:  # fmt: skip
        faulty = Faulty("exit", every=5, once=str(tmp_path))
        with Pool([spec(faulty)], 2, scheduler=cluster.scheduler_address) as pool:
            assert results(pool, 4) == expected[:4]
            assert pool.counts["coarse"] == Counts(executions=4, crashes=1)
        with (
            Pool([spec(Faulty(parallel=False))], 1, cluster.scheduler_address) as pool,
            pytest.raises(MenidError, match="allows no copies"),
        ):
            submitted(pool, 1)[0].result()


@pytest.mark.skipif(not find_spec("distributed"), reason="needs the extra `dask`")
@pytest.mark.filterwarnings("default")
def test_a_dask_scheduler_without_workers() -> None:
    from distributed import LocalCluster

    options: Any = {
        "threads_per_worker": 1, "host": "127.0.0.1", "dashboard_address": None,
        "processes": False, "protocol": "tcp",
    }  # fmt: skip
    with LocalCluster(n_workers=0, **options) as cluster:
        begun = time.monotonic()
        with pytest.raises(MenidError, match=r"the scheduler at tcp://.* has no workers") as caught:
            Pool([spec(Simulated(), start_timeout=0.5)], 1, cluster.scheduler_address)
        assert caught.value.exit_code == 5
        assert time.monotonic() - begun < 10
    with (
        LocalCluster(n_workers=1, **options) as cluster,  # it loses them
        Pool([spec(Faulty(), start_timeout=1.0)], 1, cluster.scheduler_address) as pool,
    ):
        assert submitted(pool, 1)[0].result()
        cluster.scale(0)
        wait_until(lambda: not cluster.scheduler.workers)
        with pytest.raises(MenidError, match="has no workers"):
            submitted(pool, 1)[0].result(timeout=60)


def test_no_scheduler_there() -> None:
    if not find_spec("distributed"):
        pytest.skip("needs the extra `dask`")
    with pytest.raises(MenidError, match="the scheduler at nonsense"):
        Pool([spec(Simulated())], 1, scheduler="nonsense://x")


@pytest.mark.parametrize(
    ("sent", "message"),
    [
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "what answers at tcp://.* is no Dask scheduler"),
        (b"", "the scheduler at tcp://.* gives no answer within 0.5 s"),
        (None, "the scheduler at tcp://.* gives no answer within 0.5 s"),
    ],
)
def test_something_else_there(
    monkeypatch: pytest.MonkeyPatch, sent: bytes | None, message: str
) -> None:
    if not find_spec("distributed"):
        pytest.skip("needs the extra `dask`")
    monkeypatch.setattr("menid_plan.environments.dask._PATIENCE", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"

        def serve() -> None:
            with server.accept()[0] as connection:
                connection.sendall(sent or b"")
                while connection.recv(1000):  # until the other side has had enough
                    pass

        if sent is None:
            server.close()
        else:
            threading.Thread(target=serve, daemon=True).start()
        with pytest.raises(EnvironmentFailedError, match=message):
            Pool([spec(Simulated())], 1, scheduler=address)


@pytest.mark.skipif(not find_spec("distributed"), reason="needs the extra `dask`")
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="there is no SIGKILL here")
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("fault", ["", "hang"])
def test_workers_of_a_scheduler_end_with_the_pool_that_was_killed(
    tmp_path: Path, fault: str
) -> None:
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=1, threads_per_worker=2, host="127.0.0.1", dashboard_address=None,
        processes=False, protocol="tcp",
    ) as cluster:  # fmt: skip
        check_that_workers_end(tmp_path / "diary", fault, cluster.scheduler_address)


@pytest.mark.skipif(not find_spec("distributed"), reason="needs the extra `dask`")
@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="there is no SIGSTOP here")
@pytest.mark.filterwarnings("default")
def test_a_dask_worker_that_is_lost_or_stuck(tmp_path: Path, expected: list[Execution]) -> None:
    from distributed import LocalCluster

    failures: list[Failure] = []
    diary = tmp_path / "diary"
    with LocalCluster(
        n_workers=1, threads_per_worker=1, host="127.0.0.1", dashboard_address=None
    ) as cluster:
        hanging = Faulty("hang", once=str(tmp_path), diary=str(diary))
        with Pool([spec(hanging)], 1, cluster.scheduler_address, failures.append) as pool:
            future = submitted(pool, 1)[0]
            wait_until((tmp_path / "0").exists)
            os.kill(cluster.workers[0].pid, signal.SIGKILL)
            assert future.result(timeout=60) == expected[0]
            assert pool.counts["coarse"] == Counts(executions=1, crashes=1)
            assert [str(failure) for failure in failures] == [
                "environment `coarse`, `lever(n8)`, execution 0, attempt 1: its Dask worker was lost"
            ]
            submitted(pool, 2)
            wait_until((tmp_path / "1").exists)
            stuck = cluster.workers[0].pid
            os.kill(stuck, signal.SIGSTOP)
            begun = time.monotonic()
            pool.close()
            assert time.monotonic() - begun < 8
            os.kill(stuck, signal.SIGCONT)
        for pid in map(int, diary.read_text().split()):
            wait_until(lambda pid=pid: not is_alive(pid), 10)


@pytest.mark.skipif(not find_spec("distributed"), reason="needs the extra `dask`")
@pytest.mark.skipif(os.name == "nt", reason="sends SIGINT")
@pytest.mark.filterwarnings("default")
def test_ctrl_c_with_a_scheduler(tmp_path: Path) -> None:
    from distributed import LocalCluster

    folder = ROOT / "domains" / "greenhouse"
    program = (folder / "simulator.py").read_text(encoding="utf-8")
    slow = f"time.sleep(0.1); open({str(tmp_path / 'begun')!r}, 'w').close(); time.sleep(3600)"
    program = program.replace("seconds = ", f"import time; {slow}; seconds = ")
    (tmp_path / "simulator.py").write_text(program, encoding="utf-8")
    with LocalCluster(
        n_workers=1, threads_per_worker=2, host="127.0.0.1", dashboard_address=None,
        processes=False, protocol="tcp",
    ) as cluster:  # fmt: skip
        workers = f'[workers]\nnumber = 2\nscheduler = "{cluster.scheduler_address}"\n'
        run_file = tmp_path / "run.toml"
        run_file.write_text((folder / "run.toml").read_text(encoding="utf-8") + workers, "utf-8")
        process = subprocess.Popen(
            [
                sys.executable, "-c", "from menid_plan.cli.main import main; main()", "learn",
                folder / "domain.menid", folder / "two-pots.menid", "--run", run_file,
                "-o", tmp_path / "run",
            ],
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        try:
            wait_until((tmp_path / "begun").exists)
            process.send_signal(signal.SIGINT)
            _, said = process.communicate(timeout=8)
        finally:
            process.kill()
            process.wait()
        assert said == "interrupted; --resume goes on with this run\n"
        assert process.returncode == 6
