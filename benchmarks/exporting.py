"""How long the exports take for a domain of 500 actions and 10,000 ground rules.

Run by hand: python benchmarks/exporting.py [ACTIONS [OBJECTS]]
"""

from __future__ import annotations

import sys
import time
from itertools import product

import menid_plan
from menid_plan.errors import MenidError
from menid_plan.planning import Task
from menid_plan.texts import ppddl_text, rddl_text

HORIZON = 20


def text(actions: int, objects: int) -> str:
    """Things that are changed by many actions, each with a reference, a condition and two outcomes."""
    lines = ["domain large", "type thing", "environment real : target"]
    lines += [f"predicate p{i}(thing)" for i in range(10)]
    lines += ["predicate near(thing, thing)"]
    for number in range(actions):
        first, second, third = number % 10, (number // 10) % 10, (number + 1) % 10
        lines.append(f"""\
action a{number}(t: thing) cost 1 {{
  rule r {{
    the o: thing where near(t, o)
    when not p{first}(t) and (p{second}(o) or not p{third}(t))
    outcomes {{ works: 0.{1 + number % 8} p{first}(t), not p{second}(o)  fails: nothing  noise: 0.05 }}
  }}
}}""".replace("fails: nothing", f"fails: {0.95 - (1 + number % 8) / 10:.2f} nothing"))  # fmt: skip
    names = [f"o{i}" for i in range(objects)]
    near = ", ".join(f"near({a}, {b})" for a, b in zip(names, names[1:] + names[:1], strict=True))
    goal = " and ".join(f"p0({name})" for name in names[:3])
    lines += ["problem many for large", f"object {', '.join(names)}: thing", f"init {near}"]
    lines += [f"goal {goal} reward 100", f"horizon {HORIZON}"]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Print seconds and sizes for each language and form."""
    actions, objects = (int(each) for each in [*sys.argv[1:], *("500", "20")[len(sys.argv) - 1 :]])
    start = time.perf_counter()
    document = menid_plan.parse(text(actions, objects))
    assert document.domain is not None
    assert document.problem is not None
    print(f"read: {time.perf_counter() - start:.2f} s")
    print(f"{actions} actions, {actions * objects} ground rules")
    for language, form in product(("ppddl", "prost", "pyrddlgym"), ("lifted", "grounded")):
        task = Task(document.domain, document.problem)
        start = time.perf_counter()
        try:
            if language == "ppddl":
                ppddl = ppddl_text(task, form)
                size = len(ppddl.domain) + len(ppddl.problem)
            else:
                dialect = "prost" if language == "prost" else "pyrddlgym"
                rddl = rddl_text(task, form, dialect, HORIZON)
                size = len(rddl.domain) + len(rddl.instance)
        except MenidError as error:
            print(f"{language} {form}: {error}")
            continue
        print(f"{language} {form}: {time.perf_counter() - start:.2f} s, {size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
