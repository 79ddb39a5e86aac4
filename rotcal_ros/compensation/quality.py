"""What a controller's table can remove and what it cannot: figures, and the proof by its rule."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from rotcal_ros.compensation.controller import Controller, Lag, Rule
from rotcal_ros.compensation.interpolation_uncertainty import CERTAIN
from rotcal_ros.compensation.lookup import Correction
from rotcal_ros.compensation.resample import averaged, resample
from rotcal_ros.compensation.table import DIRECTIONS, CompensationTable
from rotcal_ros.curves.interpolation import SAME_ANGLE, TURN
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.units import ARCSEC, DEGREE

POINTS_PER_ROW = 24
SHARE_OF_U: Final = 1.0 / 3.0
SPACINGS_DEG: Final = (
    30.0, 20.0, 15.0, 10.0, 7.5, 6.0, 5.0, 4.0, 3.0, 2.5, 2.0, 1.5, 1.2, 1.0, 0.75, 0.5,
)  # fmt: skip
"""Distances of rows that divide a turn, the widest first."""
NO_LAG = Lag()
SAMPLING = 1.02
"""A maximum over so fine a grid can miss the true one by less than this factor."""


@dataclass(frozen=True)
class ResidualBudget:
    """Largest deviations in radians, over all angles and both directions.

    ``before`` is what there is without compensation. ``interpolation`` is the distance of the
    control's line (or staircase) between the rows from the smooth curve through the measured
    points, ``sampling`` bounds what that curve may miss between them, ``rounding`` comes from the
    digits or whole numbers of the file, ``direction`` from a control that has one column for both
    directions, ``second_order`` from looking the correction up at the commanded instead of the
    true angle. ``following`` is what a control leaves whose correction does not follow its table
    at once. ``simulated`` is what the control's own rule leaves when it reads the written file;
    ``std`` the largest standard uncertainty (k = 1) of the correction, which no table removes.
    """

    before: float
    interpolation: float
    sampling: float
    rounding: float
    direction: float
    second_order: float
    simulated: float
    std: float
    following: float = 0.0

    @property
    def stated(self) -> float:
        """The bound on what is left: the sum of all six parts."""
        between_rows = self.interpolation + self.sampling
        return between_rows + self.rounding + self.direction + self.second_order + self.following

    def in_words(self) -> str:
        """Return the figures in one line, in arcseconds."""
        parts = {
            "interpolation": self.interpolation,
            "between the measured angles": self.sampling,
            "rounding": self.rounding,
            "one column for both directions": self.direction,
            "second order": self.second_order,
            "where the correction stands": self.following,
        }
        listed = ", ".join(
            f"{name} {value / ARCSEC:.2g}" for name, value in parts.items() if value
        )
        return (
            f"largest deviation {self.before / ARCSEC:.4g} arcsec, after compensation at most "
            f"{self.stated / ARCSEC:.3g} arcsec ({listed}), {self.simulated / ARCSEC:.3g} arcsec "
            f"by the control's own rule; standard uncertainty {self.std / ARCSEC:.2g} arcsec"
        )


def demanded(table: CompensationTable) -> float:
    """Return what the lines between the rows may leave, rad: a third of U (k = 2).

    More would be seen in a measurement of the same kind. Infinite where U is not known.
    """
    return COVERAGE_FACTOR * table.largest_std * SHARE_OF_U or np.inf


def chosen_rows(table: CompensationTable, controller: Controller) -> CompensationTable:
    """Return ``table`` on the widest rows between which the control leaves what is demanded.

    Its own rows come first. Where no rows that ``controller`` takes are narrow enough, those that
    leave least are returned. Raises ConfigurationError, with the reason for its own rows, when the
    controller takes none at all.
    """
    best, least, refused = None, np.inf, None
    for spacing in (None, *(degrees * DEGREE for degrees in SPACINGS_DEG)):
        try:
            rows = resample(table, spacing)
            controller.write(rows, "x")
        except ConfigurationError as error:
            refused = refused or error
            continue
        left = left_between(table, rows, controller)
        if left <= demanded(table):
            return rows
        if left < least:
            best, least = rows, left
    if best is None:
        assert refused is not None
        raise refused
    return best


def left_between(
    table: CompensationTable, rows: CompensationTable, controller: Controller
) -> float:
    """Return how far (rad) the control is at most from the curve of ``table`` between ``rows``."""
    grid = _fine_grid(table, rows)
    smooth, written = table, rows
    if controller.one_direction:
        smooth, written = averaged(table), averaged(rows)
    columns = (written.correction_forward, written.correction_reverse)
    return SAMPLING * max(
        _largest(
            _neighbours(written, column, grid, controller.staircase)
            - Correction(smooth)(grid, approach)
        )
        for column, approach in zip(columns, DIRECTIONS, strict=True)
    )


def residual_budget(
    table: CompensationTable,
    rows: CompensationTable,
    controller: Controller,
    rule: Rule,
    lag: Lag = NO_LAG,
) -> ResidualBudget:
    """Return what is left of the deviations in ``table`` when the control follows ``rule``.

    ``table`` holds the measured rows (their smooth curve is taken for true), ``rows`` those that
    ``controller`` wrote, ``rule`` is what it read in its files, ``lag`` what of it comes too late.
    """
    grid = _fine_grid(table, rows)
    needed = [Correction(table)(grid, approach) for approach in DIRECTIONS]
    direction = 0.0
    if controller.one_direction:
        goal = [Correction(averaged(table))(grid, approach) for approach in DIRECTIONS]
        direction = SAMPLING * _largest(np.subtract(needed, goal))
    steepest = SAMPLING * _largest(np.gradient(np.array(needed), grid, axis=1))
    interpolation = left_between(table, rows, controller)
    rounding = controller.resolution(rows) / 2.0
    rounding += steepest * controller.position_resolution
    sampling = CERTAIN * table.between_std
    before = _largest(needed)
    return ResidualBudget(
        before=before,
        interpolation=interpolation,
        sampling=sampling,
        rounding=rounding,
        direction=direction,
        second_order=steepest * (before + interpolation + sampling + rounding + direction),
        simulated=simulate(table, controller, rule, grid) + lag.simulated,
        std=table.largest_std,
        following=lag.bound,
    )


def simulate(table: CompensationTable, controller: Controller, rule: Rule, grid: Floats) -> float:
    """Return the largest deviation (rad) left on ``grid`` (rad, one turn or the arc).

    The axis has the deviations of ``table``; it is commanded to every angle from both sides in
    every turn that the file is made for, and moves by what the control makes of the file.
    """
    first, last = controller.travel if table.closed else (0.0, TURN)
    truth = Correction(table)
    worst = 0.0
    for turn in range(round(first / TURN), round(last / TURN)):
        for approach in DIRECTIONS:
            command = grid + turn * TURN
            correction = rule.correction(command, approach)
            moved = command + correction
            if not table.closed:
                moved = np.clip(moved, table.angles[0], table.angles[-1])
            worst = max(worst, _largest(correction - truth(moved, approach)))
    return worst


def _fine_grid(table: CompensationTable, rows: CompensationTable) -> Floats:
    """Return angles that hold all rows and many points between any two of them."""
    ends = np.append(rows.angles, TURN) if table.closed else rows.angles
    knots = np.unique(np.concatenate([ends, table.angles]))
    knots = knots[np.append(True, np.diff(knots) > SAME_ANGLE)]
    share = np.arange(POINTS_PER_ROW) / POINTS_PER_ROW
    between = knots[:-1, None] + np.diff(knots)[:, None] * share
    return np.append(between.ravel(), knots[-1])


def _neighbours(rows: CompensationTable, column: Floats, grid: Floats, staircase: bool) -> Floats:
    """Return what the control may give between the rows: one line, or either neighbour (2, n)."""
    knots, values = rows.angles, column
    if rows.closed:
        knots, values = np.append(knots, knots[0] + TURN), np.append(values, values[0])
    if not staircase:
        return np.interp(grid, knots, values)[None, :]
    left = np.clip(np.searchsorted(knots, grid, side="right") - 1, 0, len(knots) - 2)
    return np.vstack([values[left], values[left + 1]])


def _largest(values: Any) -> float:
    return float(np.max(np.abs(np.asarray(values))))
