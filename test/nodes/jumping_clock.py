"""A system clock that a test can set, for processes that are started with its environment."""

import mmap
import struct
import subprocess
from pathlib import Path

SOURCE = Path(__file__).with_name("jumping_clock.c")


class JumpingClock:
    """``environment`` makes a process live by the clock; the monotonic one is left alone."""

    def __init__(self, folder: Path) -> None:
        library, offset = folder / "jumping_clock.so", folder / "clock_jump"
        subprocess.run(
            ["cc", "-shared", "-fPIC", "-O2", "-o", library, SOURCE, "-ldl"], check=True
        )
        offset.write_bytes(bytes(8))
        with offset.open("r+b") as file:
            self._offset = mmap.mmap(file.fileno(), 8)
        self._ahead_ns = 0
        self.environment = {"LD_PRELOAD": str(library), "CLOCK_JUMP": str(offset)}

    def jump(self, seconds: float) -> None:
        self._ahead_ns += round(seconds * 1e9)
        self._offset[:] = struct.pack("<q", self._ahead_ns)
