"""Finding the next sound record behind damaged bytes."""

from __future__ import annotations

import re
from typing import BinaryIO, Final

from rotcal_ros.bags import mcap_records as mcap

_WINDOW: Final = 1 << 20
_OVERLAP: Final = 64
# An opcode of the data section, then a length below 2^32 (four zero bytes on top).
_CANDIDATE: Final = re.compile(rb"(?s)[\x02-\x07\x09\x0c\x0f](?=.{4}\x00{4})")
_INSIDE_CHUNKS: Final = (mcap.SCHEMA, mcap.CHANNEL, mcap.MESSAGE)
_LINKS: Final = 3
# Where the first text of a record stands, and the length of the record without any text.
_NAMED: Final = {
    mcap.SCHEMA: (2, 14),
    mcap.CHANNEL: (4, 16),
    mcap.METADATA: (0, 8),
    mcap.ATTACHMENT: (16, 36),
}


def find_record(file: BinaryIO, start: int, size: int, *, chunked: bool) -> int | None:
    """Return the offset of the first sound record at or after ``start``, or None.

    ``size`` is the size of the file. In a ``chunked`` file messages stand only in chunks, so
    bytes that look like messages are the content of a damaged chunk and are not taken.
    """
    position = start
    while position + mcap.HEADER_SIZE <= size:
        file.seek(position)
        window = file.read(_WINDOW + _OVERLAP)
        for match in _CANDIDATE.finditer(window):
            if match.start() >= _WINDOW:
                break
            opcode = window[match.start()]
            if chunked and opcode in _INSIDE_CHUNKS:
                continue
            if is_sound(file, position + match.start(), size, links=_LINKS):
                return position + match.start()
        position += _WINDOW
    return None


def is_sound(file: BinaryIO, offset: int, size: int, *, links: int) -> bool:
    """Tell whether a record at ``offset`` is consistent, with ``links`` more behind it."""
    if offset + mcap.HEADER_SIZE > size:
        return offset == size
    file.seek(offset)
    head = file.read(mcap.HEADER_SIZE + 64)
    opcode, length = mcap.record_header.unpack_from(head)
    content = head[mcap.HEADER_SIZE :]
    end = offset + mcap.HEADER_SIZE + length
    if length > mcap.MAX_RECORD or end > size or not _fits(opcode, length, content):
        return False
    if opcode == mcap.FOOTER:
        file.seek(end)
        return end + len(mcap.MAGIC) == size and file.read(len(mcap.MAGIC)) == mcap.MAGIC
    if opcode == mcap.CHUNK or links == 0:
        return True  # a chunk's three nested lengths do not agree by chance
    return is_sound(file, end, size, links=links - 1)


def _fits(opcode: int, length: int, content: bytes) -> bool:
    """Check the length of a record against the lengths inside it."""
    if opcode == mcap.CHUNK:
        return mcap.is_chunk(content, length)
    if opcode == mcap.MESSAGE_INDEX:
        return length == 6 + int.from_bytes(content[2:6], "little") and length % 16 == 6
    if opcode in (mcap.FOOTER, mcap.DATA_END):
        return length == (mcap.FOOTER_CONTENT if opcode == mcap.FOOTER else 4)
    if opcode == mcap.MESSAGE:
        return length >= mcap.message_header.size
    if opcode in _NAMED:
        name, shortest = _NAMED[opcode]
        text = int.from_bytes(content[name : name + 4], "little")
        return length >= shortest + text
    return 0 < opcode <= mcap.DATA_END
