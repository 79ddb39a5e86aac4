"""Storage files that rosbag2 has compressed as a whole (mode FILE)."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePath
from typing import IO, BinaryIO, Final

import zstandard

from rotcal_ros.bags.reading_limits import ReadingLimits, refusal
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.untrusted import open_plain

PACKED: Final = ".zstd"
"""The ending of such a file, behind the one of its storage."""
_STEP: Final = 1 << 12
"""Bytes unpacked at once: so many are lost before a fault."""


@contextmanager
def opened(path: Path, limits: ReadingLimits) -> Iterator[BinaryIO]:
    """Open a storage file; one that is compressed as a whole is unpacked into a temporary file.

    Raises OSError, and BagError where it cannot be unpacked or would become too large. What
    can be unpacked of a file that is cut off is given.
    """
    with open_plain(path) as file:
        if plain_name(path) == path:
            yield file
            return
        with tempfile.TemporaryFile() as plain:
            _unpack(file, plain, path, limits)
            yield plain


@contextmanager
def unpacked(path: Path, limits: ReadingLimits) -> Iterator[tuple[Path, str]]:
    """Yield where a storage file lies in plain, and what was wrong while it was unpacked.

    That is ``path`` itself, or a temporary file; raises what :func:`opened` does.
    """
    if plain_name(path) == path:
        yield path, ""
        return
    with open_plain(path) as file, tempfile.NamedTemporaryFile(prefix="rotcal_") as plain:
        fault = _unpack(file, plain, path, limits)
        plain.flush()
        yield Path(plain.name), fault


def plain_name(path: PurePath) -> PurePath:
    """Return ``path`` without the ending of a file that is compressed as a whole."""
    return path.with_suffix("") if path.suffix.lower() == PACKED else path


def _unpack(file: BinaryIO, plain: IO[bytes], path: Path, limits: ReadingLimits) -> str:
    """Unpack as far as it goes; return why no further, '' at the end of the file."""
    size = path.stat().st_size
    most = max(limits.unpacked_bytes, limits.unpacked_ratio * size)
    done = 0
    try:
        reader = zstandard.ZstdDecompressor().stream_reader(file, read_across_frames=True)
        while part := reader.read(_STEP):
            done += len(part)
            if done > most:
                ratio = 2 * (done // max(1, size)) + 1
                raise BagError(refusal(f"{path} unpacks to too much", "unpacked_ratio", ratio))
            plain.write(part)
    except zstandard.ZstdError as error:
        if not done:
            raise BagError(f"{path} cannot be unpacked: {error}") from None
        return f"the file cannot be unpacked behind byte {done} of its content: {error}"
    return ""
