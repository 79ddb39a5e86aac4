"""Serialised messages of one channel into Python, by the definition that is in the bag.

The types of a channel's messages, parsed from its definition; anybody may have written it.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from rotcal_ros.arrays import Bytes, Ints
from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.layout import NUMBERS, Definitions, Layout, work_out_layout
from rotcal_ros.bags.mcap_records import DamagedRecord
from rotcal_ros.bags.reading_limits import LARGEST_MESSAGE
from rotcal_ros.errors import BagError

_MAX_LAYOUTS: Final = 64
_HEADER: Final = (Nodetype.NAME, "std_msgs/msg/Header")


@dataclass(frozen=True)
class Columns:
    """Fields of messages of one shape.

    ``rows`` says which messages of the block they are; ``values`` holds one element per row
    with the wanted fields by their dotted names, and ``layout`` the texts all have in common,
    as far as those were asked for.
    """

    rows: Ints
    values: NDArray[np.void]
    layout: Layout

    def stamp_ns(self) -> Ints:
        """Return the header's stamps in integer nanoseconds."""
        seconds = self.values["header.stamp.sec"].astype(np.int64)
        stamps: Ints = seconds * 1_000_000_000 + self.values["header.stamp.nanosec"]
        return stamps


class Decoder:
    """Decodes the messages of one channel; ``broken`` counts those that could not be.

    ``begins_with_header`` says that seconds and nanoseconds of a stamp stand first in a message.

    Raises BagError when the channel's definition cannot be used.
    """

    def __init__(self, channel: ChannelDefinition) -> None:
        self.channel = channel
        self.broken = 0
        self._store, self.definitions = message_types(channel)
        self._layouts: dict[int, list[tuple[Layout, Bytes]]] = {}
        fields = self.definitions[channel.type_name][1]
        self.begins_with_header = bool(fields) and fields[0][1] == _HEADER

    def message(self, data: bytes) -> Any | None:
        """Return one message as an object whose attributes are its fields, as in rclpy.

        None, and counted as broken, when the bytes are not such a message.
        """
        with suppress(Exception):
            return self._store.deserialize_cdr(data, self.channel.type_name)
        with suppress(Exception):  # some serialisers, as rclpy's, leave unused bytes at the end
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
    ) -> tuple[Layout, Bytes] | None:
        """Return a layout that fits ``message``, known or new; None when it is broken."""
        known = self._layouts.setdefault(len(message), [])
        for layout, template in known:
            if layout.fits(message[np.newaxis], template, alike)[0]:
                return layout, template
        try:
            layout = work_out_layout(message.tobytes(), self.channel.type_name, self.definitions)
        except DamagedRecord:
            return None
        if len(known) >= _MAX_LAYOUTS:
            known.clear()
        known.append((layout, message.copy()))
        return known[-1]

    def _dtype(self, layout: Layout, wanted: Sequence[str]) -> np.dtype[np.void]:
        missing = [name for name in wanted if name not in layout.fields]
        if missing:
            raise BagError(
                f"topic {self.channel.topic}: {self.channel.type_name} has no field "
                f"{', '.join(missing)}; it has {', '.join(layout.fields) or 'none'}"
            )
        return layout.dtype(wanted)


MAX_DEFINITION: Final = 1 << 18
"""Longest definition that is parsed, in characters; ROS's own are up to a tenth of that."""
MAX_DEPTH: Final = 64
"""How deep messages may contain each other."""
_REMEMBERED: Final = 1 << 14
"""Longest definition whose types are remembered: all of ROS's and ours that are recorded here."""
_MAX_ELEMENTS: Final = 10_000
"""Most elements of arrays of texts and messages together: rosbags writes code for each."""
_ENCODINGS: Final = ("cdr", "")
_ALWAYS_KNOWN: Final = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_SECONDS: Final = "int32 sec\nuint32 nanosec\n"
"""The definition of both, in every distribution of ROS 2; a bag may leave it out."""
_SHOWN: Final = 60
_LINE_END: Final = re.compile(r"[ \t]*(?:\r\n?|\n)")
"""As on Windows and elsewhere, with the blanks that editors leave before it."""
_PLACE: Final = re.compile(r"\n(\d+)\n")


class _Unusable(Exception):  # noqa: N818 - becomes a BagError that names the topic
    """What is wrong with a definition."""


def message_types(channel: ChannelDefinition) -> tuple[Typestore, Definitions]:
    """Return the store that decodes the messages of ``channel``, and the types in it.

    A message without fields has one byte in CDR, ``structure_needs_at_least_one_member``.
    Raises BagError when there is no definition or none that can be used.
    """
    if channel.encoding not in ("ros2msg", "ros2idl"):
        what = f"only one in {channel.encoding!r}" if channel.encoding else "no definition"
        raise BagError(f"topic {channel.topic}: the bag holds {what} of {channel.type_name}")
    if channel.message_encoding not in _ENCODINGS:
        raise BagError(
            f"topic {channel.topic}: its messages are serialised as "
            f"{channel.message_encoding!r}, which cannot be read (cdr can)"
        )
    known = len(channel.definition) <= _REMEMBERED
    try:
        store = (_store if known else _store.__wrapped__)(
            channel.type_name, channel.encoding, channel.definition
        )
    except _Unusable as error:
        reason = str(error)
    except Exception as error:
        reason = _in_one_line(error)
    else:
        return store, store.fielddefs
    raise BagError(
        f"topic {channel.topic}: the definition of {channel.type_name} cannot be read: {reason}"
    )


@lru_cache(maxsize=64)
def _store(type_name: str, encoding: str, definition: str) -> Typestore:
    """Return the store with the types of a definition: bags of one cell have the same ones."""
    types = _always_known() | _parsed(type_name, encoding, definition)
    _Tree(types).least_size(type_name)
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    return store


def _parsed(type_name: str, encoding: str, definition: str) -> dict[str, Any]:
    if len(definition) > MAX_DEFINITION:
        raise _Unusable(f"it is longer than {MAX_DEFINITION} characters")
    text = _LINE_END.sub("\n", definition.removeprefix("\ufeff"))
    if encoding == "ros2idl":
        return dict(get_types_from_idl(text))
    return dict(get_types_from_msg(text, type_name))


class _Tree:
    """What contains what; refuses what no serialised message can look like."""

    def __init__(self, types: Mapping[str, Any]) -> None:
        self._types = types
        self._sizes: dict[str, int] = {}
        self._path: list[str] = []
        self._elements = 0

    def least_size(self, name: str) -> int:
        """Return how many bytes a message of type ``name`` has at least."""
        if name in self._sizes:
            return self._sizes[name]
        if name not in self._types:
            raise _Unusable(f"it does not say what {_short(name)} is")
        if name in self._path:
            raise _Unusable(f"{_short(name)} contains itself")
        if len(self._path) >= MAX_DEPTH:
            raise _Unusable(f"more than {MAX_DEPTH} messages within each other")
        self._path.append(name)
        size = sum(self._field(field, *kind) for field, kind in self._types[name][1])
        self._path.pop()
        if size > LARGEST_MESSAGE:
            raise _Unusable(
                f"{_short(name)} has {size} bytes at least, more than {LARGEST_MESSAGE}"
            )
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
    """Return where the parser stopped, or what it says, without the whole text."""
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
def _always_known() -> dict[str, Any]:
    return {name: get_types_from_msg(_SECONDS, name)[name] for name in _ALWAYS_KNOWN}
