"""Which steps of a calibration the dropouts of its recording fall into."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from rotcal_ros.bags import names
from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.decode import Decoder
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.dropouts import Dropout
from rotcal_ros.bags.reader import read_blocks
from rotcal_ros.bags.reading_limits import DEFAULT_LIMITS, ReadingLimits
from rotcal_ros.bags.verdict import FileVerdict
from rotcal_ros.capture import messages as records
from rotcal_ros.foundation.errors import BagError

_SENTENCES: Final = 20
"""Largest number of sentences; more of them would not say more."""
_NAMED: Final = 5
_TYPE: Final = "rotcal_msgs/msg/Observation"


@dataclass(frozen=True, slots=True)
class Window:
    """The window of an accepted observation in log time (ns), as dropouts are.

    Stamps are those of the publisher's clock, which may differ from the recorder's or run at
    another rate: the window ends when the observation arrived.
    """

    step: int
    from_ns: int
    to_ns: int

    def touches(self, dropout: Dropout) -> bool:
        """Return whether the two have a moment in common."""
        return dropout.from_ns <= self.to_ns and self.from_ns <= dropout.to_ns


@dataclass(frozen=True, slots=True)
class PlacedDropout:
    """A dropout and the steps whose accepted observations it touches, ascending."""

    dropout: Dropout
    steps: tuple[int, ...]

    def sentence(self) -> str:
        """Return it in words."""
        if not self.steps:
            return self.dropout.sentence()
        few = len(self.steps) <= _NAMED
        listed = ", ".join(map(str, self.steps))
        named = listed if few else f"{self.steps[0]} to {self.steps[-1]}, {len(self.steps)} in all"
        return f"{self.dropout.sentence()}; step{'s'[: len(self.steps) > 1]} {named}"

    def to_dict(self) -> dict[str, Any]:
        """Return the machine-readable form."""
        return {**self.dropout.to_dict(), "steps": list(self.steps)}


def placed(
    verdicts: Iterable[FileVerdict], windows: Iterable[Window]
) -> tuple[PlacedDropout, ...]:
    """Return all dropouts in the order of time, with the steps that they touch."""
    dropouts = [dropout for verdict in verdicts for dropout in verdict.dropouts]
    known = list(windows)
    return tuple(
        PlacedDropout(dropout, tuple(sorted({w.step for w in known if w.touches(dropout)})))
        for dropout in sorted(dropouts, key=lambda dropout: dropout.from_ns)
    )


def placed_in(
    verdicts: Sequence[FileVerdict], limits: ReadingLimits = DEFAULT_LIMITS
) -> tuple[PlacedDropout, ...]:
    """Return :func:`placed` with the observations in the files; reads them only if it must."""
    if not any(verdict.dropouts for verdict in verdicts):
        return ()
    return placed(verdicts, _windows(tuple(verdict.path for verdict in verdicts), limits))


def sentences(dropouts: Sequence[PlacedDropout]) -> tuple[str, ...]:
    """Return dropouts in words; where there are many, the first ones."""
    shown = tuple(dropout.sentence() for dropout in dropouts[:_SENTENCES])
    left = len(dropouts) - len(shown)
    return (*shown, f"and {left} more dropouts") if left else shown


def _windows(files: tuple[Path, ...], limits: ReadingLimits) -> Iterator[Window]:
    """Yield the windows of the accepted observations that the live capture had published."""
    decoders: dict[ChannelDefinition, Decoder] = {}
    for scan, block in read_blocks(files, None, limits):
        for number in () if block is None else block.counts():
            channel = scan.channels[number]
            noted = scan.metadata.get(names.TOPICS, {}).get(names.OBSERVATION)
            if channel.type_name != _TYPE or (
                channel.topic.rpartition("/")[2] != names.OBSERVATION and channel.topic != noted
            ):
                continue
            assert block is not None
            # A topic that is not defined as our observation names no steps; solving says why.
            with suppress(BagError, AttributeError, IndexError, TypeError, ValueError):
                decoder = decoders.get(channel) or Decoder(channel)
                decoders[channel] = decoder
                yield from _accepted(block.select(block.headers["channel"] == number), decoder)


def _accepted(block: Block, decoder: Decoder) -> Iterator[Window]:
    for row, log_time_ns in enumerate(block.headers["log_time"].tolist()):
        message = decoder.message(block.payload(row))
        if message is not None and (found := records.observation(message)).accepted:
            lasted_ns = found.window_end_ns - found.window_start_ns
            yield Window(found.step, log_time_ns - lasted_ns, log_time_ns)
