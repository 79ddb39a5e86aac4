"""One look for all figures, and figures as inline SVG: no display, no global state.

Drawing takes a second to load, so that is done by the first figure.
"""

from __future__ import annotations

import functools
import io
import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final, ParamSpec, TypeVar

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.escapes import printable_lines, shortened
from rotcal_ros.foundation.language import SPOKEN

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure


P = ParamSpec("P")
R = TypeVar("R")

INK: Final = "#1d2733"
BLUE: Final = "#1f6fb2"
ORANGE: Final = "#b8560f"
GREEN: Final = "#26774a"
RED: Final = "#c0392b"
GREY: Final = "#6b7985"
MISSING: Final = "#c9d1d8"
GRID: Final = "#e3e8ec"
PAPER: Final = "#ffffff"
COLOURS: Final = (BLUE, ORANGE, GREEN, RED, "#7d4fa3", "#6b5b4b")
"""Colours of curves that are drawn together, in this order."""

LEGEND_COLUMNS: Final = 4
ANGLE_STEPS: Final = (1.0, 2.0, 5.0, 15.0, 30.0, 45.0, 90.0)
"""Degrees between the ticks of an axis of angles."""
MOST_TICKS: Final = 13
FEWER_TICKS: Final = 5
"""Where panels stand side by side."""
NOT_VALID: Final = "not valid: U is not stated"

LONGEST_NAME: Final = 120
"""Characters in a figure; longer names lose their middle."""

_RC: Final[dict[Any, Any]] = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.8,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
    "text.parse_math": False,  # a dollar in the name of a station is a dollar
    "legend.frameon": False,
    "legend.fontsize": 8,
    "hatch.linewidth": 0.5,
    "svg.hashsalt": "rotcal",
    "svg.fonttype": "path",
}


def house_style(draw: Callable[P, R]) -> Callable[P, R]:
    """Run a drawing function in the house style without touching matplotlib's global settings."""

    @functools.wraps(draw)
    def in_style(*args: P.args, **kwargs: P.kwargs) -> R:
        import matplotlib as mpl

        with mpl.rc_context(_RC):
            return draw(*args, **kwargs)

    return in_style


def grid(rows: int = 1, columns: int = 1, height: float = 3.0, **options: Any) -> list[Axes]:
    """Return the axes of a new figure, row by row; ``height`` in inches per row."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.6, height * rows), layout="constrained")
    return list(figure.subplots(rows, columns, squeeze=False, **options).ravel())


def finish_figure(ax: Axes) -> Figure:
    """Return the figure of ``ax``, whose panels share one legend above them."""
    from matplotlib.text import Text

    figure = ax.get_figure(root=True)
    assert figure is not None
    entries: dict[str, Any] = {}
    for panel in figure.axes:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    if entries:
        columns = min(len(entries), LEGEND_COLUMNS)
        figure.legend(entries.values(), entries, loc="outside upper left", ncols=columns)
    # what is ours in the language of the page, and names as they are: no formulas, no controls,
    # and nothing wider than the figure
    for text in figure.findobj(Text):
        text.set_parse_math(False)
        text.set_text(shortened(printable_lines(SPOKEN.get()(text.get_text())), LONGEST_NAME))
    vars(figure)["_repr_png_"] = functools.partial(_png, figure)
    return figure


def _png(figure: Figure) -> bytes:
    """Return what a notebook shows; it would know a figure by itself only after pyplot."""
    stream = io.BytesIO()
    figure.savefig(stream)
    return stream.getvalue()


def svg(ax: Axes) -> str:
    """Return the figure of ``ax`` as an ``<svg>`` element; equal figures give equal text."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    figure, stream = finish_figure(ax), io.StringIO()
    with warnings.catch_warnings():
        # A box stands for a sign that the font lacks, and long names stand over each other.
        warnings.filterwarnings("ignore", "Glyph .* missing|constrained_layout not applied")
        canvas: Any = FigureCanvasSVG(figure)  # untyped; savefig would draw the same twice
        canvas.print_svg(stream, metadata={"Date": None, "Creator": None})
    text = printable_lines(stream.getvalue())  # ticks get their names while they are drawn
    return text[text.index("<svg") :]


def angle_axis(ax: Axes, angles_deg: Floats, label: str = "commanded table angle / °") -> None:
    """Name the axis of angles and tick it where people look for them: at 30, 45 or 90 degrees."""
    from matplotlib.ticker import MultipleLocator

    ax.set_xlabel(label)
    span = float(angles_deg.max() - angles_deg.min()) if len(angles_deg) else 0.0
    panels = ax.get_gridspec()
    most = MOST_TICKS if panels is None or panels.ncols == 1 else FEWER_TICKS
    steps = [step for step in ANGLE_STEPS if span <= most * step]
    if span >= ANGLE_STEPS[0]:
        ax.xaxis.set_major_locator(MultipleLocator(steps[0] if steps else 360.0))


def whole_numbers(axis: Axis) -> None:
    """Tick an axis of indices at whole numbers only."""
    from matplotlib.ticker import MaxNLocator

    axis.set_major_locator(MaxNLocator(integer=True))


def curve_with_band(
    ax: Axes,
    x: Floats,
    y: Floats,
    band: Floats,
    label: str,
    colour: str = BLUE,
    *,
    valid: bool = True,
) -> None:
    """Draw measured points with their expanded uncertainty as a band.

    One that is not ``valid`` is grey, hatched and labelled, so that it is not taken for valid.
    """
    band_about(ax, x, y, band, colour, valid=valid)
    label = label if valid else label.split(",")[0]
    ax.plot(x, y, "o-", color=colour, markersize=3.5, linewidth=1.2, label=label)
    ax.axhline(0.0, color=GREY, linewidth=0.8)


def band_about(
    ax: Axes, x: Floats, y: Floats, band: Floats, colour: str, *, valid: bool = True
) -> None:
    """Draw a band about a curve; see :func:`curve_with_band`."""
    if valid:
        ax.fill_between(x, y - band, y + band, color=colour, alpha=0.18, linewidth=0)
        return
    ax.fill_between(
        x, y - band, y + band, facecolor="none", edgecolor=GREY, hatch="////", linewidth=0.5,
        label=NOT_VALID,
    )  # fmt: skip


COVERED_MM: Final = 20.0
"""Places nearer to each other than that in a view share a name there."""


def name_places(ax: Axes, numbers: Sequence[int], points: Floats) -> None:
    """Write names beside ``points`` (p, 2), mm; those that cover each other share one."""
    left = list(zip(numbers, points.tolist(), strict=True))
    while left:
        x, y = left[0][1]
        near = [number for number, at in left if np.hypot(at[0] - x, at[1] - y) < COVERED_MM]
        left = [pair for pair in left if pair[0] not in near]
        names = ", ".join(map(str, near))
        ax.annotate(names, (x, y), xytext=(4, 4), textcoords="offset points", fontsize=7)
