"""Schemas are bytes: whatever a bag holds is read, checked and repaired byte for byte."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import small_bag
from mcap.reader import make_reader
from mcap.records import Channel, Schema
from mcap.writer import CompressionType

from rotcal_ros.bags.definitions import dump_definitions, parse_definitions, schema_bytes
from rotcal_ros.bags.repair import repair

PRESETS: dict[str, dict[str, Any]] = {
    "fastwrite": {"use_chunking": False, "enable_crcs": False},
    "zstd_fast": {"chunk_size": 1000, "enable_crcs": False},
    "zstd_small": {"chunk_size": 4 << 20},
    "lz4": {"compression": CompressionType.LZ4},
    "none": {"compression": CompressionType.NONE},
}


@pytest.mark.parametrize("preset", PRESETS)
def test_all_encodings_are_read_in_every_storage_preset(preset: str, tmp_path: Path) -> None:
    path = tmp_path / "theirs.MCAP"
    path.write_bytes(small_bag.small_bag(**PRESETS[preset]))
    found = small_bag.read(path)
    assert found.messages == small_bag.truth()
    assert found.verdict.describe() == "complete"
    by_topic = {channel.topic: channel for channel in found.scan.channels.values()}
    assert by_topic.keys() == {*small_bag.SCHEMAS, small_bag.NONE}
    for topic, (name, encoding, data, messages) in small_bag.SCHEMAS.items():
        channel = by_topic[topic]
        assert (channel.type_name, channel.encoding, channel.message_encoding) == (
            name, encoding, messages,
        )  # fmt: skip
        assert schema_bytes(channel.definition) == data


def test_repair_keeps_them(tmp_path: Path) -> None:
    (tmp_path / "theirs.mcap").write_bytes(small_bag.small_bag()[:-300])
    (after,) = repair(tmp_path / "theirs.mcap", tmp_path / "good").after
    assert after.state == "complete"
    assert small_bag.read(after.path).messages == small_bag.truth()
    with after.path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = [(s, c) for s, c, m in reader.iter_messages() if m.sequence == 0]
        kept = {a.name: (a.log_time, a.create_time, a.data) for a in reader.iter_attachments()}
        notes = {note.name: note.metadata for note in reader.iter_metadata()}
    assert {c.topic: _described(s, c) for s, c in found} == {
        **small_bag.SCHEMAS,
        small_bag.NONE: ("", "", b"", "raw"),
    }
    assert all(c.metadata.get("of", c.topic) == c.topic for _, c in found)
    for name, data in small_bag.ATTACHMENTS.items():
        assert kept[name] == (4, 3, data)
    assert {name: notes[name] for name in small_bag.METADATA} == small_bag.METADATA


def _described(schema: Schema | None, channel: Channel) -> tuple[str, str, bytes, str]:
    parts = (schema.name, schema.encoding, schema.data) if schema else ("", "", b"")
    return *parts, channel.message_encoding


def test_definitions_json_keeps_any_bytes(tmp_path: Path) -> None:
    path = tmp_path / "theirs.mcap"
    path.write_bytes(small_bag.small_bag())
    channels = tuple(small_bag.read(path).scan.channels.values())
    assert parse_definitions(dump_definitions(channels)) == channels
