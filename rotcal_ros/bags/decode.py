"""Decodes the messages of one channel by the definition in the bag.

Many messages are decoded at once: if the lengths of their texts and lists agree, every field of
messages of one type stands at the same byte. A layout is worked out from one message; it fits all
that equal it in size and lengths, and in the texts that are asked for. Neither definitions nor
messages are trusted.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.mcap_records import DamagedRecord
from rotcal_ros.bags.settings import LARGEST_MESSAGE
from rotcal_ros.foundation.arrays import Bools, Bytes, Ints
from rotcal_ros.foundation.errors import BagError

_MAX_LAYOUTS: Final = 64
_HEADER: Final = (Nodetype.NAME, "std_msgs/msg/Header")


@dataclass(frozen=True)
class Columns:
    """Fields of messages of one shape.

    ``rows`` are those of the messages in the block; ``values`` has one element per row, with the
    wanted fields by their dotted names; ``layout`` has the texts that were asked for, which all
    rows have in common.
    """

    rows: Ints
    values: NDArray[np.void]
    layout: FieldLayout

    def stamp_ns(self) -> Ints:
        """Return the header's stamps in integer nanoseconds."""
        seconds = self.values["header.stamp.sec"].astype(np.int64)
        stamps: Ints = seconds * 1_000_000_000 + self.values["header.stamp.nanosec"]
        return stamps


class Decoder:
    """Decodes the messages of one channel; ``broken`` counts those that could not be.

    ``unreadable`` says why, if all of them are in a form that is not read.

    ``begins_with_header`` says that seconds and nanoseconds of a stamp stand first in a message.

    Raises BagError when the channel's definition cannot be used.
    """

    def __init__(self, channel: ChannelDefinition) -> None:
        self.channel = channel
        self.broken = 0
        self.unreadable = ""
        self._store, self.definitions = message_types(channel)
        self._layouts: dict[int, list[tuple[FieldLayout, Bytes]]] = {}
        fields = self.definitions[channel.type_name][1]
        self.begins_with_header = bool(fields) and fields[0][1] == _HEADER

    def message(self, data: bytes) -> Any | None:
        """Return one message as an object whose attributes are its fields, as in rclpy.

        None, and counted as broken, when the bytes are not such a message.
        """
        if self._is_of_other_form(data):
            self.broken += 1
            return None
        if data[1:2] in _XCDR2:
            with suppress(DamagedRecord):
                data = plain_cdr(data, self.channel.type_name, self.definitions)
        with suppress(Exception):
            return self._store.deserialize_cdr(data, self.channel.type_name)
        # Some serialisers, as rclpy's, leave unused bytes at the end.
        with suppress(Exception):
            end = work_out_layout(data, self.channel.type_name, self.definitions).end
            return self._store.deserialize_cdr(data[:end], self.channel.type_name)
        self.broken += 1
        return None

    def columns(
        self, block: Block, wanted: Sequence[str], alike: Collection[str] | None = None
    ) -> Iterator[Columns]:
        """Yield the ``wanted`` fields of all messages of ``block``, shape by shape.

        Messages of one shape have the texts named by ``alike`` in common, None: all texts.
        Lists that are shorter than wanted and missing fields raise BagError.
        """
        for rows, raw in block.equally_long():
            rest = np.arange(len(rows))
            while len(rest):
                found = self._layout(raw[rest[0]], alike)
                if found is None:
                    self.broken += 1
                    rest = rest[1:]
                    continue
                layout, template = found
                same = layout.fits(raw[rest], template, alike)
                chosen = rest[same]
                values = raw[chosen].view(self._dtype(layout, wanted))[:, 0]
                yield Columns(rows[chosen], values, layout)
                rest = rest[~same]

    def _layout(
        self, message: Bytes, alike: Collection[str] | None
    ) -> tuple[FieldLayout, Bytes] | None:
        """Return a layout that fits ``message``, known or new; None when it is broken."""
        known = self._layouts.setdefault(len(message), [])
        for layout, template in known:
            if layout.fits(message[np.newaxis], template, alike)[0]:
                return layout, template
        if self._is_of_other_form(message[:_ENCAPSULATION].tobytes()):
            return None
        try:
            layout = work_out_layout(message.tobytes(), self.channel.type_name, self.definitions)
        except DamagedRecord:
            return None
        if len(known) >= _MAX_LAYOUTS:
            known.clear()
        known.append((layout, message.copy()))
        return known[-1]

    def _is_of_other_form(self, data: bytes) -> bool:
        """Return whether a message is in no form of CDR that is read, and name it."""
        name = _OTHER_FORMS.get(data[:2])
        if name is None:
            return False
        self.unreadable = (
            f"topic {self.channel.topic}: messages of {self.channel.type_name} are serialised as "
            f"{name}, which cannot be read (plain CDR and plain CDR2 can): declare the type "
            "@final in its writer, or record with a middleware of ROS 2"
        )
        return True

    def _dtype(self, layout: FieldLayout, wanted: Sequence[str]) -> np.dtype[np.void]:
        missing = [name for name in wanted if layout.place(name) is None]
        if missing:
            raise BagError(
                f"topic {self.channel.topic}: {self.channel.type_name} has no field "
                f"{', '.join(missing)}; it has {', '.join(layout.fields) or 'none'}"
            )
        return layout.dtype(wanted)


MAX_DEFINITION: Final = 1 << 18
"""Longest definition that is parsed, in characters; ROS's own have at most a tenth of that."""
MAX_DEPTH: Final = 64
"""How deeply messages may be nested."""
_REMEMBERED: Final = 1 << 14
"""Longest definition whose types are remembered: those of ROS and ours are shorter."""
_MAX_ELEMENTS: Final = 10_000
"""Most elements of arrays of texts and messages together: rosbags writes code for each."""
_ENCODINGS: Final = ("cdr", "")
_TIMES: Final = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_TIMES_DEFINITION: Final = "int32 sec\nuint32 nanosec\n"
"""The definition of Time and Duration in every distribution of ROS 2; a bag may leave it out."""
_SHOWN: Final = 60
_LINE_END: Final = re.compile(r"[ \t]*(?:\r\n?|\n)")
"""An end of a line, as on Windows too, with the blanks that editors leave before it."""
_IDL_PARTS: Final = re.compile(r"(?m)^={80}\n(?:IDL: .*\n)?")
"""What MCAP's ``ros2idl`` has before every definition, the first one too."""
_PREPROCESSOR: Final = re.compile(r"(?m)^[ \t]*#.*$")
"""Lines that rosidl generates, ``#include``: what they name stands in the other parts."""
_ENUMERATION: Final = re.compile(r"\benum\s+(\w+)\s*\{[^{}]*\}")
_PLACE: Final = re.compile(r"\n(\d+)\n")


class _Unusable(Exception):  # noqa: N818 - becomes a BagError that names the topic
    """What is wrong with a definition."""


def message_types(channel: ChannelDefinition) -> tuple[Typestore, Definitions]:
    """Return the store that decodes the messages of ``channel``, and the types in it.

    Raises BagError when there is no definition or none that can be used.
    """
    if channel.encoding not in ("ros2msg", "ros2idl"):
        if not channel.encoding:
            raise BagError(
                f"topic {channel.topic}: the bag holds no definition of "
                f"{channel.type_name or 'its messages'}; "
                "convert it with 'ros2 bag convert' where the package of this type is installed"
            )
        raise BagError(
            f"topic {channel.topic}: the schema {channel.type_name} is described in "
            f"{channel.encoding!r}, its messages are in {channel.message_encoding!r}: only "
            "cdr of ros2msg or ros2idl, json and protobuf are read; publish it as a message of "
            "ROS 2 and record that, or write its numbers into a table (docs/formats.md)"
        )
    if channel.message_encoding not in _ENCODINGS:
        raise BagError(
            f"topic {channel.topic}: its messages are serialised as "
            f"{channel.message_encoding!r}, which cannot be read (cdr can); record it from ROS 2"
        )
    remembered = len(channel.definition) <= _REMEMBERED
    try:
        store = (_store if remembered else _store.__wrapped__)(
            channel.type_name, channel.encoding, channel.definition
        )
    except _Unusable as error:
        reason = str(error)
    except Exception as error:
        reason = _in_one_line(error)
    else:
        return store, store.fielddefs
    raise BagError(
        f"topic {channel.topic}: the definition of {channel.type_name} cannot be read: {reason}; "
        "correct it in its package, and record again"
    )


@lru_cache(maxsize=64)
def _store(type_name: str, encoding: str, definition: str) -> Typestore:
    """Return the store with the types of a definition; bags of one cell share it."""
    types = _time_types() | _parsed(type_name, encoding, definition)
    _TypeCheck(types).least_size(type_name)
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    return store


def _parsed(type_name: str, encoding: str, definition: str) -> dict[str, Any]:
    if len(definition) > MAX_DEFINITION:
        raise _Unusable(f"it is longer than {MAX_DEFINITION} characters")
    text = _LINE_END.sub("\n", definition.removeprefix("\ufeff"))
    if encoding == "ros2idl":
        parts = _IDL_PARTS.split(_without_enumerations(_PREPROCESSOR.sub("", text)))
        return {
            name: fields
            for part in parts
            if part.strip()
            for name, fields in get_types_from_idl(part).items()
        }
    return dict(get_types_from_msg(text, type_name))


def _without_enumerations(idl: str) -> str:
    """Return definitions whose enumerations are structures of a number of 32 bits, as in CDR.

    Those of another size, and lists of them, which CDR2 writes in two ways, stay and are refused.
    """

    def replaced(found: re.Match[str]) -> str:
        name = found[1]
        listed = re.search(rf"<[\w:]*\b{name}\b|\b{name}\s+\w+\s*\[", idl)
        return found[0] if listed or "@bit_bound" in idl else f"struct {name} {{ int32 value; }}"

    return _ENUMERATION.sub(replaced, idl)


class _TypeCheck:
    """Refuses types that contain themselves or are too large to be those of real messages."""

    def __init__(self, types: Mapping[str, Any]) -> None:
        self._types = types
        self._sizes: dict[str, int] = {}
        self._path: list[str] = []
        self._elements = 0

    def least_size(self, name: str) -> int:
        """Return the least number of bytes of a message of type ``name``."""
        if name in self._sizes:
            return self._sizes[name]
        if name not in self._types:
            raise _Unusable(f"it does not define {_short(name)}")
        if name in self._path:
            raise _Unusable(f"{_short(name)} contains itself")
        if len(self._path) >= MAX_DEPTH:
            raise _Unusable(f"more than {MAX_DEPTH} messages nested in each other")
        self._path.append(name)
        size = sum(self._field(field, *kind) for field, kind in self._types[name][1])
        self._path.pop()
        if size > LARGEST_MESSAGE:
            raise _Unusable(
                f"{_short(name)} has at least {size} bytes, more than {LARGEST_MESSAGE}"
            )
        # A message without fields has one byte in CDR, structure_needs_at_least_one_member.
        self._sizes[name] = max(1, size)
        return self._sizes[name]

    def _field(self, name: str, kind: Nodetype, detail: Any) -> int:
        if kind == Nodetype.NAME:
            return self.least_size(detail)
        if kind == Nodetype.BASE:
            base = detail[0]
            if base != "string" and base not in NUMBERS:
                raise _Unusable(f"field {_short(name)} is a {base}, which is not supported")
            return 4 if base == "string" else int(NUMBERS[base][1])
        inner, count = detail
        size = self._field(name, *inner)
        if kind == Nodetype.SEQUENCE:
            return 4
        self._elements += count if inner[0] == Nodetype.NAME or inner[1][0] == "string" else 0
        if count < 1 or self._elements > _MAX_ELEMENTS:
            raise _Unusable(f"field {_short(name)} is an array of {_short(str(count))} elements")
        return int(size * count)


def _in_one_line(error: Exception) -> str:
    """Return where the parser stopped, or its message, without the whole text."""
    lines = str(error).splitlines() or [type(error).__name__]
    place = _PLACE.search(str(error))
    if place is None:
        return _short(lines[0])
    rest = str(error)[place.end() :].strip().splitlines()
    return f"it ends too early or makes no sense at {_short(rest[0] if rest else '')!r}"


def _short(text: str) -> str:
    shown = text.encode("unicode_escape").decode()
    return shown if len(shown) <= _SHOWN else f"{shown[:_SHOWN]}..."


@cache
def _time_types() -> dict[str, Any]:
    return {name: get_types_from_msg(_TIMES_DEFINITION, name)[name] for name in _TIMES}


Fields = Sequence[tuple[str, Any]]
Definitions = Mapping[str, tuple[Any, Fields]]
"""Message type -> (constants, fields), as rosbags parses it."""

_ENCAPSULATION: Final = 4
"""Bytes before the fields in CDR; fields are aligned from their end: the second one is 0 for
big, 1 for little endian; 6 and 7 are the same in plain CDR2 of XTypes, others are not read."""
_XCDR2: Final = (b"\6", b"\7")
_OTHER_FORMS: Final = {
    bytes([0, kind]): name
    for kinds, name in (
        ((2, 3), "a parameter list (PL_CDR)"),
        ((8, 9), "CDR2 with delimiters (D_CDR2, of appendable types)"),
        ((10, 11), "CDR2 with members (PL_CDR2, of mutable types)"),
    )
    for kind in kinds
}
_ASCII: Final = 0x7F
"""Largest byte that is UTF-8 whatever bytes stand beside it."""
NUMBERS: Final = {
    "bool": "u1", "byte": "u1", "char": "u1", "octet": "u1", "uint8": "u1", "int8": "i1",
    "uint16": "u2", "int16": "i2", "uint32": "u4", "int32": "i4", "uint64": "u8", "int64": "i8",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
"""Kind and size in bytes of each base type, for numpy."""


@dataclass
class FieldLayout:
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

    def place(self, name: str) -> tuple[np.dtype[Any], int] | None:
        """Return type and offset of a field, or of an element of a list, as ``position.1``."""
        listed, _, number = name.rpartition(".")
        dtype, offset = self.fields.get(listed, (np.dtype("u1"), 0))
        if name in self.fields or not number.isdecimal() or dtype.subdtype is None:
            return self.fields.get(name)
        item, index = dtype.base, int(number)
        return (item, offset + index * item.itemsize) if index < dtype.shape[0] else None

    def dtype(self, wanted: Sequence[str]) -> np.dtype[np.void]:
        """Return the structured type that reads the ``wanted`` fields from a message."""
        picked = [place for name in wanted if (place := self.place(name)) is not None]
        return np.dtype(
            {
                "names": list(wanted),
                "formats": [dtype for dtype, _ in picked],
                "offsets": [offset for _, offset in picked],
                "itemsize": self.size,
            }
        )

    def fits(self, rows: Bytes, template: Bytes, alike: Collection[str] | None = None) -> Bools:
        """Return which rows have the shape of ``template``, of which this is the layout.

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
                same[row] = all(_is_utf8(rows[row, begin:end]) for begin, end in free)
        return same


def _bytes(ranges: Sequence[tuple[int, int]]) -> Ints:
    """Return the places of all bytes of some ranges."""
    return np.concatenate([np.arange(begin, end) for begin, end in ranges])


def _is_utf8(text: Bytes) -> bool:

    try:
        text.tobytes().decode()
    except UnicodeDecodeError:
        return False
    return True


def work_out_layout(message: bytes, type_name: str, definitions: Definitions) -> FieldLayout:
    """Return the layout of one serialised message; raises DamagedRecord when it is broken."""
    return _LayoutFinder(message, definitions).layout(type_name)


def plain_cdr(message: bytes, type_name: str, definitions: Definitions) -> bytes:
    """Return a message in plain CDR2 as classic CDR; raises DamagedRecord when it is broken."""
    finder = _LayoutFinder(message, definitions)
    finder.layout(type_name)
    return finder.classic()


class _LayoutFinder:
    """Works out the layout of one message in classic CDR or plain CDR2, of either byte order.

    CDR2 aligns to 4 bytes at most, and has the size of a list of texts or messages before it.
    """

    def __init__(self, message: bytes, definitions: Definitions) -> None:
        self._xcdr2 = message[1:2] in _XCDR2
        if len(message) < _ENCAPSULATION or message[0] != 0 or not (self._xcdr2 or message[1] < 2):
            raise DamagedRecord("a message is not serialised as plain CDR")
        self._order = "<" if message[1] & 1 else ">"
        self._pieces: list[tuple[int, int, int]] = []
        self._message = message
        self._definitions = definitions
        self._position = _ENCAPSULATION
        self._layout = FieldLayout(len(message), fixed=[(0, 2)])

    def layout(self, type_name: str) -> FieldLayout:
        self._message_fields(type_name, "")
        self._layout.end = self._position
        return self._layout

    def classic(self) -> bytes:
        """Return the message with the alignment of classic CDR, after :meth:`layout`."""
        classic = bytearray((0, self._message[1] & 1, 0, 0))
        for alignment, begin, end in self._pieces:
            classic += (
                bytes(-(len(classic) - _ENCAPSULATION) % alignment) + self._message[begin:end]
            )
        return bytes(classic)

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
            if self._xcdr2 and (inner != Nodetype.BASE or inner_detail[0] == "string"):
                self._skip(4, 4)
                self._pieces.pop()  # classic CDR has no such size
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
        offset = self._skip(item.itemsize, item.itemsize * (1 if count is None else count))
        dtype = item if count is None else np.dtype((item, (count,)))
        self._layout.fields[name] = (dtype, offset)

    def _count(self) -> int:
        """Read the length of a list or text; it is part of the shape."""
        offset = self._skip(4, 4)
        self._layout.fixed.append((offset, offset + 4))
        order = "little" if self._order == "<" else "big"
        return int.from_bytes(self._message[offset : offset + 4], order)  # type: ignore[arg-type]

    def _text(self, places: list[tuple[int, int]]) -> str:
        length = self._count()
        offset = self._skip(1, length)
        places.append((offset, offset + length))
        try:
            return self._message[offset : offset + length].rstrip(b"\0").decode()
        except UnicodeDecodeError:
            raise DamagedRecord("a text in a message is not UTF-8") from None

    def _check_count(self, count: int) -> None:
        """Refuse a list that does not fit into a message of this size, before walking over it."""
        if count > len(self._message):
            raise DamagedRecord(f"a list of {count} elements in {len(self._message)} bytes")

    def _skip(self, alignment: int, size: int) -> int:
        """Align, skip ``size`` bytes and return where they begin."""
        padding = -(self._position - _ENCAPSULATION) % (
            min(alignment, 4) if self._xcdr2 else alignment
        )
        begin = self._position + padding
        if begin + size > len(self._message):
            raise DamagedRecord("a message is shorter than its fields")
        self._position = begin + size
        self._pieces.append((alignment, begin, begin + size))
        return begin
