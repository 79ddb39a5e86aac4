"""Files that survive a crash: exclusive creation, whole records, explicit sync."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from rotcal_ros.errors import BagError


class DurableFile:
    """A new binary file for an appending writer; never replaces an existing one.

    ``write`` puts all bytes into the file or none: after a failure (full disk) the file ends
    where the failed record would have begun. Nothing is buffered here, so what was written
    survives the death of this process, and what was synced that of the machine.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        self._size = 0
        self._closed = False

    def write(self, data: bytes) -> int:
        """Append ``data``; on OSError the file is as it was before."""
        remaining = memoryview(data)
        try:
            while remaining:
                remaining = remaining[os.write(self._descriptor, remaining) :]
        except OSError:
            os.ftruncate(self._descriptor, self._size)
            os.lseek(self._descriptor, self._size, os.SEEK_SET)
            raise
        self._size += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the size of the file."""
        return self._size

    def flush(self) -> None:
        """Do nothing: nothing is buffered."""

    def sync(self) -> None:
        """Return when everything written is on the medium."""
        os.fsync(self._descriptor)

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        if not self._closed:
            self._closed = True
            os.close(self._descriptor)


class FolderLock:
    """The right to write in ``folder``; the system takes it back when the process dies.

    Children that inherit ``descriptor`` hold the right as well. Raises BagError when another
    process holds it.
    """

    def __init__(self, folder: Path) -> None:
        self.descriptor = os.open(folder, os.O_RDONLY)
        try:
            fcntl.flock(self.descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(self.descriptor)
            raise BagError(f"another process still writes in {folder}; end it first") from None

    def release(self) -> None:
        """Give the right back; a second call does nothing."""
        if self.descriptor >= 0:
            os.close(self.descriptor)
            self.descriptor = -1


def write_atomically(path: Path, text: str, encoding: str = "utf-8") -> None:
    """Write ``text`` so that ``path`` holds either the old or the new content, never half."""
    replace_atomically(path, lambda temporary: write_durably(temporary, text, encoding))


def replace_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` make a file at the path it gets, sync it, and put it in the place of ``path``.

    ``path`` holds either the old or the new content, never half. What ``write`` raises is passed
    on; the unfinished file is removed. It is made in a folder of its own that nobody else may
    enter: under a name that can be guessed, a planted link would lead the writing elsewhere.
    """
    with tempfile.TemporaryDirectory(prefix=f".{path.name}-", dir=path.parent) as scratch:
        temporary = Path(scratch) / path.name
        write(temporary)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    sync_folder(path.parent)


def write_durably(path: Path, text: str, encoding: str = "utf-8") -> None:
    """Write ``text``, line ends as they are; it is on the medium when this returns."""
    with path.open("wb") as file:
        file.write(text.encode(encoding))
        file.flush()
        os.fsync(file.fileno())


def sync_folder(folder: Path) -> None:
    """Make the names of new files in ``folder`` durable."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def readable(name: str) -> str:
    """Return the name of a file as text: bytes that are no UTF-8 are escaped."""
    return name.encode(errors="surrogateescape").decode(errors="backslashreplace")
