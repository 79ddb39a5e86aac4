"""Making ``metadata.yaml`` again from the files, as ``ros2 bag reindex`` does."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from rotcal_ros.bags.file_compression import plain_name
from rotcal_ros.bags.interrupted_files import InterruptedSession
from rotcal_ros.bags.mcap_file import LIBRARY
from rotcal_ros.bags.reader import Progress, bag_files, file_info, read_blocks
from rotcal_ros.bags.rosbag2_metadata import FileInfo, bag_information, yaml_text
from rotcal_ros.bags.rosbag2_reading import (
    INFORMATION,
    LIBRARY_KEY,
    METADATA_FILE,
    MISSING_KEY,
    BagDescription,
    read_description,
)
from rotcal_ros.bags.session_identity import require_one_session
from rotcal_ros.bags.session_verdict import SessionVerdict, judge_session
from rotcal_ros.bags.verdict import FileVerdict
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.files import FolderLock, sync_folder, write_atomically


@dataclass(frozen=True)
class Reindexed:
    """The new description at ``path``, the copy of the ``old`` one, and what the session lacks."""

    path: Path
    old: Path | None
    messages: int
    session: SessionVerdict


def reindex(folder: Path, progress: Progress | None = None) -> Reindexed:
    """Write ``metadata.yaml`` of the bag in ``folder`` from its files; a copy of the old stays.

    What is missing is named in it, so that it stays known. Raises BagError, and changes nothing,
    for a file alone, for files that are damaged, left open or of several sessions: nobody else
    could read them with any metadata.yaml.
    """
    if not folder.is_dir():
        raise BagError(f"{folder} is no folder: metadata.yaml describes the files in a folder")
    files = bag_files(folder)
    require_one_session(files)
    infos: list[FileInfo] = []
    verdicts: list[FileVerdict] = []
    for scan, block in read_blocks(files, progress):
        if block is None:
            infos.append(file_info(scan))
            verdicts.append(scan.verdict())
    _require_sound(folder, verdicts)
    session = judge_session(folder, verdicts)
    try:
        old = read_description(folder)
    except BagError:
        old = None
    information = bag_information(
        infos,
        (),
        ros_distro=old.ros_distro if old else "",
        custom_data=_custom(old, session),
        storage="mcap" if plain_name(files[0]).suffix.lower() == ".mcap" else "sqlite3",
        compression_mode=_compression_mode(files, old),
    )
    path = folder / METADATA_FILE
    try:
        kept = _keep(path)
        write_atomically(path, yaml_text({INFORMATION: information}))
    except OSError as error:
        raise BagError(f"cannot write {path}: {error.strerror or error}") from error
    return Reindexed(path, kept, sum(v.messages for v in verdicts), session)


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


def _compression_mode(files: Iterable[Path], old: BagDescription | None) -> str:
    """Return rosbag2's name of how the bag is compressed; zstd is all that can be read.

    Raises BagError where some files are compressed as a whole and others are not.
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
    bad = [f"{v.path.name} is {v.sentence()}" for v in verdicts if v.state != "complete"]
    if bad:
        raise BagError(
            f"{'; '.join(bad)}: no metadata.yaml makes that readable for others; "
            f"rotcal bag repair {folder} writes a sound bag with its own"
        )


def _custom(old: BagDescription | None, session: SessionVerdict) -> dict[str, str]:
    custom = {LIBRARY_KEY: LIBRARY, **((old.custom if old else None) or {})}
    custom.pop(MISSING_KEY, None)
    if session.missing:
        custom[MISSING_KEY] = "\n".join(session.missing)
    return custom


def _keep(path: Path) -> Path | None:
    """Give the old description a name of its own beside; None when there is none."""
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
