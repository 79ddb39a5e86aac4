"""Saving what can be saved of a damaged bag into a new, sound one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rotcal_ros.bags import names
from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.reader import Progress, bag_files, check_files, read_blocks
from rotcal_ros.bags.repair_record import repair_record
from rotcal_ros.bags.scan import Scan
from rotcal_ros.bags.session_verdict import judge_session
from rotcal_ros.bags.verdict import FileVerdict, session_losses
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.bags.writer_settings import WriterSettings
from rotcal_ros.errors import BagError


@dataclass(frozen=True)
class Repair:
    """The verdicts on the files before and after a repair."""

    before: tuple[FileVerdict, ...]
    after: tuple[FileVerdict, ...]


def repair(path: Path, folder: Path, progress: Progress | None = None) -> Repair:
    """Write all that can be read of the bag at ``path`` into the new ``folder``.

    The original is never touched. The new bag is read again and must hold every message
    that was saved. Raises BagError when nothing can be read or ``folder`` exists.
    """
    before: list[FileVerdict] = []
    with BagWriter(folder, WriterSettings(min_free_bytes=0)) as writer:
        copier = _Copier(writer)
        for scan, block in read_blocks(bag_files(path), progress):
            copier.attachments(scan)
            copier.run(scan)
            if block is not None:
                copier.copy(scan, block)
            else:
                copier.notes(scan)
                before.append(scan.verdict())
        if losses := session_losses(before):
            writer.note(names.LOSSES, losses)
        writer.note(names.REPAIR, repair_record(before, judge_session(path, before).missing))
    after = check_files(bag_files(folder))
    _compare(before, after, folder)
    return Repair(tuple(before), after)


class _Copier:
    """Copies blocks with all that belongs to them, each channel once."""

    def __init__(self, writer: BagWriter) -> None:
        self._writer = writer
        self._channels: dict[tuple[str, str, str], int] = {}
        self._attached: set[bytes] = set()
        self._run: dict[str, str] = {}

    def copy(self, scan: Scan, block: Block) -> None:
        numbers = {number: self._channel(scan.channels[number]) for number in block.counts()}
        for row, (channel, sequence, log_time, publish_time) in enumerate(block.headers.tolist()):
            self._writer.write(
                numbers[channel], block.payload(row), log_time, publish_time, sequence
            )

    def attachments(self, scan: Scan) -> None:
        """Copy the attachments that have come to light so far, each once."""
        for attachment in scan.attachments.values():
            if attachment.name != names.DEFINITIONS and attachment.data not in self._attached:
                self._attached.add(attachment.data)
                self._writer.attach(attachment.name, attachment.media_type, attachment.data)

    def run(self, scan: Scan) -> None:
        """Say which run of an interrupted plan the messages belong to that come now."""
        if names.RUN in scan.metadata and scan.metadata[names.RUN] != self._run:
            self._run = dict(scan.metadata[names.RUN])
            self._writer.sync()  # closes the chunk: the record must not overtake its messages
            self._writer.note(names.RUN, self._run)

    def notes(self, scan: Scan) -> None:
        """Copy the other metadata records."""
        for name, entries in scan.metadata.items():
            if name not in (names.ROSBAG2, names.RUN, names.LOSSES, names.CONTINUED, names.REPAIR):
                self._writer.note(name, entries)

    def _channel(self, channel: ChannelDefinition) -> int:
        key = (channel.topic, channel.type_name, channel.definition)
        if key not in self._channels:
            self._channels[key] = self._writer.channel(
                *key, channel.type_hash, channel.offered_qos, encoding=channel.encoding
            )
        return self._channels[key]


def _compare(before: Sequence[FileVerdict], after: Sequence[FileVerdict], folder: Path) -> None:
    saved, written = (sum(v.messages for v in verdicts) for verdicts in (before, after))
    bad = [v.sentence() for v in after if v.state != "complete"]
    if bad or saved != written:
        raise BagError(
            f"the repaired bag {folder} is not sound: {written} of {saved} messages were read "
            f"back; {'; '.join(bad) or 'the file is complete'}; check the disk and repair again"
        )
