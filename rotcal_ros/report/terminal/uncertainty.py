"""Propagated uncertainties as a table for people."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from rotcal_ros.components import unit_of
from rotcal_ros.evaluation.propagated import Propagated
from rotcal_ros.units import DEGREE


def print_uncertainty(both: Propagated) -> None:
    """Print, for each component, both uncertainties and the interval of the trials by angle."""
    console = Console(highlight=False)
    percent = f"{100 * both.spread.probability:g} %"
    for name, part in both.components.items():
        unit, label = unit_of(name)
        table = Table(title=f"{name}/{label}: standard uncertainty and {percent} interval")
        for heading in ("angle/deg", "value", "solver", "trials", "shift", "from", "to"):
            table.add_column(heading, justify="right")
        for i, angle in enumerate(both.result.angles):
            cells = (part.value, part.linear_std, part.std, part.mean - part.value)
            row = [f"{values[i] / unit:.4f}" for values in (*cells, part.low, part.high)]
            table.add_row(f"{angle / DEGREE:.4f}", *row)
        console.print(table)
    for warning in both.warnings:
        console.print(f"warning: {warning}", markup=False, soft_wrap=True)
    console.print(both.in_words(), markup=False, soft_wrap=True)
