"""The lock of a folder, such as that of a session: one process writes in it."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from rotcal_ros.foundation import disk
from rotcal_ros.foundation.errors import BagError


class FolderLock:
    """The right to write in ``folder``; the system releases it when the process dies.

    Children that inherit ``descriptor`` hold the right as well. Raises BagError when another
    process holds it.
    """

    def __init__(self, folder: Path) -> None:
        self.descriptor = disk.open_file(folder, os.O_RDONLY)
        try:
            disk.lock(self.descriptor)
        except BlockingIOError:
            self.release()
            raise BagError(f"another process still writes in {folder}; end it first") from None
        except OSError:
            self.release()
            raise

    def release(self) -> None:
        """Give the right back; a second call does nothing."""
        if self.descriptor >= 0:
            with suppress(OSError):  # whatever it says, the descriptor and its lock are gone
                disk.close(self.descriptor)
            self.descriptor = -1
