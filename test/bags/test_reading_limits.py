"""Whatever a file asks for, memory stays below 300 MB, and what is left out is said."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from click.testing import CliRunner
from mcap_matrix import MAGIC, record, text

from rotcal_ros.bags.mcap_scan import McapScan
from rotcal_ros.bags.settings import DEFAULT_LIMITS
from rotcal_ros.bags.storage_scan import FileVerdict
from rotcal_ros.cli.bag import command
from rotcal_ros.cli.main import rotcal

DATA = Path(__file__).parents[2] / "examples" / "data"
PACK: dict[str, Callable[[bytes], bytes]] = {
    "": bytes,
    "zstd": zstandard.compress,
    "lz4": lz4.frame.compress,
}
CHANNEL = record(4, struct.pack("<HH", 1, 0) + text("/a") + text("cdr") + text(b""))
MESSAGE = record(5, struct.pack("<HIQQ", 1, 0, 0, 0))
PRIVATE = record(0x80, b"")


def chunk(inside: bytes, compression: str = "zstd", size: int | None = None) -> bytes:
    packed = PACK[compression](inside)
    size = len(inside) if size is None else size
    head = struct.pack("<QQQI", 0, 0, size, zlib.crc32(inside)) + text(compression)
    return record(6, head + struct.pack("<Q", len(packed)) + packed)


def file_of(*parts: bytes) -> bytes:
    """Return a closed file without checksums and index."""
    head = MAGIC + record(1, text("") + text(""))
    return head + b"".join(parts) + record(15, bytes(4)) + record(2, bytes(20)) + MAGIC


def attachment(name: str, data: bytes, size: int | None = None) -> bytes:
    size = len(data) if size is None else size
    head = struct.pack("<QQ", 0, 0) + text(name) + text("") + struct.pack("<Q", size)
    return record(9, head + data + bytes(4))


def nested(count: int, step: int = 64) -> bytes:
    """Return attachments that each claim to hold all that follows, with a wrong checksum."""
    size, parts = count * step, []
    for number in range(count):
        rest = size - number * step
        head = struct.pack("<BQ", 9, rest - 9) + struct.pack("<QQ", 0, 0) + text("a") + text("")
        parts.append((head + struct.pack("<Q", rest - len(head) - 12) + b"\1" * step)[:step])
    return b"".join(parts)


BOMBS: dict[str, tuple[Callable[[], bytes], int, str]] = {
    "11 million records": (lambda: file_of(chunk(PRIVATE * 11_000_000)), 0, "chunk_bytes"),
    "six of them": (lambda: file_of(*[chunk(PRIVATE * 11_000_000)] * 6), 0, "chunk_bytes"),
    "as large as allowed": (
        lambda: file_of(*[chunk(PRIVATE * 5_500_000)] * 2), 0, "",
    ),
    "lz4": (lambda: file_of(chunk(PRIVATE * 5_500_000, "lz4")), 0, ""),
    "empty messages": (lambda: file_of(chunk(CHANNEL + MESSAGE * 1_500_000)), 1_500_000, ""),
    "too many of them": (
        lambda: file_of(*[chunk(CHANNEL + MESSAGE * 1_500_000)] * 6), 7_500_000, "unpacked_ratio",
    ),
    "opcodes everywhere": (
        lambda: file_of(CHANNEL, chunk(MESSAGE + record(5, b"\1\0" + b"\5" * 45_000_000))), 2, "",
    ),
    "one large message": (
        lambda: file_of(CHANNEL, record(5, b"\1" + bytes(45_000_000))), 1, "",
    ),
    "too large a message": (
        lambda: file_of(CHANNEL, MESSAGE, record(5, b"\1" + bytes(60_000_000))), 1, "chunk_bytes",
    ),
    "claimed sizes": (
        lambda: file_of(*[chunk(b"x", size=50_000_000)] * 1000), 0, "unpacked_ratio",
    ),
    "attachments": (
        lambda: file_of(*[attachment(f"{n}", bytes(30_000_000)) for n in range(3)]), 0, "",
    ),
    "a claimed attachment": (lambda: file_of(attachment("a", b"x", size=2**63)), 0, ""),
    "many attachments": (
        lambda: file_of(*[attachment(f"{n}", b"") for n in range(30_000)]), 0, "",
    ),
    "many notes": (
        lambda: file_of(*[record(12, text(f"{n}") + text(b"")) for n in range(40_000)]),
        0, "kept_bytes",
    ),
    "a map of numbers": (
        lambda: file_of(record(11, bytes(42) + text(bytes(40_000_000)))), 0, "kept_bytes",
    ),
    "schemas": (
        lambda: file_of(chunk(b"".join(
            record(3, struct.pack("<H", n + 1) + text("a") + text("b") + text(bytes(1000)))
            for n in range(40_000)
        ))), 0, "kept_bytes",
    ),
    "nested records": (lambda: MAGIC + nested(30_000), 0, ""),
    "no records at all": (lambda: file_of(b"\xff" + (b"\5\x16" + bytes(7)) * 100_000), 0, ""),
}  # fmt: skip

PASS = """
import json, sys
from pathlib import Path
from rotcal_ros.bags.reader import check_files
for path in map(Path, sys.argv[1:]):
    (verdict,) = check_files((path,))
    status = Path("/proc/self/status").read_text()
    kilobytes = int(status.partition("VmHWM:")[2].split()[0])
    damages = [damage.what for damage in verdict.damages]
    print(json.dumps([path.stem, kilobytes, verdict.messages, damages]))
"""


@pytest.mark.slow
def test_bombs_take_little_memory_and_are_told(tmp_path: Path) -> None:
    paths = [tmp_path / f"{name}.mcap" for name in BOMBS]
    for path in paths:
        path.write_bytes(BOMBS[path.stem][0]())
    done = subprocess.run(
        [sys.executable, "-c", PASS, *map(str, paths)], capture_output=True, text=True, check=True
    )
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert [name for name, *_ in lines] == list(BOMBS)
    for name, kilobytes, read, damages in lines:
        _, messages, setting = BOMBS[name]
        told = "; ".join(damages)
        assert kilobytes < 300_000, name
        assert read == messages, name
        assert f"reading.{setting}=" in told if setting else "reading." not in told, name


def verdict_of(path: Path, **limits: int) -> FileVerdict:
    scan = McapScan(path, replace(DEFAULT_LIMITS, **limits), check_index=True)
    for _ in scan.blocks():
        pass
    return scan.verdict()


def test_every_verb_that_reads_a_bag_takes_limits() -> None:
    run, bag = CliRunner().invoke, str(DATA / "ball_plate_bag")
    small = ["--set", "reading.unpacked_bytes=65536", "--set", "reading.unpacked_ratio=1"]
    for verb in (["bag", "info"], ["solve"], ["solve", "--set", "capture.settle_time_s=0.5"]):
        assert "reading.unpacked_ratio=3" in run(rotcal, [*verb, bag, *small]).output
        enough = run(rotcal, [*verb, bag, *small, "--set", "reading.unpacked_ratio=3"])
        assert "reading." not in enough.output
    table = ["solve", str(DATA / "balls.csv"), "--setup", str(DATA / "ball_plate.yaml")]
    assert "balls.csv is not a bag" in run(rotcal, [*table, *small]).stderr
    for wrong in ("reading.chunk=1", "reading=1", "reading.chunk_bytes=[1]"):
        answer = run(rotcal, ["solve", bag, "--set", wrong])
        assert (answer.exit_code, answer.stderr.count("\n")) == (2, 1), answer.stderr


def test_the_setting_that_is_named_lets_it_pass(tmp_path: Path) -> None:
    path = tmp_path / "large.mcap"
    path.write_bytes(file_of(chunk(CHANNEL + MESSAGE * 10_000 + PRIVATE * 2000)))
    assert verdict_of(path).messages == 10_000
    value = 100
    for of in ("record", "chunk"):  # as it stands in the file, then what it unpacks to
        refused = verdict_of(path, chunk_bytes=value)
        assert refused.state == "damaged"
        named = next(d.what for d in refused.damages if "reading.chunk_bytes=" in d.what)
        assert of in named
        value = int(named.partition("reading.chunk_bytes=")[2].split()[0])
    assert verdict_of(path, chunk_bytes=value).describe() == "complete"


def test_limits_are_set_on_the_command_line(tmp_path: Path) -> None:
    path = tmp_path / "large.mcap"
    path.write_bytes(file_of(CHANNEL, chunk(MESSAGE * 100_000)))
    run = CliRunner().invoke
    refused = run(command, ["check", str(path), "--set", "reading.chunk_bytes=70000"])
    assert "--set reading.chunk_bytes=3100000" in refused.output
    assert "100000 messages, complete" in run(command, ["check", str(path)]).output
    wrong = run(command, ["check", str(path), "--set", "reading.chunks=1"])
    assert "unknown setting 'chunks'" in str(wrong.exception)
