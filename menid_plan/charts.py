"""Figures by Matplotlib: made and written in one way."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from typing import Any

from menid_plan.errors import MissingDependencyError

_STYLE: Any = {"font.size": 8, "axes.titlesize": 8, "legend.fontsize": 7.5}
_INK = "#010203"
_SVG_STYLE: Any = {
    "font.size": 9,
    "svg.fonttype": "none",
    "text.parse_math": False,
    "axes.facecolor": "none",
    **dict.fromkeys(("text.color", "axes.edgecolor", "axes.labelcolor"), _INK),
    **dict.fromkeys(("xtick.color", "ytick.color", "grid.color"), _INK),
}


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


def svg(size: tuple[float, float], draw: Callable[[Any], None], name: str) -> str:
    """A figure of some inches as an `svg` element of a page, once ``draw`` has put panels into it.

    Its ids begin with ``name``, which no other figure of the page may have. Texts stay texts, and what
    is black has the colour of the page's text. MissingDependencyError without Matplotlib.
    """
    require()
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with rc_context({**_STYLE, **_SVG_STYLE, "svg.hashsalt": name}):
        figure = Figure(figsize=size, layout="constrained", facecolor="none")
        draw(figure)
        stream = io.StringIO()
        nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        FigureCanvasSVG(figure).print_figure(stream, format="svg", metadata=nothing)
    text = stream.getvalue()
    text = text[text.index("<svg") :].replace(_INK, "currentColor")
    text = re.sub("<style.*?</style>", "", text)  # it would hold for the whole page
    # Other figures of the page have ids of the same names.
    return re.sub(r'(\bid="|url\(#|href="#)', rf"\1{name}-", text)


def require() -> None:
    """Raise MissingDependencyError without Matplotlib; for what takes long before it is drawn."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        raise MissingDependencyError(
            "drawing the figure needs Matplotlib: pip install 'menid-plan[draw]'"
        ) from error
