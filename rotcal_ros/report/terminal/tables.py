"""Results, comparisons, ISO 230-2 figures and propagated uncertainties as tables for people."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from rotcal_ros.components import unit_of
from rotcal_ros.evaluation.iso230 import ONLY_SCATTER, Iso230
from rotcal_ros.results import Result
from rotcal_ros.units import ARCSEC, DEGREE

if TYPE_CHECKING:  # a result is printed without what compares and combines
    from rotcal_ros.evaluation.compare import Comparison
    from rotcal_ros.evaluation.component_groups import Group
    from rotcal_ros.evaluation.propagated import Propagated
    from rotcal_ros.evaluation.quick_check import QuickCheck


def print_result(result: Result) -> None:
    """Print deviations with their standard uncertainties, warnings and the verdict."""
    names = result.components
    rows = []
    for i, angle in enumerate(result.angles):
        cells = []
        for name in names:
            unit, _ = unit_of(name)
            band = f" +- {result.std[name][i] / unit:.3f}" if name in result.std else ""
            cells.append(f"{result.deviations[name][i] / unit:+.3f}{band}")
        rows.append((_degrees(angle), *cells))
    _lines(f"{result.method}: deviation = actual - commanded, +- standard uncertainty")
    _table("", ["angle/deg", *(f"{name}/{unit_of(name)[1]}" for name in names)], rows)
    _lines(
        *(f"warning: {warning}" for warning in result.warnings),
        f"verdict {result.verdict_line}: {result.n_observations} observations, "
        f"{len(result.rejected)} rejected, {result.dof} degrees of freedom, "
        f"sigma0 {result.sigma0:.3f}",
    )


def print_groups(groups: Sequence[Group]) -> None:
    """Print for each group of components how well the inputs agree, and their weights."""
    rows = [
        (
            group.name,
            f"{group.chi2:.4g}",
            str(group.dof),
            f"{group.p_value:.2g}",
            ", ".join(f"{name} {100 * part:.3g} %" for name, part in group.weights.items()),
        )
        for group in groups
    ]
    _table("", ["components", "chi-square", "dof", "p", "weights"], rows)


def print_comparisons(comparisons: Mapping[tuple[str, str], Comparison], component: str) -> None:
    """Print every pair: differences, their uncertainty and E_n by angle, and the verdict."""
    unit, label = unit_of(component)
    headings = ["angle/deg", f"difference/{label}", f"U (k = 2)/{label}", "E_n", ""]
    for (first, second), comparison in comparisons.items():
        rows = []
        for i, cells in enumerate(comparison.rows(unit)):
            remarks = ["above 1"] * bool(abs(comparison.normalised_error[i]) > 1.0)
            remarks += ["interpolated"] * bool(comparison.interpolated[i])
            rows.append((*cells, ", ".join(remarks)))
        _table(f"{component}: {first} - {second}, aligned", headings, rows)
        _lines(
            *(f"note: {note}" for note in comparison.notes),
            f"{first} - {second}: {comparison.in_words(unit, label)}",
        )


def print_check(check: QuickCheck, component: str) -> None:
    """Print a quick check by angle, its notes and its verdict."""
    unit, label = unit_of(component)
    rows = []
    for i, cells in enumerate(check.rows(unit)):
        remarks = ["changed"] * bool(abs(check.difference[i]) > check.alarm[i])
        remarks += ["between"] * bool(check.interpolated[i])
        rows.append((*cells, ", ".join(remarks)))
    headings = ["angle/deg", "difference", "U (k = 2)", "valid up to", "changed from", ""]
    _table(f"{component}: new - earlier, aligned, {label}", headings, rows)
    _lines(*(f"note: {note}" for note in check.notes), check.in_words(unit, label))


def print_iso230(figures: Iso230, n_runs: int) -> None:
    """Print what belongs to each target, then the figures of the axis, in arc seconds."""
    columns = {
        "mean up": figures.mean_forward,
        "s up": figures.s_forward,
        "mean down": figures.mean_reverse,
        "s down": figures.s_reverse,
        "mean": figures.mean,
        "B_i": figures.reversal_i,
        "R_i": figures.repeatability_i,
    }
    _table(
        f"ISO 230-2, {n_runs} runs in each direction, arcsec",
        ["deg", *columns],
        [
            (_degrees(angle), *(f"{values[i] / ARCSEC:.3f}" for values in columns.values()))
            for i, angle in enumerate(figures.targets)
        ],
    )
    _table(
        "",
        ["arcsec", "both", "up", "down", "U (95 %) of both"],
        [
            (
                name,
                *("" if value is None else f"{value / ARCSEC:.3f}" for value in values),
                f"{expanded / ARCSEC:.3f}",
            )
            for (name, values), expanded in zip(figures.summary(), figures.expanded(), strict=True)
        ],
    )
    if not figures.measurement_stated:
        _lines(f"note: {ONLY_SCATTER}")
    _lines(*(f"warning: {warning}" for warning in figures.warnings))


def print_uncertainty(both: Propagated) -> None:
    """Print, for each component, both uncertainties and the interval of the trials by angle."""
    interval = f"{100 * both.spread.probability:g} % interval"
    headings = ["angle/deg", "value", "solver", "trials", "shift", "from", "to"]
    for name, part in both.components.items():
        unit, label = unit_of(name)
        shift = part.mean - part.value
        columns = (part.value, part.linear_std, part.std, shift, part.low, part.high)
        rows = [
            (_degrees(angle), *(f"{values[i] / unit:.4f}" for values in columns))
            for i, angle in enumerate(both.result.angles)
        ]
        _table(f"{name}/{label}: standard uncertainty and {interval}", headings, rows)
    _lines(*(f"warning: {warning}" for warning in both.warnings), both.in_words())


def _degrees(angle: float) -> str:
    return f"{angle / DEGREE:.4f}"


def _table(title: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table; all columns stand right, but for one of names."""
    table = Table(title=title or None)
    for heading in headings:
        table.add_column(heading, justify="left" if heading == "arcsec" else "right")
    for row in rows:
        table.add_row(*row)
    Console(highlight=False).print(table)


def _lines(*texts: str) -> None:
    console = Console(highlight=False)
    for text in texts:
        console.print(text, markup=False, soft_wrap=True)
