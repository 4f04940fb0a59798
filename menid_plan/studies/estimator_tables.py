"""The tables and figures of the study of estimators."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from menid_plan.charts import chart
from menid_plan.learning.estimators import Empirical, SubsetMixture
from menid_plan.studies.estimators import (
    BASE,
    DRIVE,
    GAPS,
    PAIRS,
    RANDOM,
    Errors,
    Found,
    Rewards,
    gap_text,
    pair_text,
    relative,
)
from menid_plan.studies.learning import Interval
from menid_plan.studies.random_rules import CANDIDATES, MINUTES, TARGET_ONLY

# N2, the gap and N1 of the table that is shown first: three outcomes, one test.
FIRST = ((300, "0", 10), (300, "0.1", 50), (300, "0.3", 20), (300, "0.3", 200), (3000, "0.3", 500))
# What is shown of the rest: random rules with three outcomes, the hard drive with N2 and N1 of these.
_OUTCOMES, _TESTED = "3", 300
_DRIVE_TESTED, _DRIVE_EXECUTED = 500, (5, 50)


@dataclass(frozen=True, slots=True)
class Table:
    """Rows of texts, each with its name, under a head with the names of the columns."""

    title: str
    head: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[str, ...]], ...]


def tables(found: Found) -> Iterator[Table]:
    """What is printed; the whole is in the files."""
    yield _first(found)
    for gaps in GAPS:
        gap = gap_text(gaps)
        (shown,) = _random(found, _OUTCOMES, gap, _TESTED)
        tests = "two tests, gaps" if len(gaps) > 1 else "gap"
        columns = {f"N1 {n1}": _column(shown, i) for i, n1 in enumerate(shown.n1)}
        yield _table(f"error, {_OUTCOMES} outcomes, N2 {_TESTED}, {tests} {gap}", "", columns)
    columns = {
        f"gap {gap}" if len(gaps) == 1 else f"gaps {gap}": {
            name: f"{value:.2f}" for name, value in relative(_random(found, gap=gap)).items()
        }
        for gaps in GAPS
        for gap in [gap_text(gaps)]
    }
    yield _table("error over that of the target only, geometric mean of all", "", columns)
    for pair in PAIRS:
        yield _of_drive(found, pair_text(pair))
    for actions, named in ((RANDOM, "random actions"), (DRIVE, "hard drive")):
        of_kind = [each for each in found.rewards if each.actions == actions]
        for minutes, penalty in dict.fromkeys((each.minutes, each.penalty) for each in of_kind):
            if actions == DRIVE or minutes == MINUTES[-1]:
                here = [e for e in of_kind if (e.minutes, e.penalty) == (minutes, penalty)]
                yield _of_rewards(f"{named}, penalty {penalty:g}, {minutes:g} minutes", here)


def _first(found: Found) -> Table:
    columns = {}
    for n2, gap, n1 in FIRST:
        (shown,) = _random(found, _OUTCOMES, gap, n2)
        columns[f"{n2}, {gap}, {n1}"] = _column(shown, shown.n1.index(n1))
    return _table("error, 3 outcomes", "N2, gap, N1", columns)


def _of_drive(found: Found, tests: str) -> Table:
    columns = {
        f"{each.gap}, {n1}": _column(each, each.n1.index(n1))
        for each in found.errors
        if (each.rules, each.tests, each.n2) == (DRIVE, tests, _DRIVE_TESTED)
        for n1 in _DRIVE_EXECUTED
    }
    title = f"error on the hard drive, {tests}, N2 {_DRIVE_TESTED}"
    return _table(title, "gap, N1", columns)


def _of_rewards(title: str, shown: Sequence[Rewards]) -> Table:
    rows = [(BASE, tuple(_interval(each.rewards[BASE]) for each in shown))]
    for name in CANDIDATES:
        if name != BASE:
            cells = tuple(_interval(each.more[name], sign="+") for each in shown)
            rows.append((name, cells))
    head = f"{title}: {BASE}'s reward, others' lead"
    return Table(head, "tests", tuple(each.tests for each in shown), tuple(rows))


def _random(
    found: Found, outcomes: str | None = None, gap: str | None = None, n2: int | None = None
) -> list[Errors]:
    return [
        each
        for each in found.errors
        if each.rules == RANDOM
        and outcomes in (None, each.outcomes)
        and gap in (None, each.gap)
        and n2 in (None, each.n2)
    ]


def _column(shown: Errors, at: int) -> dict[str, str]:
    return {name: f"{values[at]:.3f}" for name, values in shown.errors.items()}


def _table(title: str, head: str, columns: Mapping[str, Mapping[str, str]]) -> Table:
    names = next(iter(columns.values()), {})
    rows = ((name, tuple(cells[name] for cells in columns.values())) for name in names)
    return Table(title, head, tuple(columns), tuple(rows))


def _interval(found: Interval, sign: str = "-") -> str:
    half = "" if math.isnan(found.half) else f" ± {_short(found.half, '', 2)}"
    return _short(found.mean, sign, 3) + half


def _short(value: float, sign: str, digits: int) -> str:
    """A number with so many digits, or as a whole number where it has more before its point."""
    return f"{value:{sign}.{digits}g}" if abs(value) < 10**digits - 0.5 else f"{value:{sign}.0f}"


# --------------------------------------------------------------------------------------- figures

# The colours of Okabe and Ito (2008), which the colour-blind can tell apart.
_LINES = {
    TARGET_ONLY: ("#000000", "--", ""),
    "pooled": ("#56b4e9", "-", "s"),
    BASE: ("#d55e00", "-", "o"),
    "robust": ("#0072b2", "-", "^"),
    "robust, u .98": ("#0072b2", ":", "^"),
    "sam": ("#009e73", "-", "v"),
    "sam, odds 50": ("#009e73", ":", "v"),
    "power-prior": ("#e69f00", "-", "D"),
    "precision-grid": ("#cc79a7", "-", "X"),
    SubsetMixture.name: ("#777777", "-", "P"),
}
# Where two lines have their names, by the gaps: the number of a point, and so many points above it.
_NAMED = {
    (0.0,): {TARGET_ONLY: (1, 5), BASE: (1, -10)},
    (0.1,): {TARGET_ONLY: (1, 5), BASE: (1, -12)},
    (0.3,): {TARGET_ONLY: (0, -24), BASE: (4, 5)},
    (0.0, 0.3): {TARGET_ONLY: (1, 5), BASE: (4, 5)},
}


def errors_png(found: Found, dpi: int = 200) -> bytes:
    """Error against N1, for random rules with three outcomes: a panel for each gap.

    MissingDependencyError without Matplotlib.
    """

    def draw(figure: Any) -> None:
        panels = figure.subplots(2, 2, sharex=True, sharey=True)
        for panel, gaps in zip(panels.flat, GAPS, strict=True):
            (shown,) = _random(found, _OUTCOMES, gap_text(gaps), _TESTED)
            one = len(gaps) == 1
            panel.set_title(f"gap {gaps[0]:g}" if one else f"two tests, gaps {gap_text(gaps)}")
            for name, (colour, style, marker) in _LINES.items():
                if one and name == SubsetMixture.name:
                    continue  # the line of `robust`
                values = shown.errors[name]
                panel.plot(
                    range(len(values)), values, style, marker=marker, color=colour, markersize=3.0,
                    linewidth=1.1, label=name,
                )  # fmt: skip
                if name in _NAMED[gaps]:
                    at, above = _NAMED[gaps][name]
                    panel.annotate(
                        name, (at, values[at]), (0, above), color=colour,
                        textcoords="offset points", fontsize=7.5,
                    )  # fmt: skip
            panel.set_yscale("log")
            panel.set_yticks([0.03, 0.05, 0.1, 0.2, 0.4], minor=False)
            panel.set_yticks([], minor=True)
            panel.yaxis.set_major_formatter("{x:g}")
            panel.set_xticks(range(len(shown.n1)), map(str, shown.n1))
            panel.grid(visible=True, linewidth=0.4, alpha=0.5)
        for panel in panels[1]:
            panel.set_xlabel("executions in the target, N1")
        for panel in panels[:, 0]:
            panel.set_ylabel("error (L2)")
        handles, labels = panels[-1, -1].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)

    return chart((6.4, 5.2), draw, dpi)


def rewards_png(found: Found, actions: str, dpi: int = 200) -> bytes:
    """How much more reward each estimator earns than decreasing-m: a panel for each kind of tests.

    ``actions`` are random or the hard drive's. The smallest and the largest penalty are shown, and all
    estimators that use tests.
    MissingDependencyError without Matplotlib.
    """
    of_kind = [each for each in found.rewards if each.actions == actions]
    end = max(each.minutes for each in of_kind)
    tests = list(dict.fromkeys(each.tests for each in of_kind))
    penalties = sorted({each.penalty for each in of_kind})
    ends = dict(zip(penalties[:1] + penalties[1:][-1:], _TWO, strict=False))
    # Without tests so much is lost that the others could not be told apart.
    names = [name for name in CANDIDATES if name not in (BASE, Empirical.name)]

    def draw(figure: Any) -> None:
        panels = figure.subplots(1, len(tests), sharey=True, squeeze=False)[0]
        for panel, kind in zip(panels, tests, strict=True):
            for number, (penalty, (colour, marker)) in enumerate(ends.items()):
                (shown,) = (
                    each
                    for each in of_kind
                    if (each.tests, each.penalty, each.minutes) == (kind, penalty, end)
                )
                panel.errorbar(
                    [shown.more[name].mean for name in names],
                    [row + 0.3 * (number - 0.5) for row in range(len(names))],
                    xerr=[0.0 if math.isnan(h := shown.more[n].half) else h for n in names],
                    fmt=marker, color=colour, markersize=3.5, linewidth=1.1,
                    label=f"penalty {penalty:g}",
                )  # fmt: skip
            panel.axvline(0.0, color="#d55e00", linewidth=0.8)
            panel.set_title(kind)
            panel.grid(visible=True, linewidth=0.4, alpha=0.5)
        panels[0].set_yticks(range(len(names)), names)
        panels[0].invert_yaxis()
        figure.supxlabel(f"reward after {end:g} minutes, less that of {BASE}", fontsize=8)
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False)

    return chart((1.6 + 1.5 * len(tests), 3.0), draw, dpi)


_TWO = (("#0072b2", "o"), ("#000000", "s"))
