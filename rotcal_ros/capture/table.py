"""Finds when the table is at rest at its commanded angle, and how far it is off."""

from __future__ import annotations

from math import fsum, isnan, pi, remainder
from typing import Final

import numpy as np

from rotcal_ros.capture.attempt import nanoseconds
from rotcal_ros.capture.settings import CaptureSettings
from rotcal_ros.capture.streams import Stream
from rotcal_ros.foundation.arrays import Bools, Floats, differences_from
from rotcal_ros.foundation.language import Phrase, join_texts, phrase
from rotcal_ros.foundation.units import ARCSEC, DEGREE, NANOSECOND
from rotcal_ros.planning.table_feedback import (
    PUBLISH_VELOCITY,
    is_near,
    looks_like_degrees,
    looks_reversed,
)

ANGLE, VELOCITY = range(2)
"""Columns of the table stream, rad and rad/s."""

STANDING_NS: Final = 1_000_000_000
"""Feedback in a wrong unit must last this long before it is called hopeless."""
_SAME: Final = 0.05 * DEGREE
"""A table this close to its angle has arrived, in the unit in question."""
_CHUNK: Final = 512
"""Feedbacks examined at a time: an arrival is usually among the first."""


def angle_offset(angles: Floats, commanded: float) -> Floats:
    """Return measured - commanded angle, in [-pi, pi], without full turns."""
    difference = angles - commanded
    return difference - 2 * pi * np.round(difference / (2 * pi))


def at_rest(feedback: Floats, commanded: float, settings: CaptureSettings) -> Bools:
    """Return for each row (angle, velocity) whether the table stands at ``commanded`` (rad)."""
    near = np.abs(angle_offset(feedback[:, ANGLE], commanded)) <= (
        settings.position_tolerance_arcsec * ARCSEC
    )
    slow = np.abs(feedback[:, VELOCITY]) <= settings.velocity_tolerance_deg_s * DEGREE
    return near & slow


def arrival(
    table: Stream, since_ns: int, commanded: float, settings: CaptureSettings
) -> int | None:
    """Return the stamp of the first feedback from ``since_ns`` on that is at rest, if any."""
    for begin in range(table.index(since_ns), len(table.stamps), _CHUNK):
        resting = at_rest(table.values[begin : begin + _CHUNK], commanded, settings)
        if resting.any():
            return int(table.stamps[begin + int(np.argmax(resting))])
    return None


def departure(
    table: Stream, begin_ns: int, end_ns: int, commanded: float, settings: CaptureSettings
) -> int | None:
    """Return from when on to look for a new arrival if the table did not rest all the time.

    All feedback from ``begin_ns`` to the first one at or after ``end_ns`` must be at rest and
    without longer pauses than ``table_silence_s``. None: it was.
    """
    first, last = table.index(begin_ns), table.index(end_ns)
    stamps = table.stamps[first : last + 1]
    moved = ~at_rest(table.values[first : last + 1], commanded, settings)
    silent = differences_from(begin_ns, stamps) > nanoseconds(settings.table_silence_s)
    wrong = moved | silent
    if not wrong.any():
        return None
    at = int(np.argmax(wrong))
    return int(stamps[at]) + int(moved[at])


def mean_angle(table: Stream, begin_ns: int, end_ns: int, commanded: float) -> float:
    """Return the mean measured angle (rad) from ``begin_ns`` to the first feedback past the end.

    Full turns are counted from the commanded angle.
    """
    rows = table.values[table.index(begin_ns) : table.index(end_ns) + 1]
    offsets = angle_offset(rows[:, ANGLE], commanded)
    return commanded + fsum(offsets) / len(offsets)


def largest_offset(table: Stream, begin_ns: int, end_ns: int, commanded: float) -> float:
    """Return how far off (rad) the table was at most between two stamps."""
    rows = table.values[table.index(begin_ns) : table.index(end_ns) + 1]
    return float(np.abs(angle_offset(rows[:, ANGLE], commanded)).max())


def why_not_at_rest(
    table: Stream, begin_ns: int, end_ns: int, commanded: float, settings: CaptureSettings
) -> Phrase:
    """Return in words and numbers how far the table was off between two stamps."""
    first, last = table.index(begin_ns), table.index(end_ns + 1)
    limit = (end_ns - begin_ns) * NANOSECOND
    if first == last:
        text = phrase(
            "no table feedback in the {0:.3g} s after the probe reached its target", limit
        )
        if last < len(table.stamps):
            ahead = (int(table.stamps[last]) - begin_ns) * NANOSECOND
            return phrase("{0}; the next is stamped {1:.3g} s later (another clock?)", text, ahead)
        if table.latest is None:
            return phrase(
                "{0}, and none before: does cell.joint name a joint of the feedback?", text
            )
        return text
    pause = float(np.diff(table.stamps[first:last]).max(initial=0)) * NANOSECOND
    if pause > settings.table_silence_s:
        return phrase(
            "the table's feedback pauses for up to {0:.3g} s, allowed {1:g} s "
            "(capture.table_silence_s)", pause, settings.table_silence_s
        )  # fmt: skip
    angle, velocity = table.values[last - 1].tolist()
    had_velocity = bool(np.isfinite(table.values[:last, VELOCITY]).any())
    return phrase(
        "table not at rest in position for a whole window within {0:.3g} s: {1}", limit,
        describe_offset(angle, velocity, commanded, settings, had_velocity=had_velocity)
    )  # fmt: skip


def lasting_feedback_fault(
    table: Stream, since_ns: int, commanded: float, had_velocity: bool, ordered_ns: int | None
) -> Phrase | None:
    """Return why nothing will ever be measured with this feedback, if that is certain.

    The fault must have lasted for :data:`STANDING_NS` since ``since_ns``. A
    feedback that ``had_velocity`` before may lack it for a while, until the joint begins to obey.
    One of the wrong sign must have come there since the order of ``ordered_ns``: it may have stood
    there before.
    """
    if table.latest is None or table.latest - since_ns < STANDING_NS:
        return None
    rows = table.values[table.index(table.latest - STANDING_NS) :]
    if had_velocity and np.isnan(rows[-1, VELOCITY]):
        return None
    ends = (rows[0].tolist(), rows[-1].tolist())
    first, last = (_feedback_fault(angle, velocity, commanded) for angle, velocity in ends)
    near = np.abs(angle_offset(rows[:, ANGLE], commanded)) <= _SAME
    if first is None or (near.any() and not np.isnan(rows[-1, VELOCITY])):
        return None
    angle = float(rows[-1, ANGLE])
    if looks_reversed(angle, commanded) and not _came_since(table, ordered_ns, angle):
        return None
    return last


def _came_since(table: Stream, since_ns: int | None, angle: float) -> bool:
    """Return whether the table stood elsewhere than at ``angle`` (rad) at a stamp, if known."""
    at = len(table.stamps) if since_ns is None else table.index(since_ns)
    return at < len(table.stamps) and not is_near(float(table.values[at, ANGLE]), angle, DEGREE)


def describe_offset(
    angle: float,
    velocity: float,
    commanded: float,
    settings: CaptureSettings,
    *,
    had_velocity: bool = False,
) -> Phrase:
    """Return in words how far (rad, rad/s) the last feedback is off its order, and why.

    One that ``had_velocity`` before lacks it while its joint has not begun to obey: so says
    table_adapter.
    """
    off = float(angle_offset(np.array([angle]), commanded)[0])
    if isnan(velocity) and had_velocity:
        return phrase(
            "the last feedback is {0:.4g} arcsec off the commanded {1:.4f} deg (allowed {2:g}), "
            "and its driver does not report it at rest: the ordered motion has not begun",
            off / ARCSEC, commanded / DEGREE, settings.position_tolerance_arcsec
        )  # fmt: skip
    fault = _feedback_fault(angle, velocity, commanded)
    off_and_fast = phrase(
        "the last feedback is {0:.4g} arcsec off the commanded {1:.4f} deg (allowed {2:g}) at "
        "{3:.3g} deg/s (allowed {4:g})", off / ARCSEC, commanded / DEGREE,
        settings.position_tolerance_arcsec, velocity / DEGREE, settings.velocity_tolerance_deg_s
    )  # fmt: skip
    return off_and_fast if fault is None else join_texts([off_and_fast, fault])


def _feedback_fault(angle: float, velocity: float, commanded: float) -> Phrase | None:
    """Return what is wrong with a feedback itself, so that it is never in position."""
    if isnan(velocity):
        return phrase("the feedback has no velocity: {0}", phrase(PUBLISH_VELOCITY))
    if looks_like_degrees(angle, commanded):
        return phrase(
            "it says {0:.6g} where {1:.6g} rad = {2:.6g} deg was commanded: degrees? Publish "
            "radians, or set topics.angle_unit: deg", angle, commanded, commanded / DEGREE
        )  # fmt: skip
    if looks_reversed(angle, commanded):
        return phrase(
            "it says {0:+.6g} deg where {1:+.6g} deg was commanded: is a sign wrong? Positive is "
            "counter-clockwise seen from above, in orders and feedback",
            remainder(angle, 2.0 * pi) / DEGREE, remainder(commanded, 2.0 * pi) / DEGREE
        )  # fmt: skip
    # A settings file with angle_unit: deg for a drive that publishes radians: the number before
    # the conversion is the commanded angle.
    angle_deg = angle / DEGREE
    same = abs(remainder(angle_deg - commanded, 2.0 * pi)) <= _SAME
    if same and abs(angle - commanded) > DEGREE:
        return phrase(
            "in position if its {0:.6g} are radians, not degrees: see topics.angle_unit", angle_deg
        )
    return None
