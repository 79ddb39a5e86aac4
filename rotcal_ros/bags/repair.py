"""Saving what can be saved of a damaged bag into a new, sound one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Final

from mcap.records import Attachment, Metadata

from rotcal_ros.bags import names
from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.mcap_file import Attached
from rotcal_ros.bags.reader import Progress, bag_files, check_files, read_items
from rotcal_ros.bags.reading_limits import DEFAULT_LIMITS, ReadingLimits
from rotcal_ros.bags.repair_record import repair_record
from rotcal_ros.bags.session_verdict import judge_session
from rotcal_ros.bags.storage_scan import Scan
from rotcal_ros.bags.verdict import FileVerdict, session_losses
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.bags.writer_settings import WriterSettings
from rotcal_ros.foundation.errors import BagError

_MESSAGE_BYTES: Final = 31
"""What a message takes in a file beside its payload."""


@dataclass(frozen=True)
class Repair:
    """The verdicts on the files before and after a repair."""

    before: tuple[FileVerdict, ...]
    after: tuple[FileVerdict, ...]


def repair(
    path: Path,
    folder: Path,
    progress: Progress | None = None,
    limits: ReadingLimits = DEFAULT_LIMITS,
) -> Repair:
    """Write all that can be read of the bag at ``path`` into the new ``folder``.

    The original is never touched. The new bag is read again and must hold every message
    that was saved. Raises BagError when nothing can be read or ``folder`` exists.
    """
    before: list[FileVerdict] = []
    with BagWriter(folder, WriterSettings(min_free_bytes=0)) as writer:
        copier = _Copier(writer)
        for scan, item in read_items(bag_files(path), progress, limits):
            if isinstance(item, Block):
                copier.messages(scan, item)
            elif isinstance(item, Attachment):
                copier.attachment(item)
            elif isinstance(item, Metadata):
                copier.metadata(item)
            else:
                before.append(scan.verdict())
                copier.end_file()
        unread = {name: text for v in before for name, text in v.losses_unread.items()}
        if losses := {**unread, **session_losses(before)}:
            writer.note(names.LOSSES, losses)
        writer.note(names.REPAIR, repair_record(before, judge_session(path, before).missing))
    room = max(limits.unpacked_bytes, 2 * copier.message_bytes)  # it may be packed more tightly
    after = check_files(bag_files(folder), limits=replace(limits, unpacked_bytes=room))
    _compare(before, after, folder)
    return Repair(tuple(before), after)


class _Copier:
    """Copies messages and all that belongs to them, each channel once."""

    def __init__(self, writer: BagWriter) -> None:
        self.message_bytes = 0
        self._writer = writer
        self._channels: dict[ChannelDefinition, int] = {}
        self._of_earlier_files: set[bytes] = set()
        self._of_this_file: set[bytes] = set()
        self._run: dict[str, str] = {}

    def messages(self, scan: Scan, block: Block) -> None:
        """Copy messages with their numbers and times."""
        numbers = {number: self._channel(scan.channels[number]) for number in block.counts()}
        self.message_bytes += int(block.size.sum()) + _MESSAGE_BYTES * len(block)
        for row, (channel, sequence, log_time, publish_time) in enumerate(block.headers.tolist()):
            self._writer.write(
                numbers[channel], block.payload(row), log_time, publish_time, sequence
            )

    def attachment(self, found: Attachment) -> None:
        """Copy an attachment; of those that every file of a session carries, the first."""
        key = sha256(repr((found.name, found.media_type)).encode() + found.data).digest()
        self._of_this_file.add(key)
        if found.name != names.DEFINITIONS and key not in self._of_earlier_files:
            self._writer.attach_once(
                Attached(
                    found.name, found.media_type, found.data, found.log_time, found.create_time
                )
            )

    def metadata(self, record: Metadata) -> None:
        """Copy a metadata record; losses are added up at the end, rosbag2's own is made anew."""
        if record.name == names.RUN:
            self._begin_run(record.metadata)
        elif record.name not in (names.ROSBAG2, names.LOSSES, names.CONTINUED, names.REPAIR):
            self._writer.note(record.name, record.metadata)

    def end_file(self) -> None:
        """Take note that the next file begins."""
        self._of_earlier_files |= self._of_this_file
        self._of_this_file.clear()

    def _begin_run(self, run: dict[str, str]) -> None:
        """Say which run of an interrupted plan the messages belong to that come now."""
        if run != self._run:
            self._run = dict(run)
            self._writer.sync()  # closes the chunk: the record must not overtake its messages
            self._writer.note(names.RUN, self._run)

    def _channel(self, channel: ChannelDefinition) -> int:
        key = replace(channel, channel_id=0)
        if key not in self._channels:
            self._channels[key] = self._writer.add_channel(key)
        return self._channels[key]


def _compare(before: Sequence[FileVerdict], after: Sequence[FileVerdict], folder: Path) -> None:
    saved, written = (sum(v.messages for v in verdicts) for verdicts in (before, after))
    bad = [v.sentence() for v in after if v.state != "complete"]
    if bad or saved != written:
        raise BagError(
            f"the repaired bag {folder} is not sound: {written} of {saved} messages were read "
            f"back; {'; '.join(bad) or 'the file is complete'}; check the disk and repair again"
        )
