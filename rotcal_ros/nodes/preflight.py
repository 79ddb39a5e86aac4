"""What the capture has heard, held against a configuration before anything moves; without ROS.

It is the values of the capture's beat that are judged: the latest reading of every instrument.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import isfinite, pi
from typing import Final

from rotcal_ros.bags import names
from rotcal_ros.capture import CaptureSettings
from rotcal_ros.catalogue import Calibration, Configuration
from rotcal_ros.escapes import printable
from rotcal_ros.nodes.concerns import OFFSET
from rotcal_ros.nodes.latest import JOINT, MOST_JOINTS, NOW
from rotcal_ros.nodes.topic_names import name_in

_RANGES: Final = {
    names.TEMPERATURE: (-20.0, 60.0, "degrees Celsius", "kelvin or Fahrenheit"),
    names.AIR_PRESSURE: (50e3, 120e3, "pascal", "hectopascal"),
    names.RELATIVE_HUMIDITY: (0.0, 1.0, "a share from 0 to 1", "per cent"),
}
"""Plausible values, their unit, and what others are likely to be."""
_AIR: Final = {
    "temperature": names.TEMPERATURE,
    "pressure": names.AIR_PRESSURE,
    "humidity": names.RELATIVE_HUMIDITY,
}
"""Topic of each quantity of the air, by its name in the settings of the capture."""
_FULL_TURN: Final = 2 * pi

Values = Mapping[str, str]


def faults(values: Values, configuration: Configuration) -> list[str]:
    """Return why no observation can come of these instruments, in words."""
    clocks = [values[OFFSET]] if OFFSET in values else []
    joint = configuration.cell.joint
    return [*_of_the_joint(values, joint), *_of_lengths(values, configuration), *clocks]


def doubts(values: Values, configuration: Configuration) -> list[str]:
    """Return what looks wrong, though observations may come of it."""
    found = []
    angle, _ = _joints(values).get(_chosen(values, configuration.cell.joint), (0.0, 0.0))
    if abs(angle) > _FULL_TURN:
        found.append(
            f"the table says {angle:.6g} rad, {abs(angle) / _FULL_TURN:.1f} turns from zero: are "
            "these degrees? Feedback is in radians"
        )
    for topic, (low, high, unit, others) in _RANGES.items():
        value = _number(values.get(NOW + topic, ""))
        if value is not None and not low <= value <= high:
            name = name_in(values, topic)
            found.append(f"{name} says {value:.6g}; {unit} are expected: {others}?")
    return found


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
    largest = configuration.capture.max_length_m
    topic = name_in(values, names.TRACER_LENGTH)
    length = _number(values.get(NOW + names.TRACER_LENGTH, ""))
    if length is not None and abs(length) > largest:
        yield (
            f"{topic} says {length:.6g} m, plausible are {largest:g} m "
            "(capture.max_length_m): millimetres? Lengths are in metres"
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
