"""Results, comparisons, ISO 230-2 figures and propagated uncertainties as tables for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from rotcal_ros.evaluation.marks import further_statements, marks, why_withheld
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR, unit_of
from rotcal_ros.foundation.gum_numbers import uncertainty, value
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.report.terminal.columns import (
    Column,
    TitledTable,
    print_table,
    print_tables,
    print_words,
)

if TYPE_CHECKING:  # a result is printed without what compares and combines
    from rotcal_ros.evaluation.compare import Comparison
    from rotcal_ros.evaluation.component_groups import ComponentGroup
    from rotcal_ros.evaluation.iso230 import Iso230
    from rotcal_ros.evaluation.monte_carlo import PropagatedResult
    from rotcal_ros.evaluation.quick_check import QuickCheck
    from rotcal_ros.evaluation.truth_scores import LeaderboardRow


def print_result(result: Result) -> None:
    """Print deviations with their expanded uncertainties, warnings and the marks.

    If no uncertainty may be stated it is left out, and a line says why.
    """
    columns, reason = [_angles(result.angles)], why_withheld(result)
    about, *against = marks(result)
    for name in result.components:
        unit, label = unit_of(name)
        value, std = result.deviations[name] / unit, result.std[name] / unit
        columns.append(Column(f"{name}/{label}", value, std=std, valid=not reason))
    band = "" if reason else f", ± U (k = {COVERAGE_FACTOR:g})"
    print_words(f"{result.method}: deviation = actual - commanded{band}")
    print_table(columns)
    print_words(
        *further_statements(result, valid=not reason),
        *(f"warning: {warning}" for warning in result.warnings),
        *([f"U: not stated, because the verdict is {result.verdict}"] if reason else []),
    )
    print_words(
        f"{about.line}: {result.n_observations} observations, "
        f"{len(result.rejected)} rejected, {result.dof} degrees of freedom, "
        f"sigma0 {result.sigma0:.3f}",
        colour=about.colour,
    )
    print_words(*filter(None, [about.remark]))
    for mark in against:
        print_words(mark.line, colour=mark.colour)


def print_group_agreement(groups: Sequence[ComponentGroup]) -> None:
    """Print for each group of components how well the inputs agree, and their weights."""
    print_words(
        *(
            f"{group.name}: chi-square {group.chi2:.4g} with {group.dof} degrees of freedom, "
            f"p {group.p_value:.2g}; weights "
            + ", ".join(f"{name} {100 * part:.3g} %" for name, part in group.weights.items())
            for group in groups
        )
    )


def print_comparisons(comparisons: Mapping[tuple[str, str], Comparison], component: str) -> None:
    """Print every pair: differences, their uncertainty and E_n by angle, and the verdict."""
    unit, label = unit_of(component)
    tables = []
    for (first, second), c in comparisons.items():
        remarks = [
            _remarks({"above 1": abs(error) > 1.0, "interpolated": between})
            for error, between in zip(c.normalised_error, c.interpolated, strict=True)
        ]
        columns = [
            _angles(c.angles),
            *_with_u(f"difference/{label}", c.difference / unit, c.std / unit, label),
            Column("E_n", c.normalised_error, "+.2f"),
            Column("remarks", remarks),
        ]
        pair = f"{first} - {second}"
        tables.append(TitledTable(columns, f"{component}: {pair}, aligned", pair))
    print_tables(tables, "pair")
    for (first, second), c in comparisons.items():
        print_words(
            *(f"note: {note}" for note in c.notes),
            f"{first} - {second}: {c.describe(unit, label)}",
        )


def print_leaderboard(leaderboard: Sequence[LeaderboardRow], misleading: Sequence[str]) -> None:
    """Print the leaderboard of results against the truth, and what misleads, in words."""
    from rotcal_ros.evaluation.truth_scores import FORMATS, HEADINGS

    columns = zip(
        HEADINGS, zip(*(row.row for row in leaderboard), strict=True), FORMATS, strict=True
    )
    print_table([Column(*column) for column in columns])
    print_words(
        *(f"misleads: {text}" for text in misleading),
        f"{len(misleading)} curves mislead: they say ok, name no reason, and are wrong by more "
        "than U",
    )


def print_check(check: QuickCheck, component: str) -> None:
    """Print a quick check by angle, its notes and its verdict."""
    unit, label = unit_of(component)
    remarks = [
        _remarks({"changed": abs(difference) > alarm, "between": between})
        for difference, alarm, between in zip(
            check.difference, check.alarm, check.interpolated, strict=True
        )
    ]
    columns = [
        _angles(check.angles),
        *_with_u(f"difference/{label}", check.difference / unit, check.std / unit, label),
        Column(
            f"valid up to/{label}", check.acceptance / unit, to=COVERAGE_FACTOR * check.std / unit
        ),
        Column(f"changed from/{label}", check.alarm / unit, to=COVERAGE_FACTOR * check.std / unit),
        Column("remarks", remarks),
    ]
    print_table(columns, f"{component}: new - earlier, aligned")
    print_words(*(f"note: {note}" for note in check.notes), check.describe(unit, label))


def print_iso230(figures: Iso230, n_runs: int) -> None:
    """Print the figures of each target, then those of the axis, in arc seconds."""
    by_target = {
        "mean up": figures.mean_forward,
        "s up": figures.s_forward,
        "mean down": figures.mean_reverse,
        "s down": figures.s_reverse,
        "mean": figures.mean,
        "B_i": figures.reversal_i,
        "R_i": figures.repeatability_i,
    }
    expanded = [e for *_, e in figures.summary() if e] or [0.0]
    to = np.full(len(figures.targets), min(expanded) / ARCSEC)
    columns = [Column(f"{name}/arcsec", v / ARCSEC, to=to) for name, v in by_target.items()]
    title = f"ISO 230-2, {n_runs} runs in each direction"
    print_table([_angles(figures.targets), *columns], title)
    _say_figures(figures)
    if not figures.measurement_stated:
        from rotcal_ros.evaluation.iso230 import ONLY_SCATTER

        print_words(f"note: {ONLY_SCATTER}")
    print_words(*(f"warning: {warning}" for warning in figures.warnings))


def _say_figures(figures: Iso230) -> None:
    """Print the figures of the axis, for both directions and for each."""
    for name, values, expanded in figures.summary():
        both, up, down = (
            "" if v is None else value(v / ARCSEC, expanded / ARCSEC).lstrip("+") for v in values
        )
        sides = f"; {up} up, {down} down" if up else ""
        print_words(f"{name}: {both} arcsec, U (95 %) {uncertainty(expanded / ARCSEC)}{sides}")


def print_uncertainty(both: PropagatedResult) -> None:
    """Print, for each component, both U and the interval of the trials by angle.

    If no uncertainty of the measurement may be stated they are left out, and a line says why.
    """
    interval, reason = f"{100 * both.spread.probability:g} % interval", why_withheld(both.result)
    k = f"(k = {COVERAGE_FACTOR:g})"
    tables = []
    for name, part in both.components.items():
        unit, label = unit_of(name)
        to = COVERAGE_FACTOR * part.std / unit
        columns: dict[str, Floats] = {"value": part.value, "shift": part.mean - part.value}
        stated = {
            f"U solver {k}": COVERAGE_FACTOR * part.linear_std,
            f"U trials {k}": COVERAGE_FACTOR * part.std,
            "from": part.low,
            "to": part.high,
        }
        tables.append(
            TitledTable(
                [
                    _angles(both.result.angles),
                    *(Column(head, v / unit, to=to) for head, v in columns.items()),
                    *(
                        Column(head, [None] * len(v) if reason else v / unit, to=to)
                        for head, v in stated.items()
                    ),
                    Column("unit", [label] * len(both.result.angles)),
                ],
                f"{name}: U {k} of solver and trials, {interval}",
                name,
            )
        )
    print_tables(tables, "component")
    print_words(
        *(f"warning: {warning}" for warning in both.warnings),
        *([f"U: not stated, because {reason}"] if reason else []),
        both.describe(),
    )


def _with_u(
    heading: str, difference: Floats, std: Floats, unit_name: str
) -> tuple[Column, Column]:
    """Return the columns of differences and of their expanded uncertainties."""
    to = COVERAGE_FACTOR * std
    return Column(heading, difference, to=to), Column(f"U (k = 2)/{unit_name}", to, to=to)


def _angles(angles: Floats) -> Column:
    return Column("angle/deg", np.round(angles / DEGREE, 10), ".4f")


def _remarks(true: Mapping[str, bool]) -> str:
    return ", ".join(name for name, holds in true.items() if holds)
