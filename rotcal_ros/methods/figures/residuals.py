"""Figures of residuals by table position and target."""

from __future__ import annotations

import numpy as np

from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import MICROMETRE
from rotcal_ros.methods.figures import Figure, style


def residual_figures(result: Result, unit: float = MICROMETRE, label: str = "µm") -> list[Figure]:
    """Return the figures of residuals, drawn in ``unit``, by table position and target."""
    return [
        Figure(
            "Residuals",
            "Observed − computed. A pattern by table position or by target points to an error "
            "that the model does not hold.",
            residuals(result, unit, label),
            "residuals",
        ),
        Figure(
            "Normalised residuals",
            "Residual divided by its own standard deviation, by table position and target.",
            residual_map(result),
            "residuals",
        ),
    ]


@style.house_style
def residuals(result: Result, unit: float = MICROMETRE, label: str = "µm") -> str:
    """Draw residuals by table angle and by target; what was not used is marked."""
    rows = result.residuals
    if rows is None:
        return ""
    left, right = style.grid(1, 2, sharey=True)
    for ax, index, name in (
        (left, rows.table_position, "table position (index)"),
        (right, rows.target, "target (index)"),
    ):
        residual, gone = rows.residual / unit, ~rows.used
        ax.scatter(index[rows.used], residual[rows.used], s=7, color=style.BLUE, alpha=0.55,
                   label="used")  # fmt: skip
        if gone.any():
            ax.scatter(index[gone], residual[gone], s=26, color=style.RED, marker="x",
                       label="rejected")  # fmt: skip
        ax.axhline(0.0, color=style.GREY, linewidth=0.8)
        ax.set_xlabel(name)
        style.whole_numbers(ax.xaxis)
    left.set_ylabel(phrase("residual / {0}", label))
    return style.svg(left)


@style.house_style
def residual_map(result: Result) -> str:
    """Draw the normalised residual of every table position and target as a map.

    Where a cell would hold several residuals there is no map.
    """
    rows = result.residuals
    if rows is None or rows.test_value.size == 0:
        return ""
    cells = np.column_stack([rows.table_position, rows.target])
    if len(np.unique(cells, axis=0)) < len(cells):
        return ""
    grid = np.full((rows.table_position.max() + 1, rows.target.max() + 1), np.nan)
    grid[rows.table_position, rows.target] = rows.test_value
    (ax,) = style.grid(height=2.6)
    ax.grid(visible=False)
    ax.set_facecolor(style.MISSING)
    image = ax.imshow(grid, cmap="RdBu_r", vmin=-4, vmax=4, aspect="auto", interpolation="nearest")
    ax.set_xlabel("target (index)")
    ax.set_ylabel("table position")
    style.whole_numbers(ax.xaxis)
    style.whole_numbers(ax.yaxis)
    ax.figure.colorbar(image, ax=ax, label="normalised residual")
    return style.svg(ax)
