"""Fuzzed by themselves: bags, read and repaired, and read by others."""

from __future__ import annotations

import io
import json
import shutil
import sqlite3
from collections.abc import Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import IO

from bags_harmed import MAGIC
from properties import LieError, suppress_rotcal


def read_bag(path: Path) -> None:
    from rotcal_ros.bags.reader import bag_files, check_files
    from rotcal_ros.recordings.replay import read_recording
    from rotcal_ros.recordings.summary import summarise_bag

    with suppress_rotcal():
        json.dumps(summarise_bag(path).to_dict())
    with suppress_rotcal():
        read_recording(path)
    (verdict,) = check_files(bag_files(path))
    verdict.describe()
    if path.suffix == ".db3" and verdict.messages < _first_rows(path):
        raise LieError(f"{verdict.messages} messages read, sqlite3 reads {_first_rows(path)}")
    if verdict.state == "complete":
        _compare(path, {n: t.messages for n, t in verdict.topics.items() if t.messages})


def _compare(path: Path, counts: Mapping[str, int]) -> None:
    """Raise LieError unless an independent reader finds the same messages in a sound file."""
    try:
        found = _by_mcap(path) if path.suffix == ".mcap" else _by_sqlite(path)
    except Exception as error:
        raise LieError(f"called complete, but read elsewhere: {error!r}") from error
    if found != counts:
        raise LieError(f"called complete with {dict(counts)}, elsewhere {found}")


def _by_mcap(path: Path) -> dict[str, int]:
    from mcap.reader import NonSeekingReader

    found: dict[str, int] = {}
    with path.open("rb") as file:
        reader = NonSeekingReader(io.BytesIO(_without_chunks(file)))
        for _, channel, _ in reader.iter_messages(log_time_order=False):
            found[channel.topic] = found.get(channel.topic, 0) + 1
    return found


def _without_chunks(file: IO[bytes]) -> bytes:
    """Return definitions and messages of a file in their order, its checksums being right.

    Readers pass over what may follow the known fields of a record, says the specification; in a
    chunk those of the mcap package do not, therefore no chunk is left to them.
    """
    from mcap.data_stream import RecordBuilder
    from mcap.records import Channel, Chunk, Footer, Message, Schema
    from mcap.stream_reader import StreamReader, get_chunk_data_stream

    whole = RecordBuilder()
    whole.write(MAGIC)
    for record in StreamReader(file, emit_chunks=True, validate_crcs=True).records:
        if isinstance(record, Chunk):
            stream, size = get_chunk_data_stream(record, validate_crc=True)
            whole.write(stream.read(size))
        elif isinstance(record, (Schema, Channel, Message, Footer)):
            record.write(whole)
    whole.write(MAGIC)
    return whole.end()


def _by_sqlite(path: Path) -> dict[str, int]:
    connection = sqlite3.connect(f"file:{path}?mode=ro&immutable=1", uri=True)
    try:
        (sound,) = connection.execute("PRAGMA integrity_check").fetchone()
        if sound != "ok":
            raise LieError(f"integrity_check: {sound:.80}")
        rows = connection.execute(
            "SELECT name, count(*) FROM messages JOIN topics ON topic_id = topics.id GROUP BY name"
        )
        return dict(rows.fetchall())
    finally:
        connection.close()


def _first_rows(path: Path) -> int:
    """Return how many messages sqlite3 reads until its first complaint or a row out of order."""
    good = (
        "typeof(timestamp) = 'integer' AND typeof(topic_id) = 'integer' AND typeof(data) = 'blob'"
    )
    query = f"SELECT id, {good}, data FROM messages NOT INDEXED WHERE id > 0 ORDER BY id"
    last = count = 0
    connection = sqlite3.connect(f"file:{path}?mode=ro&immutable=1", uri=True)
    connection.execute("PRAGMA cell_size_check = ON")
    with closing(connection), suppress(sqlite3.Error, UnicodeDecodeError):
        for number, is_good, _ in connection.execute(query):
            if number <= last:
                break
            last, count = number, count + is_good
    return count


def repair_bag(path: Path) -> None:
    from rotcal_ros.bags.repair import repair

    folder = path.parent / "repaired"
    try:
        outcome = repair(path, folder)
        assert all(verdict.state == "complete" for verdict in outcome.after)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
