"""The correction of a rotary axis: one model for all methods and all controllers.

Correction = -deviation = commanded - actual, radians: what must be *added* to the command. The
same correction comes in other forms: on other rows, without direction, or as a function.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike

from rotcal_ros.compensation.interpolation_uncertainty import (
    Weights,
    cut_at_wide_gaps,
    propagated_variances,
)
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.components import COVERAGE_FACTOR, check_axis
from rotcal_ros.foundation.curves.directional import DirectionalCurve, directional_curve
from rotcal_ros.foundation.curves.interpolation import (
    SAME_ANGLE,
    curve_through,
    harmonic_basis,
    harmonic_estimator,
    interpolation_matrix,
    row_angles,
    wrap_to_period,
    wrap_to_turn,
)
from rotcal_ros.foundation.curves.measured import gaps_of
from rotcal_ros.foundation.errors import ConfigurationError, DataError
from rotcal_ros.foundation.gum_numbers import value_with_uncertainty
from rotcal_ros.foundation.in_force import (
    UNKNOWN,
    agreed_state,
    check_in_force,
    describe_contradiction,
)
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.results import Result, Verdict
from rotcal_ros.foundation.units import ARCSEC, DEGREE, TURN

COLUMNS: Final = ("angles", "correction_forward", "correction_reverse", "std", "std_reverse")
DIRECTIONS: Final = (Approach.POSITIVE, Approach.NEGATIVE)
LINK: Final = (
    "What links them: a second result of the same table that sees both from one zero (mirror, "
    "tracer, autocollimator with polygon, a plate whose ball steps share no factor with the grid, "
    "such as 12 balls), joined by 'rotcal combine'; or solver.group_allowance_m, if a bound on "
    "their distance is known"
)
OTHER: Final = "; other direction: "
SIGN_CONVENTION: Final = "correction = -(actual - commanded); add it to the commanded angle"


@dataclass(frozen=True, eq=False)
class CompensationTable:
    """Correction of the angular positioning over one turn, or over an arc.

    Arrays have shape (n,) and are radians. ``angles`` ascend; with ``period`` 2 pi they lie within
    one turn, and the row at angles[0] + 2 pi is the first row again. ``period`` 0 means an arc: it
    neither closes nor wraps. ``correction_forward`` is for approaches with increasing angle and
    zero at ``reference_angle``, ``correction_reverse`` for decreasing angle. ``std`` and
    ``std_reverse`` are their standard uncertainties (k = 1); the latter is None if it is the
    same. ``between_std`` (rad) comes on top of them between the measured angles, which are up to
    ``widest_gap`` (rad) apart; zero if that is not known, as for a table made by hand.
    ``warnings`` say in words what to know before use. ``verdict_line`` is the verdict with what it
    does not cover; empty if that is not known, as in a message. ``measured_on`` is the table in
    force during the measurement (hash of the controller's files, "none" or "unknown"), ``adds_to``
    the one that the corrections contain. ``item`` says what was measured and ``serial`` is its
    number, empty if that is not known; ``simulated``: no instrument measured it.
    ``measured_from_ns`` and ``measured_until_ns`` are when (ns since 1970) the first and the last
    measurement that counts was made; 0: not known. ``open_zeros`` names the offsets within the
    table that were not measured, so that no uncertainty holds between its parts; empty: none. Such
    a table is fed to no controller, see :func:`check_verdict`. ``zero`` (rad) is the forward
    correction at the reference angle: what the control did there without a table, else 0. Raises
    DataError when the arrays do not fit together.

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
    std_reverse: Floats | None = None
    between_std: float = 0.0
    widest_gap: float = 0.0
    measured_on: str = UNKNOWN
    adds_to: str = ""
    item: str = ""
    simulated: bool = False
    serial: str = ""
    measured_from_ns: int = 0
    measured_until_ns: int = 0
    open_zeros: str = ""
    zero: float = 0.0

    def __post_init__(self) -> None:
        check_axis(self.axis)
        if self.std_reverse is not None and np.array_equal(self.std_reverse, self.std):
            object.__setattr__(self, "std_reverse", None)
        for name in COLUMNS if self.std_reverse is not None else COLUMNS[:-1]:
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
            if name.startswith("std") and np.min(column) < 0.0:
                row = int(np.argmin(column))
                raise DataError(
                    f"compensation table: {name} in row {row} is {column[row]}, expected 0 or more"
                )
        if not np.isfinite(self.reference_angle):
            raise DataError(
                f"compensation table: reference angle {self.reference_angle}, expected a number"
            )
        _check_angles(self.angles, self.period)
        object.__setattr__(self, "measured_on", check_in_force(self.measured_on or UNKNOWN))
        for name in ("between_std", "widest_gap"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0.0):
                raise DataError(f"compensation table: {name} is {value} rad, expected 0 or more")

    def __repr__(self) -> str:
        """Return in one line what it corrects, and by how much."""
        of = f"{self.axis} by {self.method}, {self.verdict_line or self.verdict}"
        kind = "full circle" if self.closed else "arc"
        ways = "both directions" if self.directional else "one curve for both directions"
        sizes = np.abs([self.correction_forward, self.correction_reverse])
        largest, u = float(np.max(sizes)) / ARCSEC, COVERAGE_FACTOR * self.largest_std / ARCSEC
        size = value_with_uncertainty(largest, u).lstrip("+")
        return (
            f"<CompensationTable: {of}: {len(self.angles)} angles, {kind}, {ways}, up to {size} "
            f"arcsec (k = {COVERAGE_FACTOR:g})>"
        )

    def std_of(self, approach: Approach) -> Floats:
        """Return the standard uncertainty (n,) of the correction for one side of the approach."""
        if self.std_reverse is None or approach is Approach.POSITIVE:
            return self.std
        return self.std_reverse

    @property
    def largest_std(self) -> float:
        """The largest standard uncertainty (rad) of any row in any direction."""
        return float(max(np.max(self.std_of(approach)) for approach in DIRECTIONS))

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
        """SHA-256 over everything in the table: names, verdict and every bit of the numbers."""
        digest = hashlib.sha256()
        for text in (self.axis, self.method, self.verdict):
            digest.update(text.encode() + b"\0")
        scalars = np.array([self.period, self.reference_angle, len(self.angles)])
        columns = [self.angles, self.correction_forward, self.correction_reverse, self.std]
        if self.std_reverse is not None:
            digest.update(b"std_reverse\0")  # which numbers follow, so that none stand for others
            columns.append(self.std_reverse)
        if self.between_std or self.widest_gap:
            digest.update(b"between\0")
            scalars = np.append(scalars, [self.between_std, self.widest_gap])
        for name in ("measured_on", "adds_to", "serial", "measured_from_ns", "measured_until_ns"):
            if (known := getattr(self, name)) not in ("", 0, UNKNOWN):
                digest.update(f"{name} {known}\0".encode())
        if self.simulated or self.item:
            digest.update(f"simulated {self.simulated} {self.item}\0".encode())
        if self.open_zeros:
            digest.update(f"open {self.open_zeros}\0".encode())
        for block in (scalars, *columns):
            digest.update(np.asarray(block, dtype="<f8").tobytes())
        return digest.hexdigest()


def check_verdict(origin: Result | CompensationTable) -> None:
    """Raise DataError unless the verdict is "ok" and all values count from one zero.

    Nothing else may move an axis. Export and bridge both call this.
    """
    open_zeros = origin.zeros.describe() if isinstance(origin, Result) else origin.open_zeros
    if open_zeros:
        raise DataError(f"{open_zeros}, so nothing bounds its error. {LINK}; nothing was written")
    if origin.verdict != "ok":
        why = f" ({'; '.join(origin.warnings)})" if origin.warnings else ""
        raise DataError(
            f"the verdict of the {origin.method} result is '{origin.verdict}'{why}: only 'ok' may "
            "be fed to a controller; look at the report for the cause, and measure again. Nothing "
            "was written"
        )


def measured_axis(
    result: Result, reverse: Result | None = None, axis: str = "", default: str = "C"
) -> str:
    """Return the axis that was measured: from the results, else ``axis``, else ``default``.

    Raises ConfigurationError if they contradict each other or a stated ``axis``.
    """
    forward = result.circumstances.axis
    backward = "" if reverse is None else reverse.circumstances.axis
    require_one_axis(forward, backward)
    known = forward or backward
    if known and axis and check_axis(axis) != known:
        raise ConfigurationError(
            f"axis {known} was measured, and the table would be named for axis {axis}: leave the "
            "axis out; a table for another axis is accepted when files are made"
        )
    return known or axis or default


def require_one_axis(forward: str, backward: str) -> None:
    """Raise ConfigurationError if both runs state their axis, and not the same."""
    if forward and backward and forward != backward:
        raise ConfigurationError(
            f"the forward run is of axis {forward}, the reverse run of axis {backward}: give two "
            "runs of one axis"
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

    A result that was measured from both sides gives each column its own curve; otherwise
    ``reverse`` may hold the approach with decreasing angle, at the same angles and counted from
    the same zero, and without it both directions are equal. The full circle is recognised by its
    angles; positions that coincide after a turn must agree within their uncertainties (else
    DataError: they do not close) and are averaged. An arc becomes a table of ``period`` 0 and says
    so; DataError for a gap between the angles that is wider than the curve allows. The zero is
    moved to ``reference_angle`` (default: the first angle of the result).

    Without ``spacing`` the table has one row per measured angle, else rows every ``spacing``
    radians from zero, on a curve through the measured points. ``harmonics`` = order replaces that
    curve by the weighted least-squares fit of so many harmonics; the warnings state what it leaves
    out. The uncertainty is propagated with the full covariance. Raises DataError when ECC is
    absent, not finite, or does not close.
    """
    weights = _weights_of(harmonics)
    reference = float(result.angles[0] if reference_angle is None else reference_angle)
    curve, between = cut_at_wide_gaps(directional_curve(result, reverse), weights, reference)
    reference = wrap_to_turn(reference) if curve.period else reference
    rows = curve.angles if spacing is None else row_angles(curve.angles, curve.period, spacing)
    at = weights(curve, np.append(rows, reference))
    columns = _columns(curve, at)
    left_out = () if harmonics is None else (_left_out(curve, harmonics),)
    every = [result] if reverse is None else [result, reverse]
    circumstances = [r.circumstances for r in every]
    begun, ended = zip(*((c.begun_ns or 0, c.ended_ns or 0) for c in circumstances), strict=True)
    open_zeros = (r.zeros.describe(["ECC"]) for r in every)
    return CompensationTable(
        axis=axis,
        method=result.method,
        angles=rows,
        correction_forward=columns.forward,
        correction_reverse=columns.reverse,
        std=columns.std,
        std_reverse=columns.std_reverse,
        period=curve.period,
        reference_angle=reference,
        verdict=max((r.verdict for r in every), key=get_args(Verdict).index),
        warnings=(*result.warnings, *left_out, *_notes(curve, at[-1])),
        verdict_line=OTHER.join(dict.fromkeys(r.verdict_line for r in every)),
        between_std=between,
        widest_gap=float(np.max(gaps_of(curve.angles, curve.period))),
        measured_on=_measured_on(result, reverse),
        item=_item(result, reverse),
        simulated=any(c.simulated for c in circumstances),
        serial=next((c.identity.serial for c in circumstances if c.identity.serial), ""),
        measured_from_ns=min(begun) if all(begun) else 0,
        measured_until_ns=max(ended) if all(ended) else 0,
        open_zeros="; ".join(dict.fromkeys(filter(None, open_zeros))),
    )


class _Columns(NamedTuple):
    """Corrections and standard uncertainties (n,), rad; ``std_reverse`` as in the table."""

    forward: Floats
    reverse: Floats
    std: Floats
    std_reverse: Floats | None


def _columns(curve: DirectionalCurve, weights: Floats) -> _Columns:
    """Return the columns of a table: ``weights`` (n + 1, values) times the ``curve``.

    The last row of ``weights`` is the zero of the forward curve, for both columns.
    """
    up, down = weights @ curve.forward, weights @ curve.reverse
    std, std_reverse = _standard_uncertainties(weights, curve)
    return _Columns(up[-1] - up[:-1], up[-1] - down[:-1], std, std_reverse)


def _weights_of(harmonics: int | None) -> Weights:
    """Return the weights of the rows: for a curve through the points, or so many harmonics."""

    def weights(curve: DirectionalCurve, at: Floats) -> Floats:
        if harmonics is None:
            return interpolation_matrix(curve.angles, at, curve.period)
        return _harmonic_weights(curve, at, harmonics)

    return weights


def _harmonic_weights(curve: DirectionalCurve, at: Floats, order: int) -> Floats:
    if curve.period == 0.0:
        raise ConfigurationError(
            "harmonics need the full circle, and the result covers only an arc: leave out "
            "--harmonics"
        )
    estimator = harmonic_estimator(curve.angles, order, curve.forward_covariance)
    return harmonic_basis(at, order) @ estimator


def _standard_uncertainties(
    weights: Floats, curve: DirectionalCurve
) -> tuple[Floats, Floats | None]:
    """Return those of both columns; the last row of weights is the zero of the forward one."""
    rows, zero = weights[:-1], weights[-1]
    up = np.maximum(propagated_variances(rows - zero, curve.forward_covariance), 0.0)
    if not curve.both:
        return np.sqrt(up), None
    from_zero = np.hstack([np.tile(-zero, (len(rows), 1)), rows])
    return np.sqrt(up), np.sqrt(np.maximum(propagated_variances(from_zero, curve.covariance), 0.0))


def _item(result: Result, reverse: Result | None) -> str:
    """Return the item that both directions were measured on; DataError for two serial numbers."""
    ours = result.circumstances.identity
    theirs = ours if reverse is None else reverse.circumstances.identity
    if ours.serial and theirs.serial and ours.serial != theirs.serial:
        raise DataError(
            f"the two directions were measured on different items, no. {ours.serial} and no. "
            f"{theirs.serial}: measure both on one table"
        )
    titles = dict.fromkeys(title for title in (ours.title, theirs.title) if title)
    return OTHER.join(titles)


def _measured_on(result: Result, reverse: Result | None) -> str:
    """Return the table in force in both measurements; DataError when it was not the same one."""
    states = [r.measured_on for r in (result, reverse) if r is not None]
    if UNKNOWN in states:
        return UNKNOWN
    if clash := describe_contradiction(states):
        raise DataError(f"{clash}: measure both directions with the same table in force")
    return agreed_state(states)


def _left_out(curve: DirectionalCurve, order: int) -> str:
    fit = _harmonic_weights(curve, curve.angles, order)
    left = np.stack([side - fit @ side for side in (curve.forward, curve.reverse)])
    left -= np.mean(left)  # the constant does not count: the table is zero at its reference
    noise = float(np.sqrt(np.trace(curve.forward_covariance) / len(curve.angles)))
    return (
        f"harmonics up to order {order} leave out {np.sqrt(np.mean(left**2)) / ARCSEC:.3g} arcsec "
        f"rms, {np.max(np.abs(left)) / ARCSEC:.3g} arcsec at most, of the measured deviations "
        f"(their standard uncertainty: {noise / ARCSEC:.3g} arcsec)"
    )


def _notes(curve: DirectionalCurve, zero: Floats) -> list[str]:
    notes = list(curve.notes)
    if curve.period == 0.0:
        first, last = curve.angles[[0, -1]] / DEGREE
        notes.append(
            f"the angles cover only an arc ({first:.6g} .. {last:.6g} deg): no closure, no wrap, "
            "nothing is known outside"
        )
    own_zero = max(abs(zero @ curve.forward), abs(zero @ curve.reverse)) < 1e-15
    if curve.both and own_zero:
        notes.append(
            "both runs count from their own zero: the reversal at the reference angle is not in "
            "the table, only how it changes around the circle"
        )
    return notes


def _check_angles(angles: Floats, period: float) -> None:
    if np.any(np.diff(angles) <= 0.0):
        row = int(np.argmax(np.diff(angles) <= 0.0)) + 1
        raise DataError(f"compensation table: row {row} does not ascend from the row before")
    if period != 0.0 and not abs(period - TURN) <= 1e-12:
        raise DataError(f"compensation table: period {period} rad, expected 2 pi or 0 (an arc)")
    if period and angles[-1] - angles[0] > TURN - SAME_ANGLE / 2:
        raise DataError(
            "compensation table: the last row repeats the first after a full turn; leave it out: "
            "the period of 2 pi implies it"
        )


def resample(
    table: CompensationTable, spacing: float | None = None, *, reference_angle: float | None = None
) -> CompensationTable:
    """Return ``table`` with rows every ``spacing`` rad, its zero at ``reference_angle`` (rad).

    A full circle gets rows from 0; without ``spacing`` the rows stay. The new values lie on
    a curve through all old rows. A table carries no correlations, so the uncertainty returned is
    the bound that holds for any: sum of |weight| * std. To keep it sharp, give the spacing to
    ``table_from_result`` instead, which knows the covariance.
    """
    if spacing is None and reference_angle is None:
        return table
    rows = table.angles if spacing is None else row_angles(table.angles, table.period, spacing)
    reference = table.reference_angle if reference_angle is None else float(reference_angle)
    at = np.append(rows, wrap_to_turn(reference) if table.closed else reference)
    weights = interpolation_matrix(table.angles, at, table.period)
    up, down = weights @ table.correction_forward, weights @ table.correction_reverse
    zero = 0.0 if reference_angle is None else up[-1] - table.zero
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


def average_directions(table: CompensationTable) -> CompensationTable:
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
        at = wrap_to_period(self.table.angles, angle, self.table.period)
        return np.asarray(self._curves[approach](at), dtype=np.float64)

    def std(self, angle: ArrayLike, approach: Approach = Approach.POSITIVE) -> Floats:
        """Return the standard uncertainty (rad, k = 1), linear between the rows."""
        angles, period = self.table.angles, self.table.period
        at, std = wrap_to_period(angles, angle, period), self.table.std_of(approach)
        return np.asarray(np.interp(at, angles, std, period=period or None))
