"""Messages that no ROS 2 serialised: JSON, and Protobuf where its package is installed.

MCAP's registry of well-known encodings says how schema and messages belong together:
``jsonschema`` or no schema with ``json``, a ``FileDescriptorSet`` with ``protobuf``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from operator import attrgetter
from types import SimpleNamespace
from typing import Any, Final

import numpy as np

from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.decode import Columns, Decoder, FieldLayout
from rotcal_ros.bags.definitions import ChannelDefinition, schema_bytes
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
        """Yield the ``wanted`` numbers of all messages of ``block`` that hold them."""
        rows, values = [], []
        for row in range(len(block)):
            message = self.message(block.payload(row))
            if message is None:
                continue
            try:
                values.append(tuple(_number(attrgetter(name)(message)) for name in wanted))
            except AttributeError:
                raise BagError(
                    f"topic {self.channel.topic}: {self.channel.type_name} has no field "
                    f"{' or '.join(wanted)}; it has {', '.join(_fields(message))}"
                ) from None
            except (TypeError, ValueError):
                self.broken += 1
                continue
            rows.append(row)
        if rows:
            dtype = np.dtype([(name, np.float64) for name in wanted])
            yield Columns(np.array(rows, np.int64), np.array(values, dtype), FieldLayout(0))


def decoder_of(channel: ChannelDefinition) -> Decoder:
    """Return the decoder of a channel, whatever its encoding; BagError if there is none."""
    return (ObjectDecoder if channel.message_encoding in _PARSERS else Decoder)(channel)


def _number(value: Any) -> float:
    """Return a value; JSON has no other way than ``null`` to say that there is none."""
    return math.nan if value is None else float(value)


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
