"""One look for all figures, and figures as inline SVG: no display, no global state.

Drawing takes a second to load, so that is done by the first figure.
"""

from __future__ import annotations

import functools
import io
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, ParamSpec

from rotcal_ros.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.axis import Axis

P = ParamSpec("P")

INK: Final = "#1d2733"
BLUE: Final = "#1f6fb2"
ORANGE: Final = "#d9772b"
GREEN: Final = "#2e8b57"
RED: Final = "#c0392b"
GREY: Final = "#8795a1"
MISSING: Final = "#c9d1d8"
COLOURS: Final = (BLUE, ORANGE, GREEN, RED, "#7d4fa3", "#6b5b4b")
"""Colours of curves that are drawn together, in this order."""

_RC: Final[dict[Any, Any]] = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e3e8ec",
    "grid.linewidth": 0.8,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "svg.hashsalt": "rotcal",
    "svg.fonttype": "path",
}


def styled(draw: Callable[P, str]) -> Callable[P, str]:
    """Run a drawing function in the house style without touching matplotlib's global settings."""

    @functools.wraps(draw)
    def in_style(*args: P.args, **kwargs: P.kwargs) -> str:
        import matplotlib as mpl

        with mpl.rc_context(_RC):
            return draw(*args, **kwargs)

    return in_style


def grid(rows: int = 1, columns: int = 1, height: float = 3.0, **options: Any) -> list[Axes]:
    """Return the axes of a new figure, row by row; ``height`` in inches per row."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.6, height * rows), layout="constrained")
    return list(figure.subplots(rows, columns, squeeze=False, **options).ravel())


def svg(ax: Axes) -> str:
    """Return the figure of ``ax`` as an ``<svg>`` element; equal figures give equal text."""
    figure = ax.get_figure(root=True)
    assert figure is not None
    stream = io.StringIO()
    figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    return text[text.index("<svg") :]


def whole_numbers(axis: Axis) -> None:
    """Tick an axis of indices at whole numbers only."""
    from matplotlib.ticker import MaxNLocator

    axis.set_major_locator(MaxNLocator(integer=True))


def curve_with_band(
    ax: Axes, x: Floats, y: Floats, band: Floats, label: str, colour: str = BLUE
) -> None:
    """Draw measured points with their expanded uncertainty as a band."""
    ax.fill_between(x, y - band, y + band, color=colour, alpha=0.18, linewidth=0)
    ax.plot(x, y, "o-", color=colour, markersize=3.5, linewidth=1.2, label=label)
    ax.axhline(0.0, color=GREY, linewidth=0.8)
