"""Repairs a bag: into a new one, or its ``metadata.yaml`` as ``ros2 bag reindex`` does."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from itertools import count
from pathlib import Path
from typing import Final

from mcap.records import Attachment, Metadata

from rotcal_ros.bags import names, rosbag2_metadata
from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.compression import plain_name
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.interrupted_files import InterruptedSession
from rotcal_ros.bags.reader import (
    Progress,
    bag_files,
    check_files,
    file_info,
    read_blocks,
    read_items,
)
from rotcal_ros.bags.session_identity import require_one_session
from rotcal_ros.bags.session_verdict import SessionVerdict, judge_session, repair_record
from rotcal_ros.bags.settings import DEFAULT_LIMITS, ReadingLimits, WriterSettings
from rotcal_ros.bags.storage_scan import FileVerdict, Scan, session_losses
from rotcal_ros.bags.writer import LIBRARY, BagWriter, LoggedAttachment
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.files import sync_folder, write_atomically
from rotcal_ros.foundation.folder_lock import FolderLock

_MESSAGE_BYTES: Final = 31
"""Bytes that a message takes in a file besides its payload."""


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
        """Copy an attachment; those that every file of a session repeats only once."""
        key = sha256(repr((found.name, found.media_type)).encode() + found.data).digest()
        self._of_this_file.add(key)
        if found.name != names.DEFINITIONS and key not in self._of_earlier_files:
            self._writer.attach_once(
                LoggedAttachment(
                    found.name, found.media_type, found.data, found.log_time, found.create_time
                )
            )

    def metadata(self, record: Metadata) -> None:
        """Copy a metadata record.

        Losses are added up at the end, rosbag2's own record is made anew.
        """
        if record.name == names.RUN:
            self._begin_run(record.metadata)
        elif record.name not in (names.ROSBAG2, names.LOSSES, names.CONTINUED, names.REPAIR):
            self._writer.note(record.name, record.metadata)

    def end_file(self) -> None:
        """Count what this file holds as copied before the next one begins."""
        self._of_earlier_files |= self._of_this_file
        self._of_this_file.clear()

    def _begin_run(self, run: dict[str, str]) -> None:
        """Note which run of an interrupted plan the following messages belong to."""
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
    bad = [v.describe() for v in after if v.state != "complete"]
    if bad or saved != written:
        raise BagError(
            f"the repaired bag {folder} is not sound: {written} of {saved} messages were read "
            f"back; {'; '.join(bad) or 'the file is complete'}; check the disk and repair again"
        )


@dataclass(frozen=True)
class Reindexed:
    """The new description at ``path``, the copy of the ``old`` one, and what the session lacks."""

    path: Path
    old: Path | None
    messages: int
    session: SessionVerdict


def reindex(folder: Path, progress: Progress | None = None) -> Reindexed:
    """Write ``metadata.yaml`` of the bag in ``folder`` from its files; a copy of the old stays.

    It also names what is missing. Raises BagError, and changes nothing, for a single file and for
    files that are damaged, left open or of several sessions: no metadata.yaml would let other
    programs read them.
    """
    if not folder.is_dir():
        raise BagError(f"{folder} is not a folder: metadata.yaml describes the files in a folder")
    files = bag_files(folder)
    require_one_session(files)
    infos: list[rosbag2_metadata.FileInfo] = []
    verdicts: list[FileVerdict] = []
    for scan, block in read_blocks(files, progress):
        if block is None:
            infos.append(file_info(scan))
            verdicts.append(scan.verdict())
    _require_sound(folder, verdicts)
    session = judge_session(folder, verdicts)
    try:
        old = rosbag2_metadata.read_description(folder)
    except BagError:
        old = None
    information = rosbag2_metadata.bag_information(
        infos,
        (),
        ros_distro=old.ros_distro if old else "",
        custom_data=_custom(old, session),
        storage="mcap" if plain_name(files[0]).suffix.lower() == ".mcap" else "sqlite3",
        compression_mode=_compression_mode(files, old),
    )
    path = folder / rosbag2_metadata.METADATA_FILE
    try:
        copy = _copy_old(path)
        write_atomically(
            path, rosbag2_metadata.yaml_text({rosbag2_metadata.INFORMATION: information})
        )
    except OSError as error:
        raise BagError(
            f"cannot write {path}: {error.strerror or error}; make room and the folder writable"
        ) from error
    return Reindexed(path, copy, sum(v.messages for v in verdicts), session)


def finish_interrupted(folder: Path) -> None:
    """Close what an interruption left open in a session that is not continued.

    Raises BagError when another process still writes there or the disk fails.
    """
    lock = FolderLock(folder)
    try:
        left = InterruptedSession.read(folder)
        left.close()
    finally:
        lock.release()
    if left.open_ends:
        reindex(folder)


def _compression_mode(files: Iterable[Path], old: rosbag2_metadata.BagDescription | None) -> str:
    """Return rosbag2's name of how the bag is compressed: only zstd can be read.

    Raises BagError if some files are compressed as a whole and others are not.
    """
    packed = {plain_name(file) != file for file in files}
    if len(packed) > 1:
        raise BagError(
            "some files are compressed as a whole and others are not, which no metadata.yaml can "
            "say: unpack them (zstd -d)"
        )
    stated = "" if old is None else old.compression_mode
    return "FILE" if True in packed else stated.upper() if stated == "message" else ""


def _require_sound(folder: Path, verdicts: Iterable[FileVerdict]) -> None:
    bad = [f"{v.path.name} is {v.describe()}" for v in verdicts if v.state != "complete"]
    if bad:
        raise BagError(
            f"{'; '.join(bad)}: no metadata.yaml makes that readable for other programs; rotcal "
            f"bag repair {folder} writes a sound bag with its own"
        )


def _custom(
    old: rosbag2_metadata.BagDescription | None, session: SessionVerdict
) -> dict[str, str]:
    custom = {rosbag2_metadata.LIBRARY_KEY: LIBRARY, **((old.custom if old else None) or {})}
    custom.pop(rosbag2_metadata.MISSING_KEY, None)
    if session.missing:
        custom[rosbag2_metadata.MISSING_KEY] = "\n".join(session.missing)
    return custom


def _copy_old(path: Path) -> Path | None:
    """Return a copy of the old metadata.yaml under a name of its own; None without an old one."""
    if not path.is_file():
        return None
    for number in count():
        copy = path.with_name(f"{path.name}.old{number or ''}")
        try:
            os.link(path, copy)
        except FileExistsError:
            continue
        sync_folder(path.parent)
        return copy
    return None
