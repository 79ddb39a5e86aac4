"""Rows of a sqlite3 file straight from its leaf pages, whatever has become of the tree above.

Layout: https://sqlite.org/fileformat2.html, "B-tree Pages" and "Record Format".
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import BinaryIO, Final

from rotcal_ros.bags.reading_limits import LARGEST_MESSAGE

Value = None | int | float | bytes
Row = tuple[int, tuple[Value, ...]]
"""Row id and columns; texts are bytes like blobs."""

PAGE_SIZES: Final = tuple(1 << power for power in range(9, 17))
FILE_HEADER: Final = 100
_TABLE_LEAF: Final = 13
_LEAF_HEADER: Final = struct.Struct(">BHHHB")
_INTEGER_BYTES: Final = (0, 1, 2, 3, 4, 6, 8)
_MAX_COLUMNS: Final = 64
_MAX_OVERFLOW: Final = 4
"""Overflow pages are read this often at most, on average: no file is worse than linear."""


class _NoRow(Exception):  # noqa: N818 - not an error for the user, but a finding
    """A cell that holds no row."""


@dataclass
class LeafPages:
    """The leaf pages of tables in ``file``, whose pages have ``page_size`` bytes.

    ``reserved`` bytes at the end of every page belong to somebody else.
    """

    file: BinaryIO
    page_size: int
    reserved: int = 0

    def __post_init__(self) -> None:
        self._size = self.file.seek(0, 2)
        self._budget = _MAX_OVERFLOW * self._size

    def rows(self, limit: int | None = None) -> Iterator[Row]:
        """Yield the rows of all leaf pages that begin before byte ``limit``."""
        for offset in range(0, min(self._size, limit or self._size), self.page_size):
            page = self._page(offset)
            begin = FILE_HEADER if offset == 0 else 0
            if len(page) < begin + _LEAF_HEADER.size or page[begin] != _TABLE_LEAF:
                continue
            _, _, count, _, _ = _LEAF_HEADER.unpack_from(page, begin)
            first = begin + _LEAF_HEADER.size
            for place in range(first, min(first + 2 * count, len(page) - 1), 2):
                pointer = int.from_bytes(page[place : place + 2], "big")
                with suppress(_NoRow):
                    yield self._row(page, pointer % self.page_size)  # as sqlite3 takes it

    def _page(self, offset: int) -> bytes:
        """Return a page, or what is left of it at the end of a cut file."""
        if offset >= self._size:
            return b""
        self.file.seek(offset)
        return self.file.read(self.page_size)[: self.page_size - self.reserved]

    def _row(self, page: bytes, position: int) -> Row:
        size, position = _varint(page, position)
        row_id, position = _varint(page, position)
        if not 0 < size <= LARGEST_MESSAGE:
            raise _NoRow
        here = self._bytes_on_page(size)
        if position + here > len(page):
            raise _NoRow
        payload = page[position : position + here]
        if here < size:
            payload += self._overflow(page[position + here : position + here + 4], size - here)
        return _signed(row_id), _columns(payload)

    def _bytes_on_page(self, size: int) -> int:
        """Return how much of a payload stands on its leaf page; the rest overflows."""
        usable = self.page_size - self.reserved
        if size <= usable - 35:
            return size
        least = (usable - 12) * 32 // 255 - 23
        wanted = least + (size - least) % (usable - 4)
        return wanted if wanted <= usable - 35 else least

    def _overflow(self, link: bytes, size: int) -> bytes:
        parts: list[bytes] = []
        while size > 0:
            number = int.from_bytes(link, "big")
            page = self._page((number - 1) * self.page_size) if number > 1 else b""
            part = page[4 : 4 + size]
            self._budget -= len(page)
            if not part or self._budget < 0:
                raise _NoRow
            parts.append(part)
            link, size = page[:4], size - len(part)
        return b"".join(parts)


def _columns(payload: bytes) -> tuple[Value, ...]:
    """Return the values of a record; raises _NoRow unless they fill it."""
    header, position = _varint(payload, 0)
    kinds: list[int] = []
    while position < header and len(kinds) < _MAX_COLUMNS:
        kind, position = _varint(payload, position)
        kinds.append(kind)
    if position != header:
        raise _NoRow
    values: list[Value] = []
    for kind in kinds:
        size = _INTEGER_BYTES[kind] if kind < 7 else 8 if kind == 7 else max(0, kind - 12) // 2
        content = payload[position : position + size]
        if len(content) < size or kind in (10, 11):
            raise _NoRow
        values.append(_value(kind, content))
        position += size
    if position != len(payload):
        raise _NoRow
    return tuple(values)


def _value(kind: int, content: bytes) -> Value:
    if kind == 0:
        return None
    if kind == 7:
        return float(struct.unpack(">d", content)[0])
    if kind in (8, 9):
        return kind - 8
    return content if kind >= 12 else int.from_bytes(content, "big", signed=True)


def _varint(data: bytes, position: int) -> tuple[int, int]:
    """Return a number of 1 to 9 bytes and where it ends."""
    value = 0
    for count in range(9):
        if position + count >= len(data):
            raise _NoRow
        byte = data[position + count]
        if count == 8:
            return value << 8 | byte, position + 9
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, position + count + 1
    raise _NoRow


def _signed(value: int) -> int:
    return value - (1 << 64) if value >> 63 else value
