"""Finding the dropouts that the recorder wrote among the messages of a bag."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress

from rotcal_ros.bags import names
from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.decode import Decoder
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.dropouts import MESSAGE_TYPE, Dropout, of_status
from rotcal_ros.errors import BagError


class DropoutReader:
    """Finds the dropouts in the blocks of one file; what is not as we write it is none."""

    def __init__(self) -> None:
        self.found: list[Dropout] = []
        self._decoders: dict[ChannelDefinition, Decoder | None] = {}

    def take(self, block: Block, channels: Mapping[int, ChannelDefinition]) -> None:
        """Look through a block."""
        for number in block.counts():
            channel = channels[number]
            if channel.topic.rpartition("/")[2] != names.DROPOUTS:
                continue
            if channel.type_name == MESSAGE_TYPE:
                chosen = block.select(block.headers["channel"] == number)
                self.found += self._decoded(chosen, channel)

    def _decoded(self, block: Block, channel: ChannelDefinition) -> Iterator[Dropout]:
        if channel not in self._decoders:
            self._decoders[channel] = _decoder(channel)
        decoder = self._decoders[channel]
        for row in range(len(block) if decoder else 0):
            assert decoder is not None
            message = decoder.message(block.payload(row))
            with suppress(AttributeError, TypeError):  # its definition may be anybody's
                for status in () if message is None else message.status:
                    dropout = of_status({value.key: value.value for value in status.values})
                    if dropout is not None:
                        yield dropout


def _decoder(channel: ChannelDefinition) -> Decoder | None:
    try:
        return Decoder(channel)
    except BagError:
        return None
