"""Reading a big domain: ours against the PyPI package `pddl` on the same content as PDDL.

    pip install 'menid-plan[bench]'
    python benchmarks/reading.py [LINES...]

Both read texts that this script generates: the same types, predicates and actions with the same
conditions and outcomes (PDDL's `oneof` in the place of probabilities, which `pddl` cannot read). Ours
is parsed and checked, theirs parsed (which checks types). Times are of one process, by turns.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

# A block of content takes this many lines of MENID.
LINES_PER_BLOCK = 15


def menid_text(blocks: int) -> str:
    lines = ["domain big", "type place, thing", "environment robot : target"]
    lines += [f"predicate at{i}(thing, place)" for i in range(blocks)]
    for i in range(blocks):
        lines += [
            f"action move{i}(x: thing, a, b: place) {{",
            "  rule move {",
            f"    when at{i}(x, a) and not (at{i}(x, b) or a = b)",
            f"      and exists y: thing (at{i}(y, b) and x != y)",
            "    outcomes robot {",
            f"      moved: 0.7  not at{i}(x, a), at{i}(x, b)",
            f"      lost:  0.1  not at{i}(x, a)",
            "      held:  0.1  nothing",
            f"      swept: 0.1  forall y: thing where at{i}(y, a) {{ not at{i}(y, a) }}",
            "      noise: 0",
            "    }",
            "  }",
            "}",
            "",
        ]
    return "\n".join(lines)


def pddl_text(blocks: int) -> str:
    lines = [
        "(define (domain big)",
        "(:requirements :adl :non-deterministic)",
        "(:types place thing - object)",
        "(:predicates",
    ]
    lines += [f"  (at{i} ?x - thing ?p - place)" for i in range(blocks)]
    lines += [")"]
    for i in range(blocks):
        lines += [
            f"(:action move{i}",
            "  :parameters (?x - thing ?a - place ?b - place)",
            "  :precondition (and",
            f"    (at{i} ?x ?a) (not (or (at{i} ?x ?b) (= ?a ?b)))",
            f"    (exists (?y - thing) (and (at{i} ?y ?b) (not (= ?x ?y)))))",
            "  :effect (oneof",
            f"    (and (not (at{i} ?x ?a)) (at{i} ?x ?b))",
            f"    (not (at{i} ?x ?a))",
            "    (and)",
            f"    (forall (?y - thing) (when (at{i} ?y ?a) (not (at{i} ?y ?a))))",
            "  )",
            ")",
            "",
        ]
    return "\n".join([*lines, ")"])


def seconds(function: Callable[[], object]) -> float:
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def main() -> None:
    from pddl import parse_domain

    from menid_plan.language.check import check
    from menid_plan.source import SourceFile

    def ours(text: str) -> None:
        assert not check(SourceFile("big", text)).diagnostics

    ours(menid_text(1))
    print("lines of MENID   menid (s)   pddl (s)   ratio   menid, µs a line")
    for lines in [int(word) for word in sys.argv[1:]] or [5000, 10000, 20000, 40000]:
        blocks = lines // LINES_PER_BLOCK
        text, theirs = menid_text(blocks), pddl_text(blocks)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "domain.pddl"
            path.write_text(theirs)
            times = [(seconds(lambda: ours(text)), seconds(lambda: parse_domain(path)))]
            times += [(seconds(lambda: ours(text)), seconds(lambda: parse_domain(path)))]
        mine, pddl = (min(column) for column in zip(*times, strict=True))
        count = text.count("\n")
        print(
            f"{count:14d}   {mine:9.2f}   {pddl:8.2f}   {mine / pddl:5.2f}   "
            f"{mine / count * 1e6:16.0f}"
        )


if __name__ == "__main__":
    main()
