"""The README's first command: what it runs, run with fewer steps."""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from click.testing import Result

from conftest import ROOT

pytest.importorskip("pybullet", reason="the extra `hdd` is not installed")
pytest.importorskip("matplotlib", reason="the extra `draw` is not installed")


@pytest.fixture(autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.getbasetemp().parent / "hdd-cache"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MENID_CACHE", str(folder))
        yield folder


def commands() -> list[list[str]]:
    found = re.search(r"^```sh main\n(.*?)^```$", (ROOT / "README.md").read_text(), re.M | re.S)
    assert found
    return [shlex.split(part) for part in found[1].replace("\\\n", " ").split("&&")]


def test_the_first_command(menid: Callable[..., Result], tmp_path: Path) -> None:
    venv, install, folder, *rest = commands()
    assert venv == ["python3", "-m", "venv", ".venv"]
    assert install == [".venv/bin/pip", "install", "-q", "-e", ".[hdd,draw]"]
    assert folder == ["mkdir", "-p", "run"]
    shutil.copytree(ROOT / "domains", tmp_path / "domains")
    Path("run").mkdir()
    for program, *arguments in rest:
        assert program == ".venv/bin/menid"
        if arguments[0] == "learn":
            arguments += ["--test-time", "1", "--steps", "2"]
        result = menid(*arguments)
        assert result.exit_code == 0, result.stderr
        if arguments[0] == "learn":
            assert re.search(
                r"^best first action by what was learned: \S+, reward ", result.stdout, re.M
            )
    learned = Path("run/learned/learned.menid").read_text()
    assert "observed" in learned
    assert "(probabilistic" in Path("run/ppddl/domain.pddl").read_text()
    assert "(:metric maximize (reward))" in Path("run/ppddl/problem.pddl").read_text()
    assert Path("run/curve.png").read_bytes().startswith(b"\x89PNG")
    assert Path("run/learned/best.gif").read_bytes().startswith(b"GIF89a")
