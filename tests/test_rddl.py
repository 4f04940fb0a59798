"""RDDL means what the problem means: pyRDDLGym's own CPFs, state by state, and the best value."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from hypothesis import HealthCheck, assume, given, settings

import menid_plan
from conftest import ROOT
from menid_plan.errors import LimitError, MeaningError
from menid_plan.exchange.classes import propositional
from menid_plan.exchange.flat import Flat, NotExpressibleError
from menid_plan.exchange.grounded import grounded
from menid_plan.exchange.lifted import lifted
from menid_plan.exchange.rddl import Dialect, rddl
from menid_plan.exchange.rddl_model import APPLYING
from menid_plan.grounding.semantics import Noise
from menid_plan.grounding.state import SINK, NextState
from menid_plan.model.domain import Domain, Problem
from menid_plan.model.formulas import GroundAtom
from menid_plan.planning import Task
from strategies import domains_with_problems
from transitions import PROBLEMS, Transitions, assert_same, documents, transitions

rddl_simulated = pytest.importorskip("rddl_simulated", reason="pyRDDLGym is not installed")
Rddl = rddl_simulated.Rddl

Menid = Callable[..., Result]
HORIZON = 4


def made(domain: Domain, problem: Problem, form: str, noise: Noise = "stay") -> Flat:
    if form == "lifted":
        return lifted(domain, problem, noise=noise, split=False)
    return propositional(grounded(domain, problem, noise=noise))


def explored(flat: Flat, dialect: Dialect, folder: Path, **options: bool) -> Rddl:
    found = Rddl(rddl(flat, dialect, HORIZON, **options), folder)
    found.explore()
    return found


def of_rddl(text: Rddl, dialect: Dialect) -> Transitions:
    """The transitions of the problem, in steps of its own."""
    sunk = text.written.sunk
    fact = {**{f: f for f in text.written.facts}, sunk: GroundAtom(sunk)}.get(sunk)

    def state_of(values: object) -> NextState:
        facts = text.facts(values)
        return SINK if sunk and fact in facts else facts

    g = text.discount
    rows = {}
    states = set()
    for values, acts in text.rows.items():
        if text.flag(values, APPLYING):
            assert list(acts) == [None], "something can be done in the second phase"
            continue
        states.add(state_of(values))
        # One has to act where one can, and can't elsewhere.
        assert acts.keys() == {None} or (acts and None not in acts)
        for act, (paid, drawn) in acts.items():
            if act is None:
                continue
            mean, after = paid, defaultdict(float)
            if dialect == "pyrddlgym":
                for then, chance in drawn.items():
                    after[state_of(then)] += chance
            else:
                for between, chance in drawn.items():
                    (paid_then, applied) = text.rows[between][None]
                    mean += g * chance * paid_then
                    for then, share in applied.items():
                        after[state_of(then)] += chance * share
                        if None in text.rows[then]:  # it is over
                            mean += g * g * chance * share * text.rows[then][None][0]
            key = (state_of(values), text.action(act))
            now = (mean, dict(after))
            if key in rows:  # with another flag up
                assert rows[key][0] == pytest.approx(mean)
            rows[key] = now
    return Transitions(state_of(text.initial), states, set(), rows)


def of_task(task: Task, text: Rddl) -> Transitions:
    """The transitions of a task, of whose states only what effects can change is told."""
    known = set(text.written.facts)

    def state_of(state: NextState) -> NextState:
        if state is SINK:
            return SINK
        return frozenset(a for a in state if a in known or a.predicate in known)

    found = transitions(task, state_of)
    return Transitions(found.initial, found.states, set(), found.rows)


def compare(domain: Domain, problem: Problem, text: Rddl, dialect: Dialect, noise: Noise) -> None:
    task = Task(domain, replace(problem, horizon=None), noise=noise)
    task.build()
    assert_same(of_task(task, text), of_rddl(text, dialect), 1e-9, 1e-9)


def best(domain: Domain, problem: Problem, noise: Noise = "stay") -> float:
    task = Task(domain, replace(problem, horizon=HORIZON), noise=noise)
    task.build()
    return task.solve(task.solver("value-iteration"), "reward").value


SMALL: list[tuple[str, str, Dialect]] = [
    *(
        (name, form, dialect)
        for name in ("greenhouse/two-pots", "rescue/corridor", "tireworld/triangle-1")
        for form in ("lifted", "grounded")
        for dialect in ("prost", "pyrddlgym")
    ),
    ("hdd/bench", "lifted", "pyrddlgym"),
    ("hdd/bench", "grounded", "prost"),
    ("maintenance/workshop", "lifted", "pyrddlgym"),
    ("maintenance/workshop", "grounded", "prost"),
    ("exploding-blocks/unstack", "lifted", "pyrddlgym"),
    ("exploding-blocks/unstack", "lifted", "prost"),
    ("slippery-grid/pond", "grounded", "pyrddlgym"),
    ("blocks/turn-over", "grounded", "pyrddlgym"),
]


@pytest.mark.parametrize(("name", "form", "dialect"), SMALL)
def test_shipped_problems(tmp_path: Path, name: str, form: str, dialect: Dialect) -> None:
    path = next(p for p in PROBLEMS if f"{p.parent.name}/{p.stem}" == name)
    domain, problem = documents(path)
    text = explored(made(domain, problem, form), dialect, tmp_path)
    compare(domain, problem, text, dialect, "stay")
    paying = problem.goal is None or name != "exploding-blocks/unstack"
    if paying:
        assert text.value() == pytest.approx(best(domain, problem), abs=1e-6)


@pytest.mark.parametrize("dialect", ["prost", "pyrddlgym"])
def test_noise_that_leads_out_of_the_model(tmp_path: Path, dialect: Dialect) -> None:
    domain, problem = documents(next(p for p in PROBLEMS if p.stem == "two-pots"))
    text = explored(made(domain, problem, "lifted", "sink"), dialect, tmp_path)
    compare(domain, problem, text, dialect, "sink")
    assert text.value() == pytest.approx(best(domain, problem, "sink"), abs=1e-6)


# Everything that takes a class, a guard, or a flag: subtypes, `either`, constants, an empty type,
# universal and conditional effects, rewards of states, goals and dead ends, several numbers.
RICH = """
domain rich
type thing, place
type ball < thing
type box < thing
type ghost
constant home: place
predicate at(thing, place)
predicate in(ball, box)
predicate broken(thing)
predicate lit
predicate haunts(ghost, place)
reward 0.5 per b: ball when at(b, home)
reward -0.25 when lit
action move(t: thing, to: place) cost 0.125 {
  rule go per to {
    the here: place where at(t, here)
    when here != to and not broken(t) and not exists g: ghost (haunts(g, to))
    outcomes {
      there: 0.75 not at(t, here), at(t, to), if to = home { lit }
      falls: 0.25 broken(t), forall b: ball where at(b, home) { broken(b) }
    }
    probabilities target for home { there: 0.5 falls: 0.25 noise: 0.25 }
  }
}
action pack(b: ball, x: box) {
  rule together {
    when not in(b, x) and exists p: place (at(b, p) and at(x, p))
    outcomes { packed: 1 in(b, x) reward 2 }
  }
}
problem small for rich
object ball1: ball
object box1: box
object away: place
init at(ball1, home), at(box1, away)
goal in(ball1, box1) and lit reward 10
dead-end reward -3
discount 0.9
"""


def rich(text: str = RICH) -> tuple[Domain, Problem]:
    document = menid_plan.parse(text)
    assert document.domain is not None
    assert document.problem is not None
    return document.domain, document.problem


@pytest.mark.parametrize("form", ["lifted", "grounded"])
@pytest.mark.parametrize("dialect", ["prost", "pyrddlgym"])
@pytest.mark.parametrize("noise", ["stay", "sink"])
def test_all_that_the_language_has(
    tmp_path: Path, form: str, dialect: Dialect, noise: Noise
) -> None:
    domain, problem = rich()
    text = explored(made(domain, problem, form, noise), dialect, tmp_path)
    compare(domain, problem, text, dialect, noise)
    assert text.value() == pytest.approx(best(domain, problem, noise), abs=1e-6)
    stopping = explored(made(domain, problem, form, noise), dialect, tmp_path, stopping=True)
    assert stopping.discount == 1.0
    assert stopping.value() == pytest.approx(best(domain, problem, noise), abs=1e-6)


@pytest.mark.parametrize("dialect", ["prost", "pyrddlgym"])
def test_if_nothing_is_paid_the_goal_pays_one(tmp_path: Path, dialect: Dialect) -> None:
    domain, problem = rich(
        "domain d\npredicate done\npredicate lost\naction try { rule r { when not done and not lost "
        "outcomes { yes: 0.25 done  again: 0.5 nothing  never: 0.25 lost } } }\n"
        "problem p for d\ngoal done\n"
    )
    text = explored(made(domain, problem, "lifted"), dialect, tmp_path)
    assert text.value() == pytest.approx(0.25 * (1 + 0.5 + 0.25 + 0.125))


@pytest.mark.parametrize("dialect", ["prost", "pyrddlgym"])
def test_probabilities_can_be_changed_in_the_instance(tmp_path: Path, dialect: Dialect) -> None:
    domain, problem = rich()
    written = rddl(made(domain, problem, "lifted"), dialect, HORIZON)
    instance = written.instance
    for line, new in (("P_move_there(away) = 0.75", "0.5"), ("P_move_falls(away) = 0.25", "0.5")):
        assert line in instance
        instance = instance.replace(line, f"{line.split('=')[0]}= {new}")
    text = Rddl(replace(written, instance=instance), tmp_path)
    text.explore()
    changed = RICH.replace("there: 0.75", "there: 0.5").replace(
        "falls: 0.25 broken", "falls: 0.5 broken"
    )
    assert text.value() == pytest.approx(best(*rich(changed)), abs=1e-6)
    assert best(*rich(changed)) != pytest.approx(best(*rich()), abs=1e-3)


# Things of types that have nothing in common are told apart, though RDDL may not ask; a goal speaks of
# objects that nothing else does; and names that readers of RDDL would take to pieces.
APART = """
domain apart_
type t_, u
constant c: u
constant _a, b__b: t_
predicate p_(t_)
predicate q(u)
reward 0.5 per sv: t_ when p_(sv) and not (c = sv)
action a_(x: t_) cost 0.25 {
  rule r_ { when not p_(x) and x != c outcomes { done_: 0.5 p_(x), q(c)  fails__: 0.5 nothing } }
}
problem pr_ for apart_
object o: object
goal forall y: object (exists x: t_ (p_(x)) and y != _a implies q(c))
  and forall x: t_ (x != o and p_(x)) reward 3
"""


@pytest.mark.parametrize("form", ["lifted", "grounded"])
@pytest.mark.parametrize("dialect", ["prost", "pyrddlgym"])
def test_things_of_different_types_and_awkward_names(
    tmp_path: Path, form: str, dialect: Dialect
) -> None:
    domain, problem = rich(APART)
    text = explored(made(domain, problem, form), dialect, tmp_path)
    compare(domain, problem, text, dialect, "stay")
    assert text.value() == pytest.approx(best(domain, problem), abs=1e-6)


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(domains_with_problems())
def test_generated_problems(
    tmp_path_factory: pytest.TempPathFactory, documents: tuple[Domain, Problem]
) -> None:
    domain, problem = documents
    task = Task(domain, replace(problem, horizon=None), max_states=30)
    try:
        task.build()
    except (MeaningError, LimitError):
        assume(False)
    for form in ("lifted", "grounded"):
        try:
            flat = made(domain, problem, form)
            written = rddl(flat, "pyrddlgym", HORIZON)
        except (NotExpressibleError, MeaningError, LimitError):
            continue
        text = Rddl(written, tmp_path_factory.mktemp("rddl"))
        if len(text.acts) > 60:
            continue
        text.explore()
        assert_same(of_task(task, text), of_rddl(text, "pyrddlgym"), 1e-9, 1e-6)


@pytest.mark.parametrize("dialect", ["prost", "pyrddlgym"])
def test_simulated_returns_agree_with_the_value(tmp_path: Path, dialect: Dialect) -> None:
    """The best policy, played in pyRDDLGym with its own chances."""
    domain, problem = rich()
    text = explored(made(domain, problem, "lifted"), dialect, tmp_path)
    best_acts = []
    value = dict.fromkeys(text.rows, 0.0)
    for _ in range(text.horizon):
        worth = {
            values: {
                act: paid + text.discount * sum(p * value[each] for each, p in after.items())
                for act, (paid, after) in acts.items()
            }
            for values, acts in text.rows.items()
        }
        best_acts.append({v: max(acts, key=acts.__getitem__) for v, acts in worth.items()})
        value = {values: max(acts.values()) for values, acts in worth.items()}
    simulator = rddl_simulated.RDDLSimulator(text.model, rng=np.random.default_rng(7))
    returns = []
    for _ in range(1500):
        simulator.reset()
        total, factor = 0.0, 1.0
        for acts in reversed(best_acts):
            now = tuple(
                (name, np.asarray(simulator.subs[name]).tobytes())
                for name in text.model.state_fluents
            )
            _, reward, _ = simulator.step(text.prepared(acts[now]))
            total, factor = total + factor * reward, factor * text.discount
        returns.append(total)
    error = float(np.std(returns)) / len(returns) ** 0.5
    assert abs(np.mean(returns) - best(domain, problem)) < 4 * error


# ------------------------------------------------------------------------------------ the command

LAMPS = """
domain lamps
type switch, sum
predicate on(switch)
predicate det(sum)
action press(s: switch) cost 1 {
  rule press { when not on(s) outcomes a b { lit: 0.5 0.25 on(s)  dark: 0.5 0.75 nothing } }
}
problem all for lamps
object if-then: switch
goal forall s: switch (on(s))
"""


@pytest.fixture
def lamps(tmp_path: Path) -> Path:
    text = LAMPS.replace("type switch", "environment a: target\nenvironment b: test\ntype switch")
    (tmp_path / "lamps.menid").write_text(text, encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize("dialect", ["prost", "pyrddlgym"])
def test_files_are_written_and_names_told(menid: Menid, lamps: Path, dialect: Dialect) -> None:
    result = menid(
        "export", "rddl", "lamps.menid", "--dialect", dialect, "--horizon", "9", "-o", "out"
    )
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines() == ["wrote out/domain.rddl", "wrote out/instance.rddl"]
    domain, instance = (
        (lamps / "out" / f"{name}.rddl").read_text() for name in ("domain", "instance")
    )
    assert ("interm-fluent" in domain) == (dialect == "pyrddlgym")
    assert re.search(r"horizon = (\d+);", instance)[1] == ("18" if dialect == "prost" else "9")
    assert "P_press_lit = 0.5;" in instance
    assert "discount = 1.0;" in instance


def test_reserved_names_are_told(menid: Menid, lamps: Path) -> None:
    text = (
        (lamps / "lamps.menid").read_text().replace("press", "switch-row").replace("if-then", "row")
    )
    (lamps / "lamps.menid").write_text(text, encoding="utf-8")
    result = menid("export", "rddl", "lamps.menid", "--horizon", "9", "-o", "out")
    assert result.exit_code == 0, result.output
    assert (
        "menid: renamed, since RDDL has other uses for them: `row` to `row_2`, `switch`"
        in result.stderr
    )
    assert "// row_2 was called row.\n" in (lamps / "out" / "domain.rddl").read_text()


def test_environments_and_stopping(menid: Menid, lamps: Path) -> None:
    arguments = ("export", "rddl", "lamps.menid", "--horizon", "3", "-o", "out")
    assert menid(*arguments, "--env", "b").exit_code == 0
    assert "P_press_lit = 0.25;" in (lamps / "out" / "instance.rddl").read_text()
    with (lamps / "lamps.menid").open("a") as file:
        file.write("discount 0.75\n")
    assert menid(*arguments, "--stopping").exit_code == 0
    assert "Bernoulli(0.25)" in (lamps / "out" / "domain.rddl").read_text()
    assert "discount = 1.0;" in (lamps / "out" / "instance.rddl").read_text()
    assert menid(*arguments, "--goal-reward", "7.5").exit_code == 0
    assert "discount = 0.8660254037844386;" in (lamps / "out" / "instance.rddl").read_text()
    assert "horizon = 7;" in (lamps / "out" / "instance.rddl").read_text()
    # One over the discount, since it is paid two phases late.
    assert "10.0 * (applied" in (lamps / "out" / "domain.rddl").read_text()


@pytest.mark.parametrize(
    ("options", "code", "message"),
    [
        ([], 2, "problem `all` has no horizon, and RDDL must have one: give --horizon"),
        (["--horizon", "0"], 2, "--horizon"),
        (["--horizon", "5", "--goal-reward", "nan"], 2, "nan is not a finite number"),
        (["--horizon", "5", "--dialect", "spudd"], 2, "'spudd' is not one of"),
        (["--horizon", "5", "--env", "c"], 3, "there is no environment `c`"),
    ],
)
def test_what_is_refused(
    menid: Menid, lamps: Path, options: list[str], code: int, message: str
) -> None:
    result = menid("export", "rddl", "lamps.menid", *options, "-o", "out")
    assert result.exit_code == code
    assert message in result.stderr
    assert not (lamps / "out").exists()


def test_what_can_t_be_lifted_is_grounded_and_told(menid: Menid, tmp_path: Path) -> None:
    folder = ROOT / "domains" / "blocks"
    files = (str(folder / "domain.menid"), str(folder / "turn-over.menid"))
    result = menid("export", "rddl", *files, "--horizon", "9", "-o", "out")
    assert result.exit_code == 0, result.output
    assert "menid: grounded, since " in result.stderr
    assert "the derived predicate `above` is recursive" in result.stderr
    result = menid("export", "rddl", *files, "--horizon", "9", "--lifted", "-o", "none")
    assert result.exit_code == 4
    assert not (tmp_path / "none").exists()


def test_a_problem_without_actions_is_refused(menid: Menid, tmp_path: Path) -> None:
    (tmp_path / "none.menid").write_text("domain d\npredicate p\nproblem q for d\nhorizon 3\n")
    result = menid("export", "rddl", "none.menid", "-o", "out")
    assert result.exit_code == 4
    assert "RDDL has no problems without actions" in result.stderr
