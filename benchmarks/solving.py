"""From a text to a policy: menid against Storm, mdpsolver and pymdptoolbox on the same models.

    pip install 'menid-plan[storm]' mdpsolver pymdptoolbox
    python benchmarks/solving.py [--quick | --large] [--part PART] [--family NAME [--sizes N...]]

Prints tables in Markdown. Every measurement is a process of its own, with a time limit; contenders
take turns, and the median of the repeats counts. Times are seconds as a user waits for them; where
ratios are judged, those of the seconds that all cores worked stand beside them. Memory is the peak of
the process. `families.py` has the models. That both sides have the same numbers of states and
transitions, and the same value, is checked in every run.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from families import FAMILIES, Model, machines, ring

MENID = Path(sys.executable).with_name("menid")
EPSILON = 1e-6
# Where values are so large that doubles cannot bring certified bounds that near each other.
COARSER = {("walk", 1000): 1e-3, ("walk", 1500): 1e-2, ("sheet", 80): 1e-5, ("sheet", 100): 1e-4}
TOUCHED = 2**30  # bytes that a process has used before its work is timed
# How the C library is told to keep what was given back to it.
KEEP = {"MALLOC_MMAP_MAX_": "0", "MALLOC_TRIM_THRESHOLD_": str(2**40), "MALLOC_ARENA_MAX": "1"}
SIZES = {
    "machines": (14, 16, 18),
    "walk": (100, 200, 1000),
    "sheet": (20, 40, 80),
    "ring": (48, 96, 144),
    "courier": (8, 16, 24),
}
LARGE = {"machines": (20,), "walk": (1500,), "sheet": (100,), "ring": (192,), "courier": (32,)}
QUICK = {"machines": (16,), "walk": (100,), "sheet": (20,), "ring": (72,), "courier": (12,)}
SMALLEST = {"machines": 3, "walk": 6, "sheet": 3, "ring": 8, "courier": 4}
# How Storm is asked: its default, and its methods that promise the precision.
METHODS = {
    "default": "",
    "interval": "INTERVAL_ITERATION",
    "optimistic": "OPTIMISTIC_VALUE_ITERATION",
    "sound": "SOUND_VALUE_ITERATION",
}
DISCOUNT = 0.95


# ------------------------------------------------------------------------------ in processes


class Clock:
    """What the parts of a piece of work take, and under ``cpu NAME`` what they take of all cores."""

    def __init__(self) -> None:
        self.spans: dict[str, float] = {}
        self.start()

    def start(self) -> None:
        """Begin the next part here."""
        self.wall, self.cpu = time.perf_counter(), time.process_time()

    def stop(self, name: str) -> None:
        """End a part, and begin the next."""
        self.spans[name] = time.perf_counter() - self.wall
        self.spans[f"cpu {name}"] = time.process_time() - self.cpu
        self.start()


def work_menid(folder: Path, options: dict[str, Any]) -> dict[str, Any]:
    """Build and solve with everything loaded, and say what each part took."""
    import numpy as np

    import menid_plan
    from menid_plan.grounding.ground import ground
    from menid_plan.mdp.explore import explore
    from menid_plan.mdp.probabilities import written
    from menid_plan.planning import Task

    solver = Task.solver("value-iteration", epsilon=options["epsilon"])

    def build(name: str) -> tuple[Any, Any, dict[str, Any]]:
        document = menid_plan.read(folder / name)
        clock = Clock()
        problem = ground(document.domain, document.problem)
        chances, happens = written(problem, document.domain.target)
        clock.stop("ground")
        structure = explore(problem, happens)
        clock.stop("explore")
        mdp = structure.fill(chances)
        clock.stop("fill")
        return structure, mdp, clock.spans

    _, small, _ = build("small.menid")
    if options["solve"]:
        solver.solve(small, options["objective"])
    structure, mdp, result = build("model.menid")
    ends = np.diff(mdp.state_row) == 0
    result |= {
        "states": mdp.states,
        "rows": mdp.rows,
        "transitions": mdp.transitions,
        "ends": int(ends.sum()),
        "facts": len(structure.problem.facts),
        "rules": len(structure.problem.rules),
        "words": structure.problem.tables.words,
    }
    if options["solve"]:
        clock = Clock()
        solution = solver.solve(mdp, options["objective"])
        clock.stop("solve")
        result |= clock.spans
        result["value"], result["status"] = float(solution.value), solution.status
        result["iterations"] = solution.iterations
    if options.get("merged"):
        # Storm adds up the entries of a row that lead to the same state.
        result["merged"] = 0
        for first in range(0, mdp.rows, 1 << 20):
            counts = np.diff(mdp.row_transition[first : first + (1 << 20) + 1])
            at = int(mdp.row_transition[first])
            after = mdp.next_state[at : at + int(counts.sum())]
            keys = np.repeat(np.arange(len(counts)), counts) * mdp.states + after
            result["merged"] += len(np.unique(keys))
    if options.get("arrays"):
        np.savez(
            folder / "arrays.npz", mdp.state_row, mdp.row_reward, mdp.row_transition, mdp.next_state,
            mdp.probability,
        )  # fmt: skip
    return result


def work_storm(folder: Path, options: dict[str, Any]) -> dict[str, Any]:
    """Build with Storm's sparse engine and check by one of its methods."""
    import stormpy

    clock = Clock()
    program = stormpy.parse_prism_program(str(folder / "model.prism"))
    properties = stormpy.parse_properties(options["formula"], program)
    clock.stop("parse")
    model = stormpy.build_model(program, properties)
    clock.stop("build")
    result = {
        "states": model.nr_states,
        "rows": model.nr_choices,
        "transitions": model.nr_transitions,
    } | clock.spans
    print(json.dumps(result), flush=True)  # in case that checking takes too long
    if options["method"] is None:
        return result
    name = METHODS[options["method"]]
    environment = stormpy.environments.sound() if name else stormpy.Environment()
    settings = environment.solver().min_max()
    settings.precision = stormpy.Rational(repr(options["epsilon"]))
    settings.relative_termination_criterion = False
    if name:
        settings.method = getattr(stormpy.environments.MinMaxMethod, name)
    clock.start()
    answer = stormpy.model_checking(model, properties[0], environment=environment)
    clock.stop("check")
    result |= clock.spans
    result["value"] = float(answer.get_value_vector()[model.initial_states[0]])
    return result


def arrays(folder: Path) -> tuple[Any, ...]:
    import numpy as np

    with np.load(folder / "arrays.npz") as stored:
        return tuple(stored[name] for name in stored.files)


def work_mdpsolver(folder: Path, _: dict[str, Any]) -> dict[str, Any]:
    """The package mdpsolver, from nested lists, with its default algorithm."""
    import mdpsolver

    first, reward, start, after, chance = (array.tolist() for array in arrays(folder))
    rewards, columns, chances = [], [], []
    for state in range(len(first) - 1):
        rows = range(first[state], first[state + 1])
        rewards.append([reward[row] for row in rows] or [0.0])
        columns.append([after[start[row] : start[row + 1]] for row in rows] or [[state]])
        chances.append([chance[start[row] : start[row + 1]] for row in rows] or [[1.0]])
    model = mdpsolver.model()
    model.mdp(discount=DISCOUNT, rewards=rewards, tranMatProbs=chances, tranMatColumns=columns)
    clock = Clock()
    model.solve(algorithm="mpi", tolerance=EPSILON, parallel=False)
    clock.stop("solve")
    return {"value": float(model.getValue(0))} | clock.spans


def work_toolbox(folder: Path, _: dict[str, Any]) -> dict[str, Any]:
    """The package pymdptoolbox, from a sparse matrix for each action.

    Its plain value iteration first takes minutes to bound the number of iterations.
    """
    import numpy as np
    from mdptoolbox.mdp import PolicyIterationModified
    from scipy.sparse import csr_matrix, diags_array

    first, reward, start, after, chance = arrays(folder)
    states = len(first) - 1
    matrix = csr_matrix((chance, after, start), shape=(len(reward), states))
    ends = np.diff(first) == 0
    loops = ends.astype(np.float64)
    steps, pays = [], []
    for k in range(int(np.diff(first).max())):
        # States with fewer rows repeat their last one.
        row = np.minimum(first[:-1] + k, first[1:] - 1)
        row[ends] = 0
        part = diags_array(1.0 - loops) @ matrix[row] + diags_array(loops)
        pay = reward[row]
        pay[ends] = 0.0
        steps.append(csr_matrix(part))
        pays.append(pay)
    clock = Clock()
    solver = PolicyIterationModified(steps, np.array(pays).T, DISCOUNT, epsilon=EPSILON)
    solver.run()
    clock.stop("solve")
    return {"value": float(solver.V[0])} | clock.spans


WORK = {
    "menid": work_menid,
    "storm": work_storm,
    "mdpsolver": work_mdpsolver,
    "toolbox": work_toolbox,
}


# ------------------------------------------------------------------------------ running them


def run(command: list[str], limit: float, **variables: str) -> dict[str, Any]:
    """Run a process to its end, or to the limit; what it printed last, and what it used."""
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        start = time.monotonic()
        process = subprocess.Popen(
            command, stdout=output, stderr=errors, env={**os.environ, **variables}
        )
        ended, state, usage = 0, 0, None
        while not ended:
            ended, state, usage = os.wait4(process.pid, os.WNOHANG)
            if not ended:
                if time.monotonic() - start > limit:
                    process.kill()
                    limit = math.inf
                time.sleep(0.005)
        process.returncode = os.waitstatus_to_exitcode(state)
        output.seek(0)
        text = output.read().decode().strip()
        result: dict[str, Any] = {}
        if text.endswith("}"):
            result = json.loads(text if text.startswith("{\n") else text.splitlines()[-1])
        result["whole"] = time.monotonic() - start
        result["cpu whole"] = usage.ru_utime + usage.ru_stime
        result["megabytes"] = usage.ru_maxrss / 1024
        result["timeout"] = math.isinf(limit)
        if process.returncode and not result["timeout"]:
            errors.seek(0)
            lines = errors.read().decode().strip().splitlines()
            result["failed"] = lines[-1] if lines else f"exit code {process.returncode}"
        return result


def worker(
    kind: str, folder: Path, limit: float, *, fresh: bool = False, **options: Any
) -> dict[str, Any]:
    """Time a contender's parts in a process that has its memory already.

    In a virtual machine whoever is the first to use a page waits for the host, for longer than the
    work on it takes. With ``fresh`` the process has none, so that what it needs can be told.
    """
    command = [sys.executable, __file__, "--worker", kind, str(folder), json.dumps(options)]
    return run(command, limit, **({} if fresh else KEEP))


def precision(model: Model) -> float:
    """How near the value a model is to be solved."""
    return COARSER.get((model.name, model.size), EPSILON)


def menid(folder: Path, model: Model, limit: float) -> dict[str, Any]:
    file = str(folder / "model.menid")
    command = [str(MENID), "solve", file, "--json", "--epsilon", repr(precision(model))]
    command += ["--objective", model.objective]
    return run(command, limit)


@dataclass
class Line:
    """What was measured of one model: for each contender the medians of its numbers."""

    family: str
    size: int
    runs: dict[str, list[dict[str, Any]]] = field(default_factory=dict)

    def add(self, name: str, result: dict[str, Any]) -> None:
        """Note what one process gave."""
        self.runs.setdefault(name, []).append(result)

    def get(self, name: str, key: str) -> float | None:
        """The median of a number, None if no process came so far."""
        found = [run[key] for run in self.runs.get(name, []) if run.get(key) is not None]
        return statistics.median(found) if found else None

    def out(self, name: str) -> str:
        """Why a contender has no result."""
        runs = self.runs.get(name, [])
        if any(run["timeout"] for run in runs):
            return "time"
        return "fails" if any("failed" in run for run in runs) else "-"


def write_model(folder: Path, model: Model) -> None:
    (folder / "model.menid").write_text(model.text)
    (folder / "model.prism").write_text(model.prism)
    small = FAMILIES[model.name](SMALLEST[model.name])
    (folder / "small.menid").write_text(small.text)


def measure(model: Model, arguments: argparse.Namespace) -> Line:
    line = Line(model.name, model.size)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_model(folder, model)
        for repeat in range(arguments.repeats):
            progress(f"{model.name} {model.size}, round {repeat + 1}")
            options = {"objective": model.objective, "epsilon": precision(model)}
            options |= {"solve": True, "merged": repeat == 0}
            line.add("menid", worker("menid", folder, arguments.limit, **options))
            line.add("whole", menid(folder, model, arguments.limit))
            line.add(
                "fresh",
                worker(
                    "storm", folder, arguments.limit, fresh=True, formula=model.formula,
                    method="default", epsilon=precision(model),
                ),
            )  # fmt: skip
            for method in METHODS:
                if line.runs.get(method, [{"timeout": False}])[-1]["timeout"]:
                    continue
                line.add(
                    method,
                    worker(
                        "storm", folder, arguments.limit, formula=model.formula, method=method,
                        epsilon=precision(model),
                    ),
                )  # fmt: skip
    check(model, line)
    return line


def check(model: Model, line: Line) -> None:
    """Whether both sides speak of the same model, and agree on its value."""
    ours, storm = line.runs["menid"][0], line.runs["default"][0]
    for run in (ours, storm):
        if run["timeout"] or "failed" in run:
            progress(f"{model.name} {model.size}: {run}")
    if "states" in ours and "states" in storm:
        assert ours["states"] == storm["states"], (ours, storm)
        assert ours["merged"] + ours["ends"] == storm["transitions"], (ours, storm)
        assert ours["rows"] + ours["ends"] == storm["rows"], (ours, storm)
    exact = ours.get("value")
    for method in METHODS:
        value = line.get(method, "value")
        if exact is None or value is None or not METHODS[method]:
            continue
        error = abs(model.sign * value - exact)
        assert error <= 3 * precision(model) + 1e-9 * abs(exact), (model.name, method, value, exact)


# -------------------------------------------------------------------------------- the tables


def show(value: float | None, otherwise: str = "-") -> str:
    if value is None:
        return otherwise
    if value >= 100:
        return f"{value:.0f}"
    return f"{value:.2f}" if value >= 0.995 else f"{value:.3f}"


def table(head: str, rows: list[list[str]]) -> None:
    names = [name.strip() for name in head.split("|")]
    print("|", " | ".join(names), "|")
    print("|", " | ".join("---" if i == 0 else "---:" for i in range(len(names))), "|")
    for row in rows:
        print("|", " | ".join(row), "|")
    print(flush=True)


def ratio(above: float | None, below: float | None) -> float | None:
    return None if above is None or not below else above / below


def times(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def tables(lines: list[Line]) -> None:
    print("## Building the model\n")
    rows = []
    for line in lines:
        ground, explore = line.get("menid", "ground"), line.get("menid", "explore")
        fill, build = line.get("menid", "fill"), line.get("default", "build")
        total = None if explore is None else ground + explore + fill
        rows.append(
            [f"{line.family} {line.size}"]
            + [f"{line.get('menid', key) or 0:,.0f}" for key in ("facts", "states", "merged")]
            + [show(x, line.out("menid")) for x in (ground, explore, fill)]
            + [show(build, line.out("default"))]
            + [times(ratio(build, explore)), times(ratio(build, total))]
        )
    table(
        "model | fluents | states | transitions | ground (s) | explore (s) | fill (s) | Storm (s)"
        " | Storm / explore | Storm / all three",
        rows,
    )
    print("## Solving it\n")
    rows = []
    for line in lines:
        solve, value = line.get("menid", "solve"), line.get("menid", "value")
        default = line.get("default", "check")
        found = line.get("default", "value")
        error = None if found is None or value is None else abs(abs(found) - abs(value))
        status = {run.get("status") for run in line.runs["menid"]} - {"solved", None}
        rows.append(
            [f"{line.family} {line.size}", "-" if value is None else f"{value:.9g}"]
            + [f"{COARSER.get((line.family, line.size), EPSILON):.0e}"]
            + [show(solve, line.out("menid")) + ("".join(f" ({s})" for s in status))]
            + [show(default, line.out("default"))]
            + ["-" if error is None else f"{error:.0e}"]
            + [
                show(line.get(name, "check"), line.out(name))
                for name in METHODS
                if name != "default"
            ]
            + [times(ratio(default, solve))]
            + [times(ratio(best_sound(line), solve))]
        )
    table(
        "model | value | to within | menid (s) | Storm's default (s) | its error | interval (s)"
        " | optimistic (s) | sound (s) | default / menid | best sound / menid",
        rows,
    )
    print("## Whole processes, from the text to the policy\n")
    rows = []
    for line in lines:
        whole, theirs = line.get("whole", "whole"), line.get("fresh", "whole")
        both = storm_both(line)
        rows.append(
            [
                f"{line.family} {line.size}",
                show(whole, line.out("whole")),
                show(both),
                show(theirs if both else None, line.out("fresh")),
                times(ratio(both, whole)),
                show(line.get("whole", "megabytes")),
                show(line.get("fresh", "megabytes")),
                show(bytes_each(line, "whole")),
                show(bytes_each(line, "fresh")),
            ]
        )
    table(
        "model | `menid solve` (s) | Storm's build and solve (s) | Storm's process (s) | ratio"
        " | menid (MB) | Storm (MB) | menid, bytes a transition | Storm",
        rows,
    )


def best_sound(line: Line) -> float | None:
    found = [line.get(name, "check") for name in METHODS if name != "default"]
    return min((value for value in found if value is not None), default=None)


def storm_both(line: Line, of: str = "") -> float | None:
    build, check = line.get("fresh", f"{of}build"), line.get("fresh", f"{of}check")
    return None if build is None or check is None else build + check


def bytes_each(line: Line, name: str) -> float | None:
    used, count = line.get(name, "megabytes"), line.get("menid", "merged")
    return ratio(None if used is None else used * 2**20, count)


def discounted(sizes: tuple[int, ...], arguments: argparse.Namespace) -> None:
    """Against packages that take arrays; they know discounted rewards alone."""
    print(f"## Packages that take arrays: machines with discount {DISCOUNT}\n")
    rows = []
    for size in sizes:
        model = machines(size, DISCOUNT)
        line = Line(model.name, size)
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            write_model(folder, model)
            (folder / "small.menid").write_text(machines(3, DISCOUNT).text)
            for repeat in range(arguments.repeats):
                progress(f"discounted {size}, round {repeat + 1}")
                options = {"objective": model.objective, "epsilon": EPSILON}
                options |= {"solve": True, "arrays": repeat == 0}
                line.add("menid", worker("menid", folder, arguments.limit, fresh=True, **options))
                for kind in ("mdpsolver", "toolbox"):
                    line.add(kind, worker(kind, folder, arguments.limit, fresh=True))
                line.add(
                    "storm",
                    worker(
                        "storm",
                        folder,
                        arguments.limit,
                        formula=model.formula,
                        method="default",
                        fresh=True,
                        epsilon=EPSILON,
                    ),
                )
        ours = line.get("menid", "solve")
        row = [f"machines {size}", f"{line.get('menid', 'transitions') or 0:,.0f}"]
        for name, key in (
            ("menid", "solve"), ("mdpsolver", "solve"), ("toolbox", "solve"), ("storm", "check"),
        ):  # fmt: skip
            value, exact = line.get(name, "value"), line.get("menid", "value")
            row.append(show(line.get(name, key), line.out(name)))
            if name != "menid":
                off = None if value is None else abs(abs(value) - abs(exact))
                row += [
                    "-" if off is None else f"{off:.0e}",
                    times(ratio(line.get(name, key), ours)),
                ]
            row.append(show(line.get(name, "megabytes")))
        rows.append(row)
    table(
        "model | transitions | menid (s) | MB | mdpsolver (s) | error | / menid | MB"
        " | pymdptoolbox (s) | error | / menid | MB | Storm (s) | error | / menid | MB",
        rows,
    )


# ------------------------------------------------------------------------------- the demands


def demand(
    what: str, value: float | None, bound: float, *, least: bool, cores: float | None = None
) -> list[str]:
    sign = "at least" if least else "at most"
    if value is None:
        return [what, "-", "-", f"{sign} {bound:g}", "NOT MEASURED"]
    good = value >= bound if least else value <= bound
    verdict = "PASS" if good else "FAIL"
    return [what, f"{value:.3g}", times(cores), f"{sign} {bound:g}", verdict]


def each_transition(model: Model, arguments: argparse.Namespace) -> dict[str, float]:
    """Exploring alone: seconds for each transition, and peak memory."""
    line = Line(model.name, model.size)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_model(folder, model)
        for _ in range(max(5, arguments.repeats)):  # they take little time, and vary
            options = {"objective": model.objective, "solve": False, "epsilon": EPSILON}
            line.add("menid", worker("menid", folder, arguments.limit, **options))
    explore, count = line.get("menid", "explore"), line.get("menid", "transitions")
    return {"seconds": explore / count if explore else math.nan, "transitions": count or math.nan}


def faults_for(size: int, transitions: int) -> int:
    """How many machines have to be broken for so many transitions."""
    total = 0.0
    for k in range(1, size + 1):
        alone = (size - k) / (size - 1)
        total += math.comb(size, k) * k * (1 + 3 * alone + 2 * (1 - alone))
        if total >= transitions:
            return k
    return size


def demands(lines: list[Line], arguments: argparse.Namespace) -> None:
    print("## Demands\n")
    rows = []
    for family in dict.fromkeys(line.family for line in lines):
        line = [line for line in lines if line.family == family][-1]
        name = f"{family} {line.size}"
        for what, bound, theirs, ours in (
            ("Storm's builder / explore", 10, ("default", "build"), ("menid", "explore")),
            ("Storm's default method / solve", 4, ("default", "check"), ("menid", "solve")),
            ("Storm's build and solve / `menid solve`", 3, None, ("whole", "whole")),
        ):
            found = []
            for of in ("", "cpu "):
                above = line.get(theirs[0], of + theirs[1]) if theirs else storm_both(line, of)
                found.append(ratio(above, line.get(ours[0], of + ours[1])))
            rows.append(
                demand(f"{name}: {what}", found[0], bound, least=True, cores=found[1]),
            )
    for size, count in ((21, 20_000_000),):
        model = machines(size, faults=faults_for(size, count))
        with tempfile.TemporaryDirectory() as folder:
            write_model(Path(folder), model)
            progress("20 million transitions")
            found = menid(Path(folder), model, arguments.limit)
            alone = run([str(MENID), "ground", f"{folder}/model.menid", "--json"], arguments.limit)
        counted = f"{found.get('transitions', math.nan):,.0f} transitions"
        rows += [
            demand(f"`menid ground`, {counted}: MB", alone["megabytes"], 1024, least=False),
            demand(f"`menid solve`, {counted}: MB", found["megabytes"], 1024, least=False),
        ]
    progress("beyond 64 fluents")
    few, many = each_transition(ring(63), arguments), each_transition(ring(69), arguments)
    rows.append(
        demand(
            "ring: time a transition, 68 fluents / 62", many["seconds"] / few["seconds"], 1.5,
            least=False,
        )
    )  # fmt: skip
    for what, one, other in (
        ("recursive (ring 40)", ring(40), ring(40, live="inlined")),
        ("not recursive (machines 16)", machines(16, derived=True), machines(16)),
    ):
        progress(f"derived, {what}")
        with_it, without = each_transition(one, arguments), each_transition(other, arguments)
        assert with_it["transitions"] == without["transitions"]
        rows.append(
            demand(
                f"derived / inlined by hand, {what}", with_it["seconds"] / without["seconds"], 2,
                least=False,
            )
        )  # fmt: skip
    table("demand | measured | in seconds of all cores | asked | result", rows)


def progress(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def main() -> None:
    if sys.argv[1:2] == ["--worker"]:
        kind, folder, options = sys.argv[2:]
        if "MALLOC_MMAP_MAX_" in os.environ:
            bytearray(TOUCHED)[:: 2**12] = b"1" * (TOUCHED // 2**12)
        print(json.dumps(WORK[kind](Path(folder), json.loads(options))))
        return
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="one small size of each, once")
    parser.add_argument("--large", action="store_true", help="a large size of each as well")
    parser.add_argument("--part", choices=("models", "arrays", "demands"), help="this part alone")
    parser.add_argument("--family", choices=FAMILIES, help="this family alone")
    parser.add_argument("--sizes", type=int, nargs="+", help="these sizes; with --family")
    parser.add_argument("--repeats", type=int, help="how often; by default 3")
    parser.add_argument("--limit", type=float, help="seconds for a process; by default 300")
    arguments = parser.parse_args()
    if arguments.sizes and not arguments.family:
        parser.error("--sizes needs --family")
    arguments.repeats = arguments.repeats or (1 if arguments.quick else 3)
    arguments.limit = arguments.limit or (60.0 if arguments.quick else 300.0)
    sizes = QUICK if arguments.quick else SIZES
    if arguments.large:
        sizes = {name: few + LARGE[name] for name, few in SIZES.items()}
    part = "models" if arguments.family else arguments.part
    if part != "arrays":
        lines = []
        for family in [arguments.family] if arguments.family else FAMILIES:
            chosen = arguments.sizes or sizes[family]
            for size in chosen if part != "demands" else chosen[-1:]:
                lines.append(measure(FAMILIES[family](size), arguments))
        if part != "demands":
            tables(lines)
    if part in (None, "arrays"):
        discounted((10,) if arguments.quick else (10, 12, 14), arguments)
    if part in (None, "demands"):
        demands(lines, arguments)


if __name__ == "__main__":
    main()
