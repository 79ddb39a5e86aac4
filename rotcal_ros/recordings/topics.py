"""Finds which topic of a bag plays which role in the cell."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np

from rotcal_ros.bags import names
from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.decode import Decoder
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.other_encodings import decoder_of
from rotcal_ros.bags.reader import read_blocks
from rotcal_ros.bags.settings import ReadingLimits
from rotcal_ros.bags.storage_scan import StorageContents
from rotcal_ros.foundation.arrays import Ints
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.methods import Configuration

_OUR_ROLES: Final = (names.PLAN, names.OBSERVATION, names.TABLE_ANGLE, names.PROBE_TARGET)
"""Roles whose messages are of our own types."""
_PACKAGE: Final = "rotcal_msgs/"
T = TypeVar("T")


@dataclass(frozen=True)
class RoleMessages:
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
    def checked(self) -> Iterator[None]:
        """Raise BagError if messages have other fields or types than their role needs.

        The bag may define a type differently; using its fields then raises an error of Python.
        """
        try:
            yield
        except (AttributeError, IndexError, TypeError, ValueError, OverflowError) as error:
            channel = self.decoder.channel
            raise BagError(
                f"topic {channel.topic}: {channel.type_name}, as this bag defines it, is not a "
                f"{self.role}: {error}"
            ) from error


class AmbiguousCellError(BagError):
    """Two topics have the same role, and it is unknown which cell is meant."""


@dataclass
class Topics:
    """Finds the topics of one cell.

    A topic plays the role that its last name says (``/cell/tracer_length``), below ``namespace``
    when that is given, unless roles are mapped to topics with other names: by ``renamed``, which
    comes first, by the recorder's note in the bag, or by ``planned``, from the configuration.
    Plan, orders and observations are of our own types unless their topic is named. ``ignored`` are
    topics of others with the name of a role. ``unreadable`` says why the definition of a topic
    cannot be used: the others are read.
    """

    namespace: str = ""
    renamed: Mapping[str, str] = field(default_factory=dict)
    planned: Mapping[str, str] = field(default_factory=dict)
    unreadable: dict[str, str] = field(default_factory=dict)
    ignored: frozenset[str] = frozenset()
    _recorded: dict[str, str] = field(default_factory=dict, repr=False)
    _topic_of_role: dict[str, str] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, configuration: Configuration | None, namespace: str = "") -> Topics:
        """Return the finder for the topics of a cell; a given ``configuration`` names them."""
        return cls(namespace, {} if configuration is None else configuration.topics.renamed())

    def follow(self, planned: Mapping[str, str]) -> None:
        """Use the topics that the configuration names; forget which topic has which role."""
        self.planned = planned
        self._topic_of_role.clear()

    def role(self, topic: str, type_name: str = "") -> str | None:
        """Return the role of ``topic``; AmbiguousCellError when two topics have the same one."""
        if topic == names.TF_STATIC:
            return names.TF_STATIC
        others = {**self.planned, **self._recorded, **self.renamed}
        for role, other in others.items():
            if _is_called(topic, other, self.namespace):
                return self._unique(role, topic)
        namespace, _, role = topic.strip("/").rpartition("/")
        wanted = self.namespace.strip("/")
        if role not in names.ROLES or role in others or (wanted and namespace != wanted):
            return None
        is_foreign = role in _OUR_ROLES and type_name and not type_name.startswith(_PACKAGE)
        if is_foreign or topic in self.ignored:
            return None
        return self._unique(role, topic)

    def of_the_only_plan(self, files: tuple[Path, ...], limits: ReadingLimits) -> Topics | None:
        """Return the finder for the one cell that has a plan; None unless it is the only one.

        If no topic is a plan, the one cell with messages of our own types is meant. Topics outside
        its namespace are ignored if one inside has the same role. Reads the files to their ends.
        """
        if self.namespace:
            return None
        channels: set[tuple[str, str]] = set()
        for scan, block in read_blocks(files, None, limits):
            if block is None:
                topics = scan.verdict().topics
                channels |= {(name, t.type_name) for name, t in topics.items() if t.messages}
        parts = [(*topic.rpartition("/")[::2], topic, kind) for topic, kind in channels]
        ours = {(cell, role) for cell, role, _, kind in parts
                if role in names.ROLES and kind.startswith(_PACKAGE)}  # fmt: skip
        planned = {cell for cell, role in ours if role == names.PLAN}
        cells = planned or {cell for cell, _ in ours}  # the plan may be an attachment
        if len(cells) != 1:
            return None
        inside = {role for cell, role, _, _ in parts if cell in cells and role in names.ROLES}
        others = (topic for cell, role, topic, _ in parts if cell not in cells and role in inside)
        return Topics(renamed=self.renamed, ignored=frozenset(others))

    def _unique(self, role: str, topic: str) -> str:
        if self._topic_of_role.setdefault(role, topic) != topic:
            raise AmbiguousCellError(
                f"two topics of the bag are called {role}: {self._topic_of_role[role]} and "
                f"{topic}; say which cell is meant (--namespace)"
            )
        return role

    def split(
        self, block: Block, scan: StorageContents, decoders: dict[ChannelDefinition, Decoder]
    ) -> list[RoleMessages]:
        """Return the parts of a block of ``scan`` that belong to the cell."""
        noted = scan.metadata.get(names.TOPICS, {})
        self._recorded |= {role: topic for role, topic in noted.items() if role in names.ROLES}
        parts = []
        numbers = block.headers["channel"]
        for number in np.unique(numbers).tolist():
            channel = scan.channels[number]
            role = self.role(channel.topic, channel.type_name)
            if role is None:
                continue
            decoder = decoders.get(channel) or self._decoder(channel)
            if decoder is not None:
                decoders[channel] = decoder
                parts.append(RoleMessages(role, np.flatnonzero(numbers == number), decoder))
        return parts

    def _decoder(self, channel: ChannelDefinition) -> Decoder | None:
        if channel.topic in self.unreadable:
            return None
        try:
            return decoder_of(channel)
        except BagError as error:
            self.unreadable[channel.topic] = str(error)
            return None


def read_single_cell(
    read: Callable[[Topics], T], topics: Topics, files: tuple[Path, ...], limits: ReadingLimits
) -> T:
    """Return what ``read`` returns; after AmbiguousCellError, for the only cell with a plan."""
    try:
        return read(topics)
    except AmbiguousCellError:
        only = topics.of_the_only_plan(files, limits)
        if only is None:
            raise
    return read(only)


def _is_called(topic: str, name: str, namespace: str) -> bool:
    """Return whether ``name``, which may leave out the namespace, means ``topic``."""
    if topic.strip("/") == name.strip("/"):
        return True
    if name.startswith("/"):
        return False
    wanted = namespace.strip("/")
    return topic.strip("/") == f"{wanted}/{name}" if wanted else topic.endswith(f"/{name}")
