"""Figures by Matplotlib: made and written in one way."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

from menid_plan.errors import MissingDependencyError

_STYLE: Any = {"font.size": 8, "axes.titlesize": 8, "legend.fontsize": 7.5}


def chart(size: tuple[float, float], draw: Callable[[Any], None], dpi: int = 200) -> bytes:
    """A figure of some inches as a PNG file, once ``draw`` has put panels into it.

    MissingDependencyError without Matplotlib.
    """
    require()
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context(_STYLE):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure)
        stream = io.BytesIO()
        # Without the version of Matplotlib in it the same numbers give the same bytes.
        FigureCanvasAgg(figure).print_figure(
            stream, dpi=dpi, format="png", metadata={"Software": None}
        )
    return stream.getvalue()


def require() -> None:
    """Raise MissingDependencyError without Matplotlib; for what takes long before it is drawn."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise MissingDependencyError(
            "drawing the figure needs Matplotlib: pip install 'menid-plan[draw]'"
        ) from error
