"""The correction of a rotary axis: one model, whatever measured it and whoever will use it.

Correction = -deviation = commanded - actual, radians: what must be *added* to the command.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import Final

import numpy as np

from rotcal_ros.arrays import Floats
from rotcal_ros.components import check_axis
from rotcal_ros.curves.interpolation import (
    SAME_ANGLE,
    TURN,
    harmonic_basis,
    harmonic_estimator,
    interpolation_matrix,
    row_angles,
    wrapped,
)
from rotcal_ros.curves.measured import MeasuredCurve, measured_curve
from rotcal_ros.errors import ConfigurationError, DataError
from rotcal_ros.results import Result, Verdict
from rotcal_ros.units import ARCSEC, DEGREE

SIGN_CONVENTION: Final = "correction = -(actual - commanded); add it to the commanded angle"


@dataclass(frozen=True, eq=False)
class CompensationTable:
    """Correction of the angular positioning over one turn, or over an arc.

    Arrays have shape (n,) and are radians. ``angles`` ascend; with ``period`` 2 pi they lie
    within one turn, and the row at angles[0] + 2 pi is the first row again. ``period`` 0 means
    an arc: it neither closes nor wraps. ``correction_forward`` is for approaches with increasing
    angle and zero at ``reference_angle``, ``correction_reverse`` for decreasing angle. ``std`` is
    the standard uncertainty (k = 1) of both, ``warnings`` say in words what to know before use.
    ``verdict_line`` is the verdict with what it does not cover; empty where that is not known, as
    in a message.
    Raises DataError when the arrays do not fit together.

    >>> import rotcal_ros as rc
    >>> table = rc.make_table(rc.read_result("examples/data/result_ball_plate.json"))
    >>> table.closed, table.directional, float(table.correction_forward[0])
    (True, False, 0.0)
    """

    axis: str
    method: str
    angles: Floats
    correction_forward: Floats
    correction_reverse: Floats
    std: Floats
    period: float
    reference_angle: float
    verdict: Verdict
    warnings: tuple[str, ...] = ()
    verdict_line: str = ""

    def __post_init__(self) -> None:
        check_axis(self.axis)
        for name in ("angles", "correction_forward", "correction_reverse", "std"):
            column = np.array(getattr(self, name), dtype=np.float64)
            column.setflags(write=False)
            object.__setattr__(self, name, column)
            if column.shape != (len(self.angles),) or len(column) < 2:
                raise DataError(
                    f"compensation table: {name} has shape {column.shape}, expected "
                    f"one value for each of at least two angles ({np.shape(self.angles)})"
                )
            if not np.all(np.isfinite(column)):
                row = int(np.argmin(np.isfinite(column)))
                raise DataError(f"compensation table: {name} in row {row} is {column[row]}")
        _check_angles(self.angles, self.period)

    @property
    def closed(self) -> bool:
        """Whether the table covers the full circle and wraps."""
        return self.period > 0.0

    @property
    def directional(self) -> bool:
        """Whether the two directions differ."""
        return not np.array_equal(self.correction_forward, self.correction_reverse)

    @property
    def table_hash(self) -> str:
        """SHA-256 over all that the table says: names, verdict and every bit of the numbers."""
        digest = hashlib.sha256()
        for text in (self.axis, self.method, self.verdict):
            digest.update(text.encode() + b"\0")
        scalars = np.array([self.period, self.reference_angle, len(self.angles)])
        columns = (self.angles, self.correction_forward, self.correction_reverse, self.std)
        for block in (scalars, *columns):
            digest.update(np.asarray(block, dtype="<f8").tobytes())
        return digest.hexdigest()


def check_verdict(origin: Result | CompensationTable) -> None:
    """Raise DataError unless the verdict is "ok": nothing else may move an axis."""
    if origin.verdict != "ok":
        why = f" ({'; '.join(origin.warnings)})" if origin.warnings else ""
        raise DataError(
            f"the verdict of the {origin.method} result is '{origin.verdict}'{why}: only 'ok' may "
            "be fed to a controller; nothing was written"
        )


def table_from_result(
    result: Result,
    *,
    reverse: Result | None = None,
    axis: str = "C",
    reference_angle: float | None = None,
    spacing: float | None = None,
    harmonics: int | None = None,
) -> CompensationTable:
    """Turn the ECC deviations of ``result`` into a correction table, radians.

    The full circle is recognised by its angles; positions that coincide after a turn must
    agree within their uncertainties (else DataError: they do not close) and are averaged. An arc
    becomes a table of ``period`` 0 and says so. ``reverse`` holds the approach with decreasing
    angle, at the same angles and counted from the same zero; without it both directions are
    equal. The zero is moved to ``reference_angle`` (default: the first angle of the result).

    Without ``spacing`` the table has one row per measured angle, else rows every ``spacing``
    radians from zero, on a curve through the measured points. ``harmonics`` =
    order replaces that curve by the weighted least-squares fit of so many harmonics; what it
    leaves out is stated in the warnings. The uncertainty is carried through with the full
    covariance. Raises DataError when ECC is absent, not finite, or does not close.
    """
    forward = measured_curve(result)
    backward = forward if reverse is None else _reverse_curve(forward, reverse)
    reference = float(result.angles[0] if reference_angle is None else reference_angle)
    reference = wrapped(reference) if forward.period else reference
    rows = forward.angles
    if spacing is not None:
        rows = row_angles(rows, forward.period, spacing)
    at = np.append(rows, reference)
    if harmonics is None:
        weights = interpolation_matrix(forward.angles, at, forward.period)
    else:
        weights = _harmonic_weights(forward, at, harmonics)
    up, down = weights @ forward.deviation, weights @ backward.deviation
    return CompensationTable(
        axis=axis,
        method=result.method,
        angles=rows,
        correction_forward=up[-1] - up[:-1],
        correction_reverse=up[-1] - down[:-1],
        std=_standard_uncertainty(weights, forward, backward),
        period=forward.period,
        reference_angle=reference,
        verdict=_worse(result, reverse),
        warnings=(
            *result.warnings,
            *([] if harmonics is None else [_left_out(forward, harmonics)]),
            *_notes(forward, backward, weights[-1]),
        ),
        verdict_line=_lines(result, reverse),
    )


def _reverse_curve(forward: MeasuredCurve, reverse: Result) -> MeasuredCurve:
    backward = measured_curve(reverse)
    same = len(backward.angles) == len(forward.angles)
    if not same or np.max(np.abs(backward.angles - forward.angles)) > SAME_ANGLE:
        raise DataError(
            f"the reverse run has {len(backward.angles)} angles that are not the "
            f"{len(forward.angles)} of the forward run: measure both directions at the same angles"
        )
    return backward


def _harmonic_weights(curve: MeasuredCurve, at: Floats, order: int) -> Floats:
    if curve.period == 0.0:
        raise ConfigurationError("harmonics need the full circle, the result covers an arc only")
    estimator = harmonic_estimator(curve.angles, order, curve.covariance)
    return harmonic_basis(at, order) @ estimator


def _standard_uncertainty(
    weights: Floats, forward: MeasuredCurve, backward: MeasuredCurve
) -> Floats:
    """Return the larger uncertainty of both directions; the last row of weights is the zero."""
    shift = weights[:-1] - weights[-1]
    variance = np.sum((shift @ forward.covariance) * shift, axis=1)
    if backward is not forward:
        # Independent runs: the reverse values also carry the uncertainty of the forward zero.
        down = np.sum((weights[:-1] @ backward.covariance) * weights[:-1], axis=1)
        zero = weights[-1] @ forward.covariance @ weights[-1]
        variance = np.maximum(variance, down + zero)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)), dtype=np.float64)


def _worse(result: Result, reverse: Result | None) -> Verdict:
    ranking: tuple[Verdict, ...] = ("ok", "suspect", "failed")
    verdicts = [result.verdict] if reverse is None else [result.verdict, reverse.verdict]
    return max(verdicts, key=ranking.index)


def _lines(result: Result, reverse: Result | None) -> str:
    """Return the verdict lines of both directions, once where they are the same."""
    lines = (
        [result.verdict_line] if reverse is None else [result.verdict_line, reverse.verdict_line]
    )
    return "; other direction: ".join(dict.fromkeys(lines))


def _left_out(curve: MeasuredCurve, order: int) -> str:
    left = curve.deviation - _harmonic_weights(curve, curve.angles, order) @ curve.deviation
    left = left - np.mean(left)  # the constant is nobody's: the table is zero at its reference
    noise = float(np.sqrt(np.trace(curve.covariance) / len(curve.covariance)))
    return (
        f"harmonics up to order {order} leave out {np.sqrt(np.mean(left**2)) / ARCSEC:.3g} arcsec "
        f"rms, {np.max(np.abs(left)) / ARCSEC:.3g} arcsec at most, of the measured deviations "
        f"(their standard uncertainty: {noise / ARCSEC:.3g} arcsec)"
    )


def _notes(forward: MeasuredCurve, backward: MeasuredCurve, zero: Floats) -> list[str]:
    notes = []
    if forward.period == 0.0:
        first, last = forward.angles[[0, -1]] / DEGREE
        notes.append(
            f"the angles cover an arc only ({first:.6g} .. {last:.6g} deg): no closure, no wrap, "
            "nothing is known outside"
        )
    own_zero = max(abs(zero @ forward.deviation), abs(zero @ backward.deviation)) < 1e-15
    if backward is not forward and own_zero:
        notes.append(
            "both runs count from their own zero: the reversal at the reference angle is not in "
            "the table, only how it changes around the circle"
        )
    return notes


def _check_angles(angles: Floats, period: float) -> None:
    if np.any(np.diff(angles) <= 0.0):
        row = int(np.argmax(np.diff(angles) <= 0.0)) + 1
        raise DataError(f"compensation table: row {row} does not ascend from the row before")
    if period != 0.0 and abs(period - TURN) > 1e-12:
        raise DataError(f"compensation table: period {period} rad, expected 2 pi or 0 (an arc)")
    if period and angles[-1] - angles[0] > TURN - SAME_ANGLE / 2:
        raise DataError(
            "compensation table: the last row repeats the first after a full turn; leave it "
            "out, the period of 2 pi says it"
        )
