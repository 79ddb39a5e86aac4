"""Messages in JSON and Protobuf: numbers by the names of their fields, without a stamp."""

import math

import pytest
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
