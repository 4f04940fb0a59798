"""The page of a report: one HTML file that needs nothing else."""

from __future__ import annotations

import base64
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from menid_plan import __version__, charts
from menid_plan.errors import MissingDependencyError
from menid_plan.learning.clock import clock_text
from menid_plan.report.figures import Group, Look, executions_figure, groups_of, reward_figure
from menid_plan.report.run import RunReport, setting_rows

_NONE = "\N{EN DASH}"
# Runs of one look that are all named.
_NAMED = 6


def require() -> None:
    """Raise MissingDependencyError without what a page is made with."""
    charts.require()
    try:
        import jinja2  # noqa: F401
    except ImportError as error:
        raise MissingDependencyError(
            "a report needs Jinja2: pip install 'menid-plan[draw]'"
        ) from error


def page(runs: Sequence[RunReport]) -> str:
    """The page about some runs, at least one: the same text for the same runs.

    MissingDependencyError without Matplotlib or Jinja2.
    """
    require()
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup

    # Names in domains and of folders are whatever somebody has written there.
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters.update(number=_number, chance=_chance, percent=_percent, clock=clock_text)
    names, groups = _names(runs), groups_of(runs)
    summaries = [_summary(run) for run in runs]
    return environment.get_template("page.html").render(
        runs=list(zip(names, runs, strict=True)),
        lines=_lines(runs, names, groups),
        averaged=any(len(group.runs) > 1 for group in groups),
        look=Look.of,
        rewards=Markup(reward_figure(groups, "rewards")) if groups else "",  # noqa: S704 - our own
        executions=[
            Markup(executions_figure(run, f"executions-{n}")) if run.points else ""  # noqa: S704
            for n, run in enumerate(runs, start=1)
        ],
        films=[
            ""
            if run.film is None
            else "data:image/gif;base64," + base64.b64encode(run.film).decode()
            for run in runs
        ],
        domains=list(dict.fromkeys((run.domain.name, run.problem.name) for run in runs)),
        alike=len({(run.domain, run.problem) for run in runs}) == 1,
        summaries=summaries,
        measures=_measures(summaries),
        settings=_settings(runs),
        version=__version__,
    )


def _names(runs: Sequence[RunReport]) -> list[str]:
    """What runs are called: the names of their folders, or whole paths where those are not enough."""
    paths = [os.fsencode(run.folder).decode("utf-8", "replace") for run in runs]
    names = [Path(path).name or path for path in paths]
    return names if len(set(names)) == len(names) else paths


def _lines(
    runs: Sequence[RunReport], names: Sequence[str], groups: Sequence[Group]
) -> list[tuple[str, Look]]:
    """What is written beside each look of a line: the runs that have it."""
    found = []
    for group in groups:
        own = [name for name, run in zip(names, runs, strict=True) if run in group.runs]
        text = ", ".join(own) if len(own) <= _NAMED else f"{own[0]} to {own[-1]}: {len(own)} runs"
        found.append((text, group.look))
    return found


def _summary(run: RunReport) -> dict[str, str]:
    """The numbers by which runs are compared."""
    learn, last, plan = run.settings["learn"], run.last, run.plan
    attempts = sum(place.failed for place in run.places)
    goal = (
        {}
        if plan.goal_probability is None
        else {"goal probability": _chance(plan.goal_probability)}
    )
    return {
        "steps": str(run.steps),
        "episodes": _NONE if last is None else str(last.episodes),
        "to the goal": _count(run.successes),
        "accumulated reward": _number(None if last is None else last.reward),
        "tests": str(sum(place.executions for place in run.places[1:])),
        "time": _NONE if last is None else clock_text(last.seconds),
        "best first action": plan.action or _NONE,
        "its value": f"{_number(plan.value)} ({plan.objective})",
        **goal,
        "solver": learn["solver"],
        "estimator": learn["estimator"],
        "test time": f"{learn['test_time']:g} s",
        "seed": str(learn["seed"]),
        **({"failed attempts": str(attempts)} if attempts else {}),
        "end": run.end,
    }


def _count(value: int | None) -> str:
    return _NONE if value is None else str(value)


def _measures(summaries: Sequence[Mapping[str, str]]) -> list[str]:
    """The names of what is told of each run; of several, less settings that are the same in all."""
    names = dict.fromkeys(name for each in summaries for name in each)
    settings = [name for name in ("solver", "estimator", "test time") if len(summaries) > 1]
    shared = {name for name in settings if len({each[name] for each in summaries}) == 1}
    return [name for name in names if name not in shared]


def _settings(runs: Sequence[RunReport]) -> tuple[dict[str, str], dict[str, list[str]]]:
    """The settings that all runs share, and the others with a text for each run."""
    rows = [setting_rows(run.settings) for run in runs]
    names = list(dict.fromkeys(name for row in rows for name in row))
    columns = {name: [row.get(name, "") for row in rows] for name in names}
    shared = {name: each[0] for name, each in columns.items() if len(set(each)) == 1}
    return shared, {name: each for name, each in columns.items() if name not in shared}


def _number(value: float | None) -> str:
    return _NONE if value is None or math.isnan(value) else f"{value:.6g}"


def _chance(value: float | None) -> str:
    return _NONE if value is None else f"{value:.3f}"


def _percent(value: float) -> str:
    return f"{100 * value:.4g}"
