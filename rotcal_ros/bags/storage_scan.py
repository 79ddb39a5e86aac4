"""One pass over a storage file of a bag, whatever its format: what every scan has in common."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mcap.records import Attachment, Metadata

from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.dropouts import DropoutReader
from rotcal_ros.bags.verdict import FileVerdict, TopicCount
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.untrusted import require_plain, why

Item = Block | Attachment | Metadata
"""What stands in a file: messages and what is beside them."""


@dataclass(eq=False)
class StorageContents:
    """What is known beside its messages of a storage file, or of several that are read as one."""

    path: Path
    channels: dict[int, ChannelDefinition] = field(default_factory=dict)
    attachments: dict[str, Attachment] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)


class Scan(StorageContents, ABC):
    """One pass over one storage file; ``position`` is how far it has come, in bytes.

    Iterate :meth:`blocks` to the end; ``channels``, ``attachments`` and ``metadata`` fill up on
    the way, and :meth:`verdict` is final afterwards. A block only holds messages of
    channels whose definition is known. ``attachments`` and ``metadata`` hold the last of each
    name, as far as memory allows; ``replaced`` an earlier attachment of that name with another
    content.
    """

    def __init__(self, path: Path) -> None:
        """Begin nothing yet; BagError where ``path`` is a pipe or a device, which may block."""
        try:
            require_plain(path)
        except OSError as error:
            raise BagError(f"cannot read {path}: {why(error)}") from error
        super().__init__(path)
        self.position = 0
        self.replaced: dict[str, Attachment] = {}
        self._counts: Counter[int] = Counter()
        self._span: tuple[int, int] | None = None
        self._dropouts = DropoutReader()

    @abstractmethod
    def blocks(self) -> Iterator[Block]:
        """Yield the readable messages; raises BagError when the file is unreadable at all."""

    def items(self) -> Iterator[Item]:
        """Yield all that the file holds, in its order; raises what :meth:`blocks` does."""
        yield from self.blocks()

    @abstractmethod
    def verdict(self) -> FileVerdict:
        """Return the verdict on the file, after the iteration."""

    def _count(self, block: Block) -> None:
        """Count the messages of ``block``, widen the span of log times, look for dropouts."""
        self._counts.update(block.counts())
        self._dropouts.take(block, self.channels)
        times = block.headers["log_time"]
        start, end = int(times.min()), int(times.max())
        known = self._span or (start, end)
        self._span = (min(known[0], start), max(known[1], end))

    def _topics(self, lost: Counter[int]) -> dict[str, TopicCount]:
        """Return the counts by topic; ``lost`` counts by channel id."""
        topics: dict[str, TopicCount] = {}
        for number in sorted(self.channels.keys() | lost.keys()):
            channel = self.channels.get(number)
            name = channel.topic if channel else f"(unknown channel {number})"
            known = topics.get(name, TopicCount(channel.type_name if channel else "", 0))
            topics[name] = TopicCount(
                known.type_name,
                known.messages + self._counts[number],
                known.lost + lost[number],
            )
        return topics
