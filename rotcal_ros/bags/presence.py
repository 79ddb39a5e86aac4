"""Noticing that somebody takes, swaps or cuts the files of a bag while it is recorded."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import Final

from rotcal_ros import disk

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
        if not disk.may_write(self._folder):
            return f"{self._folder} was made read-only"
        return ""


def _known(path: Path) -> Known:
    status = disk.status(path)
    return status.st_dev, status.st_ino, status.st_size
