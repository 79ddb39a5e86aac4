"""Records out of place are named; the specification says where they stand."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
import small_bag
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader
from mcap_matrix import MAGIC, Message, message_record, pairs, record, text

HEADER = record(0x01, text("") + text(""))
SCHEMA = record(0x03, struct.pack("<H", 1) + text("Example") + text("c") + text(b"\4\5\6"))
CHANNEL = record(0x04, struct.pack("<HH", 1, 1) + text("example") + text("a") + pairs({"a": "b"}))
MESSAGE = message_record(Message(2, 1, 10))
INDEX = record(0x07, struct.pack("<H", 1) + text(struct.pack("<QQ", 2, 0)))
DATA_END = record(0x0F, bytes(4))
FOOTER = record(0x02, bytes(20))
STATISTICS = record(0x0B, struct.pack("<QHIIIIQQ", 1, 1, 1, 0, 0, 0, 2, 2) + text(b""))
EXTENDED = record(0x03, struct.pack("<H", 1) + text("Example") + text("c") + text(b"\4"), b"\1\2")
SHORT_MAP = CHANNEL.replace(pairs({"a": "b"}), struct.pack("<I", 5) + text("a") + text("b"))


def chunk(*inside: bytes) -> bytes:
    data = b"".join(inside)
    fields = struct.pack("<QQQI", 2, 2, len(data), 0) + text("")
    return record(0x06, fields + struct.pack("<Q", len(data)) + data)


SOUND = {
    "no chunk": (HEADER, SCHEMA, CHANNEL, MESSAGE, DATA_END, FOOTER),
    "a chunk": (HEADER, chunk(SCHEMA, CHANNEL, MESSAGE), DATA_END, FOOTER),
    "definitions before the chunk": (HEADER, SCHEMA, CHANNEL, chunk(MESSAGE), DATA_END, FOOTER),
    "an extended record in a chunk": (
        HEADER, chunk(EXTENDED, CHANNEL, MESSAGE), DATA_END, FOOTER,
    ),
}  # fmt: skip

EARLY = "messages of channel 1 stand before its definition"
REFUSED = {
    "message before channel": ((HEADER, SCHEMA, MESSAGE, CHANNEL, DATA_END, FOOTER), EARLY),
    "the same in a chunk": ((HEADER, chunk(SCHEMA, MESSAGE, CHANNEL), DATA_END, FOOTER), EARLY),
    "channel in a later chunk": (
        (HEADER, chunk(SCHEMA, MESSAGE), chunk(CHANNEL), DATA_END, FOOTER), EARLY,
    ),
    "channel in the summary alone": (
        (HEADER, SCHEMA, MESSAGE, DATA_END, CHANNEL, FOOTER), EARLY,
    ),
    "channel before schema": (
        (HEADER, CHANNEL, SCHEMA, MESSAGE, DATA_END, FOOTER), "a schema that is not there",
    ),
    "the same, in a chunk": (
        (HEADER, chunk(CHANNEL, SCHEMA, MESSAGE), DATA_END, FOOTER), "a schema that is not there",
    ),
}  # fmt: skip
NAMED = {
    "no header": ((SCHEMA, CHANNEL, MESSAGE, DATA_END, FOOTER), "does not begin with a header"),
    "two headers": (
        (HEADER, SCHEMA, CHANNEL, HEADER, MESSAGE, DATA_END, FOOTER), "a second header",
    ),
    "index without chunk": (
        (HEADER, SCHEMA, CHANNEL, MESSAGE, INDEX, DATA_END, FOOTER), "without a chunk before it",
    ),
    "no end of the data": ((HEADER, SCHEMA, CHANNEL, MESSAGE, FOOTER), "data is not marked"),
    "two ends of the data": (
        (HEADER, SCHEMA, CHANNEL, MESSAGE, DATA_END, DATA_END, FOOTER), "a second end",
    ),
    "statistics among the data": (
        (HEADER, SCHEMA, CHANNEL, STATISTICS, MESSAGE, DATA_END, FOOTER), "among the data",
    ),
    "a chunk in the summary": (
        (HEADER, SCHEMA, CHANNEL, DATA_END, chunk(MESSAGE), FOOTER), "stands in the summary",
    ),
    "texts beyond their map": (
        (HEADER, SCHEMA, SHORT_MAP, MESSAGE, DATA_END, FOOTER), "a map of texts",
    ),
}  # fmt: skip


def written(folder: Path, records: tuple[bytes, ...]) -> Path:
    path = folder / "bag.mcap"
    path.write_bytes(MAGIC + b"".join(records) + MAGIC)
    return path


@pytest.mark.parametrize("case", SOUND)
def test_what_is_in_place_is_complete(case: str, tmp_path: Path) -> None:
    found = small_bag.read(written(tmp_path, SOUND[case]))
    assert found.verdict.describe() == "complete"
    assert found.verdict.messages == 1


@pytest.mark.parametrize("case", REFUSED)
def test_what_readers_of_streams_refuse_is_named(case: str, tmp_path: Path) -> None:
    records, named = REFUSED[case]
    path = written(tmp_path, records)
    with path.open("rb") as file, pytest.raises(McapError):
        list(NonSeekingReader(file).iter_messages())
    assert_named(path, named)


@pytest.mark.parametrize("case", NAMED)
def test_what_stands_elsewhere_is_named(case: str, tmp_path: Path) -> None:
    records, named = NAMED[case]
    path = written(tmp_path, records)
    assert_named(path, named)
    assert small_bag.read(path).verdict.messages == 1


def assert_named(path: Path, named: str) -> None:
    verdict = small_bag.read(path).verdict
    assert verdict.state == "damaged"
    assert any(named in damage.what for damage in verdict.damages), verdict.damages
    assert verdict.messages + verdict.lost == 1
