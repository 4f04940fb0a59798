"""The figures of a report: rewards of runs, and executions by environment, against the clock."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from menid_plan.charts import svg
from menid_plan.learning.curve import time_unit
from menid_plan.mdp.model import Floats
from menid_plan.report.run import RunReport

# The page replaces them by its own, which are others on a dark background.
_COLOURS = (
    "#1f5fa8", "#d1490e", "#2e8540", "#7b4ab5", "#0b7d8c", "#b5306f", "#8a6d1b", "#5a6472",
)  # fmt: skip
_DASHES = ((), (5, 2), (1.5, 1.5), (6, 2, 1.5, 2))
_SIZE = (4.5, 2.8)
# Where the slowest environment has so many times fewer executions its line would lie on the axis.
_FAR = 20


@dataclass(frozen=True, slots=True)
class Look:
    """How a line is drawn: the number of its colour, and its dashes as SVG has them."""

    colour: int
    dashes: tuple[float, ...] = ()

    @classmethod
    def of(cls, number: int) -> Look:
        """That of the line with a number: colours first, then dashes."""
        return cls(number % len(_COLOURS), _DASHES[number // len(_COLOURS) % len(_DASHES)])

    @property
    def options(self) -> dict[str, Any]:
        """For Matplotlib."""
        style: Any = (0, self.dashes) if self.dashes else "-"
        return {"color": _COLOURS[self.colour], "linestyle": style}


@dataclass(frozen=True, slots=True)
class Group:
    """Runs with the same settings but the seed; ``look`` is that of their lines."""

    runs: tuple[RunReport, ...]
    look: Look

    def means(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Seconds, and the mean, the lowest and the highest reward then (float64[t] each).

        They end with the run that ends first.
        """
        last = min(run.points[-1].seconds for run in self.runs)
        seconds = np.unique([0.0] + [p.seconds for run in self.runs for p in run.points])
        seconds = seconds[seconds <= last]
        rewards = []
        for run in self.runs:
            times = [point.seconds for point in run.points]
            reward = np.array([0.0, *(point.reward for point in run.points)])
            rewards.append(reward[np.searchsorted(times, seconds, side="right")])
        found = np.array(rewards)
        return seconds, found.mean(axis=0), found.min(axis=0), found.max(axis=0)


def groups_of(runs: Sequence[RunReport]) -> tuple[Group, ...]:
    """Runs that differ in their seed alone, together; those without a curve are left out."""
    found: dict[Any, list[RunReport]] = {}
    for run in runs:
        if run.points:
            learn = {key: value for key, value in run.settings["learn"].items() if key != "seed"}
            settings = json.dumps({**run.settings, "learn": learn}, sort_keys=True)
            found.setdefault((settings, run.domain, run.problem), []).append(run)
    return tuple(Group(tuple(each), Look.of(n)) for n, each in enumerate(found.values()))


def reward_figure(groups: Sequence[Group], name: str) -> str:
    """The accumulated rewards of all runs, and of several with the same settings their mean."""
    unit, scale = time_unit(max(run.points[-1].seconds for g in groups for run in g.runs))

    def draw(figure: Any) -> None:
        panel = _panel(figure, unit, "accumulated reward")
        for group in groups:
            several = len(group.runs) > 1
            for run in group.runs:
                times = [0.0, *(point.seconds / scale for point in run.points)]
                reward = [0.0, *(point.reward for point in run.points)]
                width, alpha = (0.7, 0.5) if several else (1.5, 1.0)
                panel.step(
                    times, reward, where="post", linewidth=width, alpha=alpha, **group.look.options
                )
            if several:
                seconds, mean, low, high = group.means()
                colour = group.look.options["color"]
                panel.fill_between(
                    seconds / scale, low, high, step="post", color=colour, alpha=0.15, linewidth=0
                )
                panel.step(seconds / scale, mean, where="post", linewidth=2, **group.look.options)

    return _coloured(svg(_SIZE, draw, name))


def executions_figure(run: RunReport, name: str) -> str:
    """Executions by environment; on a logarithmic axis where the target's would not be seen."""
    unit, scale = time_unit(run.points[-1].seconds)
    numbers = [place.course[-1] for place in run.places if place.course[-1]]
    far = bool(numbers) and max(numbers) > _FAR * min(numbers)

    def draw(figure: Any) -> None:
        panel = _panel(figure, unit, "executions")
        times = [0.0, *(point.seconds / scale for point in run.points)]
        for number, place in enumerate(run.places):
            course = np.array([0, *place.course], np.float64)
            if far:
                course[course == 0] = np.nan
            panel.step(times, course, where="post", linewidth=1.5, **Look.of(number).options)
        if far:
            panel.set_yscale("log")
            panel.yaxis.set_major_formatter("{x:g}")
            panel.set_ylabel("executions (logarithmic)")

    return _coloured(svg(_SIZE, draw, name))


def _panel(figure: Any, unit: str, label: str) -> Any:
    panel = figure.subplots()
    panel.set_xlabel(f"time of the run ({unit})")
    panel.set_ylabel(label)
    panel.grid(visible=True, linewidth=0.5, alpha=0.2)
    panel.spines[["top", "right"]].set_visible(False)
    panel.margins(x=0.02)
    return panel


def _coloured(text: str) -> str:
    for number, colour in enumerate(_COLOURS):
        text = text.replace(colour, f"var(--line-{number})")
    return text
