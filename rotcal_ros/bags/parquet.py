"""The raw streams of a bag as Parquet: one file per topic, one row per message."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import count
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

import numpy as np
from rosbags.interfaces import Nodetype

from rotcal_ros.bags.blocks import Block
from rotcal_ros.bags.decode import Decoder
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.reader import Progress, bag_files, read_blocks
from rotcal_ros.bags.session_verdict import judge_session
from rotcal_ros.foundation.dataframes import arrow
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.files import naming, sync_folder

TIMES: Final = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
LOG_TIME: Final = "log_time_ns"
PUBLISH_TIME: Final = "publish_time_ns"
_ARROW: Final = {
    "bool": "bool_", "byte": "uint8", "char": "uint8", "octet": "uint8", "string": "string",
    "wstring": "string", "float32": "float32", "float64": "float64",
    **{f"{sign}int{bits}": f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)},
}  # fmt: skip


_MOST_ELEMENTS: Final = (1 << 31) - 1
"""Most elements that the lists of one Arrow array can hold together."""


@dataclass(frozen=True)
class TopicFile:
    """The file of a topic; ``broken`` messages could not be decoded, for the ``reason``."""

    topic: str
    path: Path | None
    messages: int
    broken: int
    reason: str = ""


def write_topics(
    path: Path, folder: Path, progress: Progress | None = None
) -> tuple[TopicFile, ...]:
    """Write every topic of the bag at ``path`` into the new ``folder``.

    Columns are the fields of the message under their dotted names, times and durations as int64
    ns, lists as lists; before them stand log and publish time (int64 ns). A topic whose type
    cannot be read is returned without a file. Raises BagError when the bag cannot be
    read or ``folder`` exists.
    """
    files = bag_files(path)
    try:
        folder.mkdir(parents=True)
    except FileExistsError:
        raise BagError(f"{folder} exists: name a new folder") from None
    streams: dict[tuple[str, str], _Stream] = {}
    verdicts = []
    with ExitStack() as open_files:
        for scan, block in read_blocks(files, progress):
            if block is None:
                verdicts.append(scan.verdict())
                continue
            for number in block.counts():
                channel = scan.channels[number]
                key = (channel.topic, channel.type_name)
                if key not in streams:
                    taken = {stream.path.name for stream in streams.values()}
                    target = folder / _file_name(channel.topic, taken)
                    streams[key] = open_files.enter_context(_Stream(channel, target))
                streams[key].add(block.select(block.headers["channel"] == number))
    judge_session(path, verdicts)  # notes files that are missing
    sync_folder(folder)
    return tuple(stream.summary() for stream in streams.values())


class _Stream:
    """The file of one topic; a context manager."""

    def __init__(self, channel: ChannelDefinition, path: Path) -> None:
        self.path = path
        self._channel = channel
        self._messages = 0
        self._reason = ""
        self._writer: Any = None
        self._decoder: Decoder | None = None
        try:
            self._decoder = Decoder(channel)
            self._columns = [*_columns(channel.type_name, self._decoder.definitions)]
        except (BagError, KeyError, RecursionError) as error:
            self._reason = (
                str(error) if isinstance(error, BagError) else "its definition is broken"
            )
            return
        pa, parquet = arrow()
        times = [(LOG_TIME, pa.int64()), (PUBLISH_TIME, pa.int64())]
        self._schema = pa.schema(
            [*times, *((column.name, column.type) for column in self._columns)]
        )
        self._writer = parquet.ParquetWriter(
            path, self._schema, compression="zstd", write_page_checksum=True
        )

    def __enter__(self) -> _Stream:
        return self

    def __exit__(self, *_: object) -> None:
        if self._writer is not None:
            with naming(self.path):
                self._writer.close()

    def add(self, block: Block) -> None:
        """Write the messages of a block as one group of rows."""
        if self._writer is None or self._decoder is None:
            self._messages += len(block)
            return
        pa, _ = arrow()
        found = [
            (*times, message)
            for index, times in enumerate(block.headers[["log_time", "publish_time"]].tolist())
            if (message := self._decoder.message(block.payload(index))) is not None
        ]
        self._messages += len(found)
        if found:
            log, publish, messages = zip(*found, strict=True)
            times = [pa.array(map(_time, column), pa.int64()) for column in (log, publish)]
            arrays = [*times, *(column.array(messages) for column in self._columns)]
            with naming(self.path):
                self._writer.write_table(pa.Table.from_arrays(arrays, schema=self._schema))

    def summary(self) -> TopicFile:
        broken = self._decoder.broken if self._decoder else self._messages
        if self._writer is None:
            return TopicFile(self._channel.topic, None, 0, self._messages, self._reason)
        return TopicFile(self._channel.topic, self.path, self._messages, broken)


def _time(time_ns: int) -> int | None:
    """Return a time that fits into int64; None for one beyond the year 2262."""
    return time_ns if time_ns < 1 << 63 else None


@dataclass(frozen=True)
class _Column:
    """A field of a message, nested ones by their dotted ``name``, and its Arrow ``type``."""

    name: str
    type: Any
    kind: Nodetype
    detail: Any
    definitions: Mapping[str, Any]

    def array(self, messages: Sequence[Any]) -> Any:
        """Return the field of many messages as an Arrow array."""
        pa, _ = arrow()
        values = list(map(attrgetter(self.name), messages))
        if isinstance(values[0], np.ndarray):  # numbers: one copy of all of them
            ends = np.cumsum([0, *map(len, values)], dtype=np.int64)
            numbers = pa.array(np.concatenate(values), self.type.value_type)
            if ends[-1] <= _MOST_ELEMENTS:
                return pa.ListArray.from_arrays(pa.array(ends, pa.int32()), numbers)
        plain = [_value(value, self.kind, self.detail, self.definitions) for value in values]
        return pa.array(plain, self.type)


def _columns(
    type_name: str, definitions: Mapping[str, Any], prefix: str = ""
) -> Iterator[_Column]:
    """Yield the fields of a message, nested ones under dotted names."""
    for name, (kind, detail) in definitions[type_name][1]:
        if kind == Nodetype.NAME and detail not in TIMES:
            yield from _columns(detail, definitions, f"{prefix}{name}.")
        else:
            found = _type(kind, detail, definitions)
            yield _Column(f"{prefix}{name}", found, kind, detail, definitions)


def _type(kind: Nodetype, detail: Any, definitions: Mapping[str, Any]) -> Any:
    pa, _ = arrow()
    if kind == Nodetype.BASE:
        return getattr(pa, _ARROW[detail[0]])()
    if kind == Nodetype.NAME:
        if detail in TIMES:
            return pa.int64()
        fields = definitions[detail][1]
        return pa.struct([(name, _type(k, d, definitions)) for name, (k, d) in fields])
    kind, detail = detail[0]
    return pa.list_(_type(kind, detail, definitions))


def _value(value: Any, kind: Nodetype, detail: Any, definitions: Mapping[str, Any]) -> Any:
    if kind == Nodetype.BASE:
        return value
    if kind == Nodetype.NAME:
        if detail in TIMES:
            return value.sec * 1_000_000_000 + value.nanosec
        return {
            name: _value(getattr(value, name), k, d, definitions)
            for name, (k, d) in definitions[detail][1]
        }
    kind, detail = detail[0]
    return [_value(element, kind, detail, definitions) for element in value]


def _file_name(topic: str, taken: set[str]) -> str:
    """Return a name for the file of a topic; two topics never share one."""
    stem = re.sub(r"[^A-Za-z0-9_-]+", "_", topic.strip("/"))[:100] or "topic"
    names = (f"{stem}_{n}.parquet" if n else f"{stem}.parquet" for n in count())
    return next(name for name in names if name not in taken)
