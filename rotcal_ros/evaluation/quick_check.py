"""The quick check: a new measurement shows whether an earlier curve still describes the table.

The rule with its risks and sources is in :mod:`rotcal_ros.planning.check_rule`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from rotcal_ros.adjust.distributions import normal_isf
from rotcal_ros.evaluation.common_angles import PairedCurves, pair_curves
from rotcal_ros.foundation.arrays import Bools, Floats, std_of
from rotcal_ros.foundation.components import COVERAGE_FACTOR
from rotcal_ros.foundation.curves.interpolation import without_harmonics
from rotcal_ros.foundation.curves.measured import MeasuredCurve
from rotcal_ros.foundation.dataframes import ByAngle
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.results import json_fields
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.planning.check_rule import CheckRule

CheckVerdict = Literal["still valid", "changed", "undecided"]


@dataclass(frozen=True, eq=False)
class QuickCheck(ByAngle):
    """New minus earlier at the n ``angles`` (rad) of the new measurement, in rad or m.

    ``difference`` is aligned: the offset that no method knows is removed. ``std`` is its
    standard uncertainty from the new measurement alone, ``expected_std`` the standard deviation of
    the earlier curve's error with the stated ageing. Up to a |difference| of ``acceptance`` an
    angle is still valid, beyond ``alarm`` it has changed; if nothing can pass, ``acceptance`` is
    negative. ``interpolated`` marks angles at which the earlier curve was not measured.
    ``assurance`` is the probability that this measurement finds a table still valid that has only
    aged as stated.
    """

    rule: CheckRule
    verdict: CheckVerdict
    why: str
    angles: Floats
    difference: Floats
    std: Floats
    expected_std: Floats
    acceptance: Floats
    alarm: Floats
    interpolated: Bools
    assurance: float
    notes: tuple[str, ...]

    @property
    def largest(self) -> float:
        """The largest |difference|."""
        return float(np.max(np.abs(self.difference)))

    def describe(self, unit: float = ARCSEC, unit_name: str = "arcsec") -> str:
        """Return the verdict in one line."""
        rule = self.rule
        return (
            f"{self.verdict}: {self.why} (within {rule.limit / unit:.4g} {unit_name}, risk of a "
            f"miss {100 * rule.miss:.3g} %, of a false alarm {100 * rule.false_alarm:.3g} %)"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain types for JSON, SI."""
        return {**json_fields(self), "rule": json_fields(self.rule), "largest": self.largest}


def quick_check(
    earlier: MeasuredCurve,
    new: MeasuredCurve,
    rule: CheckRule,
    align_order: int = 0,
    unit: float = ARCSEC,
    unit_name: str = "arcsec",
) -> QuickCheck:
    """Judge whether ``earlier`` is within ``rule.limit`` of the table that ``new`` has measured.

    It is judged at the angles of ``new``, whose errors are independent of the earlier ones;
    between its own angles the earlier curve is the spline that a controller's table follows.
    ``align_order`` also removes so many harmonics that both define differently. A new measurement
    that is not ok itself decides nothing. ``unit`` and its name are for the texts. Raises
    DataError without an uncertainty, without common angles, and for a result that failed.
    """
    for name, curve in (("earlier", earlier), ("new", new)):
        if curve.verdict_line.startswith("failed"):
            raise DataError(f"the {name} result: the verdict is failed: measure again")
    both = pair_curves(new, earlier, ("the new measurement", "the earlier result"))
    if both.shared is not None:
        raise DataError(
            "the new measurement rests on observations of the earlier result: nothing new was "
            "measured; give another measurement"
        )
    keep = without_harmonics(both.angles, align_order, both.free)
    difference = keep @ (both.first - both.second)
    std = std_of(keep @ both.first_covariance @ keep)
    if not np.all(std > 0.0):
        raise DataError(
            "the new measurement states no uncertainty, so no risk can be stated; give "
            "--reference-u for a table, or solve again"
        )
    expected = std_of(rule.expected(both.second_covariance, keep))
    verdict, why = _judge(rule, both.angles, difference, std, expected, (unit, unit_name))
    if new.verdict_line.startswith("suspect"):
        verdict, why = "undecided", "the new measurement itself is suspect: measure again"
    unseen = earlier.open_zeros or new.open_zeros
    if unseen and verdict == "still valid":
        verdict, why = "undecided", f"{unseen}: a change of it would not be seen"
    return QuickCheck(
        rule=rule,
        verdict=verdict,
        why=why,
        angles=both.angles,
        difference=difference,
        std=std,
        expected_std=expected,
        acceptance=rule.acceptance(std),
        alarm=rule.alarm(std, expected),
        interpolated=both.interpolated,
        assurance=rule.assurance(std, expected),
        notes=_notes(both, earlier, new),
    )


def _judge(
    rule: CheckRule,
    angles: Floats,
    difference: Floats,
    std: Floats,
    expected: Floats,
    shown: tuple[float, str],
) -> tuple[CheckVerdict, str]:
    """Return the verdict, and the angle that decides or what would decide."""
    unit, name = shown
    size, acceptance, alarm = (np.abs(difference), rule.acceptance(std), rule.alarm(std, expected))
    worst = int(np.argmax(size - acceptance))
    at = f"{angles[worst] / DEGREE:.6g} deg"
    found = f"{size[worst] / unit:.3g} {name} at {at}"
    if size[worst] <= acceptance[worst]:
        unusual = int(np.sum(size > alarm))
        beside = f", though {unusual} angles moved more than stated" if unusual else ""
        return "still valid", f"{found} is the closest to the limit{beside}"
    if np.any(size > alarm):
        most = int(np.argmax(size - alarm))
        at = f"{angles[most] / DEGREE:.6g} deg"
        return "changed", (
            f"{size[most] / unit:.3g} {name} at {at} is more than the {alarm[most] / unit:.3g} "
            f"{name} that is explained"
        )
    if size[worst] >= rule.limit:
        return ("undecided", f"{found} is beyond the limit, perhaps by chance: measure all again")
    enough = COVERAGE_FACTOR * (rule.limit - size[worst]) / normal_isf(rule.miss)
    return "undecided", (
        f"{found} needs U <= {enough / unit:.3g} {name} (k = 2) to be within for sure, it has "
        f"{COVERAGE_FACTOR * std[worst] / unit:.3g}: measure more"
    )


def _notes(both: PairedCurves, earlier: MeasuredCurve, new: MeasuredCurve) -> tuple[str, ...]:
    """Return what the verdict does not cover."""
    notes = [
        f"{name}: {curve.verdict_line}"
        for name, curve in (("earlier", earlier), ("new", new))
        if curve.verdict_line not in ("", "ok")
    ]
    if np.any(both.interpolated):
        notes.append(
            f"{int(np.sum(both.interpolated))} of {len(both.angles)} angles lie between those of "
            "the earlier curve: what the spline misses there counts as a change"
        )
    if both.outside:
        notes.append(f"{both.outside} angles lie outside the earlier arc: left out")
    unseen = len(earlier.angles) - int(np.sum(~both.interpolated))
    if unseen:
        notes.append(
            f"{unseen} of {len(earlier.angles)} angles of the earlier curve were not measured "
            "again: nothing is known there"
        )
    return tuple(notes)
