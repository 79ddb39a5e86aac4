"""The topics of a rosbag2 sqlite3 file with their definitions, in all versions of its schema.

Version 1 knows names and types, 2 adds the quality of service, 3 the table ``schema``, 4 hashes
of types and the table ``message_definitions``.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.sqlite_file import Database, text

_TOPIC: Final = (
    "id", "name", "type", "type_description_hash", "offered_qos_profiles", "serialization_format",
)  # fmt: skip
_DEFINITION: Final = (
    "topic_type", "type_description_hash", "encoding", "encoded_message_definition",
)  # fmt: skip
_ENCODINGS: Final = ("ros2msg", "ros2idl")
_CDR: Final = "cdr"
_NEEDED: Final = ("name", "type")


def read_channels(database: Database) -> Iterator[tuple[int, ChannelDefinition]]:
    """Yield the id of each topic in the database and its channel, numbered 0."""
    known: dict[tuple[str, str], tuple[str, str]] = {}
    for name, type_hash, encoding, definition in _rows(
        database, "message_definitions", _DEFINITION
    ):
        if text(encoding) in _ENCODINGS:
            stated = text(encoding), text(definition)
            for key in ((text(name), text(type_hash)), (text(name), "")):
                known.setdefault(key, stated)
    for topic_id, name, type_name, type_hash, qos, form in _rows(database, "topics", _TOPIC):
        if isinstance(topic_id, int):
            key = text(type_name), text(type_hash)
            encoding, definition = known.get(key) or known.get((key[0], "")) or _own(key[0])
            channel = ChannelDefinition(
                0, text(name), key[0], encoding, definition, key[1], text(qos), text(form) or _CDR
            )
            yield topic_id, channel


def topics_without_text(database: Database) -> int:
    """Return how many topics there are of which something is no text in UTF-8.

    Beside name and type it may be missing.
    """
    present = [name for name in _TOPIC[1:] if name in database.columns("topics")]
    needed = " AND ".join(f"typeof({name}) = 'text'" for name in _NEEDED)
    others = "".join(f" AND typeof({name}) IN ('text', 'null')" for name in present)
    query = f"SELECT {needed}{others}, {', '.join(present)} FROM topics"
    rows = database.connection.execute(query)
    return sum(not all_texts or not all(map(_is_utf8, values)) for all_texts, *values in rows)


def _is_utf8(value: bytes | None) -> bool:
    try:
        (value or b"").decode()
    except UnicodeDecodeError:
        return False
    return True


def _rows(
    database: Database, table: str, columns: tuple[str, ...]
) -> Iterator[tuple[object, ...]]:
    """Yield the rows of a table, NULL for columns that it does not have."""
    present = database.columns(table)
    if present:
        wanted = ", ".join(name if name in present else "NULL" for name in columns)
        yield from database.connection.execute(f"SELECT {wanted} FROM {table} ORDER BY rowid")


def _own(type_name: str) -> tuple[str, str]:
    """Return encoding and definition of one of ROS's own types: older bags carry none."""
    from rosbags.typesys import Stores, get_typestore  # takes a while, and few bags need it

    store = get_typestore(Stores.LATEST)
    if type_name not in store.fielddefs:
        return "", ""
    return "ros2msg", store.generate_msgdef(type_name, ros_version=2)[0]
