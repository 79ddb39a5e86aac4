"""What may be kept of a file in memory while it is read."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import Final

from rotcal_ros.bags.mcap_records import DamagedRecord
from rotcal_ros.bags.reading_limits import refusal

_OVERHEAD: Final = 1000
"""Bytes that an entry takes beside its content, at most."""
_TEXT_OVERHEAD: Final = 150
_PARSED: Final = 4
"""Times the size of a record that it may take while it is parsed."""


class Keeping:
    """Counts the bytes of all entries; one of a known key takes the place of the earlier one."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._total = 0
        self._costs: dict[Hashable, int] = {}

    def admit(self, content: bytes) -> None:
        """Refuse a record that may take more memory than is allowed while it is parsed."""
        if len(content) > self._limit // _PARSED:
            what = f"definitions or metadata have {len(content)} bytes"
            raise DamagedRecord(refusal(what, "kept_bytes", _PARSED * len(content)))

    def has_room(self, key: Hashable, size: int) -> bool:
        """Count ``size`` bytes as kept under ``key``, unless that is too much."""
        cost = size + _OVERHEAD
        total = self._total + cost - self._costs.get(key, 0)
        if total > self._limit:
            return False
        self._total, self._costs[key] = total, cost
        return True

    def add(self, key: Hashable, size: int) -> None:
        """Count ``size`` bytes as kept under ``key``; raises DamagedRecord beyond the limit."""
        if not self.has_room(key, size):
            what = "definitions and metadata take too much memory"
            raise DamagedRecord(refusal(what, "kept_bytes", 2 * (self._total + size)))


def cost_of_texts(texts: Mapping[str, str]) -> int:
    """Return about how many bytes of memory ``texts`` take."""
    return sum(len(key) + len(value) + _TEXT_OVERHEAD for key, value in texts.items())
