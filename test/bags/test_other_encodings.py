"""Messages in JSON and Protobuf: numbers by the names of their fields, without a stamp."""

import json
import math
import struct

import pytest
from google.protobuf import descriptor_pb2
from mcap.writer import Writer
from other_messages import described, write_messages

from rotcal_ros.bags.definitions import ChannelDefinition, schema_text
from rotcal_ros.bags.other_encodings import decoder_of
from rotcal_ros.bags.reader import read_blocks
from rotcal_ros.bags.settings import DEFAULT_LIMITS
from rotcal_ros.foundation.errors import BagError

SENT = [{"beam": {"distance": 1.5}, "angle": 0.25}, {"beam": {"distance": -2.0}, "angle": 0.0}]


def columns(path, *wanted):
    """The wanted fields of all messages of the only topic, and its decoder."""
    ((scan, block), *_) = [(s, b) for s, b in read_blocks((path,), None, DEFAULT_LIMITS) if b]
    (channel,) = scan.channels.values()
    decoder = decoder_of(channel)
    (found,) = decoder.columns(block, wanted)
    return found, decoder


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
def test_numbers_are_found_by_their_fields(encoding, tmp_path):
    path = tmp_path / "theirs.mcap"
    write_messages(path, encoding, [("/sent", fields, 7 + k) for k, fields in enumerate(SENT)])
    found, decoder = columns(path, "beam.distance", "angle")
    assert found.values["beam.distance"].tolist() == [1.5, -2.0]
    assert found.values["angle"].tolist() == [0.25, 0.0]
    assert (found.rows.tolist(), decoder.broken) == ([0, 1], 0)
    with pytest.raises(
        BagError, match=r"cell\.Sent has no field beam\.length; it has beam, angle"
    ):
        columns(path, "beam.length")


def test_null_is_no_reading_and_what_is_no_message_is_counted(tmp_path):
    path = tmp_path / "theirs.mcap"
    messages = [b'{"length": 1.0}', b'{"length": null}', b"[1]", b'{"length": "long"}', b"{"]
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/lengths", "json", 0)
        for number, data in enumerate(messages):
            writer.add_message(channel, number, data, number, number)
        writer.finish()
    found, decoder = columns(path, "length")
    first, second = found.values["length"].tolist()
    assert first == 1.0
    assert math.isnan(second)
    assert (found.rows.tolist(), decoder.broken) == ([0, 1], 3)


@pytest.mark.parametrize("schema", [b"no descriptor", described().SerializeToString()[:40], b""])
def test_a_broken_schema_costs_its_topic_alone(schema):
    channel = ChannelDefinition(
        1, "/lengths", "cell.Sent", "protobuf", schema_text(schema), message_encoding="protobuf"
    )
    with pytest.raises(BagError, match=r"topic /lengths: the schema of cell\.Sent cannot"):
        decoder_of(channel)


def block_of(path, encoding, schema, messages):
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        kind, data = schema
        number = writer.register_schema("cell.Axis", kind, data) if kind else 0
        channel = writer.register_channel("/axis", encoding, number)
        for at, message in enumerate(messages):
            writer.add_message(channel, at, message, at, at)
        writer.finish()
    ((scan, block), *_) = [(s, b) for s, b in read_blocks((path,), None, DEFAULT_LIMITS) if b]
    (found,) = scan.channels.values()
    return decoder_of(found), block


def test_lists_of_json_are_read_with_their_names_and_by_place(tmp_path):
    sent = [
        {"name": ["x", "table"], "position": [0.5, 1.0]},
        {"name": ["table"], "position": [2.0]},
        {"name": ["x", "table"], "position": [0.5, 3.0]},
    ]
    decoder, block = block_of(
        tmp_path / "j.mcap", "json", ("", b""), [json.dumps(each).encode() for each in sent]
    )
    pairs, single = decoder.columns(block, ["position"], ["name"])
    assert pairs.values["position"].tolist() == [[0.5, 1.0], [0.5, 3.0]]
    assert pairs.layout.texts == {"name": ["x", "table"]}
    assert (pairs.rows.tolist(), single.rows.tolist()) == ([0, 2], [1])
    assert single.values["position"].tolist() == [[2.0]]
    (second,) = decoder.columns(block, ["position.1"])
    assert second.values["position.1"] == pytest.approx([1.0, math.nan, 3.0], nan_ok=True)


def test_a_number_that_protobuf_left_out_is_none_only_where_it_can_be(tmp_path):
    """A plain field of proto3 that is 0 is not sent; an optional one that is not sent is none."""
    file = descriptor_pb2.FileDescriptorProto(name="a.proto", package="cell", syntax="proto3")
    axis = file.message_type.add(name="Axis")
    axis.field.add(name="plain", number=1, type=1, label=1)
    axis.oneof_decl.add(name="_sure")
    axis.field.add(name="sure", number=2, type=1, label=1, oneof_index=0, proto3_optional=True)
    axis.field.add(name="all", number=3, type=1, label=3)
    schema = descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()
    sent = [b"", b"\x11" + struct.pack("<d", 7.0), b"\x1a\x10" + struct.pack("<dd", 1.0, 2.0)]
    decoder, block = block_of(tmp_path / "p.mcap", "protobuf", ("protobuf", schema), sent)
    (found,) = decoder.columns(block, ["plain", "sure", "all.1"])
    assert found.values["plain"].tolist() == [0.0, 0.0, 0.0]
    assert found.values["sure"] == pytest.approx([math.nan, 7.0, math.nan], nan_ok=True)
    assert found.values["all.1"] == pytest.approx([math.nan, math.nan, 2.0], nan_ok=True)
