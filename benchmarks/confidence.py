"""The exact delta bound against Monte Carlo (Algorithm 2): time, and time at equal accuracy.

    python benchmarks/confidence.py [ROUNDS]

The two alternate, so that the machine's mood hits both; what counts is the ratio of the medians. PASS
if up to four outcomes the exact bound is at least as fast as 10,000 draws, and at equal accuracy at
least 100 times faster. Accuracy: how many draws bring Monte Carlo's standard deviation down to ACCURACY
follows from its spread over runs of 10,000 draws (it falls as the root of their number); the time of
one draw is measured in a run of a million. The exact bound's own error is taken against the same
integral with twice the nodes, and must be below ACCURACY too.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable

import numpy as np

from menid_plan.learning import exact_delta as module
from menid_plan.learning.confidence import SAMPLES, delta

EPSILON = 0.05
ACCURACY = 1e-5
COUNTS = [
    [5, 5],
    [90, 10],
    [30, 12, 5],
    [3, 1, 0],
    [100, 100, 100],
    [50, 30, 15, 5],
    [3, 2, 1, 0],
    [100, 100, 100, 100],
]
MORE = [[10, 5, 3, 1, 1], [200, 100, 3, 1, 1, 0], [*range(12)], [2] * 50]


def seconds(call: Callable[[], object]) -> float:
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def with_nodes(counts: list[int], nodes: int) -> float:
    before = module._NODES
    module._NODES = nodes
    module._gauss.cache_clear()
    try:
        return delta(counts, EPSILON)
    finally:
        module._NODES = before
        module._gauss.cache_clear()


def main() -> None:
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    rng = np.random.default_rng(0)
    delta([3, 2, 1], EPSILON)  # loads SciPy
    print(f"epsilon {EPSILON}, medians of {rounds} alternating runs\n")
    print("| counts | exact, ms | 10,000 draws, ms | ratio | draws needed | at equal accuracy |")
    print("|---|---|---|---|---|---|")
    failures = []
    for counts in COUNTS + MORE:
        few = len(counts) <= 4
        repeat = rounds if few else max(5, rounds // 5)
        exact, drawn, values = [], [], []
        for _ in range(repeat):
            exact.append(seconds(lambda: delta(counts, EPSILON)))
            start = time.perf_counter()
            values.append(delta(counts, EPSILON, "monte-carlo", SAMPLES, rng))
            drawn.append(time.perf_counter() - start)
        ours, theirs = statistics.median(exact), statistics.median(drawn)
        many = seconds(lambda: delta(counts, EPSILON, "monte-carlo", 1_000_000, rng)) / 1_000_000
        needed = SAMPLES * (statistics.stdev(values) / ACCURACY) ** 2
        gain = needed * many / ours
        name = str(counts) if len(counts) < 7 else f"{len(counts)} outcomes"
        print(
            f"| {name} | {ours * 1e3:.2f} | {theirs * 1e3:.2f} | {theirs / ours:.1f}"
            f" | {needed:.1e} | {gain:.0f} times faster |"
        )
        error = abs(with_nodes(counts, 32) - delta(counts, EPSILON))
        if error > ACCURACY:
            failures.append(f"{name}: exact is off by {error:.1e}")
        if few and ours > theirs:
            failures.append(f"{name}: slower than 10,000 draws")
        if few and gain < 100:
            failures.append(f"{name}: {gain:.0f} times faster at equal accuracy")
    print()
    print("FAIL: " + "; ".join(failures) if failures else "PASS")
    sys.exit(bool(failures))


if __name__ == "__main__":
    main()
