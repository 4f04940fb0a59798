"""Run files: what they say, and that each mistake is told with the key's name."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

import menid_plan
from conftest import ROOT
from menid_plan.environments.process import Process
from menid_plan.environments.runfile import (
    MAX_BYTES,
    RunFileError,
    WorkersTable,
    parse_run_file,
    read_run_file,
)
from menid_plan.environments.simulated import Simulated

DOCUMENT = menid_plan.read(ROOT / "domains" / "hdd" / "bench.menid")
assert DOCUMENT.domain is not None
assert DOCUMENT.problem is not None
DOMAIN, PROBLEM = DOCUMENT.domain, DOCUMENT.problem


@dataclass(frozen=True)
class Learn:
    seed: int = 0
    epsilon: float = 0.05


GOOD = """
[learn]
seed = 3

[workers]
number = 4
scheduler = "tcp://127.0.0.1:8786"

[environment.fine]
kind = "simulated"
role = "target"
duration = { lever = 30, suck = 12.5 }
timeout = 40
start_timeout = 5
retries = 0
workers = 2
settings = { column = "robot", params = { win = 2 } }

[environment.coarse]
kind = "process"
settings.command = ["sim", "-q"]
"""


def test_all_that_a_run_file_can_say() -> None:
    run = parse_run_file(GOOD, "folder/run.toml", {"learn": Learn})
    assert run.sections == {"learn": Learn(3, 0.05)}
    assert run.workers == WorkersTable(4, "tcp://127.0.0.1:8786")
    bound = run.bind(DOMAIN, PROBLEM, {"fail": 7.0})
    fine, coarse = bound.target, bound.tests[0]
    assert bound.environments == (fine, coarse)
    assert (fine.name, fine.role, fine.kind) == (
        "fine", "target", Simulated("robot", {"win": 2.0}),
    )  # fmt: skip
    assert (fine.nominal("lever"), fine.nominal("suck"), fine.nominal("shake")) == (30, 12.5, None)
    assert (fine.timeout, fine.start_timeout, fine.retries, fine.workers) == (40, 5, 0, 2)
    assert fine.params == {"fail": 7.0}
    assert fine.folder == Path("folder")
    assert (coarse.role, coarse.kind) == ("test", Process(("sim", "-q")))
    assert (coarse.duration, coarse.timeout, coarse.retries) == (None, 300, 2)
    # Whatever asks the domain for its target gets the run's; the robot is not used.
    assert bound.domain.target == "fine"
    assert [e.role for e in bound.domain.environments] == ["test", "target", "test"]


def test_sections_left_out_have_their_defaults_and_others_are_let_through() -> None:
    assert parse_run_file("", "run.toml", {"learn": Learn}).sections == {"learn": Learn()}
    assert parse_run_file("[learn]\nanything = 1", "run.toml").sections == {}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[environment.robot\nkind = 1", "line 1, column 19: Expected ']'"),
        ('a = "', "line 1: Unterminated string"),
        ("[enviroment.robot]", "enviroment: unknown table; did you mean `environment`?"),
        ("environment = 3", "environment: expected tables, as in [environment.NAME]"),
        ("[environment]\nrobot = 3", "environment.robot: expected a table, as in"),
        ("[environment.robot]", "environment.robot.kind: it is missing; expected a text"),
        ("[environment.robot]\nkind = 1", "environment.robot.kind: expected a text, not 1"),
        (
            '[environment.robot]\nkind = "simulate"',
            "environment.robot.kind: unknown kind of environment `simulate`; did you mean `simul",
        ),
        (
            '[environment.robot]\nkind = "simulated"\ntiemout = 1',
            "environment.robot.tiemout: unknown key; did you mean `timeout`?",
        ),
        (
            '[environment.robot]\nkind = "simulated"\ntimeout = "1 s"',
            'environment.robot.timeout: expected a number, not "1 s"',
        ),
        (
            '[environment.robot]\nkind = "simulated"\ntimeout = 0',
            "environment.robot.timeout: expected more than 0, not 0",
        ),
        (
            '[environment.robot]\nkind = "simulated"\ntimeout = inf',
            "environment.robot.timeout: expected a number",
        ),
        (
            '[environment.robot]\nkind = "simulated"\nduration = -1',
            "environment.robot.duration: expected at least 0, not -1",
        ),
        (
            '[environment.robot]\nkind = "simulated"\nduration = { lever = "x" }',
            'environment.robot.duration.lever: expected a number, not "x"',
        ),
        (
            '[environment.robot]\nkind = "simulated"\nretries = 1.5',
            "environment.robot.retries: expected a whole number, not 1.5",
        ),
        (
            '[environment.robot]\nkind = "simulated"\nworkers = 0',
            "environment.robot.workers: expected at least 1, not 0",
        ),
        (
            '[environment.robot]\nkind = "simulated"\nrole = "tset"',
            'environment.robot.role: expected "target" or "test", not "tset"',
        ),
        (
            '[environment.robot]\nkind = "simulated"\nsettings = { colum = "x" }',
            "environment.robot.settings.colum: unknown key; did you mean `column`?",
        ),
        (
            '[environment.robot]\nkind = "process"\nsettings.command = []',
            "environment.robot.settings.command: expected a program and its arguments",
        ),
        (
            '[environment.robot]\nkind = "process"\nsettings.command = "sim -q"',
            'environment.robot.settings.command: expected a list of texts, not "sim -q"',
        ),
        ("[learn]\nseeed = 1", "learn.seeed: unknown key; did you mean `seed`?"),
        ("learn = 1", "learn: expected a table, as in [learn]"),
        ("[workers]\nnumber = -1", "workers.number: expected at least 0, not -1"),
        ("[[environment.a]]", "environment.a: expected a table, as in [environment.a]"),
    ],
)
def test_mistakes_name_the_file_and_the_key(text: str, message: str) -> None:
    with pytest.raises(RunFileError) as caught:
        parse_run_file(text, "runs/my.toml", {"learn": Learn})
    assert f"runs/my.toml: {message}" in str(caught.value)
    assert caught.value.exit_code == 3


def test_all_mistakes_are_told_at_once() -> None:
    text = '[environment.a]\nkind = "x"\n[environment.b]\nkind = 1\n[wrong]\n[learn]\nseed = "x"'
    with pytest.raises(RunFileError) as caught:
        parse_run_file(text, "run.toml", {"learn": Learn})
    assert len(caught.value.messages) == 4


def _simulated(**roles: str) -> str:
    return "".join(
        f'[environment.{name}]\nkind = "simulated"\n' + (f'role = "{role}"\n' if role else "")
        for name, role in roles.items()
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (_simulated(robt=""), "environment.robt: unknown environment; did you mean `robot`? (dom"),
        (_simulated(coarse=""), "one environment must be the target, none is; set `role`"),
        ("", "one environment must be the target, none is"),
        (_simulated(robot="", fine="target"), "there are 2: robot, fine; set `role`"),
        (_simulated(robot="test"), "one environment must be the target, none is"),
        (
            '[environment.robot]\nkind = "simulated"\nduration = { lifer = 1 }',
            "environment.robot.duration.lifer: unknown action; did you mean `lever`?",
        ),
    ],
)
def test_what_does_not_go_with_the_domain(text: str, message: str) -> None:
    run = parse_run_file(text, "run.toml")
    with pytest.raises(RunFileError) as caught:
        run.bind(DOMAIN, PROBLEM)
    assert message in str(caught.value)


def test_a_domain_without_environments_has_a_target() -> None:
    document = menid_plan.parse(
        "domain d\npredicate p\naction a { rule r { outcomes { o: 1 p } } }"
    )
    assert document.domain is not None
    problem = menid_plan.parse("problem q for d", document.domain).problem
    assert problem is not None
    bound = parse_run_file(_simulated(target=""), "run.toml").bind(document.domain, problem)
    assert (bound.target.name, bound.domain.target) == ("target", "target")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"x = 1\n# \xff", "line 2: byte 0xff is not UTF-8"),
        (b"#" * (MAX_BYTES + 1), "the file is larger than 1 MiB"),
        (b"a = " + b"[" * 100_000, ""),
    ],
    ids=["bytes", "large", "deep"],
)
def test_files_that_are_no_text(tmp_path: Path, data: bytes, message: str) -> None:
    path = tmp_path / "run.toml"
    path.write_bytes(data)
    with pytest.raises(RunFileError) as caught:
        read_run_file(path)
    assert f"{path}: {message}" in str(caught.value)


def test_the_shipped_run_files_are_right() -> None:
    paths = sorted((ROOT / "domains").glob("*/*.toml"))
    assert paths
    for path in paths:
        problem = next(p for p in sorted(path.parent.glob("*.menid")) if p.name != "domain.menid")
        document = menid_plan.read(problem)
        assert document.domain is not None
        assert document.problem is not None
        read_run_file(path).bind(document.domain, document.problem)
