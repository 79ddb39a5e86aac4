"""Message definitions as text, with all they depend on: the schema of a bag's channel."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from rotcal_ros.foundation.errors import BagError

ShareLookup = Callable[[str], Path]
"""Returns the share folder of a ROS package; raises LookupError (or KeyError) when unknown."""

_SEPARATOR: Final = "=" * 80
_BUILTIN: Final = {"bool", "byte", "char", "string", "wstring", "float32", "float64"} | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}
_FIELD: Final = re.compile(r"^(?P<type>[A-Za-z][\w/]*)(<=\d+)?(\[[^\]]*\])?\s+\w+")


@dataclass(frozen=True, slots=True)
class ChannelDefinition:
    """Everything that is needed to read the messages of one channel of an MCAP file.

    ``definition`` is the schema, which may be any bytes: :func:`schema_text`. ``metadata`` are
    the channel's further entries, name and value.
    """

    channel_id: int
    topic: str
    type_name: str
    encoding: str
    definition: str
    type_hash: str = ""
    offered_qos: str = ""
    message_encoding: str = "cdr"
    metadata: tuple[tuple[str, str], ...] = ()


def schema_text(data: bytes) -> str:
    """Return a schema as text; bytes that are no UTF-8 become lone surrogates (PEP 383)."""
    return data.decode(errors="surrogateescape")


def schema_bytes(text: str) -> bytes:
    """Return the bytes from which :func:`schema_text` made ``text``, all of them."""
    return text.encode(errors="surrogateescape")


def collect_definition(type_name: str, share: ShareLookup) -> str:
    """Return the text of message ``type_name`` (``pkg/msg/Name``) and of all it contains.

    The form is that of MCAP's ``ros2msg``: the message's own text, then every dependency once,
    each after a line of 80 ``=`` and a line ``MSG: pkg/Name``. Raises BagError when the
    definition of any of them is not installed.
    """
    texts: dict[str, str] = {}
    waiting = [type_name]
    while waiting:
        name = waiting.pop(0)
        if name not in texts:
            texts[name] = _own_text(name, share, type_name)
            waiting += _dependencies(texts[name], name.split("/", maxsplit=1)[0])
    own = texts.pop(type_name)
    parts = [
        f"{_SEPARATOR}\nMSG: {name.replace('/msg/', '/', 1)}\n{text}"
        for name, text in texts.items()
    ]
    return "\n".join([own, *parts])


def dump_definitions(channels: Iterable[ChannelDefinition]) -> bytes:
    """Return the content of the attachment ``definitions.json``."""
    return json.dumps({"channels": [asdict(channel) for channel in channels]}).encode()


def parse_definitions(data: bytes) -> tuple[ChannelDefinition, ...]:
    """Return the channels of an attachment ``definitions.json``; raises BagError."""
    try:
        return tuple(_channel(entry) for entry in json.loads(data)["channels"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise BagError(f"damaged attachment definitions.json: {error!r}") from error


def _channel(entry: dict[str, Any]) -> ChannelDefinition:
    """Return a channel from JSON; raises TypeError or ValueError when a field is wrong."""
    metadata = tuple((str(name), str(value)) for name, value in entry.pop("metadata", ()))
    channel = ChannelDefinition(**entry, metadata=metadata)
    texts = (value for name, value in entry.items() if name != "channel_id")
    if type(channel.channel_id) is not int or not all(isinstance(text, str) for text in texts):
        raise TypeError(f"a channel with the fields {sorted(entry)}")
    schema_bytes(channel.definition)
    return channel


def _own_text(name: str, share: ShareLookup, wanted_by: str) -> str:
    try:
        package, kind, short = name.split("/")
        if kind != "msg":
            raise LookupError(f"{name} is not a message")
        return (share(package) / kind / f"{short}.msg").read_text(encoding="utf-8")
    except (ValueError, LookupError, OSError) as error:
        raise BagError(
            f"the definition of message {name} (needed for {wanted_by}) is not installed: "
            f"{error}; install or source the package that defines it"
        ) from error


def _dependencies(text: str, package: str) -> list[str]:
    """Return the full names of the message types that the fields of ``text`` have."""
    found = (_FIELD.match(line.split("#", maxsplit=1)[0].strip()) for line in text.splitlines())
    return [_full(m["type"], package) for m in found if m and m["type"] not in _BUILTIN]


def _full(name: str, package: str) -> str:
    if name == "Header":
        return "std_msgs/msg/Header"
    parts = name.split("/")
    return f"{parts[0] if len(parts) > 1 else package}/msg/{parts[-1]}"
