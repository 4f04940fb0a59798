"""The hard-drive scenes: what an execution costs beside PyBullet, what coarse meshes and workers gain.

    python benchmarks/scenes.py [EXECUTIONS]

For each quality and action the wall time of executions is compared with the time in PyBullet's own
steps and in loading the world, measured in the same executions; then fine with coarse meshes; then two
workers with one, on the same executions. Meshes are made before anything is measured.
"""

from __future__ import annotations

import sys
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import menid_plan
from menid_plan.environments.hdd import scene
from menid_plan.environments.hdd.engine import World
from menid_plan.environments.hdd.kind import Hdd
from menid_plan.environments.pool import Pool, in_order
from menid_plan.environments.registry import EnvironmentSpec, Place
from menid_plan.grounding.state import GroundAction

ROOT = Path(__file__).parent.parent
QUALITIES = {"coarse": 0.001, "fine": 0.01}
ACTIONS = (
    ("lever", ("n8",)), ("lever", ("n5",)), ("lever", ("n14",)), ("shake", ("s5",)),
    ("shake", ("s10",)), ("suck", ("centre", "strong")), ("suck", ("left", "weak")),
    ("suck", ("right", "strong")),
)  # fmt: skip


def timed(owner: Any, name: str, spent: dict[str, float], key: str) -> None:
    """Add up the time that a method takes."""
    method: Callable[..., Any] = getattr(owner, name)

    def measured(*arguments: Any, **named: Any) -> Any:
        begin = time.perf_counter()
        found = method(*arguments, **named)
        spent[key] += time.perf_counter() - begin
        return found

    setattr(owner, name, measured)


def main(executions: int) -> None:
    document = menid_plan.read(ROOT / "domains" / "hdd" / "drive.menid")
    assert document.domain is not None
    assert document.problem is not None
    place = Place("drive", document.domain, document.problem)
    kinds = {name: Hdd(quality=q, noise=1.0) for name, q in QUALITIES.items()}
    state = frozenset(document.problem.init)

    spent: dict[str, float] = defaultdict(float)
    timed(World, "step", spent, "steps")
    timed(scene.Scene, "__init__", spent, "loading")
    print(f"{'action':22}{'coarse':>9}{'fine':>9}  times   over PyBullet alone (coarse, fine)")
    total: dict[str, dict[str, float]] = {name: defaultdict(float) for name in kinds}
    for action in (GroundAction(*a) for a in ACTIONS):
        row: dict[str, dict[str, float]] = {}
        for name, kind in kinds.items():
            environment = kind.build(place)
            environment.reset(None, 0)
            environment.execute(action)
            row[name] = defaultdict(float)
            for seed in range(executions):
                environment.reset(state, seed)
                spent.clear()
                begin = time.perf_counter()
                environment.execute(action)
                row[name]["wall"] += time.perf_counter() - begin
                row[name]["bare"] += spent["steps"] + spent["loading"]
            for key, value in row[name].items():
                total[name][key] += value
        show(str(action), row, executions)
    show("all", total, executions * len(ACTIONS))

    spec = EnvironmentSpec("fine", kinds["fine"], document.domain, document.problem)
    jobs = [(GroundAction(*a), seed) for seed in range(2 * executions) for a in ACTIONS]
    walls: dict[int, list[float]] = {}
    for workers in (1, 2, 1, 2):
        with Pool([spec], workers) as pool:
            for future in [pool.submit("fine", state, jobs[0][0], k, k) for k in range(2)]:
                future.result()  # the workers have begun, and read their meshes
            begin = time.perf_counter()
            futures = [
                pool.submit("fine", state, action, seed, number)
                for number, (action, seed) in enumerate(jobs)
            ]
            for future in in_order(futures):
                future.result()
            walls.setdefault(workers, []).append(time.perf_counter() - begin)
    one, two = (min(walls[workers]) for workers in (1, 2))
    print(f"{len(jobs)} executions: one worker {one:.1f} s, two {two:.1f} s, {one / two:.2f} times")


def show(name: str, row: dict[str, dict[str, float]], number: int) -> None:
    """A line: seconds of an execution, their ratio, and what is more than PyBullet's own time."""
    coarse, fine = row["coarse"], row["fine"]
    over = "  ".join(f"{part['wall'] / part['bare']:.2f}" for part in (coarse, fine))
    print(
        f"{name:22}{coarse['wall'] / number:7.3f} s{fine['wall'] / number:7.3f} s"
        f"  {fine['wall'] / coarse['wall']:5.2f}   {over}"
    )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
