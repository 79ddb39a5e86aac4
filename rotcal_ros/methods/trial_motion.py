"""What a small trial motion of the table proves: sign, unit, handedness, lag and rest.

The table is ordered by a few degrees, and back. Its feedback says what it believes; a tracer that
rides on it sees what it does.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from math import dist, isfinite
from typing import Final

import numpy as np

from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.units import DEGREE, MILLIMETRE
from rotcal_ros.geometry.rotations import rotate_about_table_axis
from rotcal_ros.methods.calibration import Calibration
from rotcal_ros.methods.check_lines import CellReport, CheckLine
from rotcal_ros.planning.plan import Point
from rotcal_ros.planning.table_feedback import is_near, looks_like_degrees

PART: Final = "motion"
TRIAL_DEG: Final = 5.0
_REVERSE: Final = "reverse the joint in its driver: counter-clockwise from above is positive"
_NEARLY: Final = 0.05
"""Part of the ordered way by which the table may miss it, and from which on it has moved."""
_LATE_S: Final = 0.2
_SETTLED: Final = 0.02
"""Part of the change of the lengths that may be left when the table says to be at rest."""


@dataclass(frozen=True)
class TrialMotion:
    """A trial of ``way`` (rad) from ``start``, ordered at ``ordered_s``.

    ``table`` (n, 3) has time of arrival, angle and velocity of the feedback, ``lengths`` (m, 2)
    time and length; s since the same instant, rad and m. ``fault``: what ended it early.
    """

    start: float
    way: float
    ordered_s: float
    table: Floats
    lengths: Floats
    probe: Point | None = None
    fault: str = ""

    def lines(
        self, settings: CaptureSettings, beams: tuple[float, float] | None
    ) -> Iterator[CheckLine]:
        """Yield what it proves; ``beams``: how the length should change, and if clockwise (m)."""
        if self.fault:
            yield CheckLine(
                PART, "trial", "missing", self.fault, "see the log of the table's node"
            )
            return
        yield self._sign()
        if self._began_s is not None:
            yield self._lag(settings)
            yield self._rest(settings)
            yield self._handedness(beams)

    @cached_property
    def _angles(self) -> Floats:
        """The feedback, rad; a table that came to its angle by another turn did not jump."""
        angles: Floats = self.table[:, 1]
        return np.unwrap(angles) if self._near(angles[-1], self._goal) else angles

    @property
    def _goal(self) -> float:
        return self.start + self.way

    @property
    def _turned(self) -> float:
        return float(self._angles[-1] - self.start)

    @cached_property
    def _began_s(self) -> float | None:
        return _first(self.table[:, 0], np.abs(self._angles - self.start), self.way)

    @cached_property
    def _rest_s(self) -> float:
        off = np.abs(self._angles - self._angles[-1]) > 0.1 * _NEARLY * abs(self._turned)
        last = np.flatnonzero(off)
        return float(self.table[last[-1] + 1, 0]) if len(last) else self.ordered_s

    def _near(self, angle: float, other: float) -> bool:
        return is_near(angle, other, _NEARLY * abs(self.way))

    def _sign(self) -> CheckLine:
        """Say whether the table went where it was ordered: sign and unit.

        Orders are absolute: feedback in another unit, or with another sign, makes a long way.
        """
        end, goal = float(self._angles[-1]), self._goal
        found = (
            f"{self.way / DEGREE:+.4g}° ordered, the feedback turned by "
            f"{self._turned / DEGREE:+.4g}°"
        )
        if self._near(end, goal):
            return CheckLine(PART, "sign", "good", found)
        if self._began_s is None:
            todo = "see whether the table is free to move, and whether its driver obeys"
            return CheckLine(PART, "sign", "missing", f"{found}: the table has not moved", todo)
        if looks_like_degrees(end, goal):
            found += ": the feedback is in degrees"
            return CheckLine(PART, "sign", "missing", found, "publish the feedback in rad")
        if self._near(end, goal * DEGREE):
            found += ": the order was taken for degrees"
            return CheckLine(PART, "sign", "missing", found, "let the table obey rad")
        if self._near(end, -goal) or self._near(end, self.start - self.way):
            found += ": the other way, a sign is wrong"
            return CheckLine(PART, "sign", "missing", found, f"{_REVERSE}, in orders and feedback")
        todo = "see whether it was free to move, and whether orders and feedback share their zero"
        return CheckLine(PART, "sign", "missing", found, todo)

    def _lag(self, settings: CaptureSettings) -> CheckLine:
        assert self._began_s is not None
        found = f"moved {self._began_s - self.ordered_s:.2f} s after the order"
        seen_s = self._seen_s()
        if seen_s is None:
            return CheckLine(PART, "lag", "note", found)
        late_s = self._began_s - seen_s
        found = f"{found}; its feedback reported it {late_s:+.2f} s after the lengths"
        if abs(late_s) <= max(_LATE_S, 0.5 * settings.settle_time_s):
            return CheckLine(PART, "lag", "good", found)
        todo = "let the feedback come without delay, or make capture.settle_time_s longer than it"
        return CheckLine(PART, "lag", "doubt", found, todo)

    @cached_property
    def _before(self) -> Floats:
        return np.asarray(self.lengths[self.lengths[:, 0] < self.ordered_s, 1])

    def _seen_s(self) -> float | None:
        """Return when the lengths began to change; None where they do not, or there are none."""
        seen = self._seen_m()
        if seen is None or abs(seen) < 10.0 * max(np.ptp(self._before), 1e-6):
            return None
        change = np.abs(self.lengths[:, 1] - np.median(self._before))
        return _first(self.lengths[:, 0], change, seen)

    def _seen_m(self) -> float | None:
        """Return by how much the lengths have changed in the end, m.

        None where they were not heard before the order and when the table was at rest again.
        """
        after = self.lengths[self.lengths[:, 0] > self._rest_s, 1]
        if len(self._before) < 2 or not len(after):
            return None
        return float(np.median(after[-5:]) - np.median(self._before))

    def _rest(self, settings: CaptureSettings) -> CheckLine:
        under_way = (self.table[:, 0] > self.ordered_s) & (self.table[:, 0] < self._rest_s)
        part = (self._angles - self.start) / (self._turned or 1.0)
        moving = self.table[under_way & (part > 0.2) & (part < 0.8), 2]
        slow = settings.velocity_tolerance_deg_s * DEGREE
        if len(moving) > 2 and np.all(np.abs(moving) <= slow):
            found = (
                "the feedback reported velocity 0 while the table moved: when it rests is not "
                "known"
            )
            todo = (
                "publish the true velocity beside the position, or none where an adapter is used"
            )
            return CheckLine(PART, "rest", "missing", found, todo)
        if len(moving) > 2 and np.median(moving) * self._turned < 0.0:
            found = "velocity and angle have opposite signs"
            return CheckLine(PART, "rest", "doubt", found, "publish both with the same sign")
        if (late_s := self._unrest_s()) > settings.settle_time_s:
            found = (
                f"the lengths changed for {late_s:.2f} s after the feedback had reported rest, "
                f"longer than capture.settle_time_s = {settings.settle_time_s:g} s"
            )
            return CheckLine(PART, "rest", "doubt", found, "make capture.settle_time_s longer")
        found = f"at rest {self._rest_s - self.ordered_s:.2f} s after the order"
        return CheckLine(PART, "rest", "good", found)

    def _unrest_s(self) -> float:
        """Return how long the lengths went on to change after the table had reported rest."""
        whole = self._seen_m()
        if whole is None or self._seen_s() is None:
            return 0.0
        after = self.lengths[self.lengths[:, 0] > self._rest_s]
        moving = np.abs(after[:, 1] - np.median(after[-5:, 1])) > _SETTLED * abs(whole)
        return float(after[moving, 0].max() - self._rest_s) if moving.any() else 0.0

    def _handedness(self, beams: tuple[float, float] | None) -> CheckLine:
        """Say whether the table turns counter-clockwise, as far as an instrument saw it."""
        todo = "look from above: a positive angle is counter-clockwise"
        seen = self._seen_m()
        if seen is None or beams is None or abs(beams[0] - beams[1]) < 0.5 * max(map(abs, beams)):
            found = "no instrument shows from here which way round the table turned"
            return CheckLine(PART, "handedness", "open", found, todo)
        well, wrong = beams
        found = f"the length changed by {seen / MILLIMETRE:+.3f} mm, counter-clockwise makes "
        found += f"{well / MILLIMETRE:+.3f}, clockwise {wrong / MILLIMETRE:+.3f} mm"
        least = 0.1 * max(abs(well), abs(wrong))  # a length that hardly changes proves nothing
        if abs(seen - well) < 0.3 * max(abs(well), least):
            return CheckLine(PART, "handedness", "good", found)
        if abs(seen - wrong) < 0.3 * max(abs(wrong), least):
            found += ": it turns clockwise"
            return CheckLine(PART, "handedness", "missing", found, _REVERSE)
        todo = "correct plan.tracer_m, or the unit of the lengths; " + todo
        return CheckLine(PART, "handedness", "doubt", f"{found}: neither", todo)


def beams_of(calibration: Calibration, motion: TrialMotion) -> tuple[float, float] | None:
    """Return by how much the length should change (m), and by how much if clockwise.

    None where it is not stated where the tracer rides, or where the probe is.
    """
    place, probe = calibration.place_on_table(), motion.probe
    if place is None or probe is None or not all(map(isfinite, probe)):
        return None
    first, last = motion.start, motion.start + motion.way

    def change(sign: float) -> float:
        return dist(probe, rotate_about_table_axis(place, sign * last)) - dist(
            probe, rotate_about_table_axis(place, sign * first)
        )

    return change(1.0), change(-1.0)


def handedness_seen(report: CellReport, seen: str) -> CellReport:
    """Return a report with what a person has seen of the way round."""
    words = f"a person saw it turn {seen} for a positive angle"
    answers = {
        "counter-clockwise": CheckLine(PART, "handedness", "good", words),
        "clockwise": CheckLine(PART, "handedness", "missing", words, _REVERSE),
    }
    lines = (answers.get(seen, x) if x.name == "handedness" else x for x in report.lines)
    return replace(report, lines=tuple(lines))


def _first(times_s: Floats, change: Floats, whole: float) -> float | None:
    """Return the first time of a change of more than a small part of the ``whole``."""
    found = np.flatnonzero(change > _NEARLY * abs(whole))
    return float(times_s[found[0]]) if len(found) else None
