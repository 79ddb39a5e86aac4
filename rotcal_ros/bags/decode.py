"""Serialised messages of one channel into Python, by the definition that is in the bag."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype

from rotcal_ros.arrays import Bytes, Ints
from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.layout import Layout, work_out_layout
from rotcal_ros.bags.mcap_records import DamagedRecord
from rotcal_ros.bags.message_types import message_types
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
