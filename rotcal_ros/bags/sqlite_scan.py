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
from rotcal_ros.bags.scan import Scan
from rotcal_ros.bags.verdict import Damage, FileVerdict
from rotcal_ros.errors import BagError

_BLOCK_BYTES: Final = 1 << 20


class SqliteScan(Scan):
    """One pass over a sqlite3 file.

    sqlite3 has no checksums: what the database gives is taken as it is.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
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
        """Return the verdict on the file, after the iteration."""
        start_ns, end_ns = self._span or (None, None)
        return FileVerdict(
            path=self.path,
            size=self.path.stat().st_size,
            state="damaged" if self._damages else "complete",
            damages=self._damages,
            topics=self._topics(Counter()),
            start_ns=start_ns,
            end_ns=end_ns,
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
        content = b"".join(data for _, _, data in batch)
        block = Block(content, np.cumsum(sizes) - sizes, sizes, headers)
        self._count(block)
        return block


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
