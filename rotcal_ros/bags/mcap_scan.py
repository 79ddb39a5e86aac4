"""Reading one MCAP file from begin to end, tolerantly: blocks of messages and a verdict."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np
from mcap.records import Attachment, Channel, Chunk, Header, Metadata, Schema, Statistics

from rotcal_ros.bags import mcap_records as mcap
from rotcal_ros.bags import names
from rotcal_ros.bags.blocks import Block, block_of_records, joined, split_chunk
from rotcal_ros.bags.definitions import ChannelDefinition, parse_definitions
from rotcal_ros.bags.framing import Framing, Record
from rotcal_ros.bags.scan import Scan
from rotcal_ros.bags.verdict import Damage, FileVerdict, State
from rotcal_ros.errors import BagError

_RUN_BYTES: Final = 1 << 20
_JOINED_BYTES: Final = 1 << 20
"""Chunks are yielded together up to this size: a small one costs as much as a large one."""


class McapScan(Scan):
    """One pass over an MCAP file."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._schemas: dict[int, tuple[str, str, str]] = {}  # name, encoding, text
        self._lost: Counter[int] = Counter()
        self._statistics: dict[int, int] | None = None
        self._chunk_lost = False
        self._index_awaited = False
        self._loss_unknown = False
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
        """Return the verdict on the file, after the iteration."""
        damages = sorted(self._damages, key=lambda damage: damage.offset)
        state: State = "damaged" if damages else "complete"
        if self._truncated is not None:
            state = state if damages else "truncated"
            damages.append(Damage(self._truncated, "the file ends without its closing records"))
        lost = self._lost if self._statistics is None else self._missing(self._statistics)
        start_ns, end_ns = self._span or (None, None)
        return FileVerdict(
            path=self.path,
            size=self._size,
            state=state,
            damages=tuple(damages),
            topics=self._topics(lost),
            start_ns=start_ns,
            end_ns=end_ns,
            lost_exactly=self._statistics is not None or not self._loss_unknown,
            losses_recorded=_integers(self.metadata.get(names.LOSSES, {})),
            run=_integers(self.metadata.get(names.RUN, {})).get("number", 0),
            notes=self.metadata,
        )

    def _blocks(self, framing: Framing) -> Iterator[Block]:
        run: list[bytes] = []
        run_size = 0
        held = _Held()
        for record in framing.records():
            self.position = record.offset
            if record.opcode not in (mcap.CHUNK, mcap.MESSAGE_INDEX):
                yield from self._counted(held.released())  # it may speak of what comes after it
            if record.opcode == mcap.MESSAGE:
                run.append(record.content)
                run_size += len(record.content)
            if run and (record.opcode != mcap.MESSAGE or run_size > _RUN_BYTES):
                yield from self._counted(_block_of_run(run))
                run, run_size = [], 0
            try:
                block = self._take(record)
            except (mcap.DamagedRecord, BagError) as fault:
                framing.reject(record, str(fault))
            else:
                if block is not None:
                    yield from self._counted(held.grown(block))
        yield from self._counted(held.released())
        if run:
            yield from self._counted(_block_of_run(run))
        self._conclude(framing)

    def _take(self, part: Record) -> Block | None:
        """Take in one top-level record; returns the messages of a chunk."""
        opcode, content = part.opcode, part.content
        if opcode == mcap.CHUNK:
            return self._take_chunk(content)
        if opcode == mcap.MESSAGE_INDEX:
            channel, messages = mcap.parse_message_index(content)
            if self._chunk_lost:
                self._lost[channel] += messages
                self._index_awaited = False
        elif opcode == mcap.ATTACHMENT:
            self._take_attachment(mcap.parse_attachment(content))
        elif opcode == mcap.METADATA:
            record = mcap.parse(Metadata, content)
            self.metadata[record.name] = record.metadata
        elif opcode == mcap.STATISTICS:
            self._statistics = mcap.parse(Statistics, content).channel_message_counts
        elif opcode == mcap.HEADER:
            mcap.parse(Header, content)
        else:
            self._take_definition(opcode, content)
        return None

    def _take_chunk(self, content: bytes) -> Block:
        self._loss_unknown |= self._index_awaited
        self._chunk_lost = self._index_awaited = True
        block, others = split_chunk(mcap.unpack_chunk(mcap.parse(Chunk, content)))
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
        if opcode == mcap.SCHEMA:
            schema = mcap.parse(Schema, content)
            self._schemas[schema.id] = (schema.name, schema.encoding, mcap.decoded(schema.data))
        elif opcode == mcap.CHANNEL:
            channel = mcap.parse(Channel, content)
            definition = ChannelDefinition(
                channel.id,
                channel.topic,
                *self._schemas.get(channel.schema_id, ("", "", "")),
                type_hash=channel.metadata.get("topic_type_hash", ""),
                offered_qos=channel.metadata.get("offered_qos_profiles", ""),
            )
            self.channels.setdefault(channel.id, definition)

    def _counted(self, block: Block | None) -> Iterator[Block]:
        """Count the messages and yield those of known channels."""
        if block is None:
            return
        unknown = {n: count for n, count in block.counts().items() if n not in self.channels}
        if unknown:
            self._lost.update(unknown)
            block = block.select(~np.isin(block.headers["channel"], list(unknown)))
        if len(block):
            self._count(block)
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

    def _read_summary_definitions(self, file: BinaryIO) -> None:
        """Take schemas and channels from the end of a complete file, if there are any."""
        tail = mcap.HEADER_SIZE + mcap.FOOTER_CONTENT + len(mcap.MAGIC)
        if self._size < tail:
            return
        file.seek(self._size - tail)
        footer = file.read(tail)
        start = int.from_bytes(footer[mcap.HEADER_SIZE : mcap.HEADER_SIZE + 8], "little")
        end = self._size - tail
        if not footer.endswith(mcap.MAGIC) or not 0 < start < end or end - start > mcap.MAX_RECORD:
            return
        file.seek(start)
        summary = file.read(end - start)
        position = 0
        while position + mcap.HEADER_SIZE <= len(summary):
            opcode, length = mcap.record_header.unpack_from(summary, position)
            position += mcap.HEADER_SIZE
            try:
                self._take_definition(opcode, summary[position : position + length])
            except mcap.DamagedRecord:
                return
            position += length


class _Held:
    """Blocks that are yielded together: a small one costs as much as a large one."""

    def __init__(self) -> None:
        self._blocks: list[Block] = []
        self._room = 0  # the first block goes at once: who wants no more need not wait

    def grown(self, block: Block) -> Block | None:
        """Take ``block``; return all as one when they are large enough."""
        self._blocks.append(block)
        self._room -= len(block.data)
        return None if self._room > 0 else self.released()

    def released(self) -> Block | None:
        """Return what is held as one block, if anything is."""
        if not self._blocks:
            return None
        blocks, self._blocks, self._room = self._blocks, [], _JOINED_BYTES
        return joined(blocks)


def _block_of_run(run: list[bytes]) -> Block:
    """Return the block of messages that stand outside chunks."""
    sizes = np.array([len(content) for content in run], np.int64)
    return block_of_records(b"".join(run), np.cumsum(sizes) - sizes, sizes)


def _integers(texts: dict[str, str]) -> dict[str, int]:
    return {name: int(text) for name, text in texts.items() if text.lstrip("-").isdigit()}
