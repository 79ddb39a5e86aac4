"""The figures of ISO 230-2 as tables for people, in arc seconds."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from rotcal_ros.evaluation.iso230 import Iso230
from rotcal_ros.units import ARCSEC, DEGREE


def print_iso230(figures: Iso230, n_runs: int) -> None:
    """Print what belongs to each target, then the figures of the axis."""
    console = Console(highlight=False)
    table = Table(title=f"ISO 230-2, {n_runs} runs in each direction, arcsec")
    columns = {
        "mean up": figures.mean_forward,
        "s up": figures.s_forward,
        "mean down": figures.mean_reverse,
        "s down": figures.s_reverse,
        "mean": figures.mean,
        "B_i": figures.reversal_i,
        "R_i": figures.repeatability_i,
    }
    for heading in ("deg", *columns):
        table.add_column(heading, justify="right")
    for i, angle in enumerate(figures.targets):
        cells = (f"{values[i] / ARCSEC:.3f}" for values in columns.values())
        table.add_row(f"{angle / DEGREE:.4f}", *cells)
    console.print(table)
    summary = Table()
    for heading in ("arcsec", "both", "up", "down"):
        summary.add_column(heading, justify="left" if heading == "arcsec" else "right")
    for name, values in figures.summary():
        summary.add_row(name, *("" if v is None else f"{v / ARCSEC:.3f}" for v in values))
    console.print(summary)
    for warning in figures.warnings:
        console.print(f"warning: {warning}", markup=False, soft_wrap=True)
