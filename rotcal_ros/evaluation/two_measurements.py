"""Before and after a table was loaded, from two measurements that somebody has.

With b measured before, and -b loaded as the table, a = f b + n is measured after: f is 0 for a
table that acts, 1 for one that does not, 2 for one of the other sign, and n holds the errors of
both measurements. An error of calibration that is the same in both is in the table, and cancels
in n: nothing shows it. Since b is measured, its noise biases f by up to its share of b's variance,
which counts as a standard uncertainty.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rotcal_ros.compensation.held_table import (
    CorrectionEffect,
    HeldTable,
    effect_from_result,
    regress_on_correction,
)
from rotcal_ros.compensation.table import DIRECTIONS
from rotcal_ros.evaluation.common_angles import require_one_table, same_angles
from rotcal_ros.evaluation.verification import Positioning, Verification
from rotcal_ros.foundation.arrays import Floats, Ints, std_of
from rotcal_ros.foundation.curves.directional import COMPONENT, directional_curve
from rotcal_ros.foundation.curves.measured import measured_curve
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.in_force import NONE, describe, is_table_hash
from rotcal_ros.foundation.language import Phrase, phrase
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE

LEAST: Final = 3
"""Fewest common angles: with two, a curve less its mean is a single number."""


@dataclass(frozen=True, eq=False)
class _Curve:
    """Deviations (k,) rad at ``angles`` (k,) rad, of one side or up and down again.

    ``side`` (k,): 0 up or the mean, 1 down.
    """

    angles: Floats
    side: Ints
    values: Floats
    covariance: Floats
    period: float

    def at(self, rows: Ints) -> _Curve:
        """Return the curve at some of its rows."""
        chosen = self.angles[rows], self.side[rows], self.values[rows]
        return _Curve(*chosen, self.covariance[np.ix_(rows, rows)], self.period)

    def positioning(self) -> Positioning:
        """Return the measured run."""
        return Positioning(self.angles, self.values, std_of(self.covariance))


def verification_of(
    results: Mapping[str, Result],
    held: HeldTable | None = None,
    *,
    shared: float = 0.0,
) -> Verification:
    """Return what two ``results`` say of the table that was loaded between them.

    The first was measured before, the second after; the keys name them. They are compared at the
    angles that both have. ``held`` is the table, if its files are known. ``shared`` (rad, k = 1)
    is the part of both uncertainties that is one and the same error, as of one instrument's
    calibration. Raises DataError for a verdict that is not
    ok, measurements of two tables or with too few common angles, and where ``shared`` leaves
    nothing of an uncertainty.
    """
    _require_before_and_after(results)
    sides = all(COMPONENT in result.directions for result in results.values())
    whole = [_curve(result, sides=sides) for result in results.values()]
    first, second = _common(whole[0], whole[1], results)
    if shared and min(np.diag(c.covariance).min() for c in (first, second)) <= shared**2:
        raise DataError(
            f"{shared / ARCSEC:g} arcsec that both measurements share (--shared-u) are all that a "
            "U states, so that nothing says how much may be left: state the scatter too, by "
            "repeated runs or a larger uncertainty"
        )
    after = list(results.values())[1]
    acts = _effect(first, second, shared) if held is None else effect_from_result(after, held)
    found = Verification(
        before=first.positioning(),
        after=second.positioning(),
        stated=0.0 if held is None else held.stated,
        verdict_lines=dict(
            zip(("before", "after"), (r.verdict_line for r in results.values()), strict=True)
        ),
        effect=acts,
        simulated=any(result.simulated for result in results.values()),
        shared=shared,
    )
    notes = [*_notes(whole, first, second, found), *_about_table(first, found, after, held)]
    return replace(found, notes=tuple(notes))


def _require_before_and_after(results: Mapping[str, Result]) -> None:
    """Raise DataError unless the first may be without the table, and the second with it."""
    for name, result in results.items():
        if result.verdict != "ok":
            why = "; ".join(result.warnings)
            raise DataError(f"{name} has the verdict {result.verdict}: {why}")
    facts = {name: result.circumstances for name, result in results.items()}
    require_one_table({
        "serial number": {name: known.identity.serial for name, known in facts.items()},
        "axis": {name: known.axis for name, known in facts.items()},
    })  # fmt: skip
    (first, before), (second, after) = results.items()
    if after.measured_on == NONE:
        raise DataError(f"{second}: {describe(NONE)}; give the measurement with the table")
    if is_table_hash(after.measured_on) and after.measured_on == before.measured_on:
        raise DataError(f"{first} and {second}: both {describe(after.measured_on)}")
    begun, later = (result.circumstances.from_ns for result in (before, after))
    if 0 < later < begun:
        raise DataError(f"{second} was measured earlier than {first}: exchange them")


def _curve(result: Result, *, sides: bool) -> _Curve:
    """Return ECC of ``result``: up, then down again, or the mean of the sides."""
    if not sides:
        mean = measured_curve(result, COMPONENT)
        side = np.zeros(len(mean.angles), dtype=np.int64)
        return _Curve(mean.angles, side, mean.deviation, mean.covariance, mean.period)
    both = directional_curve(result)
    n = len(both.angles)
    stacked = _Curve(
        np.tile(both.angles, 2), np.repeat([0, 1], n), both.stacked, both.covariance, both.period
    )
    return stacked.at(np.r_[:n, 2 * n - 1 : n - 1 : -1])


def _common(first: _Curve, second: _Curve, names: Mapping[str, object]) -> tuple[_Curve, _Curve]:
    """Return both at the angles that both have; DataError if these are too few."""
    same = same_angles(first.angles, second.angles, first.period or second.period)
    rows, columns = np.nonzero(same & (first.side[:, None] == second.side))
    count = np.count_nonzero(first.side[rows] == 0)
    if count < LEAST:
        raise DataError(
            f"{' and '.join(names)} have {count} table angles in common, expected at least "
            f"{LEAST}: measure the second time at angles of the first one; nothing is "
            "interpolated, for a table may be wrong between them"
        )
    return first.at(rows), second.at(columns)


def _effect(first: _Curve, second: _Curve, shared: float) -> CorrectionEffect | None:
    """Return the effect of a table that was made of the ``first`` measurement."""
    same = shared**2 * (same_angles(first.angles, first.angles, 0.0) * 1.0)
    apart = first.covariance - same
    found = regress_on_correction(second.values, first.values, apart + second.covariance - same)
    if found is None:
        return None
    n = len(first.values)
    noise = float(np.trace(apart) - apart.sum() / n)
    bias = noise / (n * float(np.var(first.values)))
    return replace(found, std=float(np.hypot(found.std, bias)))


def _notes(
    whole: list[_Curve], first: _Curve, second: _Curve, found: Verification
) -> Iterator[Phrase]:
    """Yield what of both curves is not judged, and what neither can show."""
    left_out = [np.count_nonzero(c.side == 0) - np.count_nonzero(first.side == 0) for c in whole]
    if any(left_out):
        yield phrase(
            "{0} angles of the first and {1} of the second measurement are not compared: the "
            "other has none there", *left_out
        )  # fmt: skip
    offset = float(np.mean(second.values - first.values)) / ARCSEC
    yield phrase("the mean changed by {0:.3g} arcsec: a matter of zero, not judged", offset)
    if np.array_equal(first.values, second.values):
        yield phrase("both hold the same numbers: is it one measurement, given twice?")
    if found.shared:
        yield phrase(
            "{0:.3g} arcsec (k = 1) are the same error in both measurements: it cancels here, "
            "stands in the table, and nothing shows it", found.shared / ARCSEC
        )  # fmt: skip
    else:
        yield phrase(
            "an instrument that measured both times has the same error of calibration in both: "
            "it stands in the table, and nothing shows it; state it, for less may be left then"
        )


def _about_table(
    first: _Curve, found: Verification, after: Result, held: HeldTable | None
) -> Iterator[Phrase]:
    """Yield what is not known of the table that was loaded, or contradicts the first curve."""
    if not is_table_hash(after.measured_on):
        yield phrase("that the table was loaded is shown by its effect alone")
    if held is None:
        yield phrase(
            "the table is taken for that of the first measurement, and exact: what its rows and "
            "digits leave over is stated by its files"
        )
        return
    ways = [held.correction(first.angles, way) for way in DIRECTIONS]
    off = first.values + np.where(first.side == 1, ways[1], ways[0])
    off = off - np.mean(off)
    worst = int(np.argmax(np.abs(off)))
    if abs(off[worst]) > found.expected:
        yield phrase(
            "that table was not made of the first measurement: at {0:g} degrees it is {1:.3g} "
            "arcsec off it", first.angles[worst] / DEGREE, off[worst] / ARCSEC
        )  # fmt: skip
