"""The correction of a rotary axis: one model, whatever measured it and whoever will use it.

Correction = -deviation = commanded - actual, radians: what must be *added* to the command.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from math import tau
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rotcal_ros.compensation.curve import (
    Interpolation,
    harmonic_basis,
    harmonic_estimator,
    interpolation_matrix,
)
from rotcal_ros.errors import ConfigurationError, DataError
from rotcal_ros.results import Result, Verdict
from rotcal_ros.units import ARCSEC, DEGREE

Floats = NDArray[np.float64]

SIGN_CONVENTION: Final = "correction = -(actual - commanded); add it to the commanded angle"
SAME_ANGLE: Final = 1e-9
"""rad; angles closer than this are the same table position."""
CLOSURE_LIMIT: Final = 4.0
"""How many standard uncertainties two measurements of one angle may differ."""


@dataclass(frozen=True, eq=False)
class CompensationTable:
    """Correction of the angular positioning over one turn, or over an arc.

    Arrays have shape (n,) and are radians. ``angles`` ascend; with ``period`` 2 pi they lie
    within one turn, and the row at angles[0] + 2 pi is the first row again. ``period`` 0 means an
    arc: it neither closes nor wraps. ``correction_forward`` is for approaches with increasing
    angle and zero at ``reference_angle``, ``correction_reverse`` for decreasing angle. ``std`` is
    the standard uncertainty (k = 1) of both, ``warnings`` say in words what to know before use.
    Raises DataError when the arrays do not fit together.
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
        _check_period(self.angles, self.period)

    @property
    def closed(self) -> bool:
        """Whether the table covers the full circle and wraps."""
        return self.period > 0.0

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

    @property
    def directional(self) -> bool:
        """Whether the two directions differ."""
        return not np.array_equal(self.correction_forward, self.correction_reverse)


def check_axis(axis: str) -> str:
    """Return ``axis`` when it can stand in a controller file, else raise ConfigurationError."""
    if not re.fullmatch(r"[A-Z][A-Z0-9_]{0,15}", axis):
        raise ConfigurationError(
            f"axis name {axis!r}: expected a capital letter followed by at most 15 capitals, "
            "digits or underscores, such as C or C1"
        )
    return axis


def table_from_result(
    result: Result,
    *,
    reverse: Result | None = None,
    axis: str = "C",
    reference_angle: float | None = None,
    spacing: float | None = None,
    interpolation: Interpolation = "spline",
    harmonics: int | None = None,
) -> CompensationTable:
    """Turn the ECC deviations of ``result`` into a correction table, radians.

    The full circle is recognised by its angles; positions that coincide after a turn must
    agree within their uncertainties (else DataError: they do not close) and are averaged. An arc
    becomes a table of ``period`` 0 and says so. ``reverse`` holds the approach with decreasing
    angle, at the same angles and counted from the same zero; without it both directions are
    equal. The zero is moved to ``reference_angle`` (default: the first angle of the result).

    Without ``spacing`` the table has one row per measured angle, else rows every ``spacing``
    radians from zero, on a curve through the measured points (``interpolation``). ``harmonics`` =
    order replaces that curve by the weighted least-squares fit of so many harmonics; what it
    leaves out is stated in the warnings. The uncertainty is carried through with the full
    covariance. Raises DataError when ECC is absent, not finite, or does not close.
    """
    nodes, merge, period = _nodes(result)
    reference = float(result.angles[0] if reference_angle is None else reference_angle)
    if period > 0.0:
        reference = _wrapped(reference)
    rows = nodes if spacing is None else grid(nodes, period, spacing)
    warnings = list(result.warnings) + _arc_warning(nodes, period)
    deviation, covariance = _merged(result, merge)
    if harmonics is None:
        curve = interpolation_matrix(nodes, rows, period, interpolation)
        zero = interpolation_matrix(nodes, np.array([reference]), period, interpolation)
    else:
        if period == 0.0:
            raise ConfigurationError("harmonics need the full circle, the result covers an arc")
        estimator = harmonic_estimator(nodes, harmonics, covariance)
        curve = harmonic_basis(rows, harmonics) @ estimator
        zero = harmonic_basis(np.array([reference]), harmonics) @ estimator
        fit = harmonic_basis(nodes, harmonics) @ estimator @ deviation
        warnings.append(_left_out(deviation - fit, harmonics, covariance))
    shift = curve - zero
    variance = np.einsum("ij,jk,ik->i", shift, covariance, shift)
    forward = shift @ deviation
    backward = forward
    if reverse is not None:
        backward, variance_reverse = _reverse_curve(result, reverse, merge, curve, zero)
        variance = np.maximum(variance, variance_reverse)
        warnings += _own_zero(deviation, reverse, merge, zero)
    return CompensationTable(
        axis=axis,
        method=result.method,
        angles=rows,
        correction_forward=_negative(forward),
        correction_reverse=_negative(backward),
        std=np.sqrt(np.maximum(variance, 0.0)),
        period=period,
        reference_angle=reference,
        verdict=result.verdict,
        warnings=tuple(warnings),
    )


def grid(nodes: Floats, period: float, spacing: float) -> Floats:
    """Return the row angles every ``spacing`` rad: from 0 for a circle, inside of an arc else.

    When the spacing does not divide the turn the last interval of a circle is shorter. An arc keeps
    its two ends as rows.
    """
    if not np.isfinite(spacing) or spacing < 1e-5 or spacing > tau / 2:
        raise ConfigurationError(
            f"spacing {spacing / DEGREE:.6g} deg: expected more than 0.001 and at most 180 deg"
        )
    if period > 0.0:
        count = int(np.ceil(period / spacing - 1e-9))
        return np.asarray(np.arange(count) * spacing, dtype=np.float64)
    first, last = float(nodes[0]), float(nodes[-1])
    steps = np.arange(np.ceil(first / spacing - 1e-9), np.floor(last / spacing + 1e-9) + 1)
    inner = steps * spacing
    inner = inner[(inner > first + SAME_ANGLE) & (inner < last - SAME_ANGLE)]
    return np.asarray(np.concatenate([[first], inner, [last]]), dtype=np.float64)


def _nodes(result: Result) -> tuple[Floats, Floats, float]:
    """Return distinct angles (n,), the averaging matrix (n, measured) and the period."""
    angles = np.asarray(result.angles, dtype=np.float64)
    deviation = result.deviations.get("ECC")
    if deviation is None:
        raise DataError(
            f"the {result.method} result holds no ECC, only {', '.join(result.deviations) or '-'}: "
            "a positioning table needs the angular positioning deviation"
        )
    if angles.ndim != 1 or np.shape(deviation) != angles.shape or len(angles) < 2:
        raise DataError(
            f"the {result.method} result holds {np.shape(deviation)} ECC values for "
            f"{angles.shape} angles: expected one for each of at least two angles"
        )
    bad = ~(np.isfinite(angles) & np.isfinite(deviation))
    if np.any(bad):
        row = int(np.argmax(bad))
        raise DataError(
            f"the {result.method} result, row {row}: ECC is {deviation[row]} at "
            f"{angles[row] / DEGREE:.6g} deg, expected finite numbers"
        )
    period = tau if covers_circle(angles) else 0.0
    position = np.array([_wrapped(a) for a in angles]) if period else angles
    order = np.argsort(position, kind="stable")
    new = np.append(True, np.diff(position[order]) > SAME_ANGLE)
    group = np.cumsum(new) - 1
    merge = np.zeros((group[-1] + 1, len(angles)))
    merge[group, order] = 1.0
    _check_closure(result, merge)
    merge /= merge.sum(axis=1, keepdims=True)
    return np.asarray(position[order][new], dtype=np.float64), merge, period


def covers_circle(angles: Floats) -> bool:
    """Whether ``angles`` (rad) go round: the gap left is no wider than the others allow."""
    ascending = np.unique(np.asarray(angles, dtype=np.float64))
    span = float(ascending[-1] - ascending[0])
    if span >= tau - SAME_ANGLE:
        return True
    return len(ascending) > 2 and tau - span <= 1.5 * float(np.max(np.diff(ascending)))


def _wrapped(angle: float) -> float:
    wrapped = float(np.mod(angle, tau))
    return 0.0 if tau - wrapped < SAME_ANGLE else wrapped


def _covariance(result: Result) -> Floats:
    full = result.covariance.get("ECC")
    n = len(result.angles)
    if full is None:
        std = result.std.get("ECC")
        full = np.zeros((n, n)) if std is None else np.diag(np.asarray(std) ** 2)
    if np.shape(full) != (n, n) or not np.all(np.isfinite(full)):
        raise DataError(
            f"the {result.method} result: the covariance of ECC has shape {np.shape(full)} or is "
            f"not finite, expected ({n}, {n}) finite numbers"
        )
    return np.asarray(full, dtype=np.float64)


def _merged(result: Result, merge: Floats) -> tuple[Floats, Floats]:
    return merge @ result.deviations["ECC"], merge @ _covariance(result) @ merge.T


def _check_closure(result: Result, groups: Floats) -> None:
    """Raise DataError when two measurements of the same position contradict each other."""
    deviation, covariance = result.deviations["ECC"], _covariance(result)
    for members in (np.flatnonzero(row) for row in groups if row.sum() > 1):
        first = members[0]
        for other in members[1:]:
            gap = float(deviation[other] - deviation[first])
            variance = covariance[first, first] + covariance[other, other]
            std = float(np.sqrt(max(variance - 2.0 * covariance[first, other], 0.0)))
            if abs(gap) > CLOSURE_LIMIT * std + SAME_ANGLE:
                raise DataError(
                    f"the deviations do not close: at {result.angles[first] / DEGREE:.6g} and "
                    f"{result.angles[other] / DEGREE:.6g} deg, the same table position, they "
                    f"differ by {gap / ARCSEC:.4g} arcsec with a standard uncertainty of "
                    f"{std / ARCSEC:.3g} arcsec (limit {CLOSURE_LIMIT:g} times): something moved "
                    "during the run, measure again"
                )


def _reverse_curve(
    result: Result, reverse: Result, merge: Floats, curve: Floats, zero: Floats
) -> tuple[Floats, Floats]:
    """Return the reverse deviation and variance, both counted from the forward reference."""
    same = np.shape(reverse.angles) == np.shape(result.angles)
    if not same or np.max(np.abs(reverse.angles - result.angles)) > SAME_ANGLE:
        raise DataError(
            f"the reverse run has {len(reverse.angles)} angles that are not the {len(result.angles)} "
            "of the forward run: measure both directions at the same angles"
        )
    if "ECC" not in reverse.deviations or not np.all(np.isfinite(reverse.deviations["ECC"])):
        raise DataError("the reverse run holds no complete ECC")
    _check_closure(reverse, (merge > 0.0).astype(np.float64))
    deviation, covariance = _merged(reverse, merge)
    origin, origin_covariance = _merged(result, merge)
    variance = np.einsum("ij,jk,ik->i", curve, covariance, curve)
    variance = variance + float((zero @ origin_covariance @ zero.T)[0, 0])
    return curve @ deviation - (zero @ origin)[0], variance


def _own_zero(deviation: Floats, reverse: Result, merge: Floats, zero: Floats) -> list[str]:
    """Warn when both runs are zero at the reference: the reversal there has been lost."""
    forward_zero = abs(float((zero @ deviation)[0]))
    reverse_zero = abs(float((zero @ (merge @ reverse.deviations["ECC"]))[0]))
    if max(forward_zero, reverse_zero) > 1e-15:
        return []
    return [
        "both runs count from their own zero: the reversal at the reference angle is not in the "
        "table, only how it changes around the circle"
    ]


def _arc_warning(nodes: Floats, period: float) -> list[str]:
    if period:
        return []
    return [
        f"the angles cover an arc only ({nodes[0] / DEGREE:.6g} .. {nodes[-1] / DEGREE:.6g} deg): "
        "no closure, no wrap, nothing is known outside"
    ]


def _left_out(residual: Floats, order: int, covariance: Floats) -> str:
    rms = float(np.sqrt(np.mean(residual**2)))
    noise = float(np.sqrt(np.trace(covariance) / len(covariance)))
    return (
        f"harmonics up to order {order} leave out {rms / ARCSEC:.3g} arcsec rms, "
        f"{np.max(np.abs(residual)) / ARCSEC:.3g} arcsec at most, of the measured deviations "
        f"(their standard uncertainty: {noise / ARCSEC:.3g} arcsec)"
    )


def _negative(values: Floats) -> Floats:
    """Return -values without negative zeros, which would only confuse in files."""
    return np.asarray(0.0 - values, dtype=np.float64)


def _check_period(angles: Floats, period: float) -> None:
    if np.any(np.diff(angles) <= 0.0):
        row = int(np.argmax(np.diff(angles) <= 0.0)) + 1
        raise DataError(f"compensation table: row {row} does not ascend from the row before")
    if period != 0.0 and abs(period - tau) > 1e-12:
        raise DataError(f"compensation table: period {period} rad, expected 2 pi or 0 (an arc)")
    if period and angles[-1] - angles[0] > tau - SAME_ANGLE / 2:
        raise DataError(
            "compensation table: the last row repeats the first after a full turn; leave it "
            "out, the period of 2 pi says it"
        )
