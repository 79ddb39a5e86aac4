"""Reading a rosbag2 sqlite3 file through rosbags, in the same blocks as an MCAP file."""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.typesys import Stores, get_typestore

from rotcal_ros.bags.blocks import HEADER_TYPE, Block
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.mcap_records import Attachment
from rotcal_ros.bags.verdict import Damage, FileVerdict, TopicCount
from rotcal_ros.errors import BagError

_BLOCK_BYTES: Final = 1 << 20


class SqliteScan:
    """One pass over a sqlite3 file; see McapScan for the interface.

    sqlite3 has no checksums: what the database gives is taken as it is.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.position = 0
        self.channels: dict[int, ChannelDefinition] = {}
        self.attachments: dict[str, Attachment] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self._counts: Counter[int] = Counter()
        self._span: tuple[int, int] | None = None
        self._damages: tuple[Damage, ...] = ()

    def blocks(self) -> Iterator[Block]:
        """Yield the messages in the order of their log times."""
        try:
            with Reader(self.path) as reader:
                for connection in reader.connections:
                    self.channels[connection.id] = _definition(connection)
                yield from self._read(reader)
        except (ReaderError, sqlite3.Error, OSError) as error:
            if not self._counts:
                raise BagError(f"cannot read {self.path}: {error}") from error
            self._damages = (Damage(0, f"the database cannot be read further: {error}"),)

    def verdict(self) -> FileVerdict:
        """Return what is to be said about the file, after the iteration."""
        topics = {
            channel.topic: TopicCount(channel.type_name, self._counts[number])
            for number, channel in self.channels.items()
        }
        return FileVerdict(
            path=self.path,
            size=self.path.stat().st_size,
            state="damaged" if self._damages else "complete",
            damages=self._damages,
            topics=topics,
            start_ns=self._span[0] if self._span else None,
            end_ns=self._span[1] if self._span else None,
            lost_exactly=not self._damages,
        )

    def _read(self, reader: Reader) -> Iterator[Block]:
        batch: list[tuple[int, int, bytes]] = []
        size = 0
        for connection, time_ns, data in reader.messages():
            batch.append((connection.id, time_ns, bytes(data)))
            size += len(data)
            if size >= _BLOCK_BYTES:
                self.position += size
                yield self._block(batch)
                batch, size = [], 0
        if batch:
            yield self._block(batch)

    def _block(self, batch: list[tuple[int, int, bytes]]) -> Block:
        sizes = np.array([len(data) for _, _, data in batch], np.int64)
        headers = np.zeros(len(batch), HEADER_TYPE)
        headers["channel"] = [number for number, _, _ in batch]
        headers["log_time"] = headers["publish_time"] = [time_ns for _, time_ns, _ in batch]
        self._counts.update(number for number, _, _ in batch)
        start, end = int(headers["log_time"].min()), int(headers["log_time"].max())
        known = self._span or (start, end)
        self._span = (min(known[0], start), max(known[1], end))
        content = b"".join(data for _, _, data in batch)
        return Block(content, np.cumsum(sizes) - sizes, sizes, headers)


def _definition(connection: Connection) -> ChannelDefinition:
    """Return a channel; older bags carry no definitions, so ROS's own types are looked up."""
    text = connection.msgdef.data
    if not text:
        store = get_typestore(Stores.LATEST)
        if connection.msgtype in store.fielddefs:
            text, _ = store.generate_msgdef(connection.msgtype, ros_version=2)
    return ChannelDefinition(
        connection.id, connection.topic, connection.msgtype, "ros2msg" if text else "", text
    )
