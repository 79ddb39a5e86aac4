"""Comparisons as tables for people: degrees, arc seconds, micrometres."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Console
from rich.table import Table

from rotcal_ros.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.evaluation.compare import Comparison
from rotcal_ros.units import DEGREE


def print_comparisons(comparisons: Mapping[tuple[str, str], Comparison], component: str) -> None:
    """Print every pair: differences, their uncertainty and E_n by angle, and the verdict."""
    console = Console(highlight=False)
    unit, name = unit_of(component)
    for (first, second), comparison in comparisons.items():
        table = Table(title=f"{component}: {first} - {second}, aligned")
        for heading in ("angle/deg", f"difference/{name}", f"U (k = 2)/{name}", "E_n", ""):
            table.add_column(heading, justify="right")
        for i, angle in enumerate(comparison.angles):
            error = comparison.normalised_error[i]
            remarks = [
                *(["above 1"] if abs(error) > 1.0 else []),
                *(["interpolated"] if comparison.interpolated[i] else []),
            ]
            table.add_row(
                f"{angle / DEGREE:.4f}",
                f"{comparison.difference[i] / unit:+.3f}",
                f"{COVERAGE_FACTOR * comparison.std[i] / unit:.3f}",
                f"{error:+.2f}",
                ", ".join(remarks),
            )
        console.print(table)
        for note in comparison.notes:
            console.print(f"note: {note}", markup=False, soft_wrap=True)
        words = comparison.in_words(unit, name)
        console.print(f"{first} - {second}: {words}", markup=False, soft_wrap=True)
