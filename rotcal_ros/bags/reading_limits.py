"""The settings of the bag reader: how much a file may ask for, group ``reading``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import load, setting
from rotcal_ros.foundation.untrusted import load_yaml

_GROUP: Final = "reading"

LARGEST_MESSAGE: Final = 128 * 1024 * 1024
"""Bytes of the largest message that a database may hold, or a definition ask for."""


@dataclass(frozen=True)
class ReadingLimits:
    """What a bag may cost to read; what goes beyond is left out and said."""

    record_bytes: int = setting(
        50_331_648,
        doc="bytes, largest record of a file that is taken into memory",
        minimum=65_536,
    )
    chunk_bytes: int = setting(
        50_331_648,
        doc="bytes, largest chunk or message that is unpacked",
        minimum=65_536,
    )
    unpacked_bytes: int = setting(
        268_435_456,
        doc="bytes that a file of any size may unpack to in all",
        minimum=65_536,
    )
    unpacked_ratio: int = setting(
        1000,
        doc="times the size of a file that it may unpack to where this is more",
        minimum=1,
    )
    other_records: int = setting(
        200_000,
        doc="records in a chunk that are no messages",
        minimum=1000,
    )
    kept_bytes: int = setting(
        33_554_432,
        doc="bytes of memory for all definitions, attachments and metadata of a file together",
        minimum=65_536,
    )


DEFAULT_LIMITS: Final = ReadingLimits()


def is_limit(change: str) -> bool:
    """Return whether a ``group.name=value`` is about the limits of reading."""
    return change.partition(".")[0] == _GROUP


def changed_limits(changes: Sequence[str]) -> ReadingLimits:
    """Return the limits with ``reading.name=value`` changes; ConfigurationError for all others."""
    values: dict[str, Any] = {}
    for change in changes:
        name, equals, value = change.partition("=")
        group, dot, limit = name.partition(".")
        if group != _GROUP or not dot or not equals:
            raise ConfigurationError(f"--set {change}: expected {_GROUP}.NAME=VALUE")
        values[limit] = load_yaml(value, f"--set {change}")
    return load(ReadingLimits, values, f"--set: {_GROUP}")


def refusal(what: str, setting_name: str, least: int) -> str:
    """Return the words for something beyond a limit: what it is, and what lets it pass."""
    return f"{what}; --set reading.{setting_name}={least} of rotcal bag repair lets it pass"
