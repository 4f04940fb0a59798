"""Fixtures that several tests use."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from hypothesis import settings

from menid_plan.cli.main import main

# The same examples in every run; `--hypothesis-profile=search` looks for new ones.
settings.register_profile("search", settings.get_profile("default"))
settings.register_profile("same", derandomize=True)
settings.load_profile("same")

ROOT = Path(__file__).parent.parent

# The example of the language's specification: a domain and a problem that use most of it.
EXAMPLE = (ROOT / "tests" / "data" / "example.menid").read_text(encoding="utf-8")


@pytest.fixture
def example() -> str:
    return EXAMPLE


@pytest.fixture
def menid(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Result]:
    """Runs `menid` in an empty folder: menid("check", "a.menid", input=...)."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str, **options: object) -> Result:
        result = CliRunner().invoke(main, list(arguments), **options)  # type: ignore[arg-type]
        # CliRunner keeps exceptions; one that is no exit is a crash.
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        return result

    return run
