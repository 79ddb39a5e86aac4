"""Cut-off and corrupted files: never a traceback, never a wrong count, never silence."""

from __future__ import annotations

import random
from dataclasses import dataclass
from pathlib import Path

import pytest
from bag_samples import START_NS, TYPES, open_writer, serialised, writer_settings
from mcap.data_stream import ReadDataStream
from mcap.records import Chunk, MessageIndex

from rotcal_ros.bags import names
from rotcal_ros.bags.mcap_records import CHUNK, DATA_END, MAGIC, MESSAGE_INDEX
from rotcal_ros.bags.mcap_scan import McapScan
from rotcal_ros.bags.storage_scan import FileVerdict
from rotcal_ros.foundation.errors import BagError

N_MESSAGES = 600


@dataclass(frozen=True)
class Sample:
    data: bytes
    payloads: list[bytes]
    boundaries: list[tuple[int, int]]  # offset and opcode of every top-level record


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Sample:
    settings = writer_settings(chunk_bytes=3000)
    writer, channels = open_writer(tmp_path_factory.mktemp("damage") / "bag", settings)
    payloads = []
    with writer:
        for number in range(N_MESSAGES):
            role = names.TEMPERATURE if number % 10 == 0 else names.TRACER_LENGTH
            payload = message(role, number)
            payloads.append(payload)
            writer.write(channels[role], payload, START_NS + number, START_NS + number)
            if number % 200 == 150:
                writer.sync()
    data = writer.path.read_bytes()
    boundaries, position = [], len(MAGIC)
    while position < len(data) - len(MAGIC):
        boundaries.append((position, data[position]))
        position += 9 + int.from_bytes(data[position + 1 : position + 9], "little")
    return Sample(data, payloads, boundaries)


def message(role: str, number: int) -> bytes:
    if role == names.TEMPERATURE:
        return serialised(TYPES[role], stamp_ns=START_NS + number, temperature=20.0, variance=0.0)
    return serialised(
        TYPES[role], stamp_ns=START_NS + number, sequence=number, length=0.1 + 1e-9 * number,
        length_std=1e-7, status=1,
    )  # fmt: skip


def scan(path: Path) -> tuple[list[bytes], FileVerdict]:
    reader = McapScan(path)
    read = [block.payload(i) for block in reader.blocks() for i in range(len(block))]
    return read, reader.verdict()


def assert_honest(read: list[bytes], verdict: FileVerdict, truth: list[bytes]) -> None:
    """All that was read was written, in the same order and once; the counts are true."""
    remaining = iter(truth)
    assert all(any(payload == other for other in remaining) for payload in read)
    assert verdict.messages == len(read)
    missing = len(truth) - len(read)
    assert verdict.lost == missing if verdict.lost_exactly else verdict.lost <= missing


def test_sound_file_is_complete(sample: Sample, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(sample.data)
    read, verdict = scan(path)
    assert read == sample.payloads
    assert (verdict.state, verdict.damages, verdict.lost_exactly) == ("complete", (), True)
    assert verdict.start_ns == START_NS
    assert verdict.end_ns == START_NS + N_MESSAGES - 1
    assert {t: c.messages for t, c in verdict.topics.items() if c.messages} == {
        "/cell/tracer_length": 540,
        "/cell/temperature": 60,
    }


@pytest.mark.slow
def test_truncated_at_every_record_boundary(sample: Sample, tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    seen = 0
    for offset, _ in sample.boundaries:
        for extra in (0, 1, 8, 9, 40):
            cut = min(offset + extra, len(sample.data) - 1)
            path.write_bytes(sample.data[:cut])
            read, verdict = scan(path)
            assert verdict.state == "truncated"
            assert verdict.damages[0].offset <= cut
            assert read == sample.payloads[: len(read)]
            assert len(read) >= seen
            seen = len(read)
            assert_honest(read, verdict, sample.payloads)
    assert seen == N_MESSAGES


def test_truncated_file_yields_every_complete_chunk(sample: Sample, tmp_path: Path) -> None:
    chunks = [offset for offset, opcode in sample.boundaries if opcode == CHUNK]
    path = tmp_path / "cut.mcap"
    last = next(i for i, (o, _) in enumerate(sample.boundaries) if o == chunks[-1])
    path.write_bytes(sample.data[: sample.boundaries[last][0] + 5])
    read, verdict = scan(path)
    stream = ReadDataStream(_stream(sample.data[chunks[-1] + 9 :]))
    assert isinstance(Chunk.read(stream), Chunk)
    in_last = sum(
        len(MessageIndex.read(ReadDataStream(_stream(sample.data[offset + 9 :]))).records)
        for offset, opcode in sample.boundaries[last:]
        if opcode == MESSAGE_INDEX
    )
    assert len(read) == N_MESSAGES - in_last
    assert verdict.damages[0].offset == chunks[-1]


def _stream(data: bytes) -> object:
    from io import BytesIO

    return BytesIO(data)


@pytest.mark.slow
@pytest.mark.slow
def test_random_bit_flips_are_noticed_and_counted(sample: Sample, tmp_path: Path) -> None:
    path = tmp_path / "flipped.mcap"
    chance = random.Random(20)
    for _ in range(700):
        data = bytearray(sample.data)
        place = chance.randrange(len(data))
        data[place] ^= 1 << chance.randrange(8)
        path.write_bytes(data)
        read, verdict = scan(path)
        assert verdict.state != "complete", f"byte {place}"
        assert_honest(read, verdict, sample.payloads)
        assert len(read) >= N_MESSAGES - 60, f"byte {place} cost {N_MESSAGES - len(read)}"


@pytest.mark.slow
def test_bursts_of_garbage(sample: Sample, tmp_path: Path) -> None:
    path = tmp_path / "burst.mcap"
    chance = random.Random(21)
    for _ in range(200):
        data = bytearray(sample.data)
        size = chance.choice((4, 40, 400, 4000))
        place = chance.randrange(len(data) - size)
        data[place : place + size] = chance.randbytes(size)
        path.write_bytes(data)
        try:
            read, verdict = scan(path)
        except BagError:
            assert place == 0
            continue
        assert verdict.state != "complete"
        assert_honest(read, verdict, sample.payloads)


def test_cut_and_flipped(sample: Sample, tmp_path: Path) -> None:
    path = tmp_path / "both.mcap"
    chance = random.Random(22)
    for _ in range(200):
        data = bytearray(sample.data[: chance.randrange(9, len(sample.data))])
        for _ in range(3):
            data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
        path.write_bytes(data)
        try:
            read, verdict = scan(path)
        except BagError:
            continue
        assert verdict.state in ("truncated", "damaged")
        assert_honest(read, verdict, sample.payloads)


def test_removed_bytes(sample: Sample, tmp_path: Path) -> None:
    """A hole shifts everything behind it; the reader finds its way again."""
    path = tmp_path / "hole.mcap"
    chunks = [offset for offset, opcode in sample.boundaries if opcode == CHUNK]
    path.write_bytes(sample.data[: chunks[2] + 50] + sample.data[chunks[3] - 20 :])
    read, verdict = scan(path)
    assert verdict.state == "damaged"
    assert verdict.damages[0].offset == chunks[2]
    assert len(read) >= N_MESSAGES - 40
    assert_honest(read, verdict, sample.payloads)


def test_damaged_first_chunk_does_not_cost_the_definitions(sample: Sample, tmp_path: Path) -> None:
    """In a cut-off file the only schemas are in the first chunk; the attachment replaces them."""
    path = tmp_path / "first.mcap"
    first = next(offset for offset, opcode in sample.boundaries if opcode == CHUNK)
    end = next(offset for offset, opcode in sample.boundaries if opcode == DATA_END)
    data = bytearray(sample.data[:end])
    data[first + 200] ^= 0xFF
    path.write_bytes(data)
    read, verdict = scan(path)
    assert verdict.state == "damaged"
    assert N_MESSAGES - 60 <= len(read) < N_MESSAGES
    assert len(read) + verdict.lost == N_MESSAGES
    reader = McapScan(path)
    list(reader.blocks())
    assert reader.channels[1].type_name == TYPES[names.TRACER_LENGTH]
    assert "float64 length" in reader.channels[1].definition


@pytest.mark.parametrize(
    "content", [b"x", b"hello world, this is no bag", bytes(10_000), MAGIC[::-1]]
)
def test_foreign_file_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "foreign.mcap"
    path.write_bytes(content)
    with pytest.raises(BagError, match="is not an MCAP file"):
        scan(path)


@pytest.mark.parametrize("size", [0, 3, 8])
def test_file_that_was_only_begun_is_truncated(size: int, tmp_path: Path) -> None:
    path = tmp_path / "begun.mcap"
    path.write_bytes(MAGIC[:size])
    read, verdict = scan(path)
    assert (read, verdict.state) == ([], "truncated")
