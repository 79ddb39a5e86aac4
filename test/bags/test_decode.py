"""Decoding without ROS: every value bit for bit, by the definition that is in the bag."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest
from bag_samples import STORE, TYPES, encode, floats, serialised
from hypothesis import given, settings
from hypothesis import strategies as st

from rotcal_ros.bags import decode, names
from rotcal_ros.bags.blocks import HEADER_TYPE, Block
from rotcal_ros.bags.decode import Columns, Decoder
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.capture import messages as records
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.language import phrase
from rotcal_ros.foundation.observations import (
    Approach,
    Command,
    LengthStatus,
    Observation,
    PointKind,
    ProbeSample,
    TableSample,
    TemperatureSample,
    TracerSample,
    Turn,
)

any_float = st.floats(width=64)
u32 = st.integers(0, 2**32 - 1)
stamps = st.integers(0, (2**31 - 1) * 10**9)
text = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=12)
points = st.tuples(any_float, any_float, any_float)
kinds = st.sampled_from(PointKind)
lists = st.lists(any_float, max_size=4).map(tuple)

tracer_samples = st.builds(
    TracerSample, stamps, u32, any_float, any_float, st.sampled_from(LengthStatus)
)
table_samples = st.builds(TableSample, stamps, any_float, any_float)
temperatures = st.builds(TemperatureSample, stamps, text, any_float)
probe_samples = st.builds(
    ProbeSample, stamps, u32, u32, u32, kinds, u32, u32, u32, points, points, any_float
)
turns = st.none() | st.builds(Turn, any_float, any_float, any_float.filter(bool))
commands = st.builds(
    Command, u32, u32, any_float, st.sampled_from(Approach), kinds, u32, points, turn=turns
)
reasons = text.map(phrase) | st.builds(phrase, st.just("{0} of {1:.3g}"), text, any_float)
observations = st.builds(
    Observation,
    step=u32, attempt=u32, table_position=u32, table_angle=any_float, target=u32, station=u32,
    kind=kinds, mean=lists, std=lists, scatter=lists, probe_position=points, n_samples=u32,
    n_used=u32, accepted=st.booleans(), reason=reasons, table_angle_measured=any_float,
    temperature_c=st.none() | st.floats(allow_nan=False), window_start_ns=stamps,
    window_end_ns=stamps, segment=u32,
)  # fmt: skip


def decoder(role: str, type_name: str = "") -> Decoder:
    type_name = type_name or TYPES[role]
    definition, _ = STORE.generate_msgdef(type_name, ros_version=2)
    return Decoder(ChannelDefinition(1, f"/{role}", type_name, "ros2msg", definition))


DECODERS = {role: decoder(role) for role in TYPES}


def bits(value: Any) -> Any:
    """Return a form in which equal means equal to the last bit, NaN and -0.0 included."""
    if isinstance(value, float):
        return struct.pack("<d", value)
    if isinstance(value, tuple):
        return tuple(bits(item) for item in value)
    if hasattr(value, "__slots__") and not isinstance(value, int):
        return type(value), tuple(bits(getattr(value, name)) for name in value.__slots__)
    return type(value), value


def block_of(messages: list[bytes]) -> Block:
    sizes = np.array([len(message) for message in messages], np.int64)
    return Block(
        b"".join(messages), np.cumsum(sizes) - sizes, sizes, np.zeros(len(sizes), HEADER_TYPE)
    )


def column_rows(role: str, messages: list[bytes], wanted: tuple[str, ...]) -> list[Any]:
    """Return one tuple of values per message, in order."""
    rows: dict[int, Any] = {}
    columns: Columns
    for columns in decoder(role).columns(block_of(messages), wanted):
        stamps = columns.stamp_ns().tolist()
        values = zip(*(columns.values[name].tolist() for name in wanted), strict=True)
        for row, stamp, value in zip(columns.rows.tolist(), stamps, values, strict=True):
            rows[row] = (stamp, *value)
    assert sorted(rows) == list(range(len(messages)))
    return [rows[i] for i in range(len(messages))]


READERS = {
    TracerSample: (names.TRACER_LENGTH, records.tracer_sample),
    TableSample: (names.JOINT_STATES, records.table_sample),
    ProbeSample: (names.PROBE_POINT, records.probe_sample),
    TemperatureSample: (names.TEMPERATURE, records.temperature_sample),
    Observation: (names.OBSERVATION, records.observation),
}


@given(tracer_samples | table_samples | temperatures | probe_samples | observations)
def test_single_messages_round_trip(record: Any) -> None:
    role, reader = READERS[type(record)]
    ((_, data),) = encode(record)
    message = DECODERS[role].message(data)
    assert message is not None
    assert bits(reader(message)) == bits(record)


@given(commands)
def test_orders_round_trip(order: Command) -> None:
    (_, table), (_, probe) = encode(order)
    decoded = records.command(
        DECODERS[names.TABLE_ANGLE].message(table), DECODERS[names.PROBE_TARGET].message(probe)
    )
    assert bits(decoded) == bits(order)


@settings(max_examples=50)
@given(st.lists(tracer_samples, min_size=1, max_size=20))
def test_tracer_columns_round_trip(samples: list[TracerSample]) -> None:
    messages = [encode(sample)[0][1] for sample in samples]
    wanted = ("header.stamp.sec", "header.stamp.nanosec", "sequence", "length", "length_std",
              "status")  # fmt: skip
    rows = column_rows(names.TRACER_LENGTH, messages, wanted)
    for (stamp, _, _, sequence, length, std, status), sample in zip(rows, samples, strict=True):
        assert (stamp, sequence, status) == (sample.stamp_ns, sample.sequence, sample.status)
        assert bits((length, std)) == bits((sample.length, sample.length_std))


joint_states = st.tuples(
    stamps,
    text,
    st.lists(text, max_size=3),
    st.lists(any_float, max_size=3),
    st.lists(any_float, max_size=3),
)


@settings(max_examples=60)
@given(st.lists(joint_states, min_size=1, max_size=8))
def test_messages_of_many_shapes(states: list[Any]) -> None:
    """Texts and lists of any length shift the fields; blocks and single messages agree."""
    messages = [
        serialised(
            TYPES[names.JOINT_STATES], stamp_ns=stamp, frame_id=frame, name=joints,
            position=floats(position), velocity=floats(velocity), effort=floats([]),
        )
        for stamp, frame, joints, position, velocity in states
    ]  # fmt: skip
    found: dict[int, Any] = {}
    wanted = ("header.stamp.sec", "header.stamp.nanosec", "position", "velocity")
    for columns in decoder(names.JOINT_STATES).columns(block_of(messages), wanted):
        for row, stamp, position, velocity in zip(
            columns.rows.tolist(),
            columns.stamp_ns().tolist(),
            columns.values["position"].tolist(),
            columns.values["velocity"].tolist(),
            strict=True,
        ):
            texts = columns.layout.texts
            found[row] = stamp, texts["header.frame_id"], texts["name"], position, velocity
    for row, (stamp, frame, joints, position, velocity) in enumerate(states):
        assert found[row][:3] == (stamp, [frame], joints)
        assert bits(tuple(found[row][3])) == bits(tuple(position))
        assert bits(tuple(found[row][4])) == bits(tuple(velocity))


def test_texts_that_nobody_asked_for_make_no_shapes_of_their_own(monkeypatch) -> None:
    """A recorder that numbers its frames: once every length was a shape, looked for among all."""
    frames = [f"frame_{k:03d}" for k in range(200)] + ["größ_01", "größ_02"]
    messages = [
        serialised(
            TYPES[names.TRACER_LENGTH], stamp_ns=k, frame_id=frame, sequence=k, length=0.5 * k,
            length_std=1e-7, status=0,
        )
        for k, frame in enumerate(frames)
    ]  # fmt: skip
    assert {len(message) for message in messages} == {len(messages[0])}
    odd = messages[3].replace(b"frame_003", b"frame_\xff03")
    walked = []
    once = decode.work_out_layout
    monkeypatch.setattr(decode, "work_out_layout", lambda *a: walked.append(a) or once(*a))
    reader = decoder(names.TRACER_LENGTH)
    found: dict[int, tuple[int, float]] = {}
    for columns in reader.columns(block_of([*messages, odd]), ("sequence", "length"), ()):
        found |= dict(zip(columns.rows.tolist(), columns.values.tolist(), strict=True))
    assert found == {k: (k, 0.5 * k) for k in range(len(frames))}
    assert reader.broken == 1
    assert len(walked) == 2  # one shape, and what is no text
    apart = decoder(names.TRACER_LENGTH).columns(block_of(messages), ("sequence",))
    assert len(list(apart)) == len(frames)


def test_big_endian_messages() -> None:
    data = STORE.serialize_cdr(
        STORE.deserialize_cdr(
            encode(TracerSample(5_000_000_007, 9, -1.25, 1e-7, LengthStatus.OK))[0][1],
            TYPES[names.TRACER_LENGTH],
        ),
        TYPES[names.TRACER_LENGTH],
        little_endian=False,
    )
    wanted = ("header.stamp.sec", "header.stamp.nanosec", "sequence", "length")
    assert column_rows(names.TRACER_LENGTH, [bytes(data)], wanted) == [
        (5_000_000_007, 5, 7, 9, -1.25)
    ]


@given(st.binary(max_size=120))
def test_garbage_is_counted_not_raised(garbage: bytes) -> None:
    reader = decoder(names.JOINT_STATES)
    message = reader.message(garbage)
    assert reader.broken == (message is None)
    wanted = ("header.stamp.sec", "header.stamp.nanosec", "position")
    decoded = sum(len(columns.rows) for columns in reader.columns(block_of([garbage]), wanted))
    assert decoded + reader.broken == 1 + (message is None)


@given(tracer_samples | table_samples | probe_samples | observations, st.integers(1, 8))
def test_unused_bytes_behind_a_message_do_not_matter(record: Any, rest: int) -> None:
    """rclpy's serialize_message leaves up to 8 of them."""
    role, reader = READERS[type(record)]
    ((_, data),) = encode(record)
    message = DECODERS[role].message(data + b"\xf0" * rest)
    assert bits(reader(message)) == bits(record)


def test_unknown_enum_values_become_unknown() -> None:
    data = serialised(
        TYPES[names.TRACER_LENGTH], stamp_ns=0, sequence=0, length=0.0, length_std=0.0, status=77
    )
    sample = records.tracer_sample(DECODERS[names.TRACER_LENGTH].message(data))
    assert sample.status is LengthStatus.UNKNOWN


def test_table_feedback_of_a_named_joint() -> None:
    data = serialised(
        TYPES[names.JOINT_STATES], stamp_ns=3, name=["tilt", "table"], position=floats([1.0, 2.0]),
        velocity=floats([]), effort=floats([]),
    )  # fmt: skip
    message = DECODERS[names.JOINT_STATES].message(data)
    sample = records.table_sample(message, "table")
    assert sample is not None
    assert (sample.stamp_ns, sample.angle) == (3, 2.0)
    assert math.isnan(sample.velocity)
    assert records.table_sample(message, "missing") is None


def test_renamed_and_extended_message_is_read_by_its_own_definition() -> None:
    """The bag's definition decides, not the one that is installed."""
    definition = (
        "uint8 new_flag\nstd_msgs/Header header\nfloat32 quality\nfloat64 length\n"
        + "=" * 80
        + "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    )
    reader = Decoder(ChannelDefinition(1, "/x", "other_msgs/msg/Tracer", "ros2msg", definition))
    data = (
        bytes([0, 1, 0, 0, 7, 0, 0, 0])
        + struct.pack("<iI", 4, 5)
        + struct.pack("<I", 4) + b"abc\0"
        + struct.pack("<fd", 0.5, 1.75)
    )  # fmt: skip
    (columns,) = reader.columns(
        block_of([data]), ("header.stamp.sec", "header.stamp.nanosec", "length")
    )
    assert columns.stamp_ns().tolist() == [4_000_000_005]
    assert columns.values["length"].tolist() == [1.75]
    with pytest.raises(BagError, match="no field sequence; it has new_flag"):
        list(reader.columns(block_of([data]), ("sequence",)))


@pytest.mark.parametrize(("encoding", "definition"), [("", ""), ("ros2msg", "float64[ x")])
def test_channel_without_usable_definition(encoding: str, definition: str) -> None:
    with pytest.raises(BagError, match="topic /x"):
        Decoder(ChannelDefinition(1, "/x", "a/msg/B", encoding, definition))
