"""Finding the dropouts that the recorder wrote among the messages of a bag."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from rotcal_ros.bags import names
from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.decode import Decoder
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.dropouts import MESSAGE_TYPE, Dropout, of_status


class DropoutReader:
    """Finds the dropouts in the blocks of one file."""

    def __init__(self) -> None:
        self.found: list[Dropout] = []
        self._decoders: dict[ChannelDefinition, Decoder] = {}

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
        decoder = self._decoders.get(channel) or Decoder(channel)
        self._decoders[channel] = decoder
        for row in range(len(block)):
            message = decoder.message(block.payload(row))
            for status in () if message is None else message.status:
                dropout = of_status({value.key: value.value for value in status.values})
                if dropout is not None:
                    yield dropout
