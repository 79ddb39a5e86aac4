"""The system calls of durable writing, each in one place.

What must survive a crash is written only by these functions, so that a test can make any single
call fail, or cut the power between two.
"""

from __future__ import annotations

import fcntl
import os
import shutil
from pathlib import Path


def open_file(path: Path, flags: int, mode: int = 0o644) -> int:
    """Return a descriptor; ``flags`` and ``mode`` are those of os.open."""
    return os.open(path, flags, mode)


def write(descriptor: int, data: bytes | memoryview) -> int:
    """Write as much as the system takes at once; return how many bytes that were."""
    return os.write(descriptor, data)


def sync(descriptor: int) -> None:
    """Wait until the file or folder is on the medium."""
    os.fsync(descriptor)


def truncate(descriptor: int, size: int) -> None:
    """Cut a file to ``size`` bytes."""
    os.ftruncate(descriptor, size)


def close(descriptor: int) -> None:
    """Close a descriptor; it is closed even when the system reports an error."""
    os.close(descriptor)


def lock(descriptor: int) -> None:
    """Take the exclusive lock; BlockingIOError when another process has it."""
    # flock ends with the last descriptor, so no dead process leaves a lock behind.
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def replace(source: Path, target: Path) -> None:
    """Rename ``source`` to ``target``, replacing any file of that name."""
    source.replace(target)


def link(source: Path, target: Path) -> None:
    """Give ``source`` a second name, which must be free."""
    os.link(source, target)


def make_folder(path: Path, mode: int = 0o777) -> None:
    """Make one folder, whose parent must exist."""
    path.mkdir(mode)


def remove(path: Path) -> None:
    """Remove a file."""
    path.unlink()


def remove_folder(path: Path) -> None:
    """Remove an empty folder."""
    path.rmdir()


def status(path: Path) -> os.stat_result:
    """Return what the system knows of ``path``."""
    return path.stat()


def may_write(path: Path) -> bool:
    """Return whether this process may change ``path`` now."""
    return os.access(path, os.W_OK)


def free_bytes(path: Path) -> int:
    """Return the free space of the file system of ``path``."""
    return shutil.disk_usage(path).free
