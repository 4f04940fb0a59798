"""The tables and figures of the study of where to act."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
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
    """Six for each group of problems and each penalty: rewards, leads, regret, and what was done."""
    for group, penalty in dict.fromkeys((case.group, case.penalty) for case in cases):
        here = [case for case in cases if (case.group, case.penalty) == (group, penalty)]
        late = here[0].minutes[-1] / 60.0
        times = (min(EARLY, late), late)
        when = " and ".join(f"{minute:g}" for minute in times)
        title = f"{group}, penalty {penalty:g}"
        names = (*OTHERS, GAIN)
        yield _table(f"{title}: reward after {when} minutes", ("idle", *names, "oracle"), {
            case.short: ["0", *(_pair(case, name, times) for name in names), _oracle(case, times)]
            for case in here
        })  # fmt: skip
        for minute in times:
            yield _table(f"{title}: how much more gain earns by minute {minute:g} than", OTHERS, {
                case.short: [_lead(case, name, minute) for name in OTHERS] for case in here
            })  # fmt: skip
        yield _table(
            f"{title}: gain's regret in % of that of T = 0 and T = 20, after {when} minutes;\n"
            "how far it is behind T = 0 at the worst minute, and behind no simulator in the end, in % "
            "of the oracle's reward", (PAPER, TESTING, f"behind {PAPER}", f"behind {ALONE}"), {
                case.short: [
                    *(" / ".join(_share(case, n, t) for t in times) for n in (PAPER, TESTING)),
                    f"{behind(case):.1f}", f"{lost(case):.1f}",
                ]
                for case in here
            },
        )  # fmt: skip
        yield _table(f"{title}: executions = successes + failures", names, {
            case.short: [_ends(case, name) for name in names] for case in here
        })  # fmt: skip
        yield _table(f"{title}: tests", (TESTING, GAIN), {
            case.short: [f"{case.counts[name][:, 3].mean():.0f}" for name in (TESTING, GAIN)]
            for case in here
        })  # fmt: skip


def _table(title: str, columns: tuple[str, ...], rows: Mapping[str, Sequence[str]]) -> Table:
    return Table(title, "", columns, tuple((name, tuple(cells)) for name, cells in rows.items()))


def behind(case: Case) -> float:
    """How far the mean reward is below that of T = 0 at the worst minute, in % of the oracle's."""
    gap = (case.rewards[PAPER] - case.rewards[GAIN]).mean(axis=0).max()
    return 100.0 * max(0.0, float(gap)) / max(float(case.oracle.mean()), 1e-12)


def lost(case: Case) -> float:
    """What the rule with a simulator earns less than without in the end, in % of the oracle's."""
    gap = (case.rewards[ALONE] - case.rewards[GAIN])[:, -1].mean()
    return 100.0 * float(gap) / max(float(case.oracle.mean()), 1e-12)


def _pair(case: Case, name: str, times: Sequence[float]) -> str:
    means = case.rewards[name].mean(axis=0)
    return "/".join(_number(means[case.at(minute)]) for minute in times)


def _oracle(case: Case, times: Sequence[float]) -> str:
    mean = float(case.oracle.mean())
    return "/".join(_number(mean * case.minutes[case.at(m)] / case.minutes[-1]) for m in times)


def _number(value: float) -> str:
    return f"{value:.1f}" if abs(value) < 100.0 else f"{value:.0f}"


def _lead(case: Case, name: str, minute: float) -> str:
    at = case.at(minute)
    found = Interval.of(case.rewards[GAIN][:, at] - case.rewards[name][:, at])
    return f"{found.mean:+.1f} ± {found.half:.2g}"


def _share(case: Case, name: str, minute: float) -> str:
    whole = float(case.regret(name, minute).mean())
    return f"{100.0 * float(case.regret(GAIN, minute).mean()) / whole:.0f}" if whole > 0.0 else "-"


def _ends(case: Case, name: str) -> str:
    done, won, failed, _ = case.counts[name].mean(axis=0).tolist()
    return f"{done:.0f}={won:.0f}+{failed:.0f}"


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
