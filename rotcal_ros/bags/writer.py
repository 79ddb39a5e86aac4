"""Writing a session into MCAP so that a crash costs little and nothing is ever overwritten."""

from __future__ import annotations

import errno
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Final, TypeVar

from mcap.writer import CompressionType, Writer

from rotcal_ros import __version__
from rotcal_ros.bags import names
from rotcal_ros.bags.definitions import ChannelDefinition, dump_definitions
from rotcal_ros.bags.rosbag2_metadata import FileInfo, bag_information, yaml_text
from rotcal_ros.bags.writer_settings import WriterSettings
from rotcal_ros.errors import BagError
from rotcal_ros.files import DurableFile, FolderLock, sync_folder, write_atomically

T = TypeVar("T")

METADATA_FILE: Final = "metadata.yaml"
LIBRARY: Final = f"rotcal_ros {__version__}"


class BagWriter:
    """One recording session: a new folder with ``<name>_0.mcap`` and ``metadata.yaml``.

    The folder must not exist; with ``earlier`` (the files of an interrupted session, from
    reader.session_files, or none) the session in an existing folder is continued in a new
    file. One writer at a time holds the lock on its folder.
    Data are on disk after :meth:`sync`; :meth:`tick` calls it when the interval has passed.
    When the disk fails, the file is closed at its last whole record and BagError is raised.
    The caller serialises the calls.
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
        self._attachments: list[tuple[int, int, str, str, bytes]] = []
        self._notes: dict[str, dict[str, str]] = {}
        self._sequences: dict[int, int] = {}
        self._unsynced = 0
        self._undescribed: dict[int, ChannelDefinition] = {}
        self._last_sync_ns: int | None = None
        self._file: DurableFile | None = None
        self._guarded(lambda: self._prepare_folder(resume=earlier is not None))
        self._lock = self._guarded(lambda: FolderLock(self.folder))
        self._guarded(self._open_file)

    @property
    def path(self) -> Path:
        """Path of the file that is being written."""
        return self.folder / self.files[-1].name

    @property
    def counts(self) -> dict[str, int]:
        """Number of messages per topic, over all files of the session."""
        topics = [channel.topic for channel in self._channels.values()]
        return {t: sum(file.counts.get(t, 0) for file in self.files) for t in topics}

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Put ``data`` beside the messages, in this file and in every later one."""
        now_ns = time.time_ns()
        attachment = (now_ns, now_ns, name, media_type, data)
        self._attachments.append(attachment)
        self._guarded(lambda: self._writer.add_attachment(*attachment))
        self._unsynced += 1

    def note(self, name: str, values: Mapping[str, object]) -> None:
        """Write a metadata record, such as loss counters; unchanged values are not repeated."""
        texts = {key: str(value) for key, value in values.items()}
        if self._notes.get(name) != texts:
            self._notes[name] = texts
            self._guarded(lambda: self._writer.add_metadata(name, texts))
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
        if encoding and not definition:
            raise BagError(
                f"topic {topic}: no definition of {type_name}; without it nobody can read the bag"
            )
        channel = ChannelDefinition(
            0, topic, type_name, encoding, definition, type_hash, offered_qos
        )
        number = self._guarded(lambda: self._register(channel))
        self._channels[number] = self._undescribed[number] = replace(channel, channel_id=number)
        self._sequences[number] = 0
        return number

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
        if self._undescribed:
            self._guarded(self._describe)
        try:
            self._writer.add_message(channel, log_time_ns, data, publish_time_ns, sequence)
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
        """Return when all messages so far are on disk, in closed chunks."""
        if self._unsynced:
            self._guarded(self._sync)
            self._unsynced = 0
            if self._must_split():
                self._guarded(self._split)
        self._check_space()

    def close(self) -> None:
        """Finish the file with its index, write ``metadata.yaml``, sync the folder."""
        if not self.closed:
            self._guarded(self._finish)
            self.closed = True
            self._lock.release()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _prepare_folder(self, *, resume: bool) -> None:
        if resume:
            if not self.folder.is_dir():
                raise BagError(f"cannot continue {self.folder}: there is no such folder")
            return
        try:
            self.folder.mkdir(parents=True)
        except FileExistsError:
            raise BagError(
                f"{self.folder} exists already and a bag never overwrites; choose another folder, "
                "or continue the interrupted session explicitly"
            ) from None
        sync_folder(self.folder.parent)

    def _open_file(self) -> None:
        name = f"{self.folder.name}_{len(self.files)}.mcap"
        self._file = DurableFile(self.folder / name)
        self.files.append(FileInfo(name))
        self._writer = Writer(
            self._file,  # type: ignore[arg-type]
            chunk_size=self.settings.chunk_bytes,
            compression=CompressionType.ZSTD,
            enable_crcs=True,
            enable_data_crcs=True,
        )
        self._schemas: dict[tuple[str, str], int] = {}
        self._writer.start(profile="ros2", library=LIBRARY)
        self._write_metadata()
        for attachment in self._attachments:
            self._writer.add_attachment(*attachment)
        for name, values in self._notes.items():
            self._writer.add_metadata(name, values)
        for channel in self._channels.values():
            self._register(channel)
        self._undescribed.update(self._channels)
        self._sync()

    def _register(self, channel: ChannelDefinition) -> int:
        key = (channel.type_name, channel.definition)
        if key not in self._schemas:
            self._schemas[key] = self._writer.register_schema(
                channel.type_name, channel.encoding, channel.definition.encode()
            )
        self._unsynced += 1
        return self._writer.register_channel(
            channel.topic,
            "cdr",
            self._schemas[key],
            {"offered_qos_profiles": channel.offered_qos, "topic_type_hash": channel.type_hash},
        )

    def _describe(self) -> None:
        """Put new definitions beside the chunks, before the first message that needs them."""
        data = dump_definitions(self._undescribed.values())
        now_ns = time.time_ns()
        self._writer.add_attachment(now_ns, now_ns, names.DEFINITIONS, "application/json", data)
        self._undescribed.clear()

    def _sync(self) -> None:
        if self._undescribed:
            self._describe()
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._open.sync()

    def _must_split(self) -> bool:
        limits, file = self.settings, self.files[-1]
        seconds = (file.end_ns - file.start_ns) / 1e9 if file.messages else 0.0
        too_big = 0 < limits.split_bytes <= self._open.tell()
        return file.messages > 0 and (too_big or 0 < limits.split_duration_s <= seconds)

    def _split(self) -> None:
        following = f"{self.folder.name}_{len(self.files)}.mcap"
        self._writer.add_metadata(names.CONTINUED, {"in": following})
        self._finish()
        self._open_file()

    def _finish(self) -> None:
        self._sync()
        self._write_metadata()
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._open.sync()
        self._open.close()
        sync_folder(self.folder)

    def _write_metadata(self) -> None:
        information = bag_information(
            self.files,
            self._channels.values(),
            ros_distro=self._ros_distro,
            custom_data={"library": LIBRARY},
        )
        values = {"serialized_metadata": yaml_text(information)}
        self._writer.add_metadata(names.ROSBAG2, values)
        text = yaml_text({"rosbag2_bagfile_information": information})
        write_atomically(self.folder / METADATA_FILE, text)

    def _check_space(self) -> None:
        free = shutil.disk_usage(self.folder).free
        if free < self.settings.min_free_bytes and not self.closed:
            self.close()
            raise BagError(
                f"only {free / 1e6:.1f} MB are free below {self.folder}, less than the "
                f"{self.settings.min_free_bytes / 1e6:.1f} MB that recording keeps free; "
                "recording stopped, all so far is on disk; make room and continue the session"
            )

    @property
    def _open(self) -> DurableFile:
        assert self._file is not None
        return self._file

    def _guarded(self, action: Callable[[], T]) -> T:
        if self.closed:
            raise BagError(f"the bag {self.folder} is closed")
        try:
            return action()
        except OSError as error:
            raise self._failed(error) from error

    def _failed(self, error: OSError) -> BagError:
        """Close at the last whole record and return the error to raise."""
        self.closed = True
        if self._file is not None:
            with suppress(OSError):
                self._file.sync()
            with suppress(OSError):
                self._file.close()
            self._lock.release()
        reason = {
            errno.ENOSPC: "the disk is full",
            errno.EFBIG: "the file has reached the size that this system allows",
            errno.EDQUOT: "the disk quota is used up",
            errno.EROFS: "the file system is read-only",
            errno.EACCES: "writing is not permitted",
        }.get(error.errno or 0, error.strerror or str(error))
        return BagError(
            f"cannot write the bag {self.folder}: {reason}; what was synced before is safe, "
            "the last records may be missing; make room or choose another folder"
        )
