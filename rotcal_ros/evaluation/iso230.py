"""ISO 230-2 evaluation of a rotary axis: accuracy and repeatability of positioning.

Deviations x_ij = actual - target at target i in run j, approached from below (forward) and
from above (reverse). s is estimated with n - 1, repeatability is 4 s wide, accuracy +- 2 s. E
and R of both directions are taken over both directions, not as the larger of the two
one-directional figures. Repeated runs come from a result, or from a table; our own form is
``angle_deg,run,direction,deviation_arcsec``, :func:`read_any_runs` reads others.

The uncertainty of the figures follows from the law of propagation (JCGM 100). Every figure is
piecewise linear in the means and standard deviations of the targets that decide it. It has two
parts: *sampling*, how far the figures of as many other runs would lie off, from the scatter of the
runs (a mean s / sqrt(n), s itself s / sqrt(2 (n - 1)), JCGM 100, E.4.3); and *measurement*, errors
that all runs share and that no repetition shows. They cancel in the reversal and leave the
repeatability alone. Noise of the measurement is in the scatter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import hypot, inf, sqrt
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np
from scipy.special import stdtrit

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.dataframes import ByAngle
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.language import Phrase, noted, phrase
from rotcal_ros.foundation.results import Result, json_fields
from rotcal_ros.foundation.table_columns import AS_IT_STANDS, SheetSettings
from rotcal_ros.foundation.table_forms import read_any, reads_any_form
from rotcal_ros.foundation.table_questions import asking_at_once
from rotcal_ros.foundation.table_reading import Reading
from rotcal_ros.foundation.tables import Table, require_header
from rotcal_ros.foundation.units import ARCSEC, DEGREE

ONLY_SCATTER: Final = (
    "U covers only the scatter of the runs: nothing is stated about errors that all runs share"
)


FIGURES: Final[Mapping[str, str]] = {
    "reversal": noted("Reversal B"),
    "mean_reversal": noted("Mean reversal"),
    "repeatability": noted("Repeatability R"),
    "systematic": noted("Systematic deviation E"),
    "mean_range": noted("Range of the mean M"),
    "accuracy": noted("Accuracy A"),
}
"""The figures of an axis, and what people call them."""


@dataclass(frozen=True, eq=False)
class BidirectionalRuns:
    """Deviations (m, n) rad of m target angles (m,) rad in n runs for each direction.

    ``common`` (m, m) rad^2 is the covariance of measurement errors that all runs share, such as
    those of the calibration of the device; None: unknown. Raises DataError for shapes that do not
    fit, values that are not finite, or fewer than two runs or targets.

    >>> import rotcal_ros as rc
    >>> up = rc.ARCSEC * np.array([[0.0, 0.2], [1.0, 1.2]])  # two targets, two runs
    >>> runs = rc.BidirectionalRuns(np.array([0.0, np.pi]), up, up + 3 * rc.ARCSEC)
    >>> round(rc.iso230(runs).reversal / rc.ARCSEC, 6)
    3.0
    """

    targets: Floats
    forward: Floats
    reverse: Floats
    common: Floats | None = None

    def __post_init__(self) -> None:
        m = len(self.targets)
        if self.common is not None and np.shape(self.common) != (m, m):
            raise DataError(
                f"the covariance of the shared errors has shape {np.shape(self.common)}, expected "
                f"({m}, {m})"
            )
        shape = np.shape(self.forward)
        if len(shape) != 2 or shape != np.shape(self.reverse) or shape[0] != len(self.targets):
            raise DataError(
                f"runs forward {shape}, reverse {np.shape(self.reverse)}, {len(self.targets)} "
                "targets: expected one row per target and the same runs in both directions"
            )
        if shape[0] < 2 or shape[1] < 2:
            raise DataError(
                f"{shape[0]} targets and {shape[1]} runs: a spread needs at least 2 of both, and "
                "the standard requires 5 runs"
            )
        for name, values in (("forward", self.forward), ("reverse", self.reverse)):
            if not np.all(np.isfinite(values)):
                target, run = np.argwhere(~np.isfinite(values))[0]
                raise DataError(
                    f"{name} run {run + 1} has no deviation at target {target + 1} "
                    f"({self.targets[target] / DEGREE:.6g} deg): measure it again or leave out "
                    "the run"
                )


@dataclass(frozen=True, eq=False)
class Iso230(ByAngle):
    """The figures of ISO 230-2; everything in radians, arrays (m,) per target.

    ``mean_*`` and ``s_*`` per direction, ``reversal_i`` = B_i = mean forward - mean reverse,
    ``repeatability_i`` = R_i. Scalars: reversal B and its mean, repeatability R, systematic
    deviation E, range of the mean bidirectional deviation M, accuracy A. ``uncertainties`` maps
    the names of the scalars to theirs; without ``measurement_stated`` they cover only the scatter
    of the runs.
    """

    targets: Floats
    mean_forward: Floats
    mean_reverse: Floats
    mean: Floats
    s_forward: Floats
    s_reverse: Floats
    reversal_i: Floats
    repeatability_i: Floats
    reversal: float
    mean_reversal: float
    repeatability_forward: float
    repeatability_reverse: float
    repeatability: float
    systematic_forward: float
    systematic_reverse: float
    systematic: float
    mean_range: float
    accuracy_forward: float
    accuracy_reverse: float
    accuracy: float
    warnings: tuple[Phrase, ...]
    uncertainties: Mapping[str, FigureUncertainty] = field(default_factory=dict)
    measurement_stated: bool = False

    def summary(self) -> list[tuple[str, tuple[float | None, ...], float]]:
        """Return each figure (rad) with its name, and the U (95 %, rad) of both directions.

        The figure is for both directions, forward and reverse; None: it has no directions.
        """
        sides = ("", "_forward", "_reverse")
        return [
            (
                phrase(text),
                tuple(getattr(self, name + side, None) for side in sides),
                self.uncertainties[name].expanded,
            )
            for name, text in FIGURES.items()
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON; radians."""
        stated = {name: u.to_dict() for name, u in self.uncertainties.items()}
        return {**json_fields(self), "uncertainties": stated}


def iso230(runs: BidirectionalRuns) -> Iso230:
    """Evaluate ``runs`` after ISO 230-2:2014."""
    both = np.stack([runs.forward, runs.reverse])
    mean, s = both.mean(axis=2), both.std(axis=2, ddof=1)
    m, n = runs.forward.shape
    common = np.zeros((m, m)) if runs.common is None else runs.common
    weights = _weights(mean, s)
    return Iso230(
        targets=runs.targets,
        mean_forward=mean[0],
        mean_reverse=mean[1],
        mean=mean.mean(axis=0),
        s_forward=s[0],
        s_reverse=s[1],
        reversal_i=mean[0] - mean[1],
        repeatability_i=_repeatabilities(mean, s).max(axis=0),
        warnings=tuple(_short_of_the_standard(runs)),
        uncertainties={name: _propagated(s, n, common, *each) for name, each in weights.items()},
        measurement_stated=runs.common is not None,
        **{name: float((a * mean + b * s).sum()) for name, (a, b) in weights.items()},
    )


def _short_of_the_standard(runs: BidirectionalRuns) -> list[Phrase]:
    """Return in words what the runs lack of the standard's demands."""
    travel = float(np.ptp(runs.targets)) / DEGREE
    wanted = 3 if travel <= 90.0 else 5 if travel <= 180.0 else 8
    targets, n = runs.forward.shape
    notes = []
    if n < 5:
        notes.append(phrase("{0} runs in each direction, the standard requires 5", n))
    if targets < wanted:
        notes.append(
            phrase(
                "{0} targets over {1:.4g} deg, the standard requires {2}", targets, travel, wanted
            )
        )
    return notes


PROBABILITY: Final = 0.95
"""Coverage of the expanded uncertainty."""


@dataclass(frozen=True, slots=True)
class FigureUncertainty:
    """Standard uncertainties of one figure in rad; ``dof`` after Welch and Satterthwaite."""

    sampling: float
    measurement: float
    dof: float

    @property
    def std(self) -> float:
        """The combined standard uncertainty, rad."""
        return hypot(self.sampling, self.measurement)

    @property
    def expanded(self) -> float:
        """The expanded uncertainty of 95 % with Student's factor, rad (JCGM 100, G.4)."""
        # stdtrit does not take infinite degrees of freedom: these are close enough to normal.
        factor = float(stdtrit(min(self.dof, 1e9), 0.5 + 0.5 * PROBABILITY))
        return factor * self.std

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON; rad, ``dof`` null when it is unlimited."""
        return {**json_fields(self), "std": self.std, "expanded": self.expanded}


def _propagated(
    s: Floats, n: int, common: Floats, of_mean: Floats, of_s: Floats
) -> FigureUncertainty:
    """Return the uncertainty of sum(of_mean * mean) + sum(of_s * s), of n runs."""
    # Of n normal values: var(mean) = s^2 / n, var(s) = s^2 / (2 (n - 1)), independently.
    terms = s**2 * (of_mean**2 / n + of_s**2 / (2.0 * (n - 1)))
    # An error that all runs share moves the means of both directions alike.
    shared = of_mean.sum(axis=0)
    sampling = float(terms.sum())
    measurement = max(float(shared @ common @ shared), 0.0)
    # Welch and Satterthwaite: n - 1 degrees of freedom per term, no limit for the measurement.
    share = float(np.sum(terms**2)) / (n - 1)
    dof = (sampling + measurement) ** 2 / share if share > 0.0 else inf
    return FigureUncertainty(sqrt(sampling), sqrt(measurement), dof)


def _weights(mean: Floats, s: Floats) -> Mapping[str, tuple[Floats, Floats]]:
    """Return every figure as weights (2, m) of the means and of the s: they are its derivatives.

    Both directions of m targets.
    """
    reversal = np.array([[1.0], [-1.0]])
    gap, none = mean[0] - mean[1], np.zeros_like(mean)
    middle = np.repeat(_ends(mean.mean(axis=0)[None, :]) / 2.0, 2, axis=0)
    way, target = np.unravel_index(
        np.argmax(repeat := _repeatabilities(mean, s)), repeat.shape
    )  # of both directions with B_i, or of one
    of_mean, of_s = none.copy(), none.copy()
    if way == 0:
        of_mean[:, target] = np.sign(gap[target]) * reversal[:, 0]
        of_s[:, target] = 2.0
    else:
        of_s[way - 1, target] = 4.0
    figures = {
        "reversal": (reversal * _at(np.abs(gap)) * np.sign(gap), none),
        "mean_reversal": (reversal * np.full(len(gap), 1.0 / len(gap)), none),
        "mean_range": (middle, none),
        "repeatability": (of_mean, of_s),
    }
    sides = {"": slice(None), "_forward": slice(0, 1), "_reverse": slice(1, 2)}
    for name, side in sides.items():
        width, of_mean, of_s, scatter = np.zeros((4, *mean.shape))
        width[side] = _ends(mean[side])
        high, low = _at(mean[side] + 2.0 * s[side]), _at(2.0 * s[side] - mean[side])
        of_mean[side], of_s[side] = high - low, 2.0 * (high + low)
        figures |= {f"systematic{name}": (width, none), f"accuracy{name}": (of_mean, of_s)}
        if name:
            scatter[side] = 4.0 * _at(s[side])
            figures[f"repeatability{name}"] = none, scatter
    return figures


def _repeatabilities(mean: Floats, s: Floats) -> Floats:
    """Return what R_i (m,) is the largest of, (3, m): of both directions, and of each."""
    return np.array([2.0 * s.sum(axis=0) + np.abs(mean[0] - mean[1]), 4.0 * s[0], 4.0 * s[1]])


def _at(values: Floats) -> Floats:
    """Return an array that is one at the largest value and zero elsewhere."""
    found = np.zeros_like(values)
    found[np.unravel_index(np.argmax(values), values.shape)] = 1.0
    return found


def _ends(values: Floats) -> Floats:
    """Return the derivatives of the range of ``values``."""
    return _at(values) - _at(-values)


HEADER: Final = ("angle_deg", "run", "direction", "deviation_arcsec")
_IN_SI: Final = ("angle_rad", "run", "direction", "deviation_rad")
DIRECTIONS: Final = ("up", "down")
"""up: approached with increasing angle, down: with decreasing angle."""
_Visit: TypeAlias = "tuple[float, str, str]"
"""A target angle in degrees, the run and the direction."""


def read_runs(table: Table) -> BidirectionalRuns:
    """Return the runs in a table of our own form, or in one with the same columns in radians.

    Every target must occur once in every run and direction. Raises BagError for other columns;
    DataError names what is missing, double or not a number.
    """
    require_header(table, (HEADER, _IN_SI))
    degree, arcsec = (1.0, 1.0) if table.header == HEADER else (DEGREE, ARCSEC)
    rows = []
    for row in table.rows():
        angle, run, direction, deviation = table.header
        if row.cells[direction] not in DIRECTIONS:
            raise DataError(
                f"{row.place}: direction {row.cells[direction]!r}, expected up or down"
            )
        visit = row.number(angle) / degree, row.cells[run], row.cells[direction]
        rows.append((row.place, visit, row.number(deviation) / arcsec))
    return _complete(rows, str(table.path))


def read_any_runs(
    path: Path, sheet: SheetSettings = AS_IT_STANDS, announce: Callable[[Reading], object] = str
) -> BidirectionalRuns:
    """Return the runs in a table of another form: deviations at table angles, in any unit.

    Columns state run and direction, or the order of the rows. ``sheet`` says what the table leaves
    open, ``announce`` is given how it was understood. Raises as :func:`read_runs`.
    """
    by_columns = not reads_any_form()
    header = _IN_SI if by_columns else ("position", "deviation_rad")
    reading = asking_at_once(lambda s, _: read_any(path, (header,), s), sheet, announce)
    announce(reading)
    if by_columns:
        return read_runs(reading.table)
    if not reading.both_directions:
        listed = not reading.uses.keys().isdisjoint(("deviation", "actual", "reversed"))
        advice = (
            "a column 'direction' states them, and so does the order of the rows"
            if listed or not reading.form
            else "write up or down behind the number of the run at the head of each column"
        )
        raise DataError(
            f"{path}: all angles were approached in one direction, or once: ISO 230-2 needs runs "
            f"up and down; {advice}"
        )
    rows = []
    for row, (run, down) in zip(reading.table.rows(), reading.passes, strict=True):
        visit = reading.angles_deg[row.index("position")], str(run + 1), DIRECTIONS[down]
        rows.append((row.place, visit, row.number("deviation_rad") / ARCSEC))
    return _complete(rows, str(path))


def _complete(rows: Iterable[tuple[str, _Visit, float]], name: str) -> BidirectionalRuns:
    """Return the runs of all rows, each with its place, what it visits and arcseconds."""
    found: dict[_Visit, float] = {}
    for place, key, deviation in rows:
        if key in found:
            raise DataError(f"{place}: {key[0]:g} deg, run {key[1]} {key[2]} occurs twice")
        found[key] = deviation
    targets = sorted({key[0] for key in found})
    runs = sorted({key[1] for key in found})
    missing = [
        f"{target:g} deg in run {run} {direction}"
        for target in targets
        for run in runs
        for direction in DIRECTIONS
        if (target, run, direction) not in found
    ]
    if missing:
        more = f" and {len(missing) - 3} more" if len(missing) > 3 else ""
        raise DataError(
            f"{name}: missing {', '.join(missing[:3])}{more}: measure them, or leave out the run"
        )
    up, down = (
        np.array([[found[target, run, d] for run in runs] for target in targets]) * ARCSEC
        for d in DIRECTIONS
    )
    return BidirectionalRuns(np.array(targets) * DEGREE, up, down)


def runs_of(result: Result) -> BidirectionalRuns | None:
    """Return the repeated runs of a result where both directions have two or more, else None.

    The covariance of the result beyond the scatter of the runs is common to them all.
    DataError names an arrival that is missing, or offsets between targets that are open.
    """
    runs = result.runs
    if runs is not None and (words := result.zeros.describe(["ECC"])):
        raise DataError(
            f"{words}: figures of ISO 230-2 are ranges over all targets, and nothing would bound "
            "them; join it with a result that links them (rotcal combine)"
        )
    if runs is None or runs.forward is None or runs.reverse is None or runs.forward.shape[1] < 2:
        return None
    measured = BidirectionalRuns(runs.targets, runs.forward, runs.reverse)
    covariance = result.covariance.get("ECC")
    if covariance is None or np.shape(covariance) != (len(runs.targets),) * 2:
        return measured
    return replace(measured, common=_common_to_all_runs(measured, covariance))


def add_device_uncertainty(runs: BidirectionalRuns, std: float) -> BidirectionalRuns:
    """Return ``runs`` with a standard uncertainty (rad) of the device at every target.

    It is the same in all runs, independent from target to target, and adds to what is known.
    """
    known = np.zeros((len(runs.targets),) * 2) if runs.common is None else runs.common
    return replace(runs, common=known + std**2 * np.eye(len(runs.targets)))


def _common_to_all_runs(runs: BidirectionalRuns, covariance: Floats) -> Floats:
    """Return the part of the covariance of the mean curve that no repetition shows.

    Noise and repeatability differ from run to run: they are in the scatter, and their share in the
    mean of all runs is subtracted. The mean counts from its first target.
    """
    n = runs.forward.shape[1]
    scatter = (runs.forward.var(axis=1, ddof=1) + runs.reverse.var(axis=1, ddof=1)) / 2.0
    tied = np.eye(len(scatter))
    tied[:, 0] -= 1.0
    counted = tied @ covariance @ tied.T  # whatever the zero of the result is
    rest = counted - float(scatter.mean()) / (2 * n) * tied @ tied.T
    values, vectors = np.linalg.eigh((rest + rest.T) / 2.0)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T, dtype=np.float64)


def require_runs(result: Result, source: str) -> BidirectionalRuns:
    """Return the runs of a result; DataError, naming ``source``, when it holds none."""
    runs = runs_of(result)
    if runs is None:
        raise DataError(
            f"{source}: the result holds no repeated runs in both directions; measure with the "
            "plan settings 'runs' (2 or more, the standard asks for 5) and 'bidirectional', by a "
            "method that has both: tracer_multistation has"
        )
    return runs
