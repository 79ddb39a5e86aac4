"""How the clock of a bag's recorder went: what it noted of jumps, and log times that go back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from rotcal_ros.bags import names
from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.scan import Scan
from rotcal_ros.clock_jumps import read_note

LEAST_NS: Final = 1_000_000_000
"""Messages of several topics may stand a little out of their order."""
_SHOWN: Final = 5


class LogTimes:
    """Finds where log times go back, in the order of the file; ``count`` times, ``most_ns``."""

    def __init__(self) -> None:
        self._newest_ns: int | None = None
        self.count = 0
        self.most_ns = 0

    def look(self, block: Block) -> None:
        """Take the next block of the bag."""
        times = block.headers["log_time"].astype(np.int64)
        if not len(times):
            return
        first = int(times[0]) if self._newest_ns is None else self._newest_ns
        back = -np.diff(times, prepend=first)
        self.count += int(np.count_nonzero(back >= LEAST_NS))
        self.most_ns = max(self.most_ns, int(back.max()))
        self._newest_ns = int(times[-1])


def clock_in_words(scans: Sequence[Scan], log_times: LogTimes) -> tuple[str, ...]:
    """Return how the clock jumped, a line for each jump that the recorder noted."""
    jumps = [j for scan in scans for j in read_note(scan.metadata.get(names.CLOCK_JUMPS, {}))]
    jumps = sorted(set(jumps), key=lambda jump: (not jump.named, jump.at_ns))
    texts = [jump.in_words() for jump in jumps[:_SHOWN]]
    if len(jumps) > _SHOWN:
        texts.append(f"the system clock jumped {len(jumps) - _SHOWN} times more")
    if not jumps and log_times.count:
        texts.append(
            f"log times go back {log_times.count} times, by up to {log_times.most_ns / 1e9:.1f} s:"
            " the recorder's clock was set; the messages were read in the order of the file"
        )
    return tuple(texts)
