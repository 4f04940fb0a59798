"""The store of experiences: adding, adding up and reading back, and what the file takes.

    python benchmarks/store.py [EXPERIENCES] [BATCH]

The experiences are tests on the hard-drive domain's bench: few distinct states and actions, as in a
run. Times are of the wall clock, in the folder for temporary files.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import menid_plan
from menid_plan.experience.attribution import Attributor
from menid_plan.experience.record import Experience
from menid_plan.experience.store import Store
from menid_plan.grounding.state import SINK, GroundAction

ROOT = Path(__file__).parent.parent


def experiences(
    domain: menid_plan.Domain, problem: menid_plan.Problem, count: int, batch: int
) -> Iterator[list[Experience]]:
    """Batches of tests of every action that applies in the first state, one action after the other."""
    attributor = Attributor(domain, problem)
    meaning = attributor.semantics
    state = meaning.initial_state
    environments = [e.name for e in domain.environments if e.role == "test"]
    applicable = meaning.applicable(state)
    rng = np.random.default_rng(1)
    numbers: dict[tuple[str, GroundAction], int] = {}
    for begin in range(0, count, batch):
        at = begin // batch
        action, covering = applicable[at % len(applicable)]
        environment = environments[at // len(applicable) % len(environments)]
        column = meaning.probabilities(covering, environment)
        made = []
        for index in rng.choice(len(column), size=min(batch, count - begin), p=column).tolist():
            after = meaning.successor(covering, covering.rule.outcomes[index], state)
            assert after is not SINK
            number = numbers[environment, action] = numbers.get((environment, action), -1) + 1
            explanation = attributor.explain(state, action, after)
            seed = int(rng.integers(2**63))
            made.append(Experience(
                environment, state, action, after, None, 0.4, seed, 1.7e9 + begin, explanation, number
            ))  # fmt: skip
        yield made


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    batch = int(sys.argv[2]) if len(sys.argv) > 2 else 1000
    document = menid_plan.read(ROOT / "domains" / "hdd" / "bench.menid")
    domain, problem = document.domain, document.problem
    assert domain is not None
    assert problem is not None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bench.store"
        adding, making = [], time.perf_counter()
        with Store.create(path, domain, problem, seed=1) as store:
            for made in experiences(domain, problem, count, batch):
                start = time.perf_counter()
                store.add(made)
                adding.append(time.perf_counter() - start)
            making = time.perf_counter() - making - sum(adding)
            start = time.perf_counter()
        closing = time.perf_counter() - start
        print(f"making and explaining   {making / count * 1e6:8.1f} us each")
        print(f"adding, {batch} at once {sum(adding) / count * 1e6:10.1f} us each")
        print(f"the slowest batch       {max(adding) * 1000:8.1f} ms")
        print(f"closing                 {closing * 1000:8.1f} ms")
        print(f"file                    {path.stat().st_size / count:8.1f} bytes each")
        start = time.perf_counter()
        with Store.resume(path, domain, problem) as store:
            print(f"resume                  {time.perf_counter() - start:8.2f} s")
            for name, ask in (
                ("counts", store.counts),
                ("totals", store.totals),
                ("next_tests", store.next_tests),
                ("number", store.__len__),
                ("unexplained", lambda: sum(1 for _ in store.unexplained())),
                ("all experiences", lambda: sum(1 for _ in store)),
            ):
                start = time.perf_counter()
                ask()
                print(f"{name:16}        {time.perf_counter() - start:8.2f} s")


if __name__ == "__main__":
    main()
