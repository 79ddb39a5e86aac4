"""Finding the next sound record behind damaged bytes."""

from __future__ import annotations

import re
from typing import BinaryIO, Final

from rotcal_ros.bags.mcap_records import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    FOOTER_CONTENT,
    HEADER_SIZE,
    MAGIC,
    MAX_RECORD,
    MESSAGE,
    MESSAGE_INDEX,
    METADATA,
    SCHEMA,
    is_chunk,
    message_header,
    record_header,
)

_WINDOW: Final = 1 << 20
_OVERLAP: Final = 64
# An opcode of the data section, then a length below 2^32 (four zero bytes on top).
_CANDIDATE: Final = re.compile(rb"(?s)[\x02-\x07\x09\x0c\x0f](?=.{4}\x00{4})")
_INSIDE_CHUNKS: Final = (SCHEMA, CHANNEL, MESSAGE)
_LINKS: Final = 3
# Where the first text of a record stands, and the length of the record without any text.
_NAMED: Final = {SCHEMA: (2, 14), CHANNEL: (4, 16), METADATA: (0, 8), ATTACHMENT: (16, 36)}


def find_record(file: BinaryIO, start: int, size: int, *, chunked: bool) -> int | None:
    """Return the offset of the first sound record at or after ``start``, or None.

    ``size`` is the size of the file. In a ``chunked`` file messages stand only in chunks, so
    bytes that look like messages are the content of a damaged chunk and are not taken.
    """
    position = start
    while position + HEADER_SIZE <= size:
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
    if offset + HEADER_SIZE > size:
        return offset == size
    file.seek(offset)
    head = file.read(HEADER_SIZE + 64)
    opcode, length = record_header.unpack_from(head)
    content = head[HEADER_SIZE:]
    end = offset + HEADER_SIZE + length
    if length > MAX_RECORD or end > size or not _fits(opcode, length, content):
        return False
    if opcode == FOOTER:
        file.seek(end)
        return end + len(MAGIC) == size and file.read(len(MAGIC)) == MAGIC
    if opcode == CHUNK or links == 0:
        return True  # a chunk's three nested lengths do not agree by chance
    return is_sound(file, end, size, links=links - 1)


def _fits(opcode: int, length: int, content: bytes) -> bool:
    """Check the length of a record against the lengths inside it."""
    if opcode == CHUNK:
        return is_chunk(content, length)
    if opcode == MESSAGE_INDEX:
        return length == 6 + int.from_bytes(content[2:6], "little") and length % 16 == 6
    if opcode in (FOOTER, DATA_END):
        return length == (FOOTER_CONTENT if opcode == FOOTER else 4)
    if opcode == MESSAGE:
        return length >= message_header.size
    if opcode in _NAMED:
        name, shortest = _NAMED[opcode]
        text = int.from_bytes(content[name : name + 4], "little")
        return length >= shortest + text
    return 0 < opcode <= DATA_END
