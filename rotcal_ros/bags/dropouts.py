"""Dropouts: what is missing from a topic, and from when to when, as messages in the bag itself.

The recorder writes them as ``diagnostic_msgs/DiagnosticArray``, which every tool shows: stamped
with the last good moment, one status per message, whose name is the topic.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from datetime import datetime, timezone
from typing import Any, Final

from rotcal_ros.bags import names
from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.decode import Decoder
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.language import Phrase, phrase

_LARGEST: Final = 1 << 64
"""Beyond any log time or count in a bag."""
MESSAGE_TYPE: Final = "diagnostic_msgs/msg/DiagnosticArray"

GAP: Final = "a gap in the publisher's sequence numbers"
REPORTED: Final = "reported by the middleware"
QUEUE: Final = "the recorder's queue was full"
SILENCE: Final = "it was silent"
UNHEARD: Final = "a publisher with an incompatible quality of service"


@dataclass(frozen=True, slots=True)
class Dropout:
    """``count`` messages of ``topic`` (0: unknown how many) missing within two log times (ns).

    ``from_ns`` is the last moment without a loss before it, ``to_ns`` the first one after it;
    ``gaps`` is the number of gaps close together that it stands for.
    """

    topic: str
    from_ns: int
    to_ns: int
    count: int
    reason: str
    gaps: int = 1

    def joined(self, later: Dropout) -> Dropout:
        """Return one dropout for this and a ``later`` one of the same topic and reason."""
        return replace(
            self,
            from_ns=min(self.from_ns, later.from_ns),
            to_ns=max(self.to_ns, later.to_ns),
            count=self.count + later.count,
            gaps=self.gaps + later.gaps,
        )

    def describe(self) -> Phrase:
        """Return it in words."""
        begin, end = (
            datetime.fromtimestamp(ns // 1_000_000 / 1e3, timezone.utc)
            for ns in (self.from_ns, self.to_ns)
        )
        many = phrase("1 message") if self.count == 1 else phrase("messages")
        if self.count > 1:
            many = phrase("{0} messages", self.count)
        return phrase(
            "{0}: {1} missing between {2} and {3} UTC ({4:.3f} s): {5}",
            self.topic, many, f"{begin:%Y-%m-%d %H:%M:%S.%f}"[:-3], f"{end:%H:%M:%S.%f}"[:-3],
            (self.to_ns - self.from_ns) / 1e9, phrase(self.reason),
        )  # fmt: skip

    def values(self) -> dict[str, str]:
        """Return the values of its status, as texts; :func:`dropout_from_status` reads them."""
        return {name: str(value) for name, value in asdict(self).items()}

    def to_dict(self) -> dict[str, Any]:
        """Return the machine-readable form."""
        return asdict(self)


def dropout_from_status(values: Mapping[str, str]) -> Dropout | None:
    """Return the dropout in the values of a status; None for any other status."""
    try:
        dropout = Dropout(
            topic=values["topic"],
            from_ns=int(values["from_ns"]),
            to_ns=int(values["to_ns"]),
            count=int(values["count"]),
            reason=values["reason"],
            gaps=int(values["gaps"]),
        )
    except (KeyError, ValueError, TypeError):
        return None
    numbers = (dropout.from_ns, dropout.to_ns, dropout.count, dropout.gaps)
    return dropout if all(0 <= number < _LARGEST for number in numbers) else None


def loss_counters(dropouts: Iterable[Dropout]) -> dict[str, int]:
    """Return the loss counters that follow from dropouts, by the names of ``rotcal_losses``."""
    totals: dict[str, int] = {}
    for dropout in dropouts:
        name = f"{_COUNTER[dropout.reason]} {dropout.topic}"
        counts_gaps = dropout.reason in (SILENCE, UNHEARD)
        totals[name] = totals.get(name, 0) + (dropout.gaps if counts_gaps else dropout.count)
    return totals


_COUNTER: Final = {
    GAP: names.LOST,
    REPORTED: names.LOST,
    QUEUE: names.QUEUE,
    SILENCE: names.SILENT,
    UNHEARD: names.UNHEARD,
}


class DropoutReader:
    """Finds the dropouts in the blocks of one file; other messages on that topic are ignored."""

    def __init__(self) -> None:
        self.found: list[Dropout] = []
        self._decoders: dict[ChannelDefinition, Decoder | None] = {}

    def take(self, block: Block, channels: Mapping[int, ChannelDefinition]) -> None:
        """Add the dropouts in a block."""
        for number in block.counts():
            channel = channels[number]
            if channel.topic.rpartition("/")[2] != names.DROPOUTS:
                continue
            if channel.type_name == MESSAGE_TYPE:
                chosen = block.select(block.headers["channel"] == number)
                self.found += self._decoded(chosen, channel)

    def _decoded(self, block: Block, channel: ChannelDefinition) -> Iterator[Dropout]:
        if channel not in self._decoders:
            self._decoders[channel] = None
            with suppress(BagError):
                self._decoders[channel] = Decoder(channel)
        if (decoder := self._decoders[channel]) is None:
            return
        for row in range(len(block)):
            message = decoder.message(block.payload(row))
            with suppress(AttributeError, TypeError):  # the bag may define its type otherwise
                for status in () if message is None else message.status:
                    dropout = dropout_from_status(
                        {value.key: value.value for value in status.values}
                    )
                    if dropout is not None:
                        yield dropout
