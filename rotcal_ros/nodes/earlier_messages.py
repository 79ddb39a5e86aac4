"""Messages of earlier versions, published as those of this one; what they did not say is left."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, cast

from rclpy.serialization import serialize_message

from rotcal_ros.bags.decode import Decoder
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.errors import BagError
from rotcal_ros.nodes.channels import importable_type, message_type

OURS: Final = "rotcal_msgs/msg/"
Converter = Callable[[bytes, int], bytes | None]
"""From the bytes of a message, and the number of the run it is of, to those to be published."""


def as_recorded(data: bytes, _run: int) -> bytes:
    """Return the message as it is."""
    return data


def publishable(channel: ChannelDefinition) -> tuple[type, Converter]:
    """Return the class that messages of a channel are published as, and how they become it.

    BagError where the type is not installed, or defined otherwise; our own types had less fields
    in earlier versions.
    """
    kind, why = importable_type(channel.type_name, channel.type_hash)
    if kind is not None:
        return kind, as_recorded
    if not channel.type_name.startswith(OURS):
        raise BagError(why)
    decoder, kind = Decoder(channel), cast("Any", message_type(channel.type_name))
    known = {line.split()[1].partition("=")[0] for line in _fields(channel.definition)}
    if further := sorted(known - kind.get_fields_and_field_types().keys() - _constants(kind)):
        raise BagError(f"{why}: it has no {', '.join(further)}")

    def convert(data: bytes, run: int) -> bytes | None:
        message = decoder.message(data)
        if message is None:
            return None
        message_now = _filled(kind, message)
        if hasattr(message_now, "run") and not hasattr(message, "run"):
            message_now.run = run
        return bytes(serialize_message(message_now))

    return kind, convert


def _fields(definition: str) -> list[str]:
    """Return the lines of a definition's own fields and constants."""
    own = definition.partition("=" * 80)[0].splitlines()
    lines = (line.partition("#")[0].strip() for line in own)
    return [line for line in lines if len(line.split()) > 1]


def _constants(kind: Any) -> set[str]:
    return {name for name in dir(kind) if name.isupper()}


def _filled(kind: Any, message: Any) -> Any:
    """Return a message of class ``kind`` with those fields that ``message`` has."""
    message_now = kind()
    for name in kind.get_fields_and_field_types():
        if hasattr(message, name):
            value, default = getattr(message, name), getattr(message_now, name)
            nested = hasattr(default, "get_fields_and_field_types")
            setattr(message_now, name, _filled(type(default), value) if nested else value)
    return message_now
