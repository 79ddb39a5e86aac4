"""Writes a session into MCAP so that a crash costs little and nothing is ever overwritten.

Chunks are closed and synced at short intervals, and every definition is written a second time,
outside the chunks. A file that is deleted, replaced or cut while it is recorded is noticed.
"""

from __future__ import annotations

import errno
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, TypeVar

from mcap.writer import CompressionType, Writer

from rotcal_ros import __version__
from rotcal_ros.bags import names
from rotcal_ros.bags.definitions import ChannelDefinition, dump_definitions, schema_bytes
from rotcal_ros.bags.rosbag2_metadata import METADATA_FILE, FileInfo, bag_information, yaml_text
from rotcal_ros.bags.settings import WriterSettings
from rotcal_ros.foundation import disk, files
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.folder_lock import FolderLock

T = TypeVar("T")

_REASONS: Final = {
    errno.ENOSPC: "the disk is full",
    errno.EFBIG: "the file has reached the size that this system allows",
    errno.EDQUOT: "the disk quota is used up",
    errno.EROFS: "the file system is read-only",
    errno.EACCES: "writing is not permitted",
    errno.EPERM: "writing is not permitted",
    errno.EIO: "the disk reports an error (input/output)",
}


class BagWriter:
    """One recording session: a new folder with ``<name>_0.mcap`` and ``metadata.yaml``.

    The folder must not exist; with ``earlier``, the files of an :class:`InterruptedSession` or
    none, the session in an existing folder is continued in a new file. One writer at a time holds
    the lock on its folder. Data are on disk after :meth:`sync`; :meth:`tick` calls it when the
    interval has passed. When the disk fails, or somebody else deletes, replaces or cuts a file of
    the bag, the file is closed at its last whole record and BagError is raised. The caller
    serialises the calls. ``clock`` gives in ns when something is attached: with a clock that
    stands, the same calls write the same bytes.
    """

    def __init__(
        self,
        folder: Path,
        settings: WriterSettings | None = None,
        *,
        earlier: Sequence[FileInfo] | None = None,
        ros_distro: str = "",
        clock: Callable[[], int] = time.time_ns,
    ) -> None:
        self.folder = folder.absolute()
        self.settings = settings or WriterSettings()
        self.files: list[FileInfo] = list(earlier or ())
        self.closed = False
        self._ros_distro, self._clock = ros_distro, clock
        self._channels: dict[int, ChannelDefinition] = {}
        self._attachments: list[LoggedAttachment] = []
        self._notes: dict[str, dict[str, str]] = {}
        self._sequences: dict[int, int] = {}
        self._unsynced = 0
        self._last_sync_ns: int | None = None
        self._watched = WatchedFiles(self.folder)
        self._lock: FolderLock | None = None
        self._open_files: list[McapFile] = []
        self._guarded(lambda: self._begin(resume=earlier is not None))

    @property
    def path(self) -> Path:
        """Path of the file that is being written."""
        return self.folder / self.files[-1].name

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages per topic, over all files of the session."""
        topics = [channel.topic for channel in self._channels.values()]
        return {t: sum(file.counts.get(t, 0) for file in self.files) for t in topics}

    def watch_earlier_files(self) -> None:
        """Watch the earlier files of the session, as they are now."""
        for file in self.files:
            if not self._open_files or file is not self.files[-1]:
                self._watched.watch(self.folder / file.name)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Put ``data`` beside the messages, in this file and in every later one."""
        attached = LoggedAttachment(name, media_type, data, self._clock())
        self._attachments.append(attached)
        self.attach_once(attached)

    def attach_once(self, attached: LoggedAttachment) -> None:
        """Put an attachment of another bag beside the messages, in this file alone."""
        self._guarded(lambda: self._file.attach(attached))
        self._unsynced += 1

    def note(self, name: str, values: Mapping[str, object]) -> None:
        """Write a metadata record, such as loss counters; unchanged values are not repeated."""
        texts = {key: str(value) for key, value in values.items()}
        if self._notes.get(name) != texts:
            self._notes[name] = texts
            self._guarded(lambda: self._file.note(name, texts))
            self._unsynced += 1

    def channel(
        self,
        topic: str,
        type_name: str,
        definition: str,
        type_hash: str = "",
        offered_qos: str = "",
        *,
        encoding: str = "ros2msg",
    ) -> int:
        """Add a channel and return its id.

        ``definition`` is the text of :func:`collect_definition` in ``encoding``, ``type_hash``
        the RIHS01 hash (empty when the middleware offers none), ``offered_qos`` the text of
        :func:`rosbag2_metadata.qos_text`.
        """
        return self.add_channel(
            ChannelDefinition(0, topic, type_name, encoding, definition, type_hash, offered_qos)
        )

    def add_channel(self, wanted: ChannelDefinition) -> int:
        """Add a channel as another bag defines it, and return its id here."""
        channel = self._guarded(lambda: self._file.register(self._as_before(wanted)))
        self._channels[channel.channel_id] = channel
        self._sequences[channel.channel_id] = 0
        self._unsynced += 1
        return channel.channel_id

    def _as_before(self, wanted: ChannelDefinition) -> ChannelDefinition:
        """Return a channel with the QoS that its topic has in the earlier files of the session.

        There may be other publishers now, but rosbags takes a topic whose QoS differs from file to
        file for another connection and leaves out its messages.
        """
        earlier = (channel for file in self.files for channel in file.channels)
        before = next((c for c in earlier if c.topic == wanted.topic), None)
        return wanted if before is None else replace(wanted, offered_qos=before.offered_qos)

    def write(
        self,
        channel: int,
        data: bytes,
        log_time_ns: int,
        publish_time_ns: int,
        sequence: int | None = None,
    ) -> None:
        """Append one serialised message; log time is its reception, publish time its origin.

        Without ``sequence`` the messages of a channel are numbered from 0.
        """
        if self.closed:
            raise BagError(f"the bag {self.folder} is closed: a message came too late")
        if sequence is None:
            sequence = self._sequences[channel]
        try:
            self._file.write(channel, data, log_time_ns, publish_time_ns, sequence)
        except OSError as error:
            raise self._failed(error) from error
        self._sequences[channel] = (sequence + 1) & 0xFFFFFFFF
        self._unsynced += 1
        file = self.files[-1]
        topic = self._channels[channel].topic
        file.counts[topic] = file.counts.get(topic, 0) + 1
        file.start_ns = min(file.start_ns, log_time_ns)
        file.end_ns = max(file.end_ns, log_time_ns)

    def tick(self, now_ns: int) -> bool:
        """Sync when the interval has passed; ``now_ns`` is monotonic time. True when synced."""
        if self._last_sync_ns is None:
            self._last_sync_ns = now_ns
        if now_ns - self._last_sync_ns < self.settings.sync_interval_s * 1e9:
            return False
        self._last_sync_ns = now_ns
        self.sync()
        return True

    def sync(self) -> None:
        """Wait until all messages so far are on disk, in closed chunks, under their names."""
        if self._unsynced:
            self._guarded(self._sync)
        self._require_undisturbed()
        if self._must_split():
            self._guarded(self._split)
        self._require_space()

    def close(self) -> None:
        """Finish the file with its index, write ``metadata.yaml``, sync the folder."""
        if not self.closed:
            self._guarded(self._sync)
            self._require_undisturbed()
            self._guarded(self._finish)
            self._release()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _begin(self, *, resume: bool) -> None:
        if not resume:
            self._make_folder()
        elif not self.folder.is_dir():
            raise BagError(
                f"cannot continue {self.folder}: there is no such folder; name that of the "
                "interrupted recording"
            )
        self._lock = FolderLock(self.folder)
        self.watch_earlier_files()
        self._begin_file()

    def _make_folder(self) -> None:
        try:
            files.make_folder(self.folder)
        except FileExistsError:
            raise BagError(
                f"{self.folder} exists already and a bag never overwrites; choose another folder, "
                "or continue the interrupted session explicitly"
            ) from None

    def _begin_file(self) -> None:
        name = f"{self.folder.name}_{len(self.files)}.mcap"
        file = McapFile(self.folder / name, self.settings.chunk_bytes, self._clock)
        self._open_files.append(file)
        self.files.append(FileInfo(name))
        self._watched.watch(file.path)
        file.begin()
        self._describe()
        for attached in self._attachments:
            file.attach(attached)
        for name, values in self._notes.items():
            file.note(name, values)
        for channel in self._channels.values():
            file.register(channel)
        self._sync()
        files.sync_folder(self.folder)

    def _sync(self) -> None:
        self._file.sync()
        self._watched.expect_size(self._file.path, self._file.size)
        self._unsynced = 0

    def _must_split(self) -> bool:
        too_big = 0 < self.settings.split_bytes <= self._file.size
        return too_big and self.files[-1].messages > 0

    def _split(self) -> None:
        """Go on in a new file, which is on the medium before the previous one names it."""
        ending = self._file
        self._note_description()
        self._begin_file()
        ending.note(names.CONTINUED, {"in": self.path.name})
        self._finish_file(ending)

    def _finish(self) -> None:
        self._describe()
        self._finish_file(self._file)

    def _finish_file(self, file: McapFile) -> None:
        """Finish a file that is synced."""
        file.finish()
        self._open_files.remove(file)
        self._watched.expect_size(file.path, file.size)

    def _describe(self) -> None:
        """Write what rosbag2 needs to know, into the file and beside it."""
        information = self._note_description()
        text = yaml_text({"rosbag2_bagfile_information": information})
        files.write_atomically(self.folder / METADATA_FILE, text)

    def _note_description(self) -> dict[str, Any]:
        information = bag_information(
            self.files,
            self._channels.values(),
            ros_distro=self._ros_distro,
            custom_data={"library": LIBRARY},
        )
        self._file.note(names.ROSBAG2, {"serialized_metadata": yaml_text(information)})
        return information

    def _require_undisturbed(self) -> None:
        disturbance = self._guarded(self._watched.disturbance)
        if disturbance is not None:
            self._give_up()
            raise self._disturbed(disturbance)

    def _require_space(self) -> None:
        free = self._guarded(lambda: disk.free_bytes(self.folder))
        if free < self.settings.min_free_bytes:
            self.close()
            raise BagError(
                f"only {free / 1e6:.1f} MB are free below {self.folder}, less than the "
                f"{self.settings.min_free_bytes / 1e6:.1f} MB that recording keeps free; "
                "recording stopped, everything so far is on disk; make room and continue the "
                "session"
            )

    @property
    def _file(self) -> McapFile:
        return self._open_files[-1]

    def _guarded(self, action: Callable[[], T]) -> T:
        if self.closed:
            raise BagError(f"the bag {self.folder} is closed")
        try:
            return action()
        except OSError as error:
            raise self._failed(error) from error

    def _disturbed(self, disturbance: str) -> BagError:
        return BagError(
            f"cannot continue the bag {self.folder}: {disturbance}; recording stopped, since "
            "data would not be safe there; find out who else uses this folder, or choose another"
        )

    def _failed(self, error: OSError) -> BagError:
        """Give up and return the error to raise."""
        self._give_up()
        if error.errno == errno.ENOENT:
            with suppress(OSError):
                if (disturbance := self._watched.disturbance()) is not None:
                    return self._disturbed(disturbance)
        reason = _REASONS.get(error.errno or 0, error.strerror or str(error))
        return BagError(
            f"cannot write the bag {self.folder}: {reason}; what was synced before is safe, "
            "the last records may be missing; make room or choose another folder"
        )

    def _give_up(self) -> None:
        """Close at the last whole record."""
        for file in self._open_files:
            file.abandon()
        self._release()

    def _release(self) -> None:
        self.closed = True
        if self._lock is not None:
            self._lock.release()


_GONE: Final = (errno.ENOENT, errno.ENOTDIR, errno.ESTALE, errno.ENODEV, errno.ENOTCONN)

FileState = tuple[int, int, int]
"""Device, inode and size of a file."""


class WatchedFiles:
    """Watches the files of a bag in ``folder``: notices if others delete or change them.

    Writing to an open file succeeds even after its name is gone: the loss would be noticed only at
    the end of the recording. All methods raise OSError if the disk does not answer.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._expected: dict[Path, FileState] = {}

    def watch(self, path: Path) -> None:
        """Expect the file at ``path`` to stay as it is now."""
        self._expected[path] = _file_state(path)

    def expect_size(self, path: Path, size: int) -> None:
        """Expect another size: we wrote the file at ``path`` up to ``size``."""
        self._expected[path] = (*self._expected[path][:2], size)

    def disturbance(self) -> str | None:
        """Return what somebody else did to the files, None if all is as expected."""
        # Asked first: a folder that is gone cannot be written either, which the files say better.
        may_write = disk.may_write(self._folder)
        for path, expected in self._expected.items():
            try:
                found = _file_state(path)
            except OSError as error:
                if error.errno not in _GONE:
                    raise
                return (
                    f"{path} is no longer there: somebody deleted or moved it or its folder, or "
                    "removed its disk"
                )
            if found[:2] != expected[:2]:
                return f"{path} is not the file that was recorded: somebody put another there"
            if found[2] != expected[2]:
                return (
                    f"{path} has {found[2]} bytes, {expected[2]} were written: somebody changed it"
                )
        if not may_write:
            return f"{self._folder} was made read-only"
        return None


def _file_state(path: Path) -> FileState:
    status = disk.status(path)
    return status.st_dev, status.st_ino, status.st_size


LIBRARY: Final = f"rotcal_ros {__version__}"
_QOS: Final = "offered_qos_profiles"
_HASH: Final = "topic_type_hash"
_MOST_CHANNELS: Final = 65_535
"""A channel id has two bytes in MCAP; the writer counts from 1."""


@dataclass(frozen=True, slots=True)
class LoggedAttachment:
    """An attachment logged at ``time_ns``.

    Created then too, unless ``created_ns`` says otherwise.
    """

    name: str
    media_type: str
    data: bytes
    time_ns: int
    created_ns: int | None = None


class McapFile:
    """A new file at ``path``, which must not exist; :meth:`begin` it first.

    All methods raise OSError if the disk fails: then only :meth:`abandon` is left to do.
    """

    def __init__(self, path: Path, chunk_bytes: int, clock: Callable[[], int]) -> None:
        self.path, self._clock = path, clock
        self._file = files.DurableFile(path)
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

    def attach(self, attached: LoggedAttachment) -> None:
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
            raise BagError(f"a bag has at most {_MOST_CHANNELS} channels: record fewer topics")
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
        """Wait until everything so far is on the medium, in closed chunks."""
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
        """Close the file after its last whole record, as well as the disk allows."""
        with suppress(OSError):
            self._file.sync()
        with suppress(OSError):
            self._file.close()

    def _describe(self) -> None:
        """Put new definitions beside the chunks, before the first message that needs them."""
        data = dump_definitions(self._undescribed)
        self.attach(LoggedAttachment(names.DEFINITIONS, "application/json", data, self._clock()))
        self._undescribed.clear()
