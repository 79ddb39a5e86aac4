"""Bags that no ROS 2 recorded: JSON, and Protobuf with its own description as the schema."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import Writer

TYPE = "cell.Sent"
_DOUBLE = descriptor_pb2.FieldDescriptorProto.TYPE_DOUBLE
_MESSAGE = descriptor_pb2.FieldDescriptorProto.TYPE_MESSAGE


def described() -> descriptor_pb2.FileDescriptorSet:
    """The schema of ``message Sent { Beam beam; double angle; Place at; }`` in two files."""
    parts = descriptor_pb2.FileDescriptorProto(name="parts.proto", package="cell", syntax="proto3")
    for name, fields in (("Beam", ["distance"]), ("Place", ["x", "y", "z"])):
        message = parts.message_type.add(name=name)
        for number, field in enumerate(fields, 1):
            message.field.add(name=field, number=number, type=_DOUBLE, label=1)
    whole = descriptor_pb2.FileDescriptorProto(
        name="sent.proto", package="cell", syntax="proto3", dependency=["parts.proto"]
    )
    message = whole.message_type.add(name="Sent")
    message.field.add(name="beam", number=1, type=_MESSAGE, type_name=".cell.Beam", label=1)
    message.field.add(name="angle", number=2, type=_DOUBLE, label=1)
    message.field.add(name="at", number=3, type=_MESSAGE, type_name=".cell.Place", label=1)
    return descriptor_pb2.FileDescriptorSet(file=[whole, parts])  # not in the order of need


def serialiser(encoding: str) -> Any:
    """Return what turns fields into the bytes of a message."""
    if encoding == "json":
        return lambda fields: json.dumps(fields).encode()
    pool = descriptor_pool.DescriptorPool()
    for file in reversed(described().file):
        pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(TYPE))

    def serialised(fields: dict[str, Any]) -> bytes:
        message = kind(angle=fields.get("angle", 0.0))
        for part in ("beam", "at"):
            for name, value in fields.get(part, {}).items():
                setattr(getattr(message, part), name, value)
        return bytes(message.SerializeToString())

    return serialised


def write_messages(
    path: Path, encoding: str, rows: Iterable[tuple[str, dict[str, Any], int]]
) -> None:
    """Write (topic, fields, time in ns) by MCAP's own library."""
    schemas = {
        "json": ("jsonschema", b"{}"),
        "protobuf": ("protobuf", described().SerializeToString()),
    }
    bytes_of, channels = serialiser(encoding), dict[str, int]()
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        kind, data = schemas[encoding]
        schema = writer.register_schema(TYPE, kind, data)
        for number, (topic, fields, time_ns) in enumerate(rows):
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, encoding, schema)
            writer.add_message(channels[topic], time_ns, bytes_of(fields), time_ns, number)
        writer.finish()
