"""Cuts an MCAP file into its top-level records, whatever happened to it.

It finds the next sound record after damaged bytes.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO, Final

from rotcal_ros.bags import mcap_records as mcap
from rotcal_ros.bags.storage_scan import Damage

MAX_DAMAGES: Final = 100
_EXACT: Final = {mcap.FOOTER: mcap.FOOTER_CONTENT, mcap.DATA_END: 4}
_MOST_REREAD: Final = 4
"""A file may be read again this many times its size after faults: the time stays in proportion."""
_STEP: Final = 1 << 20


@dataclass(frozen=True, slots=True)
class Record:
    """A top-level record: where it begins and ends, its kind and its content.

    The content of one that is larger than the limit is not read and is empty.
    """

    offset: int
    opcode: int
    content: bytes
    end: int

    @property
    def size(self) -> int:
        """Bytes of the content in the file."""
        return self.end - self.offset - mcap.HEADER_SIZE


class Framing:
    """Walks forward over the records of ``file`` and notes every fault.

    Records of more than ``largest`` bytes are not read. After the iteration

    * ``damages`` holds the faults, ``index_faults`` those of the index alone,
    * ``truncated`` is the offset where a file without a footer ends, else None,
    * ``cut_off`` says whether it ends within a message or a chunk of messages,
    * ``skipped`` says whether bytes were left out,
    * ``data_sound`` says whether the data section has no fault, ``data_proven`` whether its
      checksum confirms that, ``summary_sound`` whether the summary agrees with its own.

    Memory is bounded by the largest record, time by the size of the file.
    """

    def __init__(self, file: BinaryIO, size: int, largest: int) -> None:
        self.damages: list[Damage] = []
        self.index_faults: list[Damage] = []
        self.truncated: int | None = None
        self.cut_off = False
        self.chunked = False
        self.skipped = False
        self.in_summary = False
        self.data_sound = False
        self.data_proven = False
        self.summary_sound = True
        self._file = file
        self._size = size
        self._largest = largest
        self._crc: int | None = 0
        self._summary_crc = 0
        self._behind_chunk = False
        self._finished = False
        self._rejected = False
        self._fields_end: int | None = None
        self._rereads_left = _MOST_REREAD * size + _STEP

    def reject(self, record: Record, what: str) -> None:
        """Note that the content of the last record is broken."""
        fault = self.index_fault if self.in_summary and self.data_sound else self.damage
        fault(record.offset, what)
        self._rejected = True

    def note_fields_end(self, record: Record, fields_end: int) -> None:
        """Note where the known fields end in the content of the last record."""
        self._fields_end = record.offset + mcap.HEADER_SIZE + fields_end

    def damage(self, offset: int, what: str) -> None:
        """Note a fault."""
        if len(self.damages) < MAX_DAMAGES:
            self.damages.append(Damage(offset, what))

    def index_fault(self, offset: int, what: str) -> None:
        """Note a fault of the index, without which the data can be read."""
        if len(self.index_faults) < MAX_DAMAGES:
            self.index_faults.append(Damage(offset, what))

    def records(self) -> Iterator[Record]:
        """Yield all records that can be recognised, up to and with the footer."""
        position: int | None = self._begin()
        while position is not None and not self._finished:
            if position + mcap.HEADER_SIZE > self._size:
                self._cut_at(position)
                return
            self._file.seek(position)
            head = self._file.read(mcap.HEADER_SIZE)
            opcode, length = mcap.record_header.unpack(head)
            record = self._read(position, opcode, length)
            if record is None:
                position = self._after_fault(position, length)
                continue
            if record.opcode == mcap.CHUNK:
                self.chunked = True
            self._behind_chunk = record.opcode in (mcap.CHUNK, mcap.MESSAGE_INDEX)
            self._checksum(record, head)
            yield record
            position = self._next_offset(record)

    def _next_offset(self, record: Record) -> int | None:
        """Return where the next record begins; the length of a broken one may be wrong."""
        rejected, self._rejected = self._rejected, False
        fields_end, self._fields_end = self._fields_end, None
        if rejected:
            if self._sound(record.end):
                return record.end
            self.skipped = True
            found = self._search(record.offset + 1, record.size)
            return record.end if found is None else found
        if fields_end is None or fields_end == record.end:
            return record.end
        return self._next_offset_of_longer(record, fields_end)

    def _next_offset_of_longer(self, record: Record, fields_end: int) -> int:
        """Return where the next record begins after one that is longer than its known fields.

        Later versions of MCAP may add fields at the end of a record, so what follows the known
        ones is skipped, unless records can be read there: then its length is wrong.
        """
        if not self._sound(fields_end):
            if self._sound(record.end):
                return record.end
            found = self._search(fields_end, record.size)
            if found is None:
                return record.end
            fields_end, self.skipped = found, True
        self._crc = None
        self.damage(record.offset, "the length of a record is wrong; its fields could be read")
        return fields_end

    def _begin(self) -> int | None:
        self._file.seek(0)
        magic = self._file.read(len(mcap.MAGIC))
        if magic == mcap.MAGIC:
            self._crc = zlib.crc32(mcap.MAGIC)
            return len(mcap.MAGIC)
        if mcap.MAGIC.startswith(magic):
            self.truncated = 0
            return None
        self._crc = None
        self.damage(0, "the file does not begin as an MCAP file")
        return len(mcap.MAGIC) if self._sound(len(mcap.MAGIC)) else self._search(0, 0)

    def _read(self, offset: int, opcode: int, length: int) -> Record | None:
        """Return the record at ``offset``, repaired where its own fields allow, or None."""
        end = offset + mcap.HEADER_SIZE + length
        if end <= self._size and length > self._largest and self._sound(end):
            return Record(offset, opcode, b"", end)
        if end <= self._size and length <= self._largest:
            content = self._file.read(length)
            if self._consistent(opcode, content, end):
                return Record(offset, opcode, content, end)
        return self._repaired_chunk(offset, length)

    def _consistent(self, opcode: int, content: bytes, end: int) -> bool:
        if opcode == mcap.CHUNK:
            return 0 < mcap.chunk_size(content) <= len(content)
        if opcode == mcap.MESSAGE:
            suspect = self.skipped or (self._behind_chunk and mcap.is_message_index(content))
            suspect = self.in_summary or (self.chunked and suspect)
            return len(content) >= mcap.MESSAGE_FIXED and not suspect
        if opcode == mcap.MESSAGE_INDEX:
            return len(content) >= 6 + int.from_bytes(content[2:6], "little")
        if opcode in _EXACT:
            return len(content) == _EXACT[opcode]
        if mcap.HEADER <= opcode <= mcap.DATA_END:
            return True
        # MCAP allows private and future kinds of records; it is one if records follow it.
        if opcode == 0 or mcap.chunk_size(content) == len(content) > 0:
            return False
        return is_sound(self._file, end, self._size, links=0, unknown=0)

    def _repaired_chunk(self, offset: int, length: int) -> Record | None:
        """Return a chunk whose opcode or one of whose two lengths is wrong."""
        begin_at = offset + mcap.HEADER_SIZE
        self._file.seek(begin_at)
        inner = mcap.chunk_size(self._file.read(64))
        if not inner or inner > min(self._largest, self._size - begin_at):
            return None
        if not self._sound(begin_at + inner):
            return None
        self._file.seek(begin_at)
        self._crc = None
        what = "the opcode of a chunk" if inner == length else "the length of a chunk"
        self.damage(offset, f"{what} is wrong; its content was read nevertheless")
        return Record(offset, mcap.CHUNK, self._file.read(inner), begin_at + inner)

    def _sound(self, offset: int) -> bool:
        return is_sound(self._file, offset, self._size, links=1)

    def _after_fault(self, offset: int, length: int) -> int | None:
        """Note the fault at ``offset``; return where the next sound record begins, or None."""
        was_read = length <= self._largest and offset + mcap.HEADER_SIZE + length <= self._size
        found = self._search(offset + 1, length if was_read else 0)
        self.skipped = True
        if found is None:
            self._cut_at(offset)
        else:
            self.damage(offset, f"{found - offset} bytes cannot be read")
        return found

    def _cut_at(self, offset: int) -> None:
        self.truncated = offset
        self._file.seek(offset)
        self.cut_off = self._file.read(1) in _WITH_MESSAGES

    def _search(self, start: int, read_before: int) -> int | None:
        """Look for a record; ``read_before`` of the bytes from here were read before."""
        self._crc = None
        self._rereads_left -= read_before
        if self._rereads_left < 0:
            self.damage(start, "too much is damaged to go on")
            return None
        return find_record(self._file, start, self._size, chunked=self.chunked)

    def _checksum(self, record: Record, head: bytes) -> None:
        """Continue the checksums of data section and summary, and compare them at their ends.

        That of the data covers all from the magic bytes to DataEnd, that of the summary all from
        there to the footer and its fields before the checksum itself. Zero means: not computed.
        """
        content = record.content
        if record.opcode == mcap.DATA_END and not self.in_summary:
            self.in_summary = True
            stated = int.from_bytes(content, "little")
            if stated and self._crc is not None and stated != self._crc:
                self.damage(record.offset, "the checksum over all data is wrong")
            self.data_sound = not self.damages
            self.data_proven = self.data_sound and stated != 0
        elif record.opcode == mcap.FOOTER:
            self._finished = True
            crc = zlib.crc32(content[:-4], zlib.crc32(head, self._summary_crc))
            stated = int.from_bytes(content[-4:], "little")
            if stated and stated != crc:
                self.summary_sound = False
                fault = self.index_fault if self.data_sound else self.damage
                fault(record.offset, "the checksum of the index is wrong")
            self._finish(record.end)
        elif self.in_summary:
            self._summary_crc = self._crc_of(record, zlib.crc32(head, self._summary_crc))
        elif self._crc is not None:
            self._crc = self._crc_of(record, zlib.crc32(head, self._crc))

    def _crc_of(self, record: Record, crc: int) -> int:
        """Return ``crc`` continued over the content of a record, read or not."""
        crc = zlib.crc32(record.content, crc)
        position = record.offset + mcap.HEADER_SIZE + len(record.content)
        while position < record.end:
            self._file.seek(position)
            part = self._file.read(min(_STEP, record.end - position))
            crc = zlib.crc32(part, crc)
            position += max(1, len(part))
        return crc

    def _finish(self, end: int) -> None:
        self._file.seek(end)
        tail = self._file.read(len(mcap.MAGIC) + 1)
        if tail != mcap.MAGIC:
            if mcap.MAGIC.startswith(tail):
                self.truncated = end
            else:
                self.damage(end, "the file does not end as an MCAP file")


_WITH_MESSAGES: Final = (bytes([mcap.MESSAGE]), bytes([mcap.CHUNK]))
_FIRST_WINDOW: Final = 1 << 12
_LARGEST_WINDOW: Final = 1 << 20
_HEAD: Final = mcap.HEADER_SIZE + 64
"""Bytes of a record that show whether it is consistent."""
# An opcode of the data section, then a length below 2^32 (four zero bytes on top).
_CANDIDATE: Final = re.compile(rb"(?s)[\x02-\x07\x09\x0c\x0f](?=.{4}\x00{4})")
_INSIDE_CHUNKS: Final = (mcap.SCHEMA, mcap.CHANNEL, mcap.MESSAGE)
_LINKS: Final = 3
_MOST_UNKNOWN: Final = 4
"""So many records of unknown kinds in a row are stepped over: they prove little."""
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
    time is proportional to the bytes from ``start`` to what is found.
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
    """Return whether a record at ``offset`` is consistent, and ``links`` more after it.

    Besides these there may be ``unknown`` records of unknown kinds.
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
    """Return where the record that begins with ``head`` ends, or None if it is not a record."""
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
        return length >= 6 + entries and entries % mcap.INDEX_ENTRY == 0
    if opcode in (mcap.FOOTER, mcap.DATA_END):
        return length == (mcap.FOOTER_CONTENT if opcode == mcap.FOOTER else 4)
    if opcode == mcap.MESSAGE:
        return length >= mcap.MESSAGE_FIXED
    if opcode in _NAMED:
        name, shortest = _NAMED[opcode]
        text = int.from_bytes(content[name : name + 4], "little")
        return length >= shortest + text
    return opcode > 0
