"""Files that were left open are closed behind their last whole record; nothing before changes."""

import os
import random
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from bag_samples import open_writer
from faulty_disk import Fault, FaultyDisk, File, faults
from mcap.reader import NonSeekingReader, SeekingReader
from rosbags.rosbag2 import Reader

from rotcal_ros.bags import names
from rotcal_ros.bags.interrupted_files import (
    JOURNAL_SUFFIX,
    InterruptedSession,
    UnclosedEnd,
    find_unclosed_end,
)
from rotcal_ros.bags.reader import bag_files, check_files
from rotcal_ros.bags.settings import WriterSettings
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.foundation import disk
from rotcal_ros.foundation.errors import BagError

DATA_END = 0x0F
LONG = bool(os.environ.get("ROTCAL_LONG_TESTS"))


def fill(folder: Path) -> bytes:
    """Write a small closed bag of several chunks; return its bytes."""
    writer, channels = open_writer(folder, WriterSettings(min_free_bytes=0))
    with writer:
        for number in range(8):
            for channel in channels.values():
                writer.write(channel, struct.pack("<4xQ", number), number * 1000, number)
            if number % 2 == 0:
                writer.sync()
    return next(folder.glob("*.mcap")).read_bytes()


def record_ends(data: bytes) -> list[tuple[int, int]]:
    """Return (opcode, end) of the top-level records, by MCAP's framing alone."""
    position, found = 8, []
    while position < len(data) - 8:
        opcode, length = struct.unpack_from("<BQ", data, position)
        position += 9 + length
        found.append((opcode, position))
    return found


def ended(path: Path) -> UnclosedEnd | None:
    (verdict,) = check_files((path,))
    return find_unclosed_end(verdict)


def close(path: Path, following: str = "next.mcap") -> int:
    end = ended(path)
    assert end is not None
    end.close(following)
    return end.end


def read_by_others(path: Path) -> int:
    """Return the messages that the seeking, the streaming and rosbags' reader find: the same."""
    counts = []
    for kind in (SeekingReader, NonSeekingReader):
        with path.open("rb") as file:
            counts.append(sum(1 for _ in kind(file, validate_crcs=True).iter_messages()))
    with Reader(path) as reader:
        counts.append(sum(1 for _ in reader.messages()))
    assert len(set(counts)) == 1
    return counts[0]


@pytest.mark.slow
def test_wherever_it_was_cut(tmp_path: Path) -> None:
    whole = fill(tmp_path / "bag")
    records = record_ends(whole)
    cuts = {0, 3, 8, 12, len(whole) - 1, len(whole) - 30}
    cuts |= {end for _, end in records[::4]} - {len(whole) - 8}
    cuts |= set(random.Random(1).sample(range(len(whole)), 12))
    path = tmp_path / "cut_0.mcap"
    for cut in sorted(cuts):
        path.write_bytes(whole[:cut])
        (before,) = check_files((path,))
        end = close(path)
        last_whole = max(
            [0, 8 * (cut >= 8), *(e for o, e in records if e <= cut and o < DATA_END)]
        )
        data_end = next(e for o, e in records if o == DATA_END)
        assert end == (last_whole if cut < data_end else data_end - 13)
        (after,) = check_files((path,))
        assert (after.state, after.messages) == ("complete", before.messages)
        assert read_by_others(path) == before.messages
        with path.open("rb") as file:
            torn = [a.data for a in SeekingReader(file).iter_attachments() if a.name == names.TORN]
        assert path.read_bytes()[:end] + b"".join(torn) == whole[:cut]
        assert ended(path) is None
        assert not path.with_name(path.name + JOURNAL_SUFFIX).exists()


def test_checksum_over_all_data_is_right(tmp_path: Path) -> None:
    path = tmp_path / "cut_0.mcap"
    path.write_bytes(fill(tmp_path / "bag")[:-500])
    close(path)
    data = path.read_bytes()
    end = next(e for o, e in record_ends(data) if o == DATA_END)
    (stated,) = struct.unpack_from("<I", data, end - 4)
    assert stated == zlib.crc32(data[: end - 13])


def test_whoever_dies_while_closing_leaves_it_to_the_next(tmp_path: Path) -> None:
    whole = fill(tmp_path / "bag")
    cut = next(e for o, e in record_ends(whole)[::-1] if o == 6) + 7  # behind a chunk
    path = tmp_path / "cut_0.mcap"
    path.write_bytes(whole[:cut])
    journal = path.with_name(path.name + JOURNAL_SUFFIX)
    once = ended(path)
    assert once is not None
    noted: list[bytes] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(disk, "remove", lambda p: noted.append(p.read_bytes()))
        once.close("next.mcap")
    closed = path.read_bytes()
    for grown in [once.end, *random.Random(2).sample(range(once.end, len(closed)), 8)]:
        path.write_bytes(closed[:grown])
        journal.write_bytes(noted[0])
        assert close(path) == once.end
        assert len(path.read_bytes()) == len(closed)
        assert read_by_others(path) == check_files((path,))[0].messages
        assert path.read_bytes().startswith(whole[: once.end])
        assert not journal.exists()


@pytest.mark.slow
def test_whichever_call_to_the_disk_fails_the_next_closing_does_it(tmp_path: Path) -> None:
    cut = fill(tmp_path / "bag")[:-300]
    sound = trial(tmp_path / "sound", cut)
    possible = faults(sound.calls)[:: 1 if LONG else 4]
    assert {"truncate", "write", "sync", "remove", "replace"} <= set(sound.calls)
    for number, fault in enumerate(possible):
        faulty = trial(tmp_path / str(number), cut, fault)
        assert faulty.hit
        for left in (faulty.root / "cut_0.mcap", *cuts_of_power(faulty, tmp_path / f"p{number}")):
            (before,) = check_files((left,))
            if before.state != "complete":
                close(left)
            assert ended(left) is None
            assert not left.with_name(left.name + JOURNAL_SUFFIX).exists()
            assert read_by_others(left) == read_by_others(sound.root / "cut_0.mcap")
            with left.open("rb") as file:
                attached = SeekingReader(file).iter_attachments()
                torn = b"".join(a.data for a in attached if a.name == names.TORN)
            assert cut.endswith(torn)
            assert left.read_bytes().startswith(cut[: len(cut) - len(torn)])


def trial(root: Path, cut: bytes, fault: Fault | None = None) -> FaultyDisk:
    """Close a file that was cut off, on a disk with that fault."""
    root.mkdir()
    path = root / "cut_0.mcap"
    path.write_bytes(cut)
    faulty = FaultyDisk(root, fault)
    faulty.names[path] = faulty.stable_names[path] = File(bytearray(cut), cut)
    with pytest.MonkeyPatch.context() as patch, suppress(BagError):
        faulty.install(patch)
        InterruptedSession.read(root).close("next.mcap")
    assert not faulty.open
    return faulty


def cuts_of_power(faulty: FaultyDisk, root: Path) -> Iterator[Path]:
    """Yield what the file may be after a power cut: least, most, something between."""
    for number, seed in enumerate((None, -1, 1)):
        left = root / str(number)
        left.mkdir(parents=True)
        faulty.power_cut(left, seed)
        yield left / "cut_0.mcap"


def test_damage_is_left_alone(tmp_path: Path) -> None:
    whole = bytearray(fill(tmp_path / "bag"))
    whole[len(whole) // 3] ^= 0xFF
    path = tmp_path / "bad_0.mcap"
    path.write_bytes(whole[:-200])
    before = path.read_bytes()
    assert ended(path) is None
    assert path.read_bytes() == before


def test_the_next_run_takes_the_identity_and_closes(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    whole = fill(bag)
    (first,) = bag_files(bag)
    first.write_bytes(whole[:-300])
    left = InterruptedSession.read(bag)
    assert first.read_bytes() == whole[:-300]  # nothing is done before the new file is there
    with BagWriter(bag, WriterSettings(min_free_bytes=0), earlier=left.files) as writer:
        left.close_before(writer)
        writer.note(names.RUN, {"number": 1, "session": left.session})
    with Reader(bag) as reader:
        assert reader.message_count == left.files[0].messages
        assert sum(1 for _ in reader.messages()) == left.files[0].messages


def test_a_file_that_changed_meanwhile_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "cut_0.mcap"
    path.write_bytes(fill(tmp_path / "bag")[:-300])
    end = ended(path)
    assert end is not None
    path.write_bytes(path.read_bytes() + b"x")
    with pytest.raises(BagError, match="has changed since it was read"):
        end.close("next.mcap")
