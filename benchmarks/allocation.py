"""How long a decision of `allocate = "gain"` takes, beside one of Thompson sampling.

Run by hand: python benchmarks/allocation.py [DOMAIN.menid PROBLEM.menid]
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from pathlib import Path

import menid_plan
from menid_plan.environments.registry import EnvironmentSpec
from menid_plan.environments.runfile import Bound, WorkersTable
from menid_plan.environments.simulated import Simulated
from menid_plan.learning.run import Run
from menid_plan.learning.settings import LearnSettings

ROOT = Path(__file__).parent.parent / "domains"
PROBLEMS = (("hdd", "drive"), ("assembly", "peg"), ("stones", "river"), ("greenhouse", "long-bench"),
            ("slippery-grid", "lake"))  # fmt: skip
DECISIONS = 60


def seconds_per_decision(domain: Path, problem: Path, allocate: str) -> tuple[int, list[float]]:
    """The number of states, and what each decision took."""
    read = menid_plan.read(domain).domain
    task = menid_plan.read(problem).problem
    assert read is not None
    assert task is not None
    target, *tests = (
        EnvironmentSpec(
            e.name, Simulated(column=e.name), read, task, e.role,
            duration=20.0 if e.role == "target" else 1.0,
        )
        for e in sorted(read.all_environments, key=lambda e: e.role != "target")
    )  # fmt: skip
    settings = LearnSettings(
        allocate="gain" if allocate == "gain" else "cheapest-first",
        test_time=0.0, steps=DECISIONS, hours=1e6, objective="reward",
    )  # fmt: skip
    took: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        bound = Bound(read, task, target, tuple(tests))
        run = Run(Path(folder) / "run", bound, settings, WorkersTable(0))
        loop = run.loop
        asked, name = (loop.gain, "decide") if loop.gain else (loop.planner, "decide")
        decide = getattr(asked, name)

        def timed(*args: object) -> object:
            start = time.perf_counter()
            found = decide(*args)
            took.append(time.perf_counter() - start)
            return found

        setattr(asked, name, timed)
        run.learn()
        states = run.planner.structure.states
    return states, took[1:]


def main() -> None:
    """Medians and maxima, in milliseconds."""
    given = [Path(each) for each in sys.argv[1:3]]
    pairs = [tuple(given)] if given else [
        (ROOT / folder / "domain.menid", ROOT / folder / f"{name}.menid") for folder, name in PROBLEMS
    ]  # fmt: skip
    print(f"{'problem':16} {'states':>8} {'gain: median':>14} {'most':>8} {'Thompson':>10}   (ms)")
    for domain, problem in pairs:
        states, gain = seconds_per_decision(domain, problem, "gain")
        _, thompson = seconds_per_decision(domain, problem, "paper")
        figures = [
            1e3 * statistics.median(gain),
            1e3 * max(gain),
            1e3 * statistics.median(thompson),
        ]
        print(
            f"{problem.stem:16} {states:8} {figures[0]:14.1f} {figures[1]:8.1f} {figures[2]:10.1f}"
        )


if __name__ == "__main__":
    main()
