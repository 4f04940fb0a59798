"""The learning loop: what an update costs as knowledge grows, a step of a run, and a replay.

    python benchmarks/learning.py [STEPS]

The run is on the greenhouse with simulated environments, in this process. Times are of the wall clock.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import menid_plan
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.runfile import Bound, WorkersTable
from menid_plan.environments.simulated import Simulated
from menid_plan.experience.record import DistributionKey
from menid_plan.learning.counts import Evidence
from menid_plan.learning.estimators import ESTIMATORS, estimator
from menid_plan.learning.run import Run
from menid_plan.learning.settings import LearnSettings

ROOT = Path(__file__).parent.parent
KEY = DistributionKey("pour", "into-the-pot")
OUTCOME = (1.0, 0.0, 0.0)


def greenhouse() -> Bound:
    document = menid_plan.read(ROOT / "domains" / "greenhouse" / "two-pots.menid")
    assert document.domain is not None
    assert document.problem is not None
    robot, simulator = (
        EnvironmentSpec(e.name, Simulated(), document.domain, document.problem, e.role)
        for e in document.domain.environments
    )
    return Bound(document.domain, document.problem, robot, (simulator,))


def updates(bound: Bound) -> None:
    """An experience more, and the estimate after it, when so many are known already."""
    print("microseconds for an update of an estimate, by experiences that are known")
    print(f"{'':16}{'10':>10}{'1000':>10}{'1000000':>10}")
    for name in ESTIMATORS:
        cells = []
        for known in (10, 1000, 1_000_000):
            evidence = Evidence(
                bound.domain, bound.problem, ["robot", "simulator"], estimator(name)
            )
            evidence.add("simulator", KEY, [known * share for share in (0.85, 0.1, 0.05)])
            repetitions = 200
            begin = time.perf_counter()
            for _ in range(repetitions):
                evidence.add("robot", KEY, OUTCOME)
                evidence.belief(KEY).estimate()
            cells.append((time.perf_counter() - begin) / repetitions * 1e6)
        print(f"{name:16}" + "".join(f"{cell:10.0f}" for cell in cells))


def steps(bound: Bound, number: int) -> None:
    """A step of a run with all that belongs to it, early and late; and going through it again."""
    times: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        settings = LearnSettings(steps=number, test_time=5.0)
        workers = WorkersTable(0)

        def note(_: object) -> None:
            times.append(time.perf_counter())

        Run(Path(folder, "run"), bound, settings, workers, watch=note).learn()
        quarter = len(times) // 4
        for text, part in (("first", times[:quarter]), ("last", times[-quarter:])):
            print(f"{text} quarter: {(part[-1] - part[0]) / len(part) * 1e3:.2f} ms a point")
        begin = time.perf_counter()
        Run(Path(folder, "run"), bound, settings, workers, resume=True).learn()
        took = time.perf_counter() - begin
        print(f"resumed at its end: {took / len(times) * 1e3:.2f} ms a point")


if __name__ == "__main__":
    updates(greenhouse())
    steps(greenhouse(), int(sys.argv[1]) if len(sys.argv) > 1 else 2000)
