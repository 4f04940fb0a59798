"""The tables and figures of the study of where to act."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from menid_plan.charts import chart
from menid_plan.learning.mixtures import Floats
from menid_plan.studies.allocation import Case
from menid_plan.studies.bandits import ALONE, GAIN, PAPER, TESTING
from menid_plan.studies.estimator_tables import Table
from menid_plan.studies.learning import Interval

EARLY, OTHERS = 10.0, (PAPER, TESTING, ALONE)
_COLOURS = {PAPER: "#d1490e", TESTING: "#1f5fa8", ALONE: "#777777", GAIN: "#2e8540"}


def tables(cases: Sequence[Case]) -> Iterator[Table]:
    """One for each group of problems and each penalty."""
    for group, penalty in dict.fromkeys((case.group, case.penalty) for case in cases):
        here = [case for case in cases if (case.group, case.penalty) == (group, penalty)]
        late = here[0].minutes[-1] / 60.0
        early = min(EARLY, late)
        rows = [("reward, at minutes", tuple(f"{early:g} / {late:g}" for _ in here))]
        rows += [("idle", tuple("0 / 0" for _ in here))]
        rows += [
            (name, tuple(_pair(case, name, early, late) for case in here))
            for name in (*OTHERS, GAIN)
        ]
        rows.append(("oracle", tuple(_oracle(case, early, late) for case in here)))
        for minute in (early, late):
            rows += [
                (f"gain leads {name}, {minute:g}", tuple(_lead(c, name, minute) for c in here))
                for name in OTHERS
            ]
        for name in (PAPER, TESTING):
            rows += [
                (f"regret, % of {name}'s, {minute:g}", tuple(_share(c, name, minute) for c in here))
                for minute in (early, late)
            ]
        rows.append(("most behind T = 0, %", tuple(f"{behind(case):.1f}" for case in here)))
        rows.append(("loses to none, %", tuple(f"{lost(case):.1f}" for case in here)))
        rows.append(("successes, failures", tuple("" for _ in here)))
        rows += [
            (f"  {name}", tuple(_ends(case, name) for case in here)) for name in (*OTHERS, GAIN)
        ]
        rows.append(("tests", tuple("" for _ in here)))
        rows += [
            (f"  {name}", tuple(f"{case.counts[name][:, 3].mean():.0f}" for case in here))
            for name in (TESTING, GAIN)
        ]
        title = f"{group}, penalty {penalty:g}"
        yield Table(
            title, "", tuple(case.name.removeprefix("drive: ") for case in here), tuple(rows)
        )


def behind(case: Case) -> float:
    """How far the mean reward is below that of T = 0 at the worst minute, in % of the oracle's."""
    gap = (case.rewards[PAPER] - case.rewards[GAIN]).mean(axis=0).max()
    return 100.0 * max(0.0, float(gap)) / max(float(case.oracle.mean()), 1e-12)


def lost(case: Case) -> float:
    """What the rule with a simulator earns less than without in the end, in % of the oracle's."""
    gap = (case.rewards[ALONE] - case.rewards[GAIN])[:, -1].mean()
    return 100.0 * float(gap) / max(float(case.oracle.mean()), 1e-12)


def _pair(case: Case, name: str, early: float, late: float) -> str:
    means = case.rewards[name].mean(axis=0)
    return " / ".join(f"{means[case.at(minute)]:.1f}" for minute in (early, late))


def _oracle(case: Case, early: float, late: float) -> str:
    mean = float(case.oracle.mean())
    return " / ".join(
        f"{mean * case.minutes[case.at(m)] / case.minutes[-1]:.1f}" for m in (early, late)
    )


def _lead(case: Case, name: str, minute: float) -> str:
    at = case.at(minute)
    found = Interval.of(case.rewards[GAIN][:, at] - case.rewards[name][:, at])
    return f"{found.mean:+.1f} ± {found.half:.2g}"


def _share(case: Case, name: str, minute: float) -> str:
    whole = float(case.regret(name, minute).mean())
    return f"{100.0 * float(case.regret(GAIN, minute).mean()) / whole:.0f}" if whole > 0.0 else "-"


def _ends(case: Case, name: str) -> str:
    _, won, failed, _ = case.counts[name].mean(axis=0).tolist()
    return f"{won:.0f}, {failed:.0f}"


def rewards_csv(cases: Sequence[Case]) -> str:
    """A row for each case, learner and minute: the mean reward, and half of its 95 % interval."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["problems", "case", "penalty", "learner", "minute", "reward", "half_95"])
    for case in cases:
        for name, rewards in case.rewards.items():
            for at, seconds in enumerate(case.minutes.tolist()):
                found = Interval.of(rewards[:, at])
                writer.writerow([
                    case.group, case.name, f"{case.penalty:g}", name, f"{seconds / 60.0:g}",
                    f"{found.mean:.6g}", f"{found.half:.6g}",
                ])  # fmt: skip
    return stream.getvalue()


def curves_png(cases: Sequence[Case], group: str, dpi: int = 130) -> bytes:
    """Mean rewards against time, a panel for each case and penalty of a group."""
    here = [case for case in cases if case.group == group]
    names = list(dict.fromkeys(case.name for case in here))
    penalties = sorted({case.penalty for case in here})

    def draw(figure: Any) -> None:
        panels = figure.subplots(len(penalties), len(names), squeeze=False, sharex=True)
        for case in here:
            axes = panels[penalties.index(case.penalty)][names.index(case.name)]
            minutes: Floats = np.concatenate(([0.0], case.minutes / 60.0))
            best = case.oracle.mean() * minutes / minutes[-1]
            axes.plot(minutes, best, color="#000000", linewidth=0.8, linestyle=":", label="oracle")
            for name in (*OTHERS, GAIN):
                mean = np.concatenate(([0.0], case.rewards[name].mean(axis=0)))
                axes.plot(minutes, mean, color=_COLOURS[name], linewidth=1.2, label=name)
            axes.axhline(0.0, color="#444444", linewidth=0.5)
            axes.grid(visible=True, linewidth=0.3, alpha=0.5)
            axes.margins(x=0.0)
            axes.tick_params(labelsize=7)
            if case.penalty == penalties[0]:
                axes.set_title(case.name, fontsize=8)
            if case.penalty == penalties[-1]:
                axes.set_xlabel("minutes", fontsize=8)
            if case.name == names[0]:
                axes.set_ylabel(f"reward, penalty {case.penalty:g}", fontsize=8)
        handles, labels = panels[0][0].get_legend_handles_labels()
        figure.legend(
            handles, labels, loc="outside lower center", ncols=5, frameon=False, fontsize=8
        )

    return chart((1.75 * len(names) + 0.4, 1.6 * len(penalties) + 0.6), draw, dpi)
