"""What the capture has heard, held against a configuration before anything moves; without ROS.

It is the values of the capture's beat that are judged: the latest reading of every instrument.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import isfinite
from typing import Final

from rotcal_ros.bags import names
from rotcal_ros.capture import CaptureSettings
from rotcal_ros.catalogue import Calibration, Configuration
from rotcal_ros.escapes import printable
from rotcal_ros.instruments.conventions import Conventions
from rotcal_ros.instruments.plausibility import (
    air_in_words,
    angle_in_words,
    length_in_words,
    position_in_words,
)
from rotcal_ros.nodes.concerns import OFFSET
from rotcal_ros.nodes.latest import JOINT, MOST_JOINTS, NOW, RATE, REFUSED
from rotcal_ros.nodes.topic_names import name_in
from rotcal_ros.planning.plan import Plan

_AIR: Final = {
    "temperature": names.TEMPERATURE,
    "pressure": names.AIR_PRESSURE,
    "humidity": names.RELATIVE_HUMIDITY,
}
"""Topic of each quantity of the air, by its name in the settings of the capture."""

Values = Mapping[str, str]


def faults(values: Values, configuration: Configuration, plan: Plan | None = None) -> list[str]:
    """Return why no observation can come of these instruments, in words.

    The probe's positions are held against the ``plan``.
    """
    clocks = [values[OFFSET]] if OFFSET in values else []
    return [
        *(text for key, text in values.items() if key.startswith(REFUSED)),
        *_of_the_joint(values, configuration.cell.joint),
        *_of_lengths(values, configuration),
        *(() if plan is None else _of_the_probe(values, configuration, plan)),
        *_of_rates(values, configuration),
        *clocks,
    ]


def doubts(values: Values, configuration: Configuration) -> list[str]:
    """Return what looks wrong, though observations may come of it."""
    angle = _number(values.get(NOW + names.JOINT_STATES, "")) or 0.0
    if chosen := _joints(values).get(_chosen(values, configuration.cell.joint)):
        angle = Conventions(configuration.topics).angle(chosen[0])
    found = [(names.JOINT_STATES, angle_in_words(angle, configuration.topics))]
    readings = {role: _number(values.get(NOW + role, "")) for role in _AIR.values()}
    found += air_in_words({role: value for role, value in readings.items() if value is not None})
    return [f"{name_in(values, role)} {text}" for role, text in found if text]


def expected_air(calibration: Calibration) -> tuple[list[str], list[str]]:
    """Return the topics of the air without which nothing is measured, and those waited for."""
    settings = calibration.configuration.capture
    required = calibration.refraction.required(settings)
    expected = [(name, topic) for name, topic in _AIR.items() if _expected(settings, name)]
    needed = [topic for name, topic in expected if name in required]
    return needed, [topic for _, topic in expected if topic not in needed]


def without_air(role: str, topic: str, configuration: Configuration) -> str:
    """Say what it means that nobody publishes the expected ``topic`` of a quantity of the air."""
    name = next(name for name, last in _AIR.items() if role == last)
    return (
        f"nobody publishes {topic}: every observation waits for it as long as "
        f"{configuration.capture.clock_tolerance_s:g} s (capture.clock_tolerance_s), then does "
        f"without; publish it, or set capture.{name}_expected: false"
    )


def _expected(settings: CaptureSettings, name: str) -> bool:
    return bool(getattr(settings, f"{name}_expected"))


def _of_the_joint(values: Values, joint: str) -> Iterator[str]:
    """Yield what is wrong with the joint that stands for the table."""
    joints = _joints(values)
    chosen, topic = _chosen(values, joint), name_in(values, names.JOINT_STATES)
    if not joints or (chosen not in joints and len(joints) >= MOST_JOINTS):  # not all are told
        return
    if chosen not in joints:
        yield (
            f"{topic} has no joint {joint!r} (cell.joint), it has "
            f"{', '.join(map(printable, joints))}: name one of these, or leave cell.joint empty "
            "for the first"
        )
    elif not isfinite(joints[chosen][1]):
        yield (
            f"{topic}: joint {printable(chosen)} has no velocity, without which no "
            "table is at rest: publish it beside the position, in rad/s"
        )


def _of_lengths(values: Values, configuration: Configuration) -> Iterator[str]:
    length = _number(values.get(NOW + names.TRACER_LENGTH, ""))
    text = length_in_words(
        0.0 if length is None else length,
        configuration.capture.max_length_m,
        configuration.topics,
    )
    if text:
        yield f"{name_in(values, names.TRACER_LENGTH)} {text}"


def _of_the_probe(values: Values, configuration: Configuration, plan: Plan) -> Iterator[str]:
    """Yield that the probe's positions are in another unit than stated."""
    words = values.get(NOW + names.PROBE_POINT, "").split()
    if len(words) != 3:
        return
    x, y, z = map(float, words)
    text = position_in_words((x, y, z), plan, configuration.topics)
    if text:
        yield f"{name_in(values, names.PROBE_POINT)} {text}"


def _of_rates(values: Values, configuration: Configuration) -> Iterator[str]:
    """Yield which stream is too slow for what waits for it, and what to change."""
    capture, planner = configuration.capture, configuration.planner
    lengths, table = names.TRACER_LENGTH, names.JOINT_STATES
    rates = {role: _number(values.get(RATE + role, "")) for role in (lengths, table)}
    for role, owner in ((lengths, "length"), (table, "table")):
        if rates[role] == 0.0:
            yield (
                f"{name_in(values, role)}: its stamps stand still, is the header filled? "
                f"topics.{owner}_clock: sent takes the time of sending"
            )
    if (rate := rates.get(table)) and 1.0 / rate > capture.table_silence_s:
        yield (
            f"{name_in(values, table)} comes every {1.0 / rate:.3g} s: at rest "
            f"{capture.table_silence_s:g} s are allowed (capture.table_silence_s)"
        )
    if configuration.topics.length_single_shot or not (rate := rates.get(lengths)):
        return
    name, window_s = name_in(values, lengths), capture.window_samples / rate
    if capture.settle_time_s + window_s > capture.step_timeout_s:
        yield (
            f"{name} comes at {rate:.3g} Hz: {capture.window_samples} readings of a window take "
            f"{window_s:.3g} s, more than capture.step_timeout_s = {capture.step_timeout_s:g} s "
            "leaves: a smaller capture.window_samples, or a longer time-out"
        )
    if 1.0 / rate > planner.stream_timeout_s:
        yield (
            f"{name} comes every {1.0 / rate:.3g} s: after planner.stream_timeout_s = "
            f"{planner.stream_timeout_s:g} s it is lost; a longer time, or "
            "topics.length_single_shot: true for an instrument that is asked"
        )


def _chosen(values: Values, joint: str) -> str:
    return joint or next(iter(_joints(values)), "")


def _joints(values: Values) -> dict[str, tuple[float, float]]:
    """Return angle (rad) and velocity (rad/s) of the joints that were heard, by name."""
    found = {}
    for key, value in values.items():
        if key.startswith(JOINT):
            angle, velocity = map(float, value.split())
            found[key.removeprefix(JOINT)] = (angle, velocity)
    return found


def _number(text: str) -> float | None:
    """Return the number that a reading begins with, if it does and is finite."""
    try:
        number = float(text.split()[0])
    except (IndexError, ValueError):
        return None
    return number if isfinite(number) else None
