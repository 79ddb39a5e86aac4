"""Where the fields of a serialised message stand, for decoding many messages at once.

As long as the lengths of their texts and lists agree, every field of messages of one type stands
at the same byte. A layout is worked out from one message; it fits all those that are equal to it
in size and lengths, and in the texts that are asked for.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from rosbags.interfaces import Nodetype

from rotcal_ros.arrays import Bools, Bytes, Ints
from rotcal_ros.bags.mcap_records import DamagedRecord

Fields = Sequence[tuple[str, Any]]
Definitions = Mapping[str, tuple[Any, Fields]]
"""Message type -> (constants, fields), as rosbags parses it."""

_ENCAPSULATION: Final = 4
_ASCII: Final = 0x7F
"""Largest byte of a text that is UTF-8 whatever stands beside it."""
NUMBERS: Final = {
    "bool": "u1", "byte": "u1", "char": "u1", "octet": "u1", "uint8": "u1", "int8": "i1",
    "uint16": "u2", "int16": "i2", "uint32": "u4", "int32": "i4", "uint64": "u8", "int64": "i8",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
"""Kind and size in bytes of each base type, for numpy."""


@dataclass
class Layout:
    """Fields of one shape of a message.

    ``fields`` maps a dotted name (``header.stamp.sec``, ``position``) to (dtype, offset);
    a list of numbers is one field with a shape. ``texts`` maps names to lists of texts.
    ``fixed`` are (begin, end) ranges of bytes that every message of this shape has in common,
    ``written`` those of the texts by name.
    The fields end at ``end``; some serialisers leave unused bytes behind them, up to ``size``.
    """

    size: int
    end: int = 0
    fields: dict[str, tuple[np.dtype[Any], int]] = field(default_factory=dict)
    texts: dict[str, list[str]] = field(default_factory=dict)
    fixed: list[tuple[int, int]] = field(default_factory=list)
    written: dict[str, list[tuple[int, int]]] = field(default_factory=dict)

    def dtype(self, wanted: Sequence[str]) -> np.dtype[np.void]:
        """Return the structured type that reads the ``wanted`` fields from a message."""
        picked = [self.fields[name] for name in wanted]
        return np.dtype(
            {
                "names": list(wanted),
                "formats": [dtype for dtype, _ in picked],
                "offsets": [offset for _, offset in picked],
                "itemsize": self.size,
            }
        )

    def fits(self, rows: Bytes, template: Bytes, alike: Collection[str] | None = None) -> Bools:
        """Tell which rows have the shape of ``template``, of which this is the layout.

        The texts named by ``alike`` have to be the same, None: all; others to be UTF-8.
        """
        ranges, free = list(self.fixed), list[tuple[int, int]]()
        for name, places in self.written.items():
            (ranges if alike is None or name in alike else free).extend(places)
        wrong = rows[:, _bytes(ranges)] != template[_bytes(ranges)]
        same: Bools = ~wrong.any(axis=1) if wrong.any() else np.ones(len(rows), np.bool_)
        if free:
            odd = same & (rows[:, _bytes(free)] > _ASCII).any(axis=1)
            for row in np.flatnonzero(odd):
                same[row] = all(_readable(rows[row, begin:end]) for begin, end in free)
        return same


def _bytes(ranges: Sequence[tuple[int, int]]) -> Ints:
    """Return the places of all bytes of some ranges."""
    return np.concatenate([np.arange(begin, end) for begin, end in ranges])


def _readable(text: Bytes) -> bool:
    """Whether a text is UTF-8."""
    try:
        text.tobytes().decode()
    except UnicodeDecodeError:
        return False
    return True


def work_out_layout(message: bytes, type_name: str, definitions: Definitions) -> Layout:
    """Return the layout of one serialised message; raises DamagedRecord when it is broken."""
    return _Walk(message, definitions).layout(type_name)


class _Walk:
    """Steps through one message in classic CDR, either byte order."""

    def __init__(self, message: bytes, definitions: Definitions) -> None:
        if len(message) < _ENCAPSULATION or message[0] != 0 or message[1] > 1:
            raise DamagedRecord("a message is not serialised as plain CDR")
        self._order = "<" if message[1] else ">"
        self._message = message
        self._definitions = definitions
        self._position = _ENCAPSULATION
        self._layout = Layout(len(message), fixed=[(0, 2)])

    def layout(self, type_name: str) -> Layout:
        self._message_fields(type_name, "")
        self._layout.end = self._position
        return self._layout

    def _message_fields(self, type_name: str, prefix: str) -> None:
        if type_name not in self._definitions:
            raise DamagedRecord(f"the definition of {type_name} is missing")
        for name, (kind, detail) in self._definitions[type_name][1]:
            self._field(f"{prefix}{name}", kind, detail)

    def _field(self, name: str, kind: Nodetype, detail: Any) -> None:
        if kind == Nodetype.BASE:
            self._numbers(name, detail[0], None)
        elif kind == Nodetype.NAME:
            self._message_fields(detail, f"{name}.")
        else:
            (inner, inner_detail), count = detail
            if kind == Nodetype.SEQUENCE:
                count = self._count()
            if inner == Nodetype.BASE:
                self._numbers(name, inner_detail[0], count)
            else:
                self._check_count(count)
                for index in range(count):
                    self._message_fields(inner_detail, f"{name}.{index}.")

    def _numbers(self, name: str, base: str, count: int | None) -> None:
        if base == "string":
            self._check_count(count or 0)
            places = self._layout.written.setdefault(name, [])
            count = 1 if count is None else count
            self._layout.texts[name] = [self._text(places) for _ in range(count)]
            return
        if base not in NUMBERS:
            raise DamagedRecord(f"field {name} has the type {base}, which has no fixed size")
        item = np.dtype(self._order + NUMBERS[base])
        if count == 0:
            self._layout.fields[name] = (np.dtype((item, (0,))), self._position)
            return
        offset = self._take(item.itemsize, item.itemsize * (1 if count is None else count))
        dtype = item if count is None else np.dtype((item, (count,)))
        self._layout.fields[name] = (dtype, offset)

    def _count(self) -> int:
        """Read the length of a list or text; it is part of the shape."""
        offset = self._take(4, 4)
        self._layout.fixed.append((offset, offset + 4))
        order = "little" if self._order == "<" else "big"
        return int.from_bytes(self._message[offset : offset + 4], order)  # type: ignore[arg-type]

    def _text(self, places: list[tuple[int, int]]) -> str:
        length = self._count()
        offset = self._take(1, length)
        places.append((offset, offset + length))
        try:
            return self._message[offset : offset + length].rstrip(b"\0").decode()
        except UnicodeDecodeError:
            raise DamagedRecord("a text in a message is not UTF-8") from None

    def _check_count(self, count: int) -> None:
        """Refuse a list that cannot be in a message of this size, before walking over it."""
        if count > len(self._message):
            raise DamagedRecord(f"a list of {count} elements in {len(self._message)} bytes")

    def _take(self, alignment: int, size: int) -> int:
        """Align, step over ``size`` bytes and return where they begin."""
        padding = -(self._position - _ENCAPSULATION) % alignment
        begin = self._position + padding
        if begin + size > len(self._message):
            raise DamagedRecord("a message is shorter than its fields")
        self._position = begin + size
        return begin
