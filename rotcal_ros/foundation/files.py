"""Files that survive a crash: exclusive creation, whole records, explicit sync."""

from __future__ import annotations

import errno
import os
import secrets
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Final

from rotcal_ros.foundation import disk
from rotcal_ros.foundation.untrusted import require_plain

_UNFINISHED: Final = ".rotcal-"
"""Begin of the name of a folder with unfinished files."""


class DurableFile:
    """A new binary file for an appending writer; never replaces an existing one.

    ``write`` puts all bytes into the file or none: after a failure (full disk) the file ends where
    the failed record would have begun. Nothing is buffered here, so what was written survives the
    death of this process, and what was synced survives that of the machine. If another process
    cuts the file or writes into it, its size differs from :meth:`tell` from then on.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        # O_EXCL: nothing is ever overwritten, also by a second process at the same moment.
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND
        self._descriptor = disk.open_file(path, flags)
        self._size = 0
        self._closed = False
        self._sync_error: OSError | None = None

    def write(self, data: bytes) -> int:
        """Append ``data``; on OSError the file is as it was before."""
        with naming(self.path), _undone(self._descriptor, self._size):
            _write_whole(self._descriptor, data)
        self._size += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the size of the file."""
        return self._size

    def flush(self) -> None:
        """Do nothing: nothing is buffered."""

    def sync(self) -> None:
        """Wait until everything written is on the medium.

        After one failure every further call fails: the system may have dropped what it could not
        write, and would then report the rest as safe.
        """
        if self._closed:
            raise OSError(errno.EBADF, f"{self.path} is closed")
        if self._sync_error is not None:
            raise self._sync_error
        try:
            with naming(self.path):
                disk.sync(self._descriptor)
        except OSError as error:
            self._sync_error = error
            raise

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        if not self._closed:
            self._closed = True
            disk.close(self._descriptor)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Let an OSError name ``path`` if it names no file, or an unfinished one.

    The system names none where a disk is full: it knows the descriptor alone.
    """
    try:
        yield
    except OSError as error:
        if error.strerror and (error.filename is None or _UNFINISHED in str(error.filename)):
            error.filename = str(path)
        raise


def write_atomically(path: Path, text: str, encoding: str = "utf-8") -> None:
    """Write ``text`` so that ``path`` holds either the old or the new content, never half."""
    replace_atomically(path, lambda temporary: write_durably(temporary, text, encoding))


def replace_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Let ``write`` make a file at the path it gets, sync it, and replace ``path`` with it.

    ``path`` holds either the old or the new content, never half. What ``write`` raises is passed
    on; the unfinished file is removed. It is made in a folder that no other user may enter: under
    a name that can be guessed, a planted link would redirect the writing. OSError if ``path`` is a
    device, a pipe or a folder.
    """
    require_plain(path)
    with naming(path):
        with scratch_folder(path.parent) as scratch:
            temporary = scratch / path.name
            write(temporary)
            # Without this, a crash after the rename may leave the new name with no content.
            sync_file(temporary)
            disk.replace(temporary, path)
        sync_folder(path.parent)


@contextmanager
def scratch_folder(parent: Path) -> Iterator[Path]:
    """Make a folder in ``parent`` for unfinished files; it is gone afterwards.

    No other user may enter it: under a name that can be guessed, a planted link would redirect the
    writing. If a failing disk does not release it, it stays behind.
    """
    folder = parent / f"{_UNFINISHED}{secrets.token_hex(8)}"
    disk.make_folder(folder, 0o700)
    try:
        yield folder
    finally:
        with suppress(OSError):
            for left in folder.iterdir():
                disk.remove(left)
            disk.remove_folder(folder)


def write_durably(path: Path, content: str | bytes, encoding: str = "utf-8") -> None:
    """Write ``content`` into a new file, line ends as they are; it is on the medium afterwards."""
    with closing(DurableFile(path)) as file:
        file.write(content.encode(encoding) if isinstance(content, str) else content)
        file.sync()


def replace_tail(path: Path, end: int, data: bytes) -> None:
    """Replace everything from byte ``end`` on by ``data``; it is on the medium afterwards.

    A crash meanwhile leaves a part of it; the bytes before ``end`` never change.
    """
    # O_NOFOLLOW: a link planted under this name would redirect the writing.
    descriptor = disk.open_file(path, os.O_WRONLY | os.O_APPEND | os.O_NOFOLLOW)
    try:
        disk.truncate(descriptor, end)
        _write_whole(descriptor, data)
        disk.sync(descriptor)
    finally:
        with suppress(OSError):  # what is synced is safe
            disk.close(descriptor)


def remove_durably(path: Path) -> None:
    """Remove a file, if there is one; its name does not come back after a crash."""
    if path.exists():
        disk.remove(path)
        sync_folder(path.parent)


def append_line(path: Path, line: bytes) -> None:
    """Append ``line``, which ends in a line break, to a file that may not exist yet.

    It is on the medium afterwards; after an OSError it was never there. A line before it that a
    crash cut off is removed. ``path`` must not be a link.
    """
    descriptor = disk.open_file(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW)
    try:
        sync_folder(path.parent)
        with open(descriptor, "rb", closefd=False) as file:
            end = file.read().rfind(b"\n") + 1
        disk.truncate(descriptor, end)
        with naming(path), _undone(descriptor, end):
            _write_whole(descriptor, line)
            disk.sync(descriptor)
    finally:
        with suppress(OSError):  # the line is safe or was never there
            disk.close(descriptor)


def make_folder(path: Path) -> None:
    """Make a new folder and its missing parents, with names that survive a crash.

    Raises FileExistsError when there is anything at ``path``.
    """
    for folder in reversed([above for above in path.parents if not above.exists()]):
        with suppress(FileExistsError):  # another process made it at the same time
            disk.make_folder(folder)
        # A new name is durable only once the folder that holds it is synced.
        sync_folder(folder.parent)
    disk.make_folder(path)
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Make the names of new files in ``folder`` durable."""
    sync_file(folder)


def sync_file(path: Path) -> None:
    """Wait until the content of a file is on the medium, whoever wrote it."""
    descriptor = disk.open_file(path, os.O_RDONLY)
    try:
        disk.sync(descriptor)
    finally:
        disk.close(descriptor)


def _write_whole(descriptor: int, data: bytes) -> None:
    remaining = memoryview(data)
    while remaining:
        # The system may take only a part, as on a disk that fills up.
        remaining = remaining[disk.write(descriptor, remaining) :]


@contextmanager
def _undone(descriptor: int, size: int) -> Iterator[None]:
    """Cut the file back to ``size`` if the block fails."""
    try:
        yield
    except OSError:
        with suppress(OSError):
            disk.truncate(descriptor, size)
        raise
