"""Writing a session into MCAP so that a crash costs little and nothing is ever overwritten.

Noticing that somebody takes, swaps or cuts the files of a bag while it is recorded.
"""

from __future__ import annotations

import errno
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, TypeVar

from rotcal_ros.bags import names
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.mcap_file import LIBRARY, Attached, McapFile
from rotcal_ros.bags.rosbag2_metadata import FileInfo, bag_information, yaml_text
from rotcal_ros.bags.writer_settings import WriterSettings
from rotcal_ros.foundation import disk
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.files import FolderLock, make_folder, sync_folder, write_atomically

T = TypeVar("T")

METADATA_FILE: Final = "metadata.yaml"

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

    The folder must not exist; with ``earlier`` (the files of an interrupted session, from
    reader.session_files, or none) the session in an existing folder is continued in a new
    file. One writer at a time holds the lock on its folder.
    Data are on disk after :meth:`sync`; :meth:`tick` calls it when the interval has passed.
    When the disk fails, or somebody else takes, swaps or cuts a file of the bag, the file is
    closed at its last whole record and BagError is raised. The caller serialises the calls.
    """

    def __init__(
        self,
        folder: Path,
        settings: WriterSettings | None = None,
        *,
        earlier: Sequence[FileInfo] | None = None,
        ros_distro: str = "",
    ) -> None:
        self.folder = folder.absolute()
        self.settings = settings or WriterSettings()
        self.files: list[FileInfo] = list(earlier or ())
        self.closed = False
        self._ros_distro = ros_distro
        self._channels: dict[int, ChannelDefinition] = {}
        self._attachments: list[Attached] = []
        self._notes: dict[str, dict[str, str]] = {}
        self._sequences: dict[int, int] = {}
        self._unsynced = 0
        self._last_sync_ns: int | None = None
        self._presence = Presence(self.folder)
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

    def expect_earlier(self) -> None:
        """Take the earlier files of the session as they are now for the right ones."""
        for file in self.files:
            if not self._open_files or file is not self.files[-1]:
                self._presence.expect(self.folder / file.name)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Put ``data`` beside the messages, in this file and in every later one."""
        attached = Attached(name, media_type, data, time.time_ns())
        self._attachments.append(attached)
        self.attach_once(attached)

    def attach_once(self, attached: Attached) -> None:
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

        There may be other publishers now, but a topic whose QoS differs from file to file is
        another connection for rosbags, which then leaves out its messages.
        """
        known = (channel for file in self.files for channel in file.channels)
        before = next((c for c in known if c.topic == wanted.topic), None)
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
        """Return when all messages so far are on disk, in closed chunks, under their names."""
        if self._unsynced:
            self._guarded(self._sync)
        self._require_presence()
        if self._must_split():
            self._guarded(self._split)
        self._require_space()

    def close(self) -> None:
        """Finish the file with its index, write ``metadata.yaml``, sync the folder."""
        if not self.closed:
            self._guarded(self._sync)
            self._require_presence()
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
            raise BagError(f"cannot continue {self.folder}: there is no such folder")
        self._lock = FolderLock(self.folder)
        self.expect_earlier()
        self._begin_file()

    def _make_folder(self) -> None:
        try:
            make_folder(self.folder)
        except FileExistsError:
            raise BagError(
                f"{self.folder} exists already and a bag never overwrites; choose another folder, "
                "or continue the interrupted session explicitly"
            ) from None

    def _begin_file(self) -> None:
        name = f"{self.folder.name}_{len(self.files)}.mcap"
        file = McapFile(self.folder / name, self.settings.chunk_bytes)
        self._open_files.append(file)
        self.files.append(FileInfo(name))
        self._presence.expect(file.path)
        file.begin()
        self._describe()
        for attached in self._attachments:
            file.attach(attached)
        for name, values in self._notes.items():
            file.note(name, values)
        for channel in self._channels.values():
            file.register(channel)
        self._sync()
        sync_folder(self.folder)

    def _sync(self) -> None:
        self._file.sync()
        self._presence.grown(self._file.path, self._file.size)
        self._unsynced = 0

    def _must_split(self) -> bool:
        limits, file = self.settings, self.files[-1]
        seconds = (file.end_ns - file.start_ns) / 1e9 if file.messages else 0.0
        too_big = 0 < limits.split_bytes <= self._file.size
        return file.messages > 0 and (too_big or 0 < limits.split_duration_s <= seconds)

    def _split(self) -> None:
        """Go on in a new file, which is on the medium before the one before it names it."""
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
        self._presence.grown(file.path, file.size)

    def _describe(self) -> None:
        """Write what rosbag2 wants to know, into the file and beside it."""
        information = self._note_description()
        text = yaml_text({"rosbag2_bagfile_information": information})
        write_atomically(self.folder / METADATA_FILE, text)

    def _note_description(self) -> dict[str, Any]:
        information = bag_information(
            self.files,
            self._channels.values(),
            ros_distro=self._ros_distro,
            custom_data={"library": LIBRARY},
        )
        self._file.note(names.ROSBAG2, {"serialized_metadata": yaml_text(information)})
        return information

    def _require_presence(self) -> None:
        if fault := self._guarded(self._presence.fault):
            self._give_up()
            raise self._disturbed(fault)

    def _require_space(self) -> None:
        free = self._guarded(lambda: disk.free_bytes(self.folder))
        if free < self.settings.min_free_bytes:
            self.close()
            raise BagError(
                f"only {free / 1e6:.1f} MB are free below {self.folder}, less than the "
                f"{self.settings.min_free_bytes / 1e6:.1f} MB that recording keeps free; "
                "recording stopped, all so far is on disk; make room and continue the session"
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

    def _disturbed(self, fault: str) -> BagError:
        return BagError(
            f"cannot go on with the bag {self.folder}: {fault}; recording stopped, since "
            "nothing would be safe there; see who else uses this folder, or choose another"
        )

    def _failed(self, error: OSError) -> BagError:
        """Give up and return the error to raise."""
        self._give_up()
        if error.errno == errno.ENOENT:
            with suppress(OSError):
                if fault := self._presence.fault():
                    return self._disturbed(fault)
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

Known = tuple[int, int, int]
"""Device, number and size of a file."""


class Presence:
    """Whether the files of the bag in ``folder`` are still where, and what, they were.

    A file that is written goes on well after its name is gone: nobody would notice before its
    end. All of it raises OSError when the disk does not answer.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._known: dict[Path, Known] = {}

    def expect(self, path: Path) -> None:
        """Take the file at ``path`` as it is now for the right one."""
        self._known[path] = _known(path)

    def grown(self, path: Path, size: int) -> None:
        """Take for known that we wrote the file at ``path`` up to ``size``."""
        self._known[path] = (*self._known[path][:2], size)

    def fault(self) -> str:
        """Return what is wrong, empty where nothing is."""
        # Asked first: nobody may write into a folder that is gone, which the files tell below.
        may_write = disk.may_write(self._folder)
        for path, known in self._known.items():
            try:
                found = _known(path)
            except OSError as error:
                if error.errno not in _GONE:
                    raise
                return (
                    f"{path} is no longer there: somebody deleted or moved it or its folder, "
                    "or its disk was taken away"
                )
            if found[:2] != known[:2]:
                return f"{path} is not the file that was recorded: somebody put another there"
            if found[2] != known[2]:
                return f"{path} has {found[2]} bytes, {known[2]} were written: somebody changed it"
        if not may_write:
            return f"{self._folder} was made read-only"
        return ""


def _known(path: Path) -> Known:
    status = disk.status(path)
    return status.st_dev, status.st_ino, status.st_size
