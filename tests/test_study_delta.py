"""The study of the delta bound: files, figures that repeat, and how often bounds are exceeded."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result

from menid_plan.learning.confidence import delta
from menid_plan.solving import MissingDependencyError
from menid_plan.studies.delta import DeltaStudy


def test_command(menid: Callable[..., Result], tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    arguments = ["study", "delta", "--samples-up-to", "30", "--runs", "2", "--seed", "5"]
    first = menid(*arguments, "-o", "one")
    assert first.exit_code == 0
    assert "skewed distribution (0.8, 0.15, 0.05)" in first.output
    assert first.output.count("is exceeded in") == 4
    second = menid(*arguments, "-o", "two", "--json")
    assert json.loads(second.output) == json.loads((tmp_path / "one/delta.json").read_text())
    for name in ("delta.csv", "delta.json", "delta.png"):
        one, two = ((tmp_path / folder / name).read_bytes() for folder in ("one", "two"))
        assert one == two
    assert (tmp_path / "one/delta.png").read_bytes().startswith(b"\x89PNG")
    rows = list(csv.DictReader((tmp_path / "one/delta.csv").read_text().splitlines()))
    assert {row["distribution"] for row in rows} == {"skewed", "uniform"}
    assert list(rows[0]) == ["distribution", "samples", "error", "delta_0.01", "delta_0.1"]
    assert (rows[0]["samples"], rows[-1]["samples"]) == ("1", "30")
    result = json.loads(second.output)
    assert result["settings"]["seed"] == 5


def test_the_smallest_study(menid: Callable[..., Result]) -> None:
    pytest.importorskip("matplotlib")
    result = menid("study", "delta", "--samples-up-to", "1", "--runs", "1", "-o", "x")
    assert result.exit_code == 0


def test_without_matplotlib_the_table_is_there(
    menid: Callable[..., Result], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    result = menid("study", "delta", "--samples-up-to", "5", "--runs", "1", "-o", "x")
    assert result.exit_code == MissingDependencyError.exit_code
    assert "pip install 'menid-plan[draw]'" in result.output
    assert (tmp_path / "x/delta.csv").exists()


def test_usage(menid: Callable[..., Result]) -> None:
    assert "delta" in menid("study").output
    assert menid("study", "nothing").exit_code == 2
    assert menid("study", "delta").exit_code == 2
    assert menid("study", "delta", "-o", "x", "--runs", "0").exit_code == 2


def test_bounds_are_those_of_the_counts() -> None:
    study = DeltaStudy(largest=30, runs=1, method="exact", skewed=(0.5, 0.5))
    curve = study.run()[0]
    # With two outcomes the true error and the size tell the counts but for their order.
    for size, error, bound in zip(curve.sizes, curve.error, curve.bounds[0.1], strict=True):
        seen = size * (0.5 + error)
        assert bound == pytest.approx(delta([seen, size - seen], 0.1), rel=1e-6)


def test_bounds_are_seldom_exceeded() -> None:
    # For fixed truths the rate is only near epsilon, here below .15 and .03. Runs are independent: by
    # Hoeffding's inequality the mean share of 25 is .45 above that with a probability below 5e-5.
    study = DeltaStudy(largest=60, runs=25, method="exact", seed=1)
    for curve in study.run():
        assert curve.exceeded[0.1] < 0.6
        assert curve.exceeded[0.01] < 0.48
        assert curve.exceeded[0.01] <= curve.exceeded[0.1]
        assert (curve.bounds[0.01] > curve.bounds[0.1]).all()
        assert np.all(np.diff(curve.sizes) > 0)
