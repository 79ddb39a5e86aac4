"""Checks what the instruments say against the configuration, before anything moves. Needs no ROS.

The values of the capture's beat are judged: the latest reading of every instrument, the joints of
the table's feedback, and the rates of the streams.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import isfinite
from typing import Final

from rotcal_ros.bags import names
from rotcal_ros.capture.instruments.conventions import Conventions
from rotcal_ros.capture.instruments.plausibility import (
    can_be_a_thousandth,
    implausible_air,
    implausible_angle,
    implausible_length,
    implausible_position,
    scatters_at_rest,
    thousandth_of_plan,
)
from rotcal_ros.foundation.escapes import printable
from rotcal_ros.foundation.observations import PointKind
from rotcal_ros.foundation.plugins import group_nodes
from rotcal_ros.methods import Calibration, Configuration
from rotcal_ros.nodes.runtime.beat_values import (
    FRAME,
    JOINT,
    MOST_JOINTS,
    NOW,
    OFFSET,
    RATE,
    REFUSED,
    SCATTER,
    displayed_topic,
)
from rotcal_ros.planning.plan import Plan
from rotcal_ros.planning.table_feedback import missing_joint_message

_AIR: Final = {
    "temperature": names.TEMPERATURE,
    "pressure": names.AIR_PRESSURE,
    "humidity": names.RELATIVE_HUMIDITY,
}
"""Topic of each quantity of the air, by its name in the settings of the capture."""
SLOW_HZ: Final = 8.0
_SIZED: Final = (names.TRACER_LENGTH, names.PROBE_POINT)
_OUTSIDE: Final = 3.0
"""A probe may be this many times nearer or further away than the targets of the plan."""
_OF_AN_INSTRUMENT: Final = {
    PointKind.DIRECT,
    PointKind.MIRRORED,
    PointKind.NEST,
    PointKind.READING,
}

Values = Mapping[str, str]


def instrument_faults(
    values: Values, configuration: Configuration, plan: Plan | None = None
) -> list[str]:
    """Return why these instruments cannot give an observation, in words.

    The probe's positions are compared with the ``plan``.
    """
    clocks = [values[OFFSET]] if OFFSET in values else []
    return [
        *(text for key, text in values.items() if key.startswith(REFUSED)),
        *joint_faults(values, configuration.cell.joint),
        *length_faults(values, configuration),
        *(() if plan is None else probe_faults(values, configuration, plan)),
        *(text for _, text in rate_faults(values, configuration)),
        *clocks,
    ]


def instrument_warnings(
    values: Values, configuration: Configuration, calibration: Calibration | None = None
) -> list[str]:
    """Return what looks wrong, though observations may still be possible.

    Readings are compared with the geometry of the plan of a ``calibration``.
    """
    small = [] if calibration is None else [
        text for role in _SIZED for text in unit_warnings(values, calibration, role)
    ]  # fmt: skip
    return [
        *small,
        *table_angle_warnings(values, configuration),
        *frame_warnings(values, configuration),
        *table_rate_warnings(values, configuration),
        *length_rate_warnings(values, configuration),
        *(text for role in _AIR.values() for text in air_warnings(values, role)),
    ]


def air_warnings(values: Values, role: str) -> Iterator[str]:
    """Yield what looks wrong about the air as the ``role`` gives it."""
    value = leading_number(values.get(NOW + role, ""))
    found = [] if value is None else implausible_air({role: value})
    yield from (f"{displayed_topic(values, role)} {text}" for role, text in found if text)


def unit_warnings(values: Values, calibration: Calibration, role: str) -> Iterator[str]:
    """Yield a doubt if lengths or probe positions seem to be in another unit, by the plan.

    Lengths may count from anywhere, so that a small one proves nothing beside their scatter.
    """
    topics, name = calibration.configuration.topics, displayed_topic(values, role)
    if role == names.TRACER_LENGTH and role in calibration.topics:
        length = leading_number(values.get(NOW + role, "")) or 0.0
        scatter = leading_number(values.get(SCATTER + role, ""))
        stated = (topics.length_unit, "topics.length_unit")
        allowed = calibration.configuration.capture.max_std_m
        text = None if scatter is None else scatters_at_rest(scatter, allowed, *stated)
        if not text and (
            abs(length) > calibration.beam_range_m[0] or can_be_a_thousandth(scatter)
        ):
            text = thousandth_of_plan(length, calibration.beam_range_m, *stated)
        if text:
            yield f"{name} {text}"
    words = values.get(NOW + role, "").split() if role == names.PROBE_POINT else []
    if len(words) == 3 and _in_the_machine_frame(calibration.configuration):
        far = max(abs(float(x)) for x in words)
        size = max(abs(x) for step in calibration.plan.steps for x in step.position)
        span = (size / _OUTSIDE, size * _OUTSIDE)
        if text := thousandth_of_plan(far, span, topics.position_unit, "topics.position_unit"):
            yield f"{name} {text}"


def table_rate_warnings(values: Values, configuration: Configuration) -> Iterator[str]:
    """Yield a doubt if the table's feedback comes so rarely that its rest is noticed late.

    A machine that is polled is asked seldom while it has no order.
    """
    rate = leading_number(values.get(RATE + names.JOINT_STATES, ""))
    drivers = (node for group, node in group_nodes().items() if group in configuration.given)
    if rate and rate < SLOW_HZ and not any(node.polled for node in drivers):
        yield (
            f"{displayed_topic(values, names.JOINT_STATES)} comes at {rate:.3g} Hz: whether the "
            f"table moves or rests is known {1.0 / rate:.2g} s late; 50 Hz are usual, "
            f"{SLOW_HZ:g} Hz the least"
        )


def length_rate_warnings(values: Values, configuration: Configuration) -> Iterator[str]:
    """Yield a doubt if lengths come so rarely that a window takes long and hides a broken beam."""
    rate = leading_number(values.get(RATE + names.TRACER_LENGTH, ""))
    if rate and rate < SLOW_HZ and not configuration.topics.length_single_shot:
        window_s = configuration.capture.window_samples / rate
        yield (
            f"{displayed_topic(values, names.TRACER_LENGTH)} comes at {rate:.3g} Hz: the "
            f"{configuration.capture.window_samples} readings of a window take {window_s:.3g} s, "
            f"and what happens between two of them is not seen; 1000 Hz are usual, {SLOW_HZ:g} Hz "
            "the least"
        )


def frame_warnings(values: Values, configuration: Configuration) -> Iterator[str]:
    """Yield a doubt if the probe's points may be in another frame than the plan's targets.

    A tracker's own points are in its own frame.
    """
    frame = values.get(FRAME + names.PROBE_POINT, "")
    ours = configuration.cell.machine_frame
    if frame and _in_the_machine_frame(configuration) and frame.lstrip("/") != ours.lstrip("/"):
        yield (
            f"{displayed_topic(values, names.PROBE_POINT)} is stamped with the frame "
            f"{printable(frame)}, the targets of the plan are in {ours} (cell.machine_frame); "
            "points are taken as they are, and not transformed"
        )


def _in_the_machine_frame(configuration: Configuration) -> bool:
    return not configuration.method.capture.decide.keys() & _OF_AN_INSTRUMENT


def expected_air_topics(calibration: Calibration) -> tuple[list[str], list[str]]:
    """Return the topics of the air that are required, and those that are waited for."""
    settings = calibration.configuration.capture
    required = calibration.refraction.required(settings)
    expected = [(n, topic) for n, topic in _AIR.items() if getattr(settings, f"{n}_expected")]
    needed = [topic for name, topic in expected if name in required]
    return needed, [topic for _, topic in expected if topic not in needed]


def missing_air_consequence(role: str, topic: str, configuration: Configuration) -> str:
    """Return what follows if no node publishes the expected ``topic`` of a quantity of the air."""
    name = next(name for name, last in _AIR.items() if role == last)
    return (
        f"no node publishes {topic}: every observation waits for it for "
        f"{configuration.capture.clock_tolerance_s:g} s (capture.clock_tolerance_s), then does "
        f"without; publish it, or set capture.{name}_expected: false"
    )


def length_faults(values: Values, configuration: Configuration) -> Iterator[str]:
    """Yield what is wrong with the lengths."""
    length = leading_number(values.get(NOW + names.TRACER_LENGTH, ""))
    text = implausible_length(
        0.0 if length is None else length, configuration.capture.max_length_m, configuration.topics
    )
    if text:
        yield f"{displayed_topic(values, names.TRACER_LENGTH)} {text}"


def probe_faults(values: Values, configuration: Configuration, plan: Plan) -> Iterator[str]:
    """Yield a fault if the probe's positions are in another unit than stated.

    A tracker's own points do not show it: they are not where the plan's targets are.
    """
    words = values.get(NOW + names.PROBE_POINT, "").split()
    if len(words) != 3 or not _in_the_machine_frame(configuration):
        return
    x, y, z = map(float, words)
    text = implausible_position((x, y, z), plan, configuration.topics)
    if text:
        yield f"{displayed_topic(values, names.PROBE_POINT)} {text}"


def rate_faults(values: Values, configuration: Configuration) -> Iterator[tuple[str, str]]:
    """Yield each stream that is too slow for what waits for it, and what to change."""
    capture, planner = configuration.capture, configuration.planner
    lengths, table = names.TRACER_LENGTH, names.JOINT_STATES
    found = {role: leading_number(values.get(RATE + role, "")) for role in (lengths, table)}
    for role, owner in ((lengths, "length"), (table, "table")):
        if found[role] == 0.0:
            text = "its stamps stand still, is the header filled?"
            way = f"topics.{owner}_clock: sent takes the time of sending"
            yield role, f"{displayed_topic(values, role)}: {text} {way}"
    rates = {role: rate for role, rate in found.items() if rate}
    if (rate := rates.get(table)) and 1.0 / rate > capture.table_silence_s:
        yield (
            table,
            f"{displayed_topic(values, table)} comes every {1.0 / rate:.3g} s: at rest "
            f"{capture.table_silence_s:g} s are allowed (capture.table_silence_s)",
        )
    if configuration.topics.length_single_shot or not (rate := rates.get(lengths)):
        return
    name, window_s = displayed_topic(values, lengths), capture.window_samples / rate
    if capture.settle_time_s + window_s > capture.step_timeout_s:
        yield (
            lengths,
            f"{name} comes at {rate:.3g} Hz: {capture.window_samples} readings of a window take "
            f"{window_s:.3g} s, more than capture.step_timeout_s = {capture.step_timeout_s:g} s "
            "leaves: set a smaller capture.window_samples, or a longer time-out",
        )
    if 1.0 / rate > planner.stream_timeout_s:
        yield (
            lengths,
            f"{name} comes every {1.0 / rate:.3g} s: after planner.stream_timeout_s = "
            f"{planner.stream_timeout_s:g} s it counts as silent: set a longer time, or "
            "topics.length_single_shot: true for an instrument that measures on request",
        )


def joint_faults(values: Values, joint: str) -> Iterator[str]:
    """Yield what is wrong with the joint of the table."""
    heard = joint_states(values)
    chosen, topic = table_joint(values, joint), displayed_topic(values, names.JOINT_STATES)
    if not heard or (chosen not in heard and len(heard) >= MOST_JOINTS):  # not all are listed
        return
    if chosen not in heard:
        yield missing_joint_message(topic, joint, heard)


def table_angle_warnings(values: Values, configuration: Configuration) -> Iterator[str]:
    """Yield what looks wrong about the table's angle."""
    text = implausible_angle(table_angle(values, configuration), configuration.topics)
    if text:
        yield f"{displayed_topic(values, names.JOINT_STATES)} {text}"


def table_angle(values: Values, configuration: Configuration) -> float:
    """Return the table's angle by its feedback (rad); 0 if there is none."""
    if chosen := joint_states(values).get(table_joint(values, configuration.cell.joint)):
        return Conventions(configuration.topics).angle(chosen[0])
    return leading_number(values.get(NOW + names.JOINT_STATES, "")) or 0.0


def table_joint(values: Values, joint: str) -> str:
    """Return the joint of the table: the configured one, else the first."""
    return joint or next(iter(joint_states(values)), "")


def joint_states(values: Values) -> dict[str, tuple[float, float]]:
    """Return angle (rad) and velocity (rad/s) of the joints that were heard, by name."""
    found = {}
    for key, value in values.items():
        if key.startswith(JOINT):
            angle, velocity = map(float, value.split())
            found[key.removeprefix(JOINT)] = (angle, velocity)
    return found


def leading_number(text: str) -> float | None:
    """Return the number that a reading begins with, if it is finite."""
    try:
        number = float(text.split()[0])
    except (IndexError, ValueError):
        return None
    return number if isfinite(number) else None
