"""A fleet out of one recording: each bag with noise of its own, at a time of its own."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.writer import CompressionType, Writer

from rotcal_ros.bags import names
from rotcal_ros.bags.decode import Decoder, work_out_layout
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.reader import bag_files, read_blocks

RECORDING = Path(__file__).parents[4] / "examples" / "data" / "ball_plate_bag"
NOISE_M = 0.5e-6
DAY_NS = 86_400 * 10**9


@dataclass(frozen=True)
class Message:
    """A message of the recording; the field ``position`` is at ``noisy`` where it gets noise."""

    channel: ChannelDefinition
    log_time: int
    data: bytes
    noisy: int | None


@functools.cache
def recorded() -> tuple[tuple[Message, ...], bytes]:
    """Return the messages of the recording and its configuration."""
    messages, text = [], b""
    for scan, block in read_blocks(bag_files(RECORDING)):
        text = scan.attachments[names.CONFIGURATION].data if scan.attachments else text
        for row in range(len(block or ())):
            channel = scan.channels[int(block.headers["channel"][row])]
            data, noisy = block.payload(row), None
            if channel.topic.endswith(names.PROBE_POINT):
                layout = work_out_layout(data, channel.type_name, Decoder(channel).definitions)
                noisy = layout.fields["position"][1]
            messages.append(Message(channel, int(block.headers["log_time"][row]), data, noisy))
    return tuple(messages), text


def configuration_text() -> str:
    return recorded()[1].decode()


def write_bag(folder: Path, seed: int, files: int = 1) -> Path:
    """Write the bag of one session into the new ``folder``, as one file or several."""
    folder.mkdir(parents=True)
    messages, _ = recorded()
    noise = np.random.default_rng(seed).normal(0.0, NOISE_M, (len(messages), 3))
    for number, rows in enumerate(np.array_split(np.arange(len(messages)), files)):
        with (folder / f"bag_{number}.mcap").open("wb") as file:
            _write(file, [(messages[row], noise[row]) for row in rows], seed * DAY_NS)
    return folder


def _write(file: BinaryIO, messages: list[tuple[Message, np.ndarray]], shift_ns: int) -> None:
    writer = Writer(file, compression=CompressionType.ZSTD)
    writer.start(profile="ros2")
    numbers: dict[ChannelDefinition, int] = {}
    writer.add_attachment(0, 0, names.CONFIGURATION, "application/yaml", recorded()[1])
    for m, noise in messages:
        if m.channel not in numbers:
            c = m.channel
            schema = writer.register_schema(c.type_name, c.encoding, c.definition.encode())
            numbers[c] = writer.register_channel(c.topic, "cdr", schema)
        when = m.log_time + shift_ns
        data = _shifted(m.data, shift_ns // 10**9)
        if m.noisy is not None:
            data = _noisy(data, m.noisy, noise)
        writer.add_message(numbers[m.channel], when, data, when)
    writer.finish()


def write_fleet(folder: Path, bags: int, tables: int, first: int = 0) -> Iterator[Path]:
    """Write many sessions of several tables, one after the other in time."""
    for seed in range(first, first + bags):
        yield write_bag(folder / f"table_{seed % tables:03}" / f"run_{seed:06}", seed)


def _shifted(data: bytes, seconds: int) -> bytes:
    """Shift the stamp of the header, which every message here begins with."""
    stamp = int.from_bytes(data[4:8], "little") + seconds
    return data[:4] + stamp.to_bytes(4, "little") + data[8:]


def _noisy(data: bytes, begin: int, noise: np.ndarray) -> bytes:
    position = np.frombuffer(data, "<f8", 3, begin) + noise
    return data[:begin] + position.tobytes() + data[begin + 24 :]
