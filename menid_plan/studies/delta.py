"""The delta bound as the sample grows, against the true error.

Suárez-Hernández et al. 2020 show it in a figure of two panels: a skewed distribution, and the uniform
one that Thompson (1987) takes for the worst case.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from menid_plan.charts import chart
from menid_plan.learning.confidence import SAMPLES, Method, delta, drawn_errors, mode, rank
from menid_plan.learning.mixtures import Floats

_POINTS = 200  # so many sizes of the sample are in the figure
_COMPARED = 20  # and so many of them are looked at in every run


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """What was found for one distribution.

    ``sizes`` (int64[n]) are those of the samples, ``error`` (float64[n]) the true error of one sampling
    and ``bounds[epsilon]`` (float64[n]) the bounds for it. ``exceeded[epsilon]`` is the share of the
    ``compared`` samples of all runs whose error is above the bound.
    """

    name: str
    truth: tuple[float, ...]
    sizes: NDArray[np.int64]
    error: Floats
    bounds: Mapping[float, Floats]
    exceeded: Mapping[float, float]
    compared: int


@dataclass(frozen=True, slots=True)
class DeltaStudy:
    """The settings; every number drawn comes from ``seed``.

    ``largest`` is the size of the largest sample; bounds are by ``method``, with ``samples`` draws for
    ``monte-carlo``.
    """

    seed: int = 0
    largest: int = 1000
    runs: int = 50
    method: Method = "monte-carlo"
    samples: int = SAMPLES
    epsilons: tuple[float, ...] = (0.01, 0.1)
    skewed: tuple[float, ...] = (0.8, 0.15, 0.05)

    def run(self) -> list[Curve]:
        """Both distributions: the skewed one, and the uniform one over as many outcomes."""
        k = len(self.skewed)
        truths = {"skewed": self.skewed, "uniform": (1.0 / k,) * k}
        seeds = np.random.SeedSequence(self.seed).spawn(len(truths))
        return [
            self._curve(name, truth, np.random.default_rng(seed))
            for (name, truth), seed in zip(truths.items(), seeds, strict=True)
        ]

    def _curve(self, name: str, truth: tuple[float, ...], rng: np.random.Generator) -> Curve:
        sizes = _sizes(self.largest, _POINTS)
        error, bounds = self._sampling(truth, sizes, rng)
        few = _sizes(self.largest, _COMPARED)
        above = dict.fromkeys(self.epsilons, 0)
        for _ in range(self.runs):
            run_error, run_bounds = self._sampling(truth, few, rng)
            for epsilon, bound in run_bounds.items():
                above[epsilon] += int(np.sum(run_error > bound))
        compared = self.runs * len(few)
        exceeded = {epsilon: number / compared for epsilon, number in above.items()}
        return Curve(name, truth, sizes, error, bounds, exceeded, compared)

    def _sampling(
        self, truth: tuple[float, ...], sizes: NDArray[np.int64], rng: np.random.Generator
    ) -> tuple[Floats, dict[float, Floats]]:
        """One sample that grows: at each size the true error, and the bounds for it."""
        steps = rng.multinomial(np.diff(sizes, prepend=0), truth)
        counts = np.cumsum(steps, axis=0).astype(np.float64)
        error = np.array([np.abs(mode(row) - truth).max() for row in counts])
        found = np.array([self._bounds(row, rng) for row in counts])
        return error, dict(zip(self.epsilons, found.T, strict=True))

    def _bounds(self, counts: Floats, rng: np.random.Generator) -> list[float]:
        if self.method != "monte-carlo":
            return [delta(counts, epsilon, self.method) for epsilon in self.epsilons]
        # One set of draws serves every epsilon.
        errors = np.sort(drawn_errors(counts, self.samples, rng))
        return [float(errors[rank(epsilon, self.samples) - 1]) for epsilon in self.epsilons]

    # ---------------------------------------------------------------------------------- results

    def as_csv(self, curves: list[Curve]) -> str:
        """A row for each distribution and size: the true error, and a bound for each epsilon."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        bounds = [f"delta_{epsilon:g}" for epsilon in self.epsilons]
        writer.writerow(["distribution", "samples", "error", *bounds])
        for curve in curves:
            for row, size in enumerate(curve.sizes.tolist()):
                values = [curve.error[row], *(curve.bounds[e][row] for e in self.epsilons)]
                writer.writerow([curve.name, size, *(f"{value:.6g}" for value in values)])
        return stream.getvalue()

    def as_json(self, curves: list[Curve]) -> dict[str, Any]:
        """The settings, and how often bounds were exceeded."""
        return {
            "settings": asdict(self),
            "distributions": [
                {
                    "name": curve.name,
                    "truth": curve.truth,
                    "compared": curve.compared,
                    "exceeded": {f"{e:g}": share for e, share in curve.exceeded.items()},
                }
                for curve in curves
            ],
        }

    def as_png(self, curves: list[Curve], dpi: int = 200) -> bytes:
        """The figure, of the width of a column; MissingDependencyError without Matplotlib."""

        def draw(figure: Any) -> None:
            panels = figure.subplots(1, len(curves), sharey=True, squeeze=False)[0]
            for panel, curve in zip(panels, curves, strict=True):
                self._draw(panel, curve)
            panels[0].set_ylabel("largest error of a probability")
            handles, labels = panels[0].get_legend_handles_labels()
            figure.legend(
                handles, labels, loc="outside lower center", ncols=len(labels), frameon=False
            )

        return chart((5.2, 2.6), draw, dpi)

    def _draw(self, panel: Any, curve: Curve) -> None:
        styles = ("-", "--", "-.", ":")
        for number, epsilon in enumerate(self.epsilons):
            panel.plot(
                curve.sizes, curve.bounds[epsilon], styles[number % 4], linewidth=1.2,
                color=_BLUES[number % len(_BLUES)], label=rf"bound $\delta$, $\epsilon = {epsilon:g}$",
            )  # fmt: skip
        # An error of 0 is a gap in the line, for a logarithm has no place for it.
        error = np.where(curve.error > 0.0, curve.error, np.nan)
        panel.plot(curve.sizes, error, linewidth=0.9, color="#d1490e", label="true error")
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.xaxis.set_major_formatter("{x:g}")
        panel.yaxis.set_major_formatter("{x:g}")
        panel.set_xlabel("sample size")
        shown = ", ".join(f"{p:.3g}" for p in curve.truth)
        panel.set_title(f"{curve.name}: {shown}")
        panel.grid(visible=True, which="major", linewidth=0.4, alpha=0.5)
        panel.margins(x=0.02)


_BLUES = ("#08306b", "#3f8fc5", "#7fb3d5")


def _sizes(largest: int, points: int) -> NDArray[np.int64]:
    """Sizes of samples from 1 on, evenly in their logarithms as far as whole numbers are."""
    exact = np.geomspace(1.0, largest, points)
    found: NDArray[np.int64] = np.unique(np.rint(exact).astype(np.int64))
    return found
