"""Cutting an MCAP file into its top-level records, whatever happened to it."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO, Final

from rotcal_ros.bags import mcap_records as mcap
from rotcal_ros.bags.resync import find_record, is_sound
from rotcal_ros.bags.verdict import Damage

MAX_DAMAGES: Final = 100
_PRIVATE: Final = 0x80
_EXACT: Final = {mcap.FOOTER: mcap.FOOTER_CONTENT, mcap.DATA_END: 4}


@dataclass(frozen=True, slots=True)
class Record:
    """A top-level record: where it begins, its kind and its content."""

    offset: int
    opcode: int
    content: bytes


class Framing:
    """Walks forward over the records of ``file`` and notes every fault.

    After the iteration ``damages`` holds the faults, ``truncated`` the offset where a file
    without a footer ends (else None), ``skipped`` tells whether bytes were left out, and
    ``summary_sound`` whether the index agrees with its checksum. Memory is bounded by the
    largest record, and every step moves forward.
    """

    def __init__(self, file: BinaryIO, size: int) -> None:
        self.damages: list[Damage] = []
        self.truncated: int | None = None
        self.chunked = False
        self.skipped = False
        self.summary_sound = True
        self._file = file
        self._size = size
        self._crc: int | None = 0
        self._summary_crc = 0
        self._in_summary = False
        self._finished = False
        self._rejected = False

    def reject(self, record: Record, what: str) -> None:
        """Note that the content of the record yielded last is broken."""
        self.damage(record.offset, what)
        self._rejected = True

    def damage(self, offset: int, what: str) -> None:
        """Note a fault."""
        if len(self.damages) < MAX_DAMAGES:
            self.damages.append(Damage(offset, what))

    def records(self) -> Iterator[Record]:
        """Yield all records that can be told apart, up to and with the footer."""
        position: int | None = self._begin()
        while position is not None and not self._finished:
            if position + mcap.HEADER_SIZE > self._size:
                self.truncated = position
                return
            self._file.seek(position)
            head = self._file.read(mcap.HEADER_SIZE)
            opcode, length = mcap.record_header.unpack(head)
            record = self._read(position, opcode, length)
            if record is None:
                position = self._after_fault(position)
                continue
            if record.opcode == mcap.CHUNK:
                self.chunked = True
            self._checksum(record, head)
            yield record
            position = self._behind(record)

    def _behind(self, record: Record) -> int | None:
        """Return where the next record is; a broken one may have lied about its length."""
        end = record.offset + mcap.HEADER_SIZE + len(record.content)
        rejected, self._rejected = self._rejected, False
        if not rejected or self._sound(end):
            return end
        self.skipped = True
        found = self._search(record.offset + 1)
        return end if found is None else found

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
        return len(mcap.MAGIC) if self._sound(len(mcap.MAGIC)) else self._search(0)

    def _read(self, offset: int, opcode: int, length: int) -> Record | None:
        """Return the record at ``offset``, repaired where its own fields allow, or None."""
        fits = length <= min(mcap.MAX_RECORD, self._size - offset - mcap.HEADER_SIZE)
        if fits:
            content = self._file.read(length)
            if self._consistent(opcode, content):
                return Record(offset, opcode, content)
        return self._repaired_chunk(offset, length)

    def _consistent(self, opcode: int, content: bytes) -> bool:
        if opcode == mcap.CHUNK:
            return mcap.is_chunk(content, len(content))
        if opcode == mcap.MESSAGE:
            return len(content) >= 22 and not self.chunked
        if opcode == mcap.MESSAGE_INDEX:
            return len(content) == 6 + int.from_bytes(content[2:6], "little")
        if opcode in _EXACT:
            return len(content) == _EXACT[opcode]
        if mcap.HEADER <= opcode <= mcap.DATA_END:
            return True
        return opcode >= _PRIVATE and not mcap.is_chunk(content, len(content))

    def _repaired_chunk(self, offset: int, length: int) -> Record | None:
        """Return a chunk whose opcode or one of whose two lengths is wrong."""
        self._file.seek(offset + mcap.HEADER_SIZE)
        begin = self._file.read(64)
        inner = mcap.chunk_size(begin)
        if not inner or inner > min(mcap.MAX_RECORD, self._size - offset - mcap.HEADER_SIZE):
            return None
        if not self._sound(offset + mcap.HEADER_SIZE + inner):
            return None
        self._file.seek(offset + mcap.HEADER_SIZE)
        self._crc = None
        what = "the opcode of a chunk" if inner == length else "the length of a chunk"
        self.damage(offset, f"{what} is wrong; its content was read all the same")
        return Record(offset, mcap.CHUNK, self._file.read(inner))

    def _sound(self, offset: int) -> bool:
        return is_sound(self._file, offset, self._size, links=1)

    def _after_fault(self, offset: int) -> int | None:
        """Note the fault at ``offset`` and return where reading can go on, or None."""
        found = self._search(offset + 1)
        self.skipped = True
        if found is None:
            self.truncated = offset
        else:
            self.damage(offset, f"{found - offset} bytes cannot be read")
        return found

    def _search(self, start: int) -> int | None:
        self._crc = None
        return find_record(self._file, start, self._size, chunked=self.chunked)

    def _checksum(self, record: Record, head: bytes) -> None:
        """Follow the checksums of data section and summary, and judge them at their ends."""
        content = record.content
        if record.opcode == mcap.DATA_END and not self._in_summary:
            self._in_summary = True
            stated = int.from_bytes(content, "little")
            if stated and self._crc is not None and stated != self._crc:
                self.damage(record.offset, "the checksum over all data is wrong")
        elif record.opcode == mcap.FOOTER:
            self._finished = True
            crc = zlib.crc32(content[:-4], zlib.crc32(head, self._summary_crc))
            stated = int.from_bytes(content[-4:], "little")
            if stated and stated != crc:
                self.summary_sound = False
                self.damage(record.offset, "the checksum of the index is wrong")
            self._finish(record.offset + mcap.HEADER_SIZE + len(content))
        elif self._in_summary:
            self._summary_crc = zlib.crc32(content, zlib.crc32(head, self._summary_crc))
        elif self._crc is not None:
            self._crc = zlib.crc32(content, zlib.crc32(head, self._crc))

    def _finish(self, end: int) -> None:
        self._file.seek(end)
        tail = self._file.read(len(mcap.MAGIC) + 1)
        if tail != mcap.MAGIC:
            if mcap.MAGIC.startswith(tail):
                self.truncated = end
            else:
                self.damage(end, "the file does not end as an MCAP file")
