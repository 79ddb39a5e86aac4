"""Harmed input, case by case, in a child process with little time and memory.

A case is its target, the seed of its harm and nothing else: whoever has both has the case again.
The child notes each input before it reads it, so that one that kills the child is known too.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import resource
import signal
import tempfile
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random
from typing import Any, Final

from properties import require_one_line
from targets import TARGETS, Target

from rotcal_ros.foundation.errors import RotcalError

CORPUS: Final = Path(__file__).parent / "corpus"
"""Inputs that were findings once: a folder for each target."""
CPU_SECONDS: Final = 10
WALL_SECONDS: Final = 120
MORE_BYTES: Final = 300 << 20
"""What one case may take beside what is loaded before it."""


@dataclass(frozen=True)
class Finding:
    """An input of a target that broke its property, and how."""

    target: str
    data: bytes
    what: str
    trace: str = ""


class TooLongError(BaseException):
    """A case took longer than it may; nobody who catches errors catches it."""


def corpus(name: str) -> list[bytes]:
    """Return the inputs that a target once broke on."""
    folder = CORPUS / name
    return [path.read_bytes() for path in sorted(folder.iterdir())] if folder.is_dir() else []


def cases(target: str, seed: int) -> Iterator[bytes]:
    """Yield harmed inputs without end; the same for the same seed."""
    chosen = TARGETS[target.partition("/")[0]]
    rng = Random(f"{target} {seed}")
    seeds = [*chosen.seeds(), *corpus(target)]
    while True:
        data = chosen.harm(rng, rng.choice(seeds))
        while rng.random() < 0.2:
            data = chosen.harm(rng, data)
        yield data


def broken(target: Target, data: bytes, folder: Path) -> Finding | None:
    """Let the target read ``data``; return how that broke its property, None where it held."""
    name, _, file = target.name.partition("/")
    path = folder / file
    path.write_bytes(data)
    what = trace = ""
    try:
        with _limits():
            try:
                target.read(path)
            except RotcalError as error:
                require_one_line(error)
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        what, trace = f"{type(error).__name__}: {error!s:.200}", traceback.format_exc()
    if not what and path.read_bytes() != data:
        what = "reading has changed the input"
    return Finding(name, data, what, trace) if what else None


class _limits:  # noqa: N801  reads like a function
    """Raise in this process when a case takes too long."""

    def __enter__(self) -> None:
        for number in (signal.SIGVTALRM, signal.SIGALRM):
            signal.signal(number, _too_long)
        signal.setitimer(signal.ITIMER_VIRTUAL, CPU_SECONDS)
        signal.setitimer(signal.ITIMER_REAL, WALL_SECONDS)

    def __exit__(self, *_: object) -> None:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.setitimer(signal.ITIMER_REAL, 0)


def _too_long(number: int, _frame: Any) -> None:
    what = f"{CPU_SECONDS} s of work" if number == signal.SIGVTALRM else f"{WALL_SECONDS} s"
    raise TooLongError(f"not done after {what}")


def run(target: str, seed: int, seconds: float, most: int = 1 << 62) -> tuple[int, list[Finding]]:
    """Fuzz a target in child processes; return the number of cases and what was found.

    A child that dies is a finding too; the next one goes on behind it.
    """
    done, findings, deadline = 0, list[Finding](), time.monotonic() + seconds
    while time.monotonic() < deadline and done < most and len(findings) < 50:
        ours, its = multiprocessing.Pipe()
        # A fork, so that what is loaded once need not be loaded again.
        context = multiprocessing.get_context("fork")
        left = (deadline - time.monotonic(), most - done)
        with tempfile.TemporaryDirectory() as folder:
            child = context.Process(target=_child, args=(its, target, seed, done, *left, folder))
            child.start()
            its.close()
            count, found = _heard(ours)
            child.join()
            findings += found
            done += count
            if child.exitcode:
                noted = Path(folder) / "case"
                data = noted.read_bytes() if noted.exists() else b""
                findings.append(Finding(target, data, f"it died with {child.exitcode}"))
                done += 1
    return done, findings


def _heard(ours: Connection) -> tuple[int, list[Finding]]:
    count, found = 0, []
    while True:
        try:
            said = ours.recv()
        except EOFError:
            return count, found
        if isinstance(said, Finding):
            found.append(said)
        else:
            count = said


def _child(
    its: Connection, name: str, seed: int, skipped: int, seconds: float, most: int, folder: str
) -> None:
    target, deadline = TARGETS[name], time.monotonic() + seconds
    os.chdir(folder)
    given = cases(name, seed)
    for _ in range(skipped):
        next(given)
    place = Path(folder) / "input"
    place.mkdir()
    for data in target.seeds():  # loads what reading needs, before memory is counted
        broken(target, data, place)
        break
    limit = _taken() + MORE_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    for number in range(most):
        data = next(given)
        (Path(folder) / "case").write_bytes(data)
        finding = broken(target, data, place)
        if finding is not None:
            its.send(finding)
        if number % 20 == 0 or finding is not None:
            its.send(number + 1)
        if time.monotonic() > deadline or (finding and "MemoryError" in finding.what):
            break
    its.send(number + 1)
    its.close()


def _taken() -> int:
    """Return the address space of this process in bytes."""
    pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[0]
    return int(pages) * resource.getpagesize()


def keep(finding: Finding, folder: Path) -> Path:
    """Write the input of a finding, with its cause beside it; return the input's path."""
    inside = folder / finding.target
    inside.mkdir(parents=True, exist_ok=True)
    path = inside / hashlib.sha256(finding.data).hexdigest()[:16]
    path.write_bytes(finding.data)
    path.with_suffix(".txt").write_text(
        f"{finding.what}\nagain: make fuzz FUZZ_ARGS='--again {path}'\n\n{finding.trace}",
        encoding="utf-8",
        errors="backslashreplace",
    )
    return path
