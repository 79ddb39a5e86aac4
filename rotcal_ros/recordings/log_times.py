"""How the clock of a bag's recorder went: what it noted of jumps, and the order of log times."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from rotcal_ros.bags import names
from rotcal_ros.bags.scan import Scan
from rotcal_ros.bags.time_order import TimeOrder
from rotcal_ros.clock_jumps import read_note

_SHOWN: Final = 5


def clock_in_words(scans: Sequence[Scan], order: TimeOrder) -> tuple[str, ...]:
    """Return how the clock jumped, a line for each jump that the recorder noted, and the order.

    Log times that go back are explained where jumps were noted.
    """
    jumps = [j for scan in scans for j in read_note(scan.metadata.get(names.CLOCK_JUMPS, {}))]
    jumps = sorted(set(jumps), key=lambda jump: (not jump.named, jump.at_ns))
    texts = [jump.in_words() for jump in jumps[:_SHOWN]]
    if len(jumps) > _SHOWN:
        texts.append(f"the system clock jumped {len(jumps) - _SHOWN} times more")
    if not (jumps and order.back):
        texts += order.in_words()
    return tuple(texts)
