"""The definitions in the summary of an MCAP file, read before its data."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from typing import BinaryIO, Final

from rotcal_ros.bags import mcap_records as mcap
from rotcal_ros.bags.framing import Record

_TAIL: Final = mcap.HEADER_SIZE + mcap.FOOTER_CONTENT + len(mcap.MAGIC)
_CRC_SIZE: Final = 4


def summary_definitions(file: BinaryIO, size: int, largest: int) -> Iterator[tuple[Record, bool]]:
    """Yield the schemas and channels of the summary, and whether a checksum covers them.

    A summary with a wrong checksum, or one of more than ``largest`` bytes, yields none.
    """
    if size < _TAIL:
        return
    file.seek(size - _TAIL)
    footer = file.read(_TAIL)
    start = int.from_bytes(footer[mcap.HEADER_SIZE : mcap.HEADER_SIZE + 8], "little")
    end = size - _TAIL
    sound = footer[0] == mcap.FOOTER and footer.endswith(mcap.MAGIC)
    if not sound or not 0 < start < end or end - start > largest:
        return
    file.seek(start)
    summary = file.read(end - start)
    fields = footer[: -len(mcap.MAGIC)]
    stated = int.from_bytes(fields[-_CRC_SIZE:], "little")
    if stated and stated != zlib.crc32(fields[:-_CRC_SIZE], zlib.crc32(summary)):
        return
    position = 0
    while position + mcap.HEADER_SIZE <= len(summary):
        opcode, length = mcap.record_header.unpack_from(summary, position)
        begin = position + mcap.HEADER_SIZE
        if opcode in (mcap.SCHEMA, mcap.CHANNEL):
            content = summary[begin : begin + length]
            yield Record(start + position, opcode, content, start + begin + length), stated != 0
        position = begin + length
