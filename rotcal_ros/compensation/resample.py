"""The same correction in another form: on other rows, zero elsewhere, or without direction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from rotcal_ros.compensation.table import CompensationTable
from rotcal_ros.curves.interpolation import interpolation_matrix, row_angles, wrapped
from rotcal_ros.foundation.arrays import Floats
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
    """Return the bound for the reverse column; its zero is the forward one, where it is moved."""
    if table.std_reverse is None:
        return None
    bound = np.abs(weights[:-1]) @ table.std_reverse
    if moved:
        bound = bound + np.abs(weights[-1]) @ table.std
    return np.asarray(bound, dtype=np.float64)


def averaged(table: CompensationTable) -> CompensationTable:
    """Return the mean of both directions, zero at the reference angle.

    For controls with one column. The warnings state what it cannot remove.
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
