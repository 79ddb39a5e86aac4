"""A result as a table for people: degrees, micrometres, arc seconds."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from rotcal_ros.components import COMPONENTS
from rotcal_ros.results import Result
from rotcal_ros.units import ARCSEC, DEGREE, MICROMETRE

_ROTATIONS = {"EAC", "EBC", "ECC"}


def print_result(result: Result) -> None:
    """Print deviations with their standard uncertainties, warnings and the verdict."""
    console = Console(highlight=False)
    names = [name for name in COMPONENTS if name in result.deviations]
    console.print(f"{result.method}: deviation = actual - commanded, +- standard uncertainty")
    table = Table()
    table.add_column("angle/deg", justify="right")
    for name in names:
        table.add_column(f"{name}/{'arcsec' if name in _ROTATIONS else 'um'}", justify="right")
    for row, angle in enumerate(result.angles):
        cells = [f"{angle / DEGREE:.4f}"]
        for name in names:
            unit = ARCSEC if name in _ROTATIONS else MICROMETRE
            value = f"{result.deviations[name][row] / unit:+.3f}"
            if name in result.std:
                value += f" +- {result.std[name][row] / unit:.3f}"
            cells.append(value)
        table.add_row(*cells)
    console.print(table)
    for warning in result.warnings:
        console.print(f"warning: {warning}", markup=False)
    console.print(
        f"verdict {result.verdict}: {result.n_observations} observations, "
        f"{len(result.rejected)} rejected, {result.dof} degrees of freedom, "
        f"sigma0 {result.sigma0:.3f}",
        markup=False,
    )
