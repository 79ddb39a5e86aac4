"""Reading a bag, whoever wrote it: a folder or a file, whole, cut off or damaged."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.mcap_scan import McapScan
from rotcal_ros.bags.reading_limits import DEFAULT_LIMITS, ReadingLimits
from rotcal_ros.bags.rosbag2_metadata import INFINITE_NS, FileInfo
from rotcal_ros.bags.scan import Item, Scan
from rotcal_ros.bags.verdict import FileVerdict
from rotcal_ros.bags.whole_file import PACKED
from rotcal_ros.errors import BagError

Progress = Callable[[int, int], None]
"""Called with the bytes done and the bytes in all."""

SUFFIXES: Final = (".mcap", ".db3")
"""The endings of storage files, in any case; ``.zstd`` behind one: compressed as a whole."""

_NUMBER: Final = re.compile(r"(.*?)_?(\d+)$")
_HASH_BYTES: Final = 1 << 20


def bag_files(path: Path) -> tuple[Path, ...]:
    """Return the storage files of a bag, oldest first; ``metadata.yaml`` is not needed.

    Raises BagError when there is no bag at ``path``.
    """
    if not path.exists():
        raise BagError(f"{path} does not exist; expected a bag folder or an .mcap or .db3 file")
    if path.is_file():
        scan_file(path)
        return (path,)
    for suffix in SUFFIXES:
        found = sorted(f for f in path.iterdir() if _storage(f) == suffix)
        # Of a file that was unpacked beside its packed form, the plain one is read.
        files = {_plain(file).stem: file for file in reversed(found)}
        if files:
            return tuple(sorted(files.values(), key=_order))
    inside = sorted(f.parent for ending in SUFFIXES for f in path.glob(f"*/*{ending}"))
    hint = f"; did you mean {inside[0]}?" if inside else ""
    raise BagError(f"{path} is no bag: there is no .mcap or .db3 file in the folder{hint}")


def scan_file(
    path: Path, limits: ReadingLimits = DEFAULT_LIMITS, *, check_index: bool = False
) -> Scan:
    """Return a pass over the storage file ``path``; raises BagError for any other file."""
    storage = _storage(path)
    if storage == ".mcap":
        return McapScan(path, limits, check_index=check_index)
    if storage != ".db3":
        raise BagError(
            f"{path} is no bag: expected a folder or a file ending in .mcap or .db3; a plain "
            "table is text with commas between its columns"
        )
    if _plain(path) != path:
        raise BagError(f"{path} is compressed as a whole; unpack it: zstd -d {path.name}")
    # Few bags need it.
    from rotcal_ros.bags.sqlite_scan import SqliteScan

    return SqliteScan(path)


def read_blocks(
    files: tuple[Path, ...], progress: Progress | None = None
) -> Iterator[tuple[Scan, Block | None]]:
    """Yield the blocks of several files in order, each with its pass; None ends a file."""
    total, done = sum(file.stat().st_size for file in files), 0
    for file in files:
        scan = scan_file(file)
        for block in scan.blocks():
            yield scan, block
            if progress is not None:
                progress(done + scan.position, total)
        done += file.stat().st_size
        yield scan, None


def read_items(
    files: tuple[Path, ...],
    progress: Progress | None = None,
    limits: ReadingLimits = DEFAULT_LIMITS,
) -> Iterator[tuple[Scan, Item | None]]:
    """Yield all that several files hold, and check their indexes; as :func:`read_blocks`."""
    total, done = sum(file.stat().st_size for file in files), 0
    for file in files:
        scan = scan_file(file, limits, check_index=True)
        for item in scan.items():
            yield scan, item
            if progress is not None:
                progress(done + scan.position, total)
        done += file.stat().st_size
        yield scan, None


def check_files(
    files: tuple[Path, ...],
    progress: Progress | None = None,
    limits: ReadingLimits = DEFAULT_LIMITS,
) -> tuple[FileVerdict, ...]:
    """Read files and their indexes to the ends and return their verdicts."""
    found = read_items(files, progress, limits)
    return tuple(scan.verdict() for scan, item in found if item is None)


def session_files(folder: Path, progress: Progress | None = None) -> tuple[FileInfo, ...]:
    """Return the files of an interrupted session, for a BagWriter that continues it."""
    return tuple(
        file_info(scan)
        for scan, block in read_blocks(bag_files(folder), progress)
        if block is None
    )


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


def _plain(path: Path) -> Path:
    """Return ``path`` without the ending of a file that is compressed as a whole."""
    return path.with_suffix("") if path.suffix.lower() == PACKED else path


def _storage(path: Path) -> str:
    """Return the ending of a storage file as in SUFFIXES, of any other file something else."""
    return _plain(path).suffix.lower()


def _order(path: Path) -> tuple[str, int]:
    """Sort key: name_2 comes before name_10."""
    stem = _plain(path).stem
    match = _NUMBER.match(stem)
    return (match[1], int(match[2])) if match else (stem, -1)
