"""What the middleware lost of one topic, by two witnesses that may both be incomplete."""

from __future__ import annotations


class TopicLosses:
    """Gaps in the numbers of the publishers, and the reports of the middleware itself.

    The numbers tell nothing of what a publisher sent before the first or behind the last message
    that arrived; reports come too late or, from some middlewares, never. Both count the same
    messages: the larger number is the better one.
    """

    def __init__(self) -> None:
        self._sequences: dict[bytes, int] = {}
        self._gaps = 0
        self._reported = 0

    @property
    def count(self) -> int:
        """Number of lost messages since :meth:`forget`."""
        return max(self._gaps, self._reported)

    def forget(self) -> None:
        """Count from zero; the numbers of the publishers go on."""
        self._gaps = self._reported = 0

    def number(self, number: int | None, publisher: bytes) -> None:
        """Take the number that ``publisher`` gave a message; None or 0 where there are none."""
        if not number:
            return
        last = self._sequences.get(publisher, number - 1)
        self._gaps += max(0, number - last - 1)
        self._sequences[publisher] = number

    def report(self, lost: int) -> None:
        """Take a report of ``lost`` further messages."""
        self._reported += lost
