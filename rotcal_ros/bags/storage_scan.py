"""One pass over a storage file of a bag, whatever its format, and the verdict on the file."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

from mcap.records import Attachment, Metadata

from rotcal_ros.bags import names
from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.dropouts import Dropout, DropoutReader
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.language import Phrase, join_texts, noted, phrase
from rotcal_ros.foundation.untrusted import read_errors_as, require_plain

FELL_SILENT: Final = noted("{0} fell silent ({1} times)")

_SHOWN: Final = 20
State = Literal["complete", "index wrong", "truncated", "damaged"]


@dataclass(frozen=True, slots=True)
class Damage:
    """A fault at a byte ``offset`` of the file."""

    offset: int
    what: str


@dataclass(frozen=True, slots=True)
class TopicCount:
    """Messages read of one topic, and how many are known to be lost."""

    type_name: str
    messages: int
    lost: int = 0


@dataclass(frozen=True)
class FileVerdict:
    """The state of one file.

    "index "
    "wrong" says that the data are sound: nothing is lost, but other programs may not find it.

    ``lost_exactly`` is False if more messages may be missing than those counted in ``topics``:
    what followed the end of a truncated file is unknown, and so is the content of a damaged chunk
    whose index is damaged too. ``cut_off``: it ends within a message, or a chunk of them.

    ``losses_recorded`` counts from the beginning of the ``run`` of an
    interrupted plan, over all files of it; ``dropouts`` are those of this file, ``notes`` its
    metadata records by name, the last of each.
    """

    path: Path
    size: int
    state: State
    damages: tuple[Damage, ...]
    topics: Mapping[str, TopicCount]
    start_ns: int | None
    end_ns: int | None
    lost_exactly: bool = True
    cut_off: bool = False
    losses_recorded: Mapping[str, int] = field(default_factory=dict)
    run: int = 0
    dropouts: tuple[Dropout, ...] = ()
    notes: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    @property
    def whole(self) -> bool:
        """Whether all data that were written can be read, index or not."""
        return self.state in ("complete", "index wrong")

    @property
    def messages(self) -> int:
        """Messages that can be read."""
        return sum(topic.messages for topic in self.topics.values())

    @property
    def lost(self) -> int:
        """Messages that are known to be lost."""
        return sum(topic.lost for topic in self.topics.values())

    @property
    def shows_loss(self) -> bool:
        """Whether the file itself shows that messages which were written cannot be read."""
        uncounted = self.state == "damaged" and not self.lost_exactly
        return self.lost > 0 or self.cut_off or uncounted

    @property
    def losses_unread(self) -> dict[str, str]:
        """Recorded losses whose count is not a number, by their names."""
        noted = self.notes.get(names.LOSSES, {})
        return {name: text for name, text in noted.items() if name not in self.losses_recorded}

    def describe(self) -> Phrase:
        """Return the verdict in words."""
        if self.state == "complete":
            return phrase("complete")
        first = self.damages[0]
        if self.state == "index wrong":
            return phrase(
                "data sound, index wrong at byte {0}: {1}; nothing is lost",
                first.offset, phrase(first.what)
            )  # fmt: skip
        lost = phrase("no message known to be lost")
        if self.lost:
            lost = phrase("{0} messages lost", self.lost)
        elif self.shows_loss:
            lost = phrase("an unknown number of messages lost")
        at = phrase("{0} at byte {1}: {2}", phrase(self.state), first.offset, phrase(first.what))
        more = [] if self.lost_exactly else [phrase("more may be missing")]
        return join_texts([at, lost, *more])

    def to_dict(self) -> dict[str, Any]:
        """Return the machine-readable form."""
        return {
            "path": str(self.path),
            "size": self.size,
            "verdict": self.state,
            "sentence": self.describe(),
            "offset": self.damages[0].offset if self.damages else None,
            "damages": [{"offset": d.offset, "what": d.what} for d in self.damages],
            "messages": self.messages,
            "lost": self.lost,
            "lost_exactly": self.lost_exactly,
            "cut_off": self.cut_off,
            "start_ns": self.start_ns,
            "end_ns": self.end_ns,
            "topics": {
                name: {"type": t.type_name, "messages": t.messages, "lost": t.lost}
                for name, t in self.topics.items()
            },
            "losses_recorded": dict(self.losses_recorded),
            "dropouts": [dropout.to_dict() for dropout in self.dropouts],
        }


def session_losses(verdicts: Iterable[FileVerdict]) -> dict[str, int]:
    """Return what was lost live in all runs together; within a run the counts never fall."""
    of_run: defaultdict[int, Counter[str]] = defaultdict(Counter)
    for verdict in verdicts:
        of_run[verdict.run] |= Counter(verdict.losses_recorded)
    total = Counter[str]()
    for losses in of_run.values():
        total.update(losses)
    return {name: count for name, count in total.items() if count}


def unread_losses(verdicts: Iterable[FileVerdict]) -> tuple[Phrase, ...]:
    """Return a sentence for each recorded loss whose count cannot be read."""
    return tuple(
        phrase(
            "{0}: a loss was recorded ({1}), but its count is not a number: {2!r}",
            verdict.path.name,
            name,
            text[:_SHOWN],
        )
        for verdict in verdicts
        for name, text in verdict.losses_unread.items()
    )


def losses_in_words(losses: Mapping[str, int]) -> tuple[Phrase, ...]:
    """Return one sentence per counter."""
    return tuple(
        phrase(FELL_SILENT, name.partition(" ")[2], count)
        if name.startswith(names.SILENT)
        else phrase("{0} lost live ({1})", count, name)
        for name, count in losses.items()
    )


Item = Block | Attachment | Metadata
"""What a file holds, in its own order."""


@dataclass(eq=False)
class StorageContents:
    """What a storage file, or several read as one, hold besides their messages."""

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
        """Read nothing yet; raises BagError if ``path`` is a pipe or a device: it may block."""
        with read_errors_as(path, BagError):
            require_plain(path)
        super().__init__(path)
        self.position = 0
        self.replaced: dict[str, Attachment] = {}
        self._counts: Counter[int] = Counter()
        self._span: tuple[int, int] | None = None
        self._dropouts = DropoutReader()

    @abstractmethod
    def blocks(self) -> Iterator[Block]:
        """Yield the readable messages; raises BagError if nothing can be read."""

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
                known.type_name, known.messages + self._counts[number], known.lost + lost[number]
            )
        return topics
