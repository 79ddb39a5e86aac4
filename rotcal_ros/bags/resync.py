"""Finding the next sound record behind damaged bytes."""

from __future__ import annotations

import re
from typing import BinaryIO, Final

from rotcal_ros.bags import mcap_records as mcap

_FIRST_WINDOW: Final = 1 << 12
_LARGEST_WINDOW: Final = 1 << 20
_HEAD: Final = mcap.HEADER_SIZE + 64
"""Bytes of a record that tell whether it is consistent."""
# An opcode of the data section, then a length below 2^32 (four zero bytes on top).
_CANDIDATE: Final = re.compile(rb"(?s)[\x02-\x07\x09\x0c\x0f](?=.{4}\x00{4})")
_INSIDE_CHUNKS: Final = (mcap.SCHEMA, mcap.CHANNEL, mcap.MESSAGE)
_LINKS: Final = 3
_MOST_UNKNOWN: Final = 4
"""Records of unknown kinds in a row, which prove little, that are stepped over."""
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
    bytes that look like messages are the content of a damaged chunk and are not taken. The
    time is proportional to the way from ``start`` to what is found.
    """
    position, width = start, _FIRST_WINDOW
    while position + mcap.HEADER_SIZE <= size:
        file.seek(position)
        window = file.read(width + _HEAD)
        for match in _CANDIDATE.finditer(window):
            begin = match.start()
            if begin >= width:
                break
            if chunked and window[begin] in _INSIDE_CHUNKS:
                continue
            head = window[begin : begin + _HEAD]
            if _end(head, position + begin, size) is None:
                continue
            if is_sound(file, position + begin, size, links=_LINKS):
                return position + begin
        position += width
        width = min(2 * width, _LARGEST_WINDOW)
    return None


def is_sound(
    file: BinaryIO, offset: int, size: int, *, links: int, unknown: int = _MOST_UNKNOWN
) -> bool:
    """Tell whether a record at ``offset`` is consistent, with ``links`` more behind it.

    Of unknown kinds there may be ``unknown`` beside these.
    """
    while offset != size:
        file.seek(offset)
        head = file.read(_HEAD)
        end = _end(head, offset, size)
        if end is None:
            return False
        opcode = head[0]
        if opcode == mcap.FOOTER:
            file.seek(end)
            return end + len(mcap.MAGIC) == size and file.read(len(mcap.MAGIC)) == mcap.MAGIC
        inner = mcap.chunk_size(head[mcap.HEADER_SIZE :]) if opcode == mcap.CHUNK else 0
        if inner and offset + mcap.HEADER_SIZE + inner == end:
            return True  # a chunk's three nested lengths do not agree by chance
        if opcode > mcap.DATA_END and unknown:
            unknown -= 1
        elif links == 0:
            return True
        else:
            links -= 1
        offset = end
    return True


def _end(head: bytes, offset: int, size: int) -> int | None:
    """Return where the record that begins with ``head`` ends, or None where it is none."""
    if len(head) < mcap.HEADER_SIZE:
        return None
    opcode, length = mcap.record_header.unpack_from(head)
    end = offset + mcap.HEADER_SIZE + length
    fits = end <= size and _fits(opcode, length, head[mcap.HEADER_SIZE :])
    return end if fits else None


def _fits(opcode: int, length: int, content: bytes) -> bool:
    """Check the length of a record against the lengths inside it; it may have been extended."""
    if opcode == mcap.CHUNK:
        return 0 < mcap.chunk_size(content) <= length
    if opcode == mcap.MESSAGE_INDEX:
        entries = int.from_bytes(content[2:6], "little")
        return length >= 6 + entries and entries % 16 == 0
    if opcode in (mcap.FOOTER, mcap.DATA_END):
        return length == (mcap.FOOTER_CONTENT if opcode == mcap.FOOTER else 4)
    if opcode == mcap.MESSAGE:
        return length >= mcap.MESSAGE_FIXED
    if opcode in _NAMED:
        name, shortest = _NAMED[opcode]
        text = int.from_bytes(content[name : name + 4], "little")
        return length >= shortest + text
    return opcode > 0
