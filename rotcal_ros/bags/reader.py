"""Reads a bag of any recorder: a folder or a file, whole, cut off or damaged."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator
from pathlib import Path, PurePath
from typing import Final, TypeVar

from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.compression import plain_name
from rotcal_ros.bags.mcap_scan import McapScan
from rotcal_ros.bags.rosbag2_metadata import INFINITE_NS, FileInfo
from rotcal_ros.bags.settings import DEFAULT_LIMITS, ReadingLimits
from rotcal_ros.bags.storage_scan import FileVerdict, Item, Scan
from rotcal_ros.bags.unread_data import note_verdict
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.untrusted import read_errors_as

Content = TypeVar("Content")

Progress = Callable[[int, int], None]
"""Called with the bytes done and the bytes in all."""

SUFFIXES: Final = (".mcap", ".db3")
"""The endings of storage files, in any case; followed by ``.zstd``: compressed as a whole."""

_NUMBERS: Final = re.compile(r"(\d+)")
_HASH_BYTES: Final = 1 << 20


def bag_files(path: Path) -> tuple[Path, ...]:
    """Return the storage files of a bag, oldest first; ``metadata.yaml`` is not needed.

    Raises BagError when there is no bag at ``path``, or none that may be read.
    """
    with read_errors_as(path, BagError):
        if not path.exists():
            raise BagError(f"{path} does not exist; name a bag folder, or an .mcap or .db3 file")
        if path.is_file():
            scan_file(path)
            return (path,)
        inside = sorted(filter(is_storage_name, path.iterdir()))
    for suffix in SUFFIXES:
        found = [file for file in inside if _storage(file) == suffix]
        # Where a file was unpacked beside its compressed form, the plain one is read.
        files = {plain_name(file).stem: file for file in reversed(found)}
        if files:
            return tuple(sorted(files.values(), key=_order))
    deeper = sorted(f.parent for ending in SUFFIXES for f in path.glob(f"*/*{ending}"))
    hint = f"did you mean {deeper[0]}?" if deeper else "name another"
    raise BagError(f"{path} is not a bag: there is no .mcap or .db3 file in the folder; {hint}")


def scan_file(
    path: Path, limits: ReadingLimits = DEFAULT_LIMITS, *, check_index: bool = False
) -> Scan:
    """Return a pass over the storage file ``path``; raises BagError for any other file."""
    storage = _storage(path)
    if storage == ".mcap":
        return McapScan(path, limits, check_index=check_index)
    if storage != ".db3":
        raise BagError(
            f"{path} is not a bag: expected a folder or a file ending in .mcap or .db3; a plain "
            "table is text with commas between its columns"
        )
    from rotcal_ros.bags.sqlite_scan import SqliteScan  # few bags need it

    return SqliteScan(path, limits)


def read_blocks(
    files: tuple[Path, ...],
    progress: Progress | None = None,
    limits: ReadingLimits = DEFAULT_LIMITS,
) -> Iterator[tuple[Scan, Block | None]]:
    """Yield the blocks of several files in order, each with its pass; None ends a file."""
    return _read(files, lambda scan: scan.blocks(), progress, limits)


def read_items(
    files: tuple[Path, ...],
    progress: Progress | None = None,
    limits: ReadingLimits = DEFAULT_LIMITS,
) -> Iterator[tuple[Scan, Item | None]]:
    """Yield all that several files hold, and check their indexes; as :func:`read_blocks`."""
    return _read(files, lambda scan: scan.items(), progress, limits, check_index=True)


def _read(
    files: tuple[Path, ...],
    contents: Callable[[Scan], Iterator[Content]],
    progress: Progress | None,
    limits: ReadingLimits,
    *,
    check_index: bool = False,
) -> Iterator[tuple[Scan, Content | None]]:
    total, done = sum(file.stat().st_size for file in files), 0
    for file in files:
        scan = scan_file(file, limits, check_index=check_index)
        for item in contents(scan):
            yield scan, item
            if progress is not None:
                progress(done + scan.position, total)
        done += file.stat().st_size
        note_verdict(scan.verdict())
        yield scan, None


def check_files(
    files: tuple[Path, ...],
    progress: Progress | None = None,
    limits: ReadingLimits = DEFAULT_LIMITS,
) -> tuple[FileVerdict, ...]:
    """Read files and their indexes to the ends and return their verdicts."""
    found = read_items(files, progress, limits)
    return tuple(scan.verdict() for scan, item in found if item is None)


def file_info(scan: Scan) -> FileInfo:
    """Return what rosbag2's description says of a file, after the pass over it."""
    verdict = scan.verdict()
    return FileInfo(
        verdict.path.name,
        INFINITE_NS if verdict.start_ns is None else verdict.start_ns,
        verdict.end_ns or 0,
        {name: topic.messages for name, topic in verdict.topics.items() if topic.messages},
        tuple(scan.channels.values()),
    )


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while part := file.read(_HASH_BYTES):
            digest.update(part)
    return digest.hexdigest()


def is_storage_name(path: PurePath) -> bool:
    """Return whether a file has the name of a storage file of a bag, compressed or not."""
    return _storage(path) in SUFFIXES


def _storage(path: PurePath) -> str:
    """Return the ending of a file; for a storage file it is in SUFFIXES."""
    return plain_name(path).suffix.lower()


def _order(path: Path) -> tuple[str | int, ...]:
    """Sort key: name_2 comes before name_10, and 2_name before 10_name, as ROS 2 Lyrical names."""
    parts = _NUMBERS.split(plain_name(path).stem)  # texts and numbers in turn
    return tuple(int(part) if n % 2 else part for n, part in enumerate(parts))
