"""The schemas and channels of an MCAP file, each from the place that is to be trusted most."""

from __future__ import annotations

from collections import defaultdict
from enum import IntEnum
from typing import Final, TypeVar

from mcap.records import Channel, Schema

from rotcal_ros.bags.definitions import ChannelDefinition, schema_text

T = TypeVar("T", Schema, Channel)

_QOS: Final = "offered_qos_profiles"
_HASH: Final = "topic_type_hash"
_NO_SCHEMA: Final = Schema(id=0, data=b"", encoding="", name="")


class Trust(IntEnum):
    """Where a definition stands: data outrank the index, what has a checksum what has none."""

    PLAIN_INDEX = 0
    PLAIN_DATA = 1
    CHECKED_INDEX = 2
    CHECKED_DATA = 3


class Definitions:
    """Schemas and channels by id; ``channels`` holds those that the data define.

    What only the index or another copy knows is held back until :meth:`recover` needs it.
    """

    def __init__(self) -> None:
        self.channels: dict[int, ChannelDefinition] = {}
        self.schema_ids: set[int] = set()
        """Of the schemas that the data define."""
        self.from_data: set[int] = set()
        """Ids of the channels that the data define."""
        self._schemas: dict[int, tuple[Trust, Schema]] = {}
        self._records: dict[int, tuple[Trust, Channel]] = {}
        self._copies: dict[int, ChannelDefinition] = {}
        self._users: defaultdict[int, set[int]] = defaultdict(set)

    def add(self, record: Schema | Channel, trust: Trust) -> str:
        """Take a schema or channel; returns what is wrong with it, or an empty text."""
        if isinstance(record, Schema):
            return self._add_schema(record, trust)
        return self._add_channel(record, trust)

    def add_copy(self, channel: ChannelDefinition) -> None:
        """Take a channel from a copy with a checksum of its own."""
        self._copies.setdefault(channel.channel_id, channel)

    def recover(self, number: int) -> bool:
        """Take a channel that the data do not define from elsewhere; False when nobody does."""
        trust, record = self._records.get(number, (Trust.PLAIN_INDEX, None))
        if number in self._copies and trust < Trust.CHECKED_INDEX:
            self.channels[number] = self._copies[number]
        elif record is not None:
            self.channels[number] = self._resolved(record)
        return number in self.channels

    def recover_all(self, *, trusted: bool) -> None:
        """Take all channels that the data do not define; ``trusted``: with a checksum only."""
        for number, (trust, _) in self._records.items():
            if number not in self.channels and (trust >= Trust.CHECKED_INDEX or not trusted):
                self.recover(number)
        for number in self._copies.keys() - self.channels.keys():
            self.recover(number)

    def with_index(self) -> tuple[int, int]:
        """Return how many schemas and channels there are, those of the index among them."""
        return len(self._schemas), len(self._records)

    def _add_schema(self, schema: Schema, trust: Trust) -> str:
        if schema.id == 0:
            return "a schema has the id 0, which means none"
        if trust in (Trust.PLAIN_DATA, Trust.CHECKED_DATA):
            self.schema_ids.add(schema.id)
        fault = _take(self._schemas, schema, trust)
        for number in self._users[schema.id] & self.channels.keys():
            self.channels[number] = self._resolved(self._records[number][1])
        if not schema.encoding and schema.data:
            return fault or f"schema {schema.name!r} has no encoding"
        return fault

    def _add_channel(self, channel: Channel, trust: Trust) -> str:
        in_data = trust in (Trust.PLAIN_DATA, Trust.CHECKED_DATA)
        fault = _take(self._records, channel, trust)
        self._users[channel.schema_id].add(channel.id)
        if in_data:
            self.from_data.add(channel.id)
        if in_data or channel.id in self.channels:
            self.channels[channel.id] = self._resolved(self._records[channel.id][1])
        if in_data and channel.schema_id and channel.schema_id not in self.schema_ids:
            return fault or f"channel {channel.id} refers to a schema that is not there"
        return fault

    def _resolved(self, channel: Channel) -> ChannelDefinition:
        _, schema = self._schemas.get(channel.schema_id, (None, _NO_SCHEMA))
        copy = self._copies.get(channel.id)
        if schema is _NO_SCHEMA and channel.schema_id and copy and copy.topic == channel.topic:
            return copy  # the record of its schema is damaged
        known = {_QOS: "", _HASH: ""} | channel.metadata
        return ChannelDefinition(
            channel.id,
            channel.topic,
            schema.name,
            schema.encoding,
            schema_text(schema.data),
            type_hash=known.pop(_HASH),
            offered_qos=known.pop(_QOS),
            message_encoding=channel.message_encoding,
            metadata=tuple(known.items()),
        )


def _take(known: dict[int, tuple[Trust, T]], record: T, trust: Trust) -> str:
    """Keep ``record`` if none of its id is to be trusted more; say if they disagree."""
    before = known.get(record.id)
    if before is None or before[0] < trust:
        known[record.id] = trust, record
    if before is None or before[1] == record:
        return ""
    return f"two definitions of {type(record).__name__.lower()} {record.id} disagree"
