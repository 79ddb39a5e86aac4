"""The same correction in another form: on other rows, without direction, or as a function."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.curves.interpolation import (
    curve_through,
    interpolation_matrix,
    row_angles,
    within,
    wrapped,
)
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import ARCSEC


def resample(
    table: CompensationTable,
    spacing: float | None = None,
    *,
    reference_angle: float | None = None,
) -> CompensationTable:
    """Return ``table`` with rows every ``spacing`` rad, zero at ``reference_angle`` (rad).

    A full circle gets rows from 0; without ``spacing`` the rows stay. The new values lie on
    a curve through all old rows. A table carries no correlations, so the uncertainty returned is
    the bound that holds for any: sum of |weight| * std. To keep it sharp, give the spacing to
    ``table_from_result`` instead, which knows the covariance.
    """
    if spacing is None and reference_angle is None:
        return table
    rows = table.angles if spacing is None else row_angles(table.angles, table.period, spacing)
    reference = table.reference_angle if reference_angle is None else float(reference_angle)
    at = np.append(rows, wrapped(reference) if table.closed else reference)
    weights = interpolation_matrix(table.angles, at, table.period)
    up, down = weights @ table.correction_forward, weights @ table.correction_reverse
    zero = 0.0 if reference_angle is None else up[-1]
    shift = weights[:-1] if reference_angle is None else weights[:-1] - weights[-1]
    return replace(
        table,
        angles=rows,
        correction_forward=up[:-1] - zero,
        correction_reverse=down[:-1] - zero,
        std=np.abs(shift) @ table.std,
        std_reverse=_reverse_bound(table, weights, moved=reference_angle is not None),
        reference_angle=float(at[-1]),
    )


def _reverse_bound(table: CompensationTable, weights: Floats, *, moved: bool) -> Floats | None:
    """Return the bound for the reverse column; if the zero is moved, it is the forward one."""
    if table.std_reverse is None:
        return None
    bound = np.abs(weights[:-1]) @ table.std_reverse
    if moved:
        bound = bound + np.abs(weights[-1]) @ table.std
    return np.asarray(bound, dtype=np.float64)


def averaged(table: CompensationTable) -> CompensationTable:
    """Return the mean of both directions, zero at the reference angle.

    It is for controls with one column. The warnings state what it cannot remove.
    """
    if not table.directional:
        return table
    at = np.array([table.reference_angle])
    mean = (table.correction_forward + table.correction_reverse) / 2.0
    mean = mean - interpolation_matrix(table.angles, at, table.period) @ mean
    columns = (table.correction_forward, table.correction_reverse)
    left = max(float(np.max(np.abs(column - mean))) for column in columns)
    warning = f"mean of both directions: up to {left / ARCSEC:.3g} arcsec of reversal remain"
    return replace(
        table,
        correction_forward=mean,
        correction_reverse=mean,
        warnings=(*table.warnings, warning),
    )


class Correction:
    """The correction as a function of angle and direction; it is added to the command.

    A smooth curve through every row of the table: the periodic cubic spline, any angle is
    allowed, for a full circle; for an arc the cubic spline inside it, and DataError outside.

    >>> Correction(table)(angle, Approach.NEGATIVE)        # radians in, radians out
    """

    def __init__(self, table: CompensationTable) -> None:
        self.table = table
        self._curves = {
            Approach.POSITIVE: curve_through(table.angles, table.correction_forward, table.period),
            Approach.NEGATIVE: curve_through(table.angles, table.correction_reverse, table.period),
        }

    def __call__(self, angle: ArrayLike, approach: Approach) -> Floats:
        """Return the correction (rad), of the shape of ``angle`` (rad)."""
        if approach not in self._curves:
            raise ConfigurationError(
                f"direction {approach!r}: expected the side from which the table comes: POSITIVE "
                "(angle increasing) or NEGATIVE"
            )
        at = within(self.table.angles, angle, self.table.period)
        return np.asarray(self._curves[approach](at), dtype=np.float64)

    def std(self, angle: ArrayLike, approach: Approach = Approach.POSITIVE) -> Floats:
        """Return the standard uncertainty (rad, k = 1), linear between the rows."""
        angles, period = self.table.angles, self.table.period
        at, std = within(angles, angle, period), self.table.std_of(approach)
        return np.asarray(np.interp(at, angles, std, period=period or None))
