"""Paths that lead to anything but a good file, and every command that takes a path."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rotcal_ros.foundation.machine_load import load_scaled_timeout

ROOT = Path(__file__).parents[2]
DATA = ROOT / "examples" / "data"
CONFIGURATION = ROOT / "config" / "tracer_demo.yaml"
SUFFIXES = ("", ".mcap", ".db3", ".csv", ".json", ".yaml", ".txt")
"""What a file is taken for, so that each reader has its turn."""

LATEST_S = 20.0
"""Whoever has not answered by then waits for somebody who will never come."""


@contextmanager
def must_answer() -> Iterator[None]:
    """Interrupt whatever blocks: TimeoutError."""

    def give_up(_number: int, _frame: object) -> None:
        raise TimeoutError("it blocks")

    previous = signal.signal(signal.SIGALRM, give_up)
    signal.setitimer(signal.ITIMER_REAL, load_scaled_timeout(LATEST_S))
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, previous)


def pipe(path: Path) -> None:
    os.mkfifo(path)


def bound_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path)[-100:]) if len(str(path)) < 100 else made.bind(os.path.relpath(path))


def endless(path: Path) -> None:
    path.symlink_to("/dev/zero")


def full(path: Path) -> None:
    path.symlink_to("/dev/full")


def link_to_itself(path: Path) -> None:
    path.symlink_to(path.name)


def folder_in_itself(path: Path) -> None:
    path.mkdir()
    (path / "again").symlink_to(path)
    (path / "once_more").symlink_to(path)


def folder_of_pipes(path: Path) -> None:
    path.mkdir()
    for name in ("bag_0.mcap", "metadata.yaml", "configuration.yaml", "result.json",
                 "verification.json", "running.json", "a.provenance.json"):  # fmt: skip
        os.mkfifo(path / name)


def empty_folder(path: Path) -> None:
    path.mkdir()


def noise(path: Path) -> None:
    path.write_bytes(bytes(range(256)) * 8)


def empty_file(path: Path) -> None:
    path.touch()


def absent(_path: Path) -> None:
    pass


KINDS: dict[str, tuple[Callable[[Path], None], bytes]] = {
    "pipe": (pipe, b"pipe"),
    "socket": (bound_socket, b"socket"),
    "endless": (endless, b"endless"),
    "full": (full, b"full"),
    "link to itself": (link_to_itself, b"turning"),
    "folder in itself": (folder_in_itself, b"folder"),
    "folder of pipes": (folder_of_pipes, b"pipes"),
    "empty folder": (empty_folder, b"nothing"),
    "empty file": (empty_file, b"empty"),
    "noise": (noise, b"noise"),
    "longest name": (noise, b"n" * 249),
    "too long a name": (absent, b"n" * 300),
    "no text": (noise, b"no\xff\xfetext"),
    "new line": (noise, b"a\nrotcal: all is well\x1b]0;owned\x07\x1b[31m"),
    "markup": (noise, b"[red]$\\frac{x}_^%s{0}$(touch owned)"),
    "turned round": (noise, "a\u202egnp.exe".encode()),
    "beginning with a dash": (noise, b"=1+1"),
}


def made(kind: str, folder: Path, suffix: str) -> Path:
    """Make what is strange about the path that is returned."""
    make, name = KINDS[kind]
    path = folder / os.fsdecode(name + suffix.encode())
    make(path)
    return path


def reading(path: Path, new: Path) -> list[list[str]]:
    """Return the command lines that read ``path``; what they write would go to ``new``."""
    x, result = str(path), str(DATA / "result_tracer.json")
    lengths, setup = str(DATA / "lengths.csv"), str(DATA / "tracer.yaml")
    bag, page = str(DATA / "ball_plate_bag"), f"{new}.html"
    return [
        ["solve", x],
        ["solve", x, "--setup", setup],
        ["solve", lengths, "--setup", x],
        ["solve", lengths, "--setup", setup, "--targets", x],
        ["solve", bag, "--setup", x],
        ["reprocess", x, "--setup", setup, "-o", str(new)],
        ["reprocess", f"{x}/**", "--setup", setup, "-o", str(new)],
        ["reprocess", bag, "--setup", x, "-o", str(new)],
        ["export", x, "--to", "csv", "-o", str(new)],
        ["export", result, "--to", "linuxcnc", "--machine-ini", x, "-o", str(new)],
        ["export", result, "--to", "csv", "--reverse", x, "-o", str(new)],
        ["export", result, "--to", "csv", "--add-to", x, "-o", str(new)],
        ["report", x, "-o", page],
        ["report", result, "--truth", x, "-o", page],
        ["compare", x, result],
        ["compare", result, x],
        ["compare", result, result, "--polygon", x],
        ["check", x, result],
        ["check", result, x],
        ["combine", x, result],
        ["iso230", x],
        ["uncertainty", x],
        ["bag", "info", x],
        ["bag", "check", x],
        ["bag", "choices", x],
        ["bag", "repair", x, "-o", str(new)],
        ["run", x, "-o", str(new)],
        ["run", str(CONFIGURATION), "--resume", x],
        ["attach", x],
        ["verify", x, "-o", str(new)],
        ["verify", "--resume", x],
        ["plan", "order", x],
        ["plan", "sequence", x],
        ["plan", "reliability", x],
        ["plan", "power", x],
        ["plan", "check", x, "--setup", setup],
        ["plan", "check", result, "--setup", x],
        ["plan", "tracer", x],
        ["plan", "tracer", "--like", x],
        ["plan", "trade", x],
        ["doctor", "--machine-ini", x],
    ]


def writing(path: Path) -> list[list[str]]:
    """Return the command lines that would write to ``path``."""
    x, result, runs = str(path), str(DATA / "result_tracer.json"), str(DATA / "runs.csv")
    bag, setup = str(DATA / "ball_plate_bag"), str(DATA / "tracer.yaml")
    return [
        ["solve", bag, "-o", x],
        ["combine", result, result, "-o", x],
        ["report", result, "-o", x],
        ["compare", result, result, "-o", f"{x}.svg"],
        ["iso230", runs, "-o", f"{x}.svg"],
        ["export", result, "--to", "csv", "-o", x],
        ["reprocess", str(DATA / "no_bag_here"), "--setup", setup, "-o", x],
        ["bag", "repair", bag, "-o", x],
        ["run", str(CONFIGURATION), "-o", x],
        ["verify", str(CONFIGURATION), "-o", x],
        ["new", "--yes", "-o", x],
    ]
