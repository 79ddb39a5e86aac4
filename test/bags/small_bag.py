"""A small sound bag with everything that a bag of somebody else may hold, and its truth."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

from mcap.writer import Writer

from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.mcap_scan import McapScan
from rotcal_ros.bags.storage_scan import FileVerdict

Key = tuple[str, int, bytes]
"""Topic, log time and payload of a message."""

PROTOBUF = b"\x0a\x05\xff\xfe\x80abc\x00\x01"
SCHEMAS = {
    "/ros": ("std_msgs/msg/Float64", "ros2msg", b"float64 data\n", "cdr"),
    "/empty": ("std_msgs/msg/Empty", "ros2msg", b"", "cdr"),
    "/pb": ("foxglove.Pose", "protobuf", PROTOBUF, "protobuf"),
    "/fb": ("foxglove.Grid", "flatbuffer", bytes(range(200, 256)), "flatbuffer"),
    "/js": ("thing", "jsonschema", '{"type": "object", "title": "é"}'.encode(), "json"),
}
NONE = "/none"
ATTACHMENTS = {"notes.txt": b"first", "zeros.bin": bytes(40)}
METADATA = {"site": {"hall": "3", "table": "ä"}}


@dataclass(frozen=True)
class Read:
    """What a pass over a file gave."""

    messages: Counter[Key]
    verdict: FileVerdict
    scan: McapScan


def small_bag(rounds: int = 12, chunk_size: int = 1000, **options: object) -> bytes:
    """Return an MCAP file with six topics of different encodings, attachments and metadata."""
    file = BytesIO()
    writer = Writer(file, chunk_size=chunk_size, **options)  # type: ignore[arg-type]
    writer.start(profile="", library="somebody else")
    channels = {}
    for topic, (name, encoding, data, messages) in SCHEMAS.items():
        schema = writer.register_schema(name, encoding, data)
        channels[topic] = writer.register_channel(topic, messages, schema, {"of": topic})
    channels[NONE] = writer.register_channel(NONE, "raw", 0)
    for number in range(rounds):
        for place, (topic, channel) in enumerate(channels.items()):
            time = 10 * number + place
            writer.add_message(channel, time, payload(topic, number), time, number)
        if number == rounds // 2:
            for name, data in ATTACHMENTS.items():
                writer.add_attachment(3, 4, name, "application/octet-stream", data)
            for name, texts in METADATA.items():
                writer.add_metadata(name, texts)
    writer.finish()
    return file.getvalue()


def payload(topic: str, number: int) -> bytes:
    """Return a message; those of ROS look like CDR."""
    head = b"\x00\x01\x00\x00" if topic in ("/ros", "/empty") else b"\x08"
    return head + bytes((number * 7 + i) % 251 for i in range(0 if topic == "/empty" else 40))


def truth(rounds: int = 12) -> Counter[Key]:
    """Return the messages of :func:`small_bag`."""
    topics = [*SCHEMAS, NONE]
    return Counter(
        (topic, 10 * number + place, payload(topic, number))
        for number in range(rounds)
        for place, topic in enumerate(topics)
    )


def read(path: Path, *, check_index: bool = True) -> Read:
    """Read a file to its end."""
    scan = McapScan(path, check_index=check_index)
    messages = Counter[Key]()
    for block in scan.blocks():
        messages += keys(scan, block)
    return Read(messages, scan.verdict(), scan)


def keys(scan: McapScan, block: Block) -> Counter[Key]:
    """Return the messages of a block."""
    return Counter(
        (scan.channels[channel].topic, time, block.payload(row))
        for row, (channel, _, time, _) in enumerate(block.headers.tolist())
    )
