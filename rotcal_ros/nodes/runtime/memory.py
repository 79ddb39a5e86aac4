"""The end of a node whose memory is used up: at once, as if it was killed, but with the reason."""

from __future__ import annotations

import os
from typing import Final

OUT_OF_MEMORY: Final = 71
"""Exit code of such a process."""
OF_LIBRARIES: Final = "not enough memory"
"""How compressors say it, in errors of their own."""


def end_without_memory(error: BaseException, where: str) -> None:
    """End this process where ``error`` is a lack of memory: other work could be half done.

    The others notice its silence; a bag is sound up to its last chunk, as after any kill.
    """
    if not isinstance(error, MemoryError) and OF_LIBRARIES not in str(error):
        return
    os.write(2, f"out of memory ({where})\n".encode())
    os._exit(OUT_OF_MEMORY)
