"""Which topic of a bag plays which role in the cell."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from rotcal_ros.arrays import Ints
from rotcal_ros.bags import names
from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.decode import Decoder
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.scan import Scan
from rotcal_ros.errors import BagError


@dataclass(frozen=True)
class Part:
    """The messages of one role in a block: their rows, ascending, and how to decode them."""

    role: str
    rows: Ints
    decoder: Decoder

    def messages(self, block: Block) -> Iterator[tuple[int, Any]]:
        """Yield (row, message), leaving out what cannot be decoded."""
        for row in self.rows.tolist():
            message = self.decoder.message(block.payload(row))
            if message is not None:
                yield row, message

    @contextmanager
    def taken_as_expected(self) -> Iterator[None]:
        """Around taking the messages: a definition of somebody else has other fields, or kinds.

        Raises BagError for what Python says to that.
        """
        try:
            yield
        except (AttributeError, IndexError, TypeError, ValueError, OverflowError) as error:
            channel = self.decoder.channel
            raise BagError(
                f"topic {channel.topic}: {channel.type_name}, as this bag defines it, is no "
                f"{self.role}: {error}"
            ) from error


@dataclass
class Topics:
    """Finds the topics of one cell.

    A topic plays the role that its last name says (``/cell/tracer_length``), below
    ``namespace`` when that is given, unless roles are mapped to topics with other names: by
    ``renamed``, which comes first, by what the recorder noted in the bag, or by ``planned``, which
    the configuration says. ``unreadable`` says of topics whose definition cannot be used why: the
    others are read.
    """

    namespace: str = ""
    renamed: Mapping[str, str] = field(default_factory=dict)
    planned: Mapping[str, str] = field(default_factory=dict)
    unreadable: dict[str, str] = field(default_factory=dict)
    _recorded: dict[str, str] = field(default_factory=dict, repr=False)
    _taken: dict[str, str] = field(default_factory=dict, repr=False)

    def follow(self, planned: Mapping[str, str]) -> None:
        """Take what the configuration says; what was taken before it was known is open again."""
        self.planned = planned
        self._taken.clear()

    def role(self, topic: str) -> str | None:
        """Return the role of ``topic``; raises BagError when two topics want the same one."""
        if topic == names.TF_STATIC:
            return names.TF_STATIC
        others = {**self.planned, **self._recorded, **self.renamed}
        for role, other in others.items():
            if _is_called(topic, other, self.namespace):
                return self._only(role, topic)
        namespace, _, role = topic.strip("/").rpartition("/")
        wanted = self.namespace.strip("/")
        if role not in names.ROLES or role in others or (wanted and namespace != wanted):
            return None
        return self._only(role, topic)

    def _only(self, role: str, topic: str) -> str:
        if self._taken.setdefault(role, topic) != topic:
            raise BagError(
                f"two topics of the bag are called {role}: {self._taken[role]} and {topic}; "
                "say which cell is meant (--namespace)"
            )
        return role

    def split(
        self,
        block: Block,
        scan: Scan,
        decoders: dict[ChannelDefinition, Decoder],
    ) -> list[Part]:
        """Return the parts of a block of ``scan`` that matter to the cell."""
        noted = scan.metadata.get(names.TOPICS, {})
        self._recorded |= {role: topic for role, topic in noted.items() if role in names.ROLES}
        parts = []
        numbers = block.headers["channel"]
        for number in np.unique(numbers).tolist():
            channel = scan.channels[number]
            role = self.role(channel.topic)
            if role is None:
                continue
            decoder = decoders.get(channel) or self._decoder(channel)
            if decoder is not None:
                decoders[channel] = decoder
                parts.append(Part(role, np.flatnonzero(numbers == number), decoder))
        return parts

    def _decoder(self, channel: ChannelDefinition) -> Decoder | None:
        if channel.topic in self.unreadable:
            return None
        try:
            return Decoder(channel)
        except BagError as error:
            self.unreadable[channel.topic] = str(error)
            return None


def _is_called(topic: str, name: str, namespace: str) -> bool:
    """Return whether ``topic`` is meant by ``name``, which may leave out the namespace."""
    if topic.strip("/") == name.strip("/"):
        return True
    if name.startswith("/"):
        return False
    wanted = namespace.strip("/")
    return topic.strip("/") == f"{wanted}/{name}" if wanted else topic.endswith(f"/{name}")
