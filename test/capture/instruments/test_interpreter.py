"""Messages of every kind become records in SI; what comes out follows from units and clocks."""

import math
from dataclasses import replace
from types import SimpleNamespace as Message

import numpy as np
import pytest

from rotcal_ros.bags import names
from rotcal_ros.bags.settings import TopicSettings
from rotcal_ros.capture.instruments.conventions import STAMP, Conventions
from rotcal_ros.capture.instruments.interpreter import Interpreter
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.observations import LengthStatus
from rotcal_ros.foundation.settings import load

SECOND = 1_000_000_000
FLOAT = "std_msgs/msg/Float64"
RANGE = "sensor_msgs/msg/Range"


def header(stamp_ns, frame="f"):
    seconds, nanoseconds = divmod(stamp_ns, SECOND)
    return Message(stamp=Message(sec=seconds, nanosec=nanoseconds), frame_id=frame)


def place(x, y, z):
    return Message(x=x, y=y, z=z)


@pytest.mark.parametrize(
    ("type_name", "fields"),
    [
        ("geometry_msgs/msg/PointStamped", {"point": place(1.0, 2.0, 3.0)}),
        ("geometry_msgs/msg/Vector3Stamped", {"vector": place(1.0, 2.0, 3.0)}),
        ("geometry_msgs/msg/PoseStamped", {"pose": Message(position=place(1.0, 2.0, 3.0))}),
    ],
)
def test_a_position_of_any_kind(type_name, fields):
    settings = TopicSettings(position_unit="mm", probe_clock_offset_s=-0.25)
    message = Message(header=header(5 * SECOND), **fields)
    found = Interpreter(settings).record(names.PROBE_POINT, type_name, message, 0)
    assert found.position == (0.001, 0.002, 0.003)
    assert found.stamp_ns == 5_250_000_000


@pytest.mark.parametrize(("unit", "value", "celsius"), [
    ("degC", 20.0, 20.0), ("K", 293.15, 20.0), ("degF", 68.0, 20.0),
])  # fmt: skip
def test_temperatures(unit, value, celsius):
    settings = TopicSettings(temperature_unit=unit)
    bare = Message(data=value)
    found = Interpreter(settings).record(names.TEMPERATURE, FLOAT, bare, 7)
    assert (found.temperature_c, found.stamp_ns) == (pytest.approx(celsius), 7)
    own = Message(header=header(9), temperature=value)
    found = Interpreter(settings).record(names.TEMPERATURE, "sensor_msgs/msg/Temperature", own, 7)
    assert (found.temperature_c, found.stamp_ns) == (pytest.approx(celsius), 9)


def test_bare_lengths_are_numbered_and_say_what_they_can_of_the_beam():
    interpreter = Interpreter(TopicSettings(length_unit="um", length_unit_m=-1.0))
    values = (1500.0, math.nan, 2500.0)
    sent = [(Message(data=value), 10 + k) for k, value in enumerate(values)]
    found = interpreter.records(names.TRACER_LENGTH, FLOAT, sent)
    assert [r.stamp_ns for r in found] == [10, 11, 12]
    assert [r.sequence for r in found] == [0, 1, 2]
    assert [found[0].length, found[2].length] == [-0.0015, -0.0025]
    assert [r.status for r in found] == [
        LengthStatus.OK, LengthStatus.BEAM_BROKEN, LengthStatus.OK,
    ]  # fmt: skip
    ((further,),) = [interpreter.records(names.TRACER_LENGTH, FLOAT, sent[:1])]
    assert further.sequence == 3


def test_a_range_beyond_its_own_limits_is_no_length():
    sent = [
        (Message(header=header(k), range=value, min_range=0.1, max_range=2.0), 0)
        for k, value in enumerate((1.0, 3.0, 0.05))
    ]
    found = Interpreter(TopicSettings()).records(names.TRACER_LENGTH, RANGE, sent)
    assert [r.status for r in found] == [LengthStatus.OK, *2 * [LengthStatus.BEAM_BROKEN]]


def test_bare_angles_have_the_speed_of_their_motion_and_a_turn_is_none():
    degrees = [359.0, 359.5, 0.0, 0.5, 1.0, 1.0, 1.0, 1.0]  # 50 deg/s, then rest
    sent = [(Message(data=a), k * SECOND // 100) for k, a in enumerate(degrees)]
    settings = TopicSettings(angle_unit="deg", angle_span_s=0.02)
    found = Interpreter(settings).records(names.JOINT_STATES, FLOAT, sent)
    assert [s.stamp_ns for s in found] == [k * SECOND // 100 for k in range(2, 8)]
    assert found[0].velocity == pytest.approx(math.radians(50.0))
    assert found[-1].velocity == 0.0
    assert found[-1].angle == pytest.approx(math.radians(1.0))


def test_a_joint_in_degrees_by_its_name():
    message = Message(
        header=header(3), name=["rail", "C"], position=[9.0, 180.0], velocity=[0.0, 90.0]
    )
    settings = TopicSettings(angle_unit="deg", angle_unit_rad=-1.0)
    (found,) = Interpreter(settings, "C").records(
        names.JOINT_STATES, "sensor_msgs/msg/JointState", [(message, 0)]
    )
    assert (found.angle, found.velocity) == (-math.pi, -math.pi / 2)


def test_a_clock_that_drifts_is_not_asked_for_the_time():
    settings = TopicSettings(length_clock="sent", length_clock_offset_s=0.5)
    message = Message(header=header(123), range=1.0, min_range=0.0, max_range=0.0)
    (found,) = Interpreter(settings).records(names.TRACER_LENGTH, RANGE, [(message, 9 * SECOND)])
    assert found.stamp_ns == 8_500_000_000


def test_own_messages_in_plain_settings_are_left_as_they_are():
    message = Message(header=header(3), sequence=4, length=0.1, length_std=1e-7, status=1)
    (found,) = Interpreter(TopicSettings(tracer_length="/x")).records(
        names.TRACER_LENGTH, "rotcal_msgs/msg/TracerLength", [(message, 77)]
    )
    assert (found.stamp_ns, found.length, found.length_std) == (3, 0.1, 1e-7)


def test_what_is_not_understood_is_named():
    refused = Conventions(TopicSettings()).why_unusable(
        names.TRACER_LENGTH, "std_msgs/msg/String", []
    )
    parts = ("std_msgs/msg/String", FLOAT, "TracerLength", "topics.length_field")
    assert all(part in refused for part in parts)
    assert not Conventions(TopicSettings()).why_unusable(names.TRACER_LENGTH, RANGE, [])


DISTANCE = "acme_msgs/msg/Distance"


def test_a_number_of_any_type_is_named_by_its_fields():
    settings = TopicSettings(length_field="beam.distance", length_unit="mm")
    sent = [
        (Message(header=header(k), beam=Message(distance=value, quality=1.0)), 99)
        for k, value in enumerate((100.0, math.nan))
    ]
    found = Interpreter(settings).records(names.TRACER_LENGTH, DISTANCE, sent)
    assert [(r.stamp_ns, r.status) for r in found] == [
        (0, LengthStatus.OK), (1, LengthStatus.BEAM_BROKEN),
    ]  # fmt: skip
    assert found[0].length == pytest.approx(0.1)
    by_sending = replace(settings, length_clock="sent")
    assert Interpreter(by_sending).records(names.TRACER_LENGTH, DISTANCE, sent)[0].stamp_ns == 99
    place_of = Interpreter(TopicSettings(position_field="at.place", position_unit="mm"))
    message = Message(header=header(5), at=Message(place=place(1.0, 2.0, 3.0)))
    found = place_of.record(names.PROBE_POINT, "acme_msgs/msg/Ball", message, 0)
    assert (found.position, found.stamp_ns) == ((0.001, 0.002, 0.003), 5)


@pytest.mark.parametrize(("fields", "words"), [
    ([*STAMP, "beam.distance"], ""),
    ([*STAMP, "beam.length"], "has no field beam.distance (topics.length_field: "),
    (["beam.distance"], "no header: state topics.length_clock: sent"),
])  # fmt: skip
def test_a_field_that_is_not_there_is_named_with_those_that_are(fields, words):
    conventions = Conventions(TopicSettings(length_field="beam.distance"))
    refused = conventions.why_unusable(names.TRACER_LENGTH, DISTANCE, fields)
    assert words in refused
    assert bool(refused) == bool(words)


def test_a_joint_without_velocity_has_that_of_its_angles():
    degrees = [0.0, 0.5, 1.0, 1.0, 1.0, 1.0]  # 50 deg/s, then rest
    joints = [
        (Message(header=header(k * SECOND // 100), name=["C"], position=[math.radians(a)],
                 velocity=told), 0)
        for k, a in enumerate(degrees) for told in [[], [math.nan]][k % 2 :][:1]
    ]  # fmt: skip
    interpreter = Interpreter(TopicSettings(angle_span_s=0.02))
    found = interpreter.records(names.JOINT_STATES, "sensor_msgs/msg/JointState", joints)
    assert [round(math.degrees(s.velocity), 9) for s in found] == [50.0, 25.0, 0.0, 0.0]
    assert found[0].angle == math.radians(1.0)
    # Once the drive has stated a velocity, it is asked for it: NaN is then no rest.
    stated = Message(header=header(SECOND), name=["C"], position=[0.1], velocity=[0.2])
    lost = Message(header=header(SECOND + 1), name=["C"], position=[0.1], velocity=[math.nan])
    found = interpreter.records(
        names.JOINT_STATES, "sensor_msgs/msg/JointState", [(stated, 0), (lost, 0)]
    )
    assert found[0].velocity == 0.2
    assert math.isnan(found[1].velocity)


@pytest.mark.parametrize(("given", "words"), [
    ({"length_unit": "mm", "length_unit_m": 0.001}, "two units"),
    ({"angle_unit": "deg", "angle_unit_rad": 0.5}, "two units"),
    ({"angle_unit_rad": 0.0}, "zero"),
    ({"length_unit": "inch"}, "is none of"),
    ({"length_trigger": "not a name"}, "not a name in ROS"),
])  # fmt: skip
def test_units_that_cannot_be(given, words):
    with pytest.raises(ConfigurationError, match=words):
        load(TopicSettings, given, "topics")


def test_units_by_name_are_those_by_number():
    assert TopicSettings(angle_unit="deg").angle_rad == np.deg2rad(1.0)
    assert TopicSettings(length_unit="mm").length_m == TopicSettings(length_unit_m=1e-3).length_m
