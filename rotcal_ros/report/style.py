"""One look for all figures, and figures as inline SVG: no display, no global state."""

from __future__ import annotations

import io
from typing import Any, Final

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

INK: Final = "#1d2733"
BLUE: Final = "#1f6fb2"
ORANGE: Final = "#d9772b"
GREEN: Final = "#2e8b57"
RED: Final = "#c0392b"
GREY: Final = "#8795a1"

_RC: Final[dict[Any, Any]] = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e3e8ec",
    "grid.linewidth": 0.8,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "svg.hashsalt": "rotcal",
    "svg.fonttype": "path",
}


def new_figure(width: float = 8.6, height: float = 3.0) -> Figure:
    """Return an empty figure in the house style; size in inches."""
    with mpl.rc_context(_RC):
        return Figure(figsize=(width, height), layout="constrained")


def axes(figure: Figure, rows: int = 1, columns: int = 1, **options: Any) -> list[Axes]:
    """Return the axes of a grid in the house style, row by row."""
    with mpl.rc_context(_RC):
        grid = figure.subplots(rows, columns, squeeze=False, **options)
    return list(grid.ravel())


def svg(figure: Figure) -> str:
    """Return the figure as an ``<svg>`` element; equal figures give equal text."""
    stream = io.StringIO()
    with mpl.rc_context(_RC):
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    return text[text.index("<svg") :]


def curve_with_band(
    ax: Axes, x: NDArray[np.float64], y: NDArray[np.float64], band: NDArray[np.float64], label: str
) -> None:
    """Draw measured points with their expanded uncertainty as a band."""
    ax.fill_between(x, y - band, y + band, color=BLUE, alpha=0.18, linewidth=0)
    ax.plot(x, y, "o-", color=BLUE, markersize=3.5, linewidth=1.2, label=label)
    ax.axhline(0.0, color=GREY, linewidth=0.8)
