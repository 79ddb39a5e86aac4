"""Every file that the MCAP specification allows for a few contents, byte for byte.

The contents and features are those of the conformance inputs of the format's makers; the bytes
are put together here from the specification (https://mcap.dev/spec) alone.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import combinations

MAGIC = b"\x89MCAP0\r\n"
PADDING = b"\x01\xff\xff"
FEATURES = ("ax", "ch", "chx", "mdx", "mx", "pad", "rch", "rsh", "st", "sum")
"""Attachment index, chunk, chunk index, metadata index, message index, padded records, channels
and schemas repeated in the summary, statistics, summary offsets."""


@dataclass(frozen=True)
class Message:
    log_time: int
    publish_time: int
    sequence: int
    data: bytes = b"\x01\x02\x03"


@dataclass(frozen=True)
class Content:
    """What a file holds, whatever its features; one channel with the id 1 at most."""

    name: str
    schema: tuple[str, str, bytes] | None = None
    channel: tuple[str, str, dict[str, str]] | None = None
    messages: tuple[Message, ...] = ()
    attachments: tuple[tuple[str, str, int, int, bytes], ...] = ()
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)


SCHEMA = ("Example", "c", b"\x04\x05\x06")
CHANNEL = ("example", "a", {"foo": "bar"})
CONTENTS = (
    Content("NoData"),
    Content(
        "OneSchemalessMessage", None, ("example", "text", {}), (Message(2, 1, 10),)
    ),
    Content("OneMessage", SCHEMA, CHANNEL, (Message(2, 1, 10),)),
    Content(
        "OneAttachment", attachments=(("myFile", "application/octet-stream", 2, 1, b"\1\2\3"),)
    ),
    Content("OneMetadata", metadata={"myMetadata": {"foo": "bar"}}),
    Content(
        "TenMessages",
        SCHEMA,
        CHANNEL,
        tuple(Message(t, t, i) for i, t in enumerate((0, 2, 1, 3, 3, 5, 4, 7, 8, 9))),
    ),
)  # fmt: skip


def matrix() -> Iterator[tuple[str, Content, frozenset[str]]]:
    """Yield (name, content, features) of every variant that makes sense."""
    for content in CONTENTS:
        for number in range(len(FEATURES) + 1):
            for chosen in combinations(FEATURES, number):
                if _makes_sense(content, features := frozenset(chosen)):
                    yield "-".join((content.name, *chosen)), content, features


def _makes_sense(content: Content, features: frozenset[str]) -> bool:
    needs = {
        "ax": bool(content.attachments),
        "mdx": bool(content.metadata),
        "rsh": content.schema is not None,
        "rch": content.channel is not None,
        "ch": content.channel is not None,
        "chx": "ch" in features,
        "mx": "ch" in features,
        "sum": bool(features & {"chx", "rsh", "rch", "mdx", "ax", "st"}),
    }
    return all(needs.get(feature, True) for feature in features)


def text(value: str | bytes) -> bytes:
    data = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(data)) + data


def pairs(values: dict[str, str]) -> bytes:
    return text(b"".join(text(key) + text(value) for key, value in values.items()))


def record(opcode: int, content: bytes, extension: bytes = b"") -> bytes:
    return struct.pack("<BQ", opcode, len(content + extension)) + content + extension


def mcap_file(content: Content, features: frozenset[str], padding: bytes = PADDING) -> bytes:
    """Return the file with ``content`` and ``features``."""
    pad = padding if "pad" in features else b""
    data = MAGIC + record(0x01, text("") + text(""), pad)
    definitions = _definitions(content, b"" if "ch" in features else pad)
    attached, noted, chunks = b"", b"", b""
    for name, kind, log_time, create_time, body in content.attachments:
        fields = struct.pack("<QQ", log_time, create_time) + text(name) + text(kind)
        fields += struct.pack("<Q", len(body)) + body
        whole = record(0x09, fields + struct.pack("<I", zlib.crc32(fields)), pad)
        place = struct.pack("<QQQQQ", len(data), len(whole), log_time, create_time, len(body))
        attached += record(0x0A, place + text(name) + text(kind), pad)
        data += whole
    for name, values in content.metadata.items():
        whole = record(0x0C, text(name) + pairs(values), pad)
        noted += record(0x0D, struct.pack("<QQ", len(data), len(whole)) + text(name), pad)
        data += whole
    if "ch" in features:
        data, chunks = _with_chunk(data, content, b"".join(definitions.values()), features, pad)
    else:
        data += b"".join(definitions.values()) + b"".join(map(message_record, content.messages))
    data += record(0x0F, struct.pack("<I", zlib.crc32(data)))
    padded = _definitions(content, pad)
    groups = {
        0x03: padded.get(0x03, b"") if "rsh" in features else b"",
        0x04: padded.get(0x04, b"") if "rch" in features else b"",
        0x0B: record(0x0B, _statistics(content, features), pad) if "st" in features else b"",
        0x0D: noted if "mdx" in features else b"",
        0x0A: attached if "ax" in features else b"",
        0x08: chunks if "chx" in features else b"",
    }
    return data + _summary(len(data), groups, features, pad) + MAGIC


def message_record(message: Message) -> bytes:
    times = (message.log_time, message.publish_time)
    return record(0x05, struct.pack("<HIQQ", 1, message.sequence, *times) + message.data)


def _definitions(content: Content, pad: bytes) -> dict[int, bytes]:
    records = {}
    if content.schema is not None:
        name, encoding, data = content.schema
        fields = struct.pack("<H", 1) + text(name) + text(encoding) + text(data)
        records[0x03] = record(0x03, fields, pad)
    if content.channel is not None:
        topic, encoding, metadata = content.channel
        ids = struct.pack("<HH", 1, 1 if content.schema else 0)
        records[0x04] = record(0x04, ids + text(topic) + text(encoding) + pairs(metadata), pad)
    return records


def _with_chunk(
    data: bytes, content: Content, inside: bytes, features: frozenset[str], pad: bytes
) -> tuple[bytes, bytes]:
    """Return ``data`` with the chunk and its message index, and the chunk's own index."""
    entries = b""
    for message in content.messages:
        entries += struct.pack("<QQ", message.log_time, len(inside))
        inside += message_record(message)
    times = [message.log_time for message in content.messages] or [0]
    span = struct.pack("<QQ", min(times), max(times))
    sizes = struct.pack("<QI", len(inside), zlib.crc32(inside))
    chunk = record(0x06, span + sizes + text("") + struct.pack("<Q", len(inside)) + inside)
    index = record(0x07, struct.pack("<H", 1) + text(entries), pad) if "mx" in features else b""
    place = struct.pack("<HQ", 1, len(data) + len(chunk)) if index else b""
    fields = span + struct.pack("<QQ", len(data), len(chunk)) + text(place)
    fields += struct.pack("<Q", len(index)) + text("")
    fields += struct.pack("<QQ", len(inside), len(inside))
    return data + chunk + index, record(0x08, fields, pad)


def _statistics(content: Content, features: frozenset[str]) -> bytes:
    times = [message.log_time for message in content.messages] or [0]
    number = len(content.messages)
    counts = struct.pack("<HQ", 1, number) if number else b""
    return struct.pack(
        "<QHIIIIQQ",
        number,
        content.schema is not None,
        content.channel is not None,
        len(content.attachments),
        len(content.metadata),
        "ch" in features,
        min(times),
        max(times),
    ) + text(counts)


def _summary(begin: int, groups: dict[int, bytes], features: frozenset[str], pad: bytes) -> bytes:
    """Return all that follows the data section, up to the footer."""
    summary, offsets = b"", b""
    for opcode, group in groups.items():
        if group:
            place = struct.pack("<BQQ", opcode, begin + len(summary), len(group))
            offsets += record(0x0E, place, pad)
        summary += group
    start = begin if summary else 0
    offset_start = begin + len(summary) if "sum" in features else 0
    if "sum" in features:
        summary += offsets
    footer = struct.pack("<BQQQ", 0x02, 20, start, offset_start)
    return summary + footer + struct.pack("<I", zlib.crc32(summary + footer))
