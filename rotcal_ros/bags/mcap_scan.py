"""Reading one MCAP file from begin to end, tolerantly: blocks of messages and a verdict."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np

from rotcal_ros.bags import names
from rotcal_ros.bags.blocks import Block, block_of_records, split_chunk
from rotcal_ros.bags.definitions import ChannelDefinition, parse_definitions
from rotcal_ros.bags.framing import Framing, Record
from rotcal_ros.bags.mcap_records import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    FOOTER_CONTENT,
    HEADER,
    HEADER_SIZE,
    MAGIC,
    MAX_RECORD,
    MESSAGE,
    MESSAGE_INDEX,
    METADATA,
    SCHEMA,
    STATISTICS,
    Attachment,
    DamagedRecord,
    Schema,
    parse_attachment,
    parse_channel,
    parse_chunk,
    parse_header,
    parse_message_index,
    parse_metadata,
    parse_schema,
    parse_statistics,
    record_header,
    unpack_chunk,
)
from rotcal_ros.bags.verdict import Damage, FileVerdict, State, TopicCount
from rotcal_ros.errors import BagError

_RUN_BYTES: Final = 1 << 20


class McapScan:
    """One pass over an MCAP file.

    Iterate :meth:`blocks` to the end; ``channels``, ``attachments`` and ``metadata`` fill up on
    the way, and :meth:`verdict` is final afterwards. A block only holds messages of
    channels whose definition is known.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.position = 0
        self.profile = ""
        self.library = ""
        self.channels: dict[int, ChannelDefinition] = {}
        self.attachments: dict[str, Attachment] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self._schemas: dict[int, Schema] = {}
        self._counts: Counter[int] = Counter()
        self._lost: Counter[int] = Counter()
        self._statistics: dict[int, int] | None = None
        self._chunk_lost = False
        self._index_awaited = False
        self._loss_unknown = False
        self._start_ns: int | None = None
        self._end_ns: int | None = None
        self._size = 0
        self._damages: list[Damage] = []
        self._truncated: int | None = None

    def blocks(self) -> Iterator[Block]:
        """Yield the readable messages in file order; raises BagError when unreadable at all."""
        try:
            with self.path.open("rb") as file:
                self._size = file.seek(0, 2)
                self._read_summary_definitions(file)
                yield from self._blocks(Framing(file, self._size))
        except OSError as error:
            raise BagError(f"cannot read {self.path}: {error.strerror or error}") from error

    def verdict(self) -> FileVerdict:
        """Return what is to be said about the file, after the iteration."""
        damages = sorted(self._damages, key=lambda damage: damage.offset)
        state: State = "damaged" if damages else "complete"
        if self._truncated is not None:
            state = state if damages else "truncated"
            damages.append(Damage(self._truncated, "the file ends without its closing records"))
        lost = self._lost if self._statistics is None else self._missing(self._statistics)
        return FileVerdict(
            path=self.path,
            size=self._size,
            state=state,
            damages=tuple(damages),
            topics=self._topics(lost),
            start_ns=self._start_ns,
            end_ns=self._end_ns,
            lost_exactly=self._statistics is not None or not self._loss_unknown,
            losses_recorded=_integers(self.metadata.get(names.LOSSES, {})),
            run=_integers(self.metadata.get(names.RUN, {})).get("number", 0),
        )

    def _blocks(self, framing: Framing) -> Iterator[Block]:
        run: list[bytes] = []
        run_size = 0
        for record in framing.records():
            self.position = record.offset
            if record.opcode == MESSAGE:
                run.append(record.content)
                run_size += len(record.content)
            if run and (record.opcode != MESSAGE or run_size > _RUN_BYTES):
                yield from self._counted(_block_of_run(run))
                run, run_size = [], 0
            try:
                block = self._take(record)
            except (DamagedRecord, BagError) as fault:
                framing.reject(record, str(fault))
            else:
                if block is not None:
                    yield from self._counted(block)
        if run:
            yield from self._counted(_block_of_run(run))
        self._conclude(framing)

    def _take(self, record: Record) -> Block | None:
        """Take in one top-level record; returns the messages of a chunk."""
        content = record.content
        if record.opcode == CHUNK:
            return self._take_chunk(content)
        if record.opcode == MESSAGE_INDEX:
            channel, messages = parse_message_index(content)
            if self._chunk_lost:
                self._lost[channel] += messages
                self._index_awaited = False
        elif record.opcode == ATTACHMENT:
            self._take_attachment(parse_attachment(content))
        elif record.opcode == METADATA:
            name, entries = parse_metadata(content)
            self.metadata[name] = entries
        elif record.opcode == STATISTICS:
            self._statistics = parse_statistics(content)
        elif record.opcode == HEADER:
            self.profile, self.library = parse_header(content)
        else:
            self._take_definition(record.opcode, content)
        return None

    def _take_chunk(self, content: bytes) -> Block:
        self._loss_unknown |= self._index_awaited
        self._chunk_lost = self._index_awaited = True
        block, others = split_chunk(unpack_chunk(parse_chunk(content)))
        for opcode, inner in others:
            self._take_definition(opcode, inner)
        self._chunk_lost = self._index_awaited = False
        return block

    def _take_attachment(self, attachment: Attachment) -> None:
        self.attachments[attachment.name] = attachment
        if attachment.name == names.DEFINITIONS:
            for channel in parse_definitions(attachment.data):
                self.channels.setdefault(channel.channel_id, channel)

    def _take_definition(self, opcode: int, content: bytes) -> None:
        if opcode == SCHEMA:
            schema = parse_schema(content)
            self._schemas[schema.schema_id] = schema
        elif opcode == CHANNEL:
            channel = parse_channel(content)
            schema = self._schemas.get(channel.schema_id, Schema(0, "", "", ""))
            self.channels.setdefault(
                channel.channel_id,
                ChannelDefinition(
                    channel_id=channel.channel_id,
                    topic=channel.topic,
                    type_name=schema.name,
                    encoding=schema.encoding,
                    definition=schema.text,
                    type_hash=channel.metadata.get("topic_type_hash", ""),
                    offered_qos=channel.metadata.get("offered_qos_profiles", ""),
                ),
            )

    def _counted(self, block: Block) -> Iterator[Block]:
        """Count the messages and yield those of known channels."""
        if not len(block):
            return
        channels, counts = np.unique(block.headers["channel"], return_counts=True)
        known = [int(c) for c in channels if int(c) in self.channels]
        for channel, count in zip(channels.tolist(), counts.tolist(), strict=True):
            if channel in self.channels:
                self._counts[channel] += count
            else:
                self._lost[channel] += count
        if len(known) < len(channels):
            block = block.select(np.isin(block.headers["channel"], known))
        if len(block):
            times = block.headers["log_time"]
            start, end = int(times.min()), int(times.max())
            self._start_ns = start if self._start_ns is None else min(self._start_ns, start)
            self._end_ns = end if self._end_ns is None else max(self._end_ns, end)
            yield block

    def _conclude(self, framing: Framing) -> None:
        if framing.damages and self.position == 0:
            raise BagError(f"{self.path} is no MCAP file: nothing in it can be read")
        self._truncated = framing.truncated
        self._loss_unknown |= (
            self._index_awaited or framing.skipped or (framing.truncated is not None)
        )
        if not framing.summary_sound:
            self._statistics = None
        if self._statistics is not None and not framing.damages:
            missing = self._missing(self._statistics)
            if missing or self._statistics.keys() - self.channels.keys():
                framing.damage(0, "fewer messages than the index of the file promises")
        if self._lost and not framing.damages:
            framing.damage(0, "messages of channels without a definition")
        self._damages = framing.damages

    def _missing(self, promised: dict[int, int]) -> Counter[int]:
        return Counter(promised) - self._counts

    def _topics(self, lost: Counter[int]) -> dict[str, TopicCount]:
        topics: dict[str, TopicCount] = {}
        for number in sorted(self.channels.keys() | lost.keys()):
            channel = self.channels.get(number)
            name = channel.topic if channel else f"(unknown channel {number})"
            known = topics.get(name, TopicCount(channel.type_name if channel else "", 0))
            topics[name] = TopicCount(
                known.type_name,
                known.messages + self._counts[number],
                known.lost + lost[number],
            )
        return topics

    def _read_summary_definitions(self, file: BinaryIO) -> None:
        """Take schemas and channels from the end of a complete file, if there are any."""
        tail = HEADER_SIZE + FOOTER_CONTENT + len(MAGIC)
        if self._size < tail:
            return
        file.seek(self._size - tail)
        footer = file.read(tail)
        start = int.from_bytes(footer[HEADER_SIZE : HEADER_SIZE + 8], "little")
        end = self._size - tail
        if not footer.endswith(MAGIC) or not 0 < start < end or end - start > MAX_RECORD:
            return
        file.seek(start)
        summary = file.read(end - start)
        position = 0
        while position + HEADER_SIZE <= len(summary):
            opcode, length = record_header.unpack_from(summary, position)
            position += HEADER_SIZE
            try:
                self._take_definition(opcode, summary[position : position + length])
            except DamagedRecord:
                return
            position += length


def _block_of_run(run: list[bytes]) -> Block:
    """Return the block of messages that stand outside chunks."""
    sizes = np.array([len(content) for content in run], np.int64)
    return block_of_records(b"".join(run), np.cumsum(sizes) - sizes, sizes)


def _integers(texts: dict[str, str]) -> dict[str, int]:
    return {name: int(text) for name, text in texts.items() if text.lstrip("-").isdigit()}
