"""How wrong each estimator is, by how far the test is from the target and how much data there is.

    python benchmarks/estimators.py [REPETITIONS]

Prints the root mean squared L2 error as Markdown, each figure beside the one it is expected to be, and
PASS if all are within TOLERANCE of that. Three outcomes, truths from Dir(2), m = 10, u = .5.

The test's distribution is the target's moved straight towards one certain outcome, by a total variation
of `gap`; among the outcomes for which that can be done one is drawn.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from menid_plan.learning.estimators import Empirical, Estimator, estimator

SEED = 20
# Both figures are means over a few thousand draws (standard error some .001 to .002), and the expected
# ones do not say in which direction the test was off.
TOLERANCE = 0.006

COLUMNS: dict[str, Estimator] = {
    "decreasing-m": estimator("decreasing-m", m=10.0),
    "robust": estimator("robust", weight=0.5),
    "power-prior": estimator("power-prior"),
    "precision-grid": estimator("precision-grid"),
}
EXTRA: dict[str, Estimator] = {
    "pooled": estimator("pooled"),
    "sam": estimator("sam"),
    "subsets": estimator("subsets", weight=0.5),
}
# N2, gap, N1, and the expected errors: of the target only, then those of COLUMNS.
ROWS = [
    (300, 0.0, 10, (0.197, 0.043, 0.109, 0.053, 0.098)),
    (300, 0.1, 50, (0.104, 0.120, 0.104, 0.096, 0.095)),
    (300, 0.3, 20, (0.153, 0.368, 0.192, 0.239, 0.208)),
    (300, 0.3, 200, (0.053, 0.197, 0.053, 0.057, 0.055)),
    (3000, 0.3, 500, (0.033, 0.275, 0.033, 0.033, 0.034)),
]


def moved(p: np.ndarray, gap: float, rng: np.random.Generator) -> np.ndarray:
    """A distribution at a total variation of `gap` from p, towards a certain outcome."""
    outcome = rng.choice(np.flatnonzero(1.0 - p >= gap))
    certain = np.eye(len(p))[outcome]
    return p + gap / (1.0 - p[outcome]) * (certain - p)


def errors(n2: int, gap: float, n1: int, repetitions: int) -> list[float]:
    rng = np.random.default_rng([SEED, n2, int(gap * 1000), n1])
    makers = [*COLUMNS.values(), *EXTRA.values()]
    squares = np.zeros(1 + len(makers))
    for _ in range(repetitions):
        p1 = rng.dirichlet([2.0] * 3)
        table = np.array([rng.multinomial(n1, p1), rng.multinomial(n2, moved(p1, gap, rng))])
        found = [Empirical().posterior(table).mean()]
        found += [maker.posterior(table).estimate() for maker in makers]
        squares += [float(np.sum((q - p1) ** 2)) for q in found]
    return np.sqrt(squares / repetitions).tolist()


def main() -> None:
    repetitions = int(sys.argv[1]) if len(sys.argv) > 1 else 4000
    start = time.perf_counter()
    print(
        f"Error of the estimate, and in brackets what it is expected to be ({repetitions} times):\n"
    )
    names = ["N2, gap, N1", "target only", *COLUMNS, *EXTRA]
    print("| " + " | ".join(names) + " |")
    print("|" + "---|" * len(names))
    worst = 0.0
    for n2, gap, n1, wanted in ROWS:
        found = errors(n2, gap, n1, repetitions)
        compared = list(zip(found, wanted, strict=False))
        worst = max(worst, *(abs(a - b) for a, b in compared))
        cells = [f"{n2}, {gap:g}, {n1}", *(f"{a:.3f} ({b:.3f})" for a, b in compared)]
        cells += [f"{a:.3f}" for a in found[len(wanted) :]]
        print("| " + " | ".join(cells) + " |")
    verdict = "PASS" if worst <= TOLERANCE else "FAIL"
    print(f"\n{verdict}: largest difference {worst:.4f}, tolerance {TOLERANCE}")
    print(f"{time.perf_counter() - start:.0f} s")
    if verdict == "FAIL":
        sys.exit(1)


if __name__ == "__main__":
    main()
