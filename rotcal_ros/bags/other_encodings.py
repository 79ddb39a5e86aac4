"""Messages that no ROS 2 serialised: JSON, and Protobuf where its package is installed.

MCAP's registry of well-known encodings says how schema and messages belong together:
``jsonschema`` or no schema with ``json``, a ``FileDescriptorSet`` with ``protobuf``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from types import SimpleNamespace
from typing import Any, Final

import numpy as np

from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.decode import Columns, Decoder, FieldLayout
from rotcal_ros.bags.definitions import ChannelDefinition, schema_bytes
from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.foundation.errors import BagError

_Parse = Callable[[bytes], Any]


class ObjectDecoder(Decoder):
    """Decodes messages one by one, to objects whose attributes are their fields."""

    def __init__(self, channel: ChannelDefinition) -> None:
        self.channel = channel
        self.broken = 0
        self.unreadable = ""
        self.definitions = {}
        self.begins_with_header = False
        try:
            self._parse = _PARSERS[channel.message_encoding](channel)
        except ImportError:
            raise BagError(
                f"topic {channel.topic}: its messages are in Protobuf: pip install protobuf"
            ) from None
        except Exception as error:
            raise BagError(
                f"topic {channel.topic}: the schema of {channel.type_name} cannot be used: "
                f"{str(error).splitlines()[0] if str(error) else type(error).__name__}"
            ) from error

    def message(self, data: bytes) -> Any | None:
        """Return one message; None, and counted as broken, when the bytes are none."""
        try:
            return self._parse(data)
        except Exception:
            self.broken += 1
            return None

    def columns(
        self, block: Block, wanted: Sequence[str], alike: Collection[str] | None = None
    ) -> Iterator[Columns]:
        """Yield the ``wanted`` numbers of all messages of ``block``, as of any other encoding.

        What a message leaves out is NaN; a message that has other things there is broken. Raises
        BagError where no message has a field.
        """
        shapes = dict[Any, tuple[list[int], list[tuple[Floats, ...]]]]()
        has_it, last = False, None
        for row in range(len(block)):
            message = self.message(block.payload(row))
            if message is None:
                continue
            last = message
            found = [_reached(message, name) for name in wanted]
            has_it = has_it or all(value is not _ABSENT for value in found)
            try:
                values = tuple(_numbers(value) for value in found)
                texts = tuple(
                    (name, tuple(_texts(_reached(message, name)))) for name in alike or ()
                )
            except (TypeError, ValueError):
                self.broken += 1
                continue
            rows, collected = shapes.setdefault(
                (tuple(value.shape for value in values), texts), ([], [])
            )
            rows.append(row)
            collected.append(values)
        if last is not None and not has_it:
            raise BagError(
                f"topic {self.channel.topic}: {self.channel.type_name or 'its message'} has no "
                f"field {' or '.join(wanted)}; it has {', '.join(_fields(last))}"
            )
        for (sizes, texts), (rows, collected) in shapes.items():
            kinds = [(name, np.float64, size) for name, size in zip(wanted, sizes, strict=True)]
            layout = FieldLayout(0, texts={name: list(listed) for name, listed in texts if listed})
            yield Columns(np.array(rows, np.int64), np.array(collected, np.dtype(kinds)), layout)


def decoder_of(channel: ChannelDefinition) -> Decoder:
    """Return the decoder of a channel, whatever its encoding; BagError if there is none."""
    return (ObjectDecoder if channel.message_encoding in _PARSERS else Decoder)(channel)


_ABSENT: Final = object()
"""What a message has not got at all."""


def _reached(message: Any, path: str) -> Any:
    """Return what stands at a dotted ``path``, elements of lists by their numbers.

    None where a message of Protobuf has its field and left it out; else that is its default.
    """
    for name in path.split("."):
        described = getattr(message, "DESCRIPTOR", None)
        field = None if described is None else described.fields_by_name.get(name)
        if field is not None and field.has_presence and not message.HasField(name):
            return None
        if name.isdecimal() and not isinstance(message, SimpleNamespace):
            message = message[int(name)] if _has_element(message, int(name)) else _ABSENT
        else:
            message = getattr(message, name, _ABSENT)
        if message is None or message is _ABSENT:
            break
    return message


def _has_element(values: Any, index: int) -> bool:
    return isinstance(values, Sequence) and not isinstance(values, str) and index < len(values)


def _numbers(value: Any) -> Floats:
    """Return a number, or a list of them; ``null`` is JSON's way to say that there is none."""
    if value is _ABSENT:
        return np.array(math.nan)
    numbers = np.array(value, dtype=np.float64)
    if numbers.ndim > 1:
        raise ValueError("lists in a list")
    return numbers


def _texts(value: Any) -> tuple[str, ...]:
    """Return a text, or a list of them; nothing where something else stands."""
    listed = [value] if isinstance(value, str) else value
    is_list = isinstance(listed, Sequence) and all(isinstance(each, str) for each in listed)
    return tuple(listed) if is_list else ()


def _fields(message: Any) -> list[str]:
    described = getattr(message, "DESCRIPTOR", None)
    return [f.name for f in described.fields] if described is not None else list(vars(message))


def _json(channel: ChannelDefinition) -> _Parse:
    def parse(data: bytes) -> Any:
        found = json.loads(data, object_hook=lambda fields: SimpleNamespace(**fields))
        if not isinstance(found, SimpleNamespace):
            raise TypeError("a message is no JSON object")
        return found

    return parse


def _protobuf(channel: ChannelDefinition) -> _Parse:
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    files = descriptor_pb2.FileDescriptorSet.FromString(schema_bytes(channel.definition))
    pool, waiting = descriptor_pool.DescriptorPool(), {file.name: file for file in files.file}

    def add(name: str) -> None:
        if (file := waiting.pop(name, None)) is not None:
            for needed in file.dependency:
                add(needed)
            pool.Add(file)

    for file in files.file:
        add(file.name)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(channel.type_name))
    parse: _Parse = kind.FromString
    return parse


_PARSERS: Final[dict[str, Callable[[ChannelDefinition], _Parse]]] = {
    "json": _json,
    "protobuf": _protobuf,
}
