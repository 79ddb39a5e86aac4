"""One MCAP file while it is written: closed chunks, and a second copy of all definitions."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from mcap.writer import CompressionType, Writer

from rotcal_ros import __version__
from rotcal_ros.bags import names
from rotcal_ros.bags.definitions import ChannelDefinition, dump_definitions, schema_bytes
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.files import DurableFile

LIBRARY: Final = f"rotcal_ros {__version__}"
_QOS: Final = "offered_qos_profiles"
_HASH: Final = "topic_type_hash"
_MOST_CHANNELS: Final = 65_535


@dataclass(frozen=True, slots=True)
class Attached:
    """A file that goes beside the messages, since ``time_ns``; made then if not otherwise said."""

    name: str
    media_type: str
    data: bytes
    time_ns: int
    created_ns: int | None = None


class McapFile:
    """A new file at ``path``, which must not exist; :meth:`begin` it first.

    Everything raises OSError when the disk fails: then only :meth:`abandon` is left to do.
    """

    def __init__(self, path: Path, chunk_bytes: int) -> None:
        self.path = path
        self._file = DurableFile(path)
        self._writer = Writer(
            self._file,  # type: ignore[arg-type]
            chunk_size=chunk_bytes,
            compression=CompressionType.ZSTD,
            enable_crcs=True,
            enable_data_crcs=True,
        )
        self._schemas: dict[tuple[str, str, str], int] = {}
        self._undescribed: list[ChannelDefinition] = []

    @property
    def size(self) -> int:
        """How many bytes were written."""
        return self._file.tell()

    def begin(self) -> None:
        """Write what every file begins with."""
        self._writer.start(profile="ros2", library=LIBRARY)

    def attach(self, attached: Attached) -> None:
        """Put a file beside the messages."""
        created_ns = attached.time_ns if attached.created_ns is None else attached.created_ns
        self._writer.add_attachment(
            created_ns, attached.time_ns, attached.name, attached.media_type, attached.data
        )

    def note(self, name: str, texts: Mapping[str, str]) -> None:
        """Write a metadata record."""
        self._writer.add_metadata(name, dict(texts))

    def register(self, channel: ChannelDefinition) -> ChannelDefinition:
        """Add a channel and return it with its number; they count from 1 in every file."""
        known = {_QOS: channel.offered_qos, _HASH: channel.type_hash}
        number = self._writer.register_channel(
            channel.topic,
            channel.message_encoding,
            self._schema(channel),
            dict(channel.metadata) | {name: text for name, text in known.items() if text},
        )
        if number > _MOST_CHANNELS:
            raise BagError(f"a bag has {_MOST_CHANNELS} channels at most")
        self._undescribed.append(replace(channel, channel_id=number))
        return self._undescribed[-1]

    def _schema(self, channel: ChannelDefinition) -> int:
        """Return the number of a channel's schema, new or known; 0 stands for none."""
        key = (channel.type_name, channel.encoding, channel.definition)
        if not any(key):
            return 0
        if key not in self._schemas:
            self._schemas[key] = self._writer.register_schema(
                channel.type_name, channel.encoding, schema_bytes(channel.definition)
            )
        return self._schemas[key]

    def write(
        self, channel: int, data: bytes, log_time_ns: int, publish_time_ns: int, sequence: int
    ) -> None:
        """Append a message."""
        if self._undescribed:
            self._describe()
        self._writer.add_message(channel, log_time_ns, data, publish_time_ns, sequence)

    def sync(self) -> None:
        """Return when all so far is on the medium, in closed chunks."""
        if self._undescribed:
            self._describe()
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._file.sync()

    def finish(self) -> None:
        """Write the index, sync and close."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.sync()
        self._file.close()

    def abandon(self) -> None:
        """Close the file where it ends, behind a whole record, as well as the disk allows."""
        with suppress(OSError):
            self._file.sync()
        with suppress(OSError):
            self._file.close()

    def _describe(self) -> None:
        """Put new definitions beside the chunks, before the first message that needs them."""
        data = dump_definitions(self._undescribed)
        self.attach(Attached(names.DEFINITIONS, "application/json", data, time.time_ns()))
        self._undescribed.clear()
