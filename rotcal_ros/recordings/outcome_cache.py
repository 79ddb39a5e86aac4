"""A cache of outcomes, so that no bag is solved twice: its keys, and its entries on disk."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

from rotcal_ros import __version__
from rotcal_ros.bags.reader import bag_files, sha256_of
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.results import Result
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.recordings.remote import METADATA, is_remote, remote_state

TAIL_BYTES: Final = 1 << 16
"""Hashed bytes of a file's end: the summary of an MCAP file, the last pages of a database."""


@dataclass(frozen=True)
class BagOutcome:
    """What became of one bag; ``error`` is empty when there is a result.

    ``table`` tells rotary tables apart: cell and axis of the configuration that the bag was
    recorded with, else the folder it lies in. ``start_ns`` is the log time of the first message,
    ``session`` is the same for a recording, its copies and its repaired twins. ``cached`` tells
    that nothing had to be computed, ``healed`` that the cached entry was damaged and was computed
    again. ``unread`` says what of the bag could not be read.
    """

    source: str
    key: str
    table: str = ""
    start_ns: int | None = None
    session: str = ""
    result: dict[str, Any] | None = field(default=None, repr=False)
    warnings: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()
    error: str = ""
    seconds: float = 0.0
    cached: bool = False
    healed: bool = False

    def deviations(self) -> Result | None:
        """Return the result, None when there is none."""
        return None if self.result is None else Result.from_dict(self.result)


class BrokenEntry(Exception):  # noqa: N818  the state of an entry, not a fault of the program
    """An entry that is not what was written."""


def fingerprint(source: str, configuration: Configuration, *, whole: bool = False) -> str:
    """Return the hash of a bag's state, the configuration and the version that solves it.

    The state is size and time of change of every file and its last 64 KiB; with ``whole`` it is
    all bytes and nothing else.
    """
    digest = hashlib.sha256(f"{__version__} {configuration.plan_id} {whole}".encode())
    if is_remote(source):
        for part in remote_state(source, TAIL_BYTES, whole=whole):
            digest.update(part)
        return digest.hexdigest()
    path = Path(source)
    beside = path / METADATA
    for file in (*bag_files(path), *([beside] if beside.is_file() else [])):
        digest.update((sha256_of(file) if whole else _state(file)).encode())
    return digest.hexdigest()


def _state(file: Path) -> str:
    with file.open("rb") as stream:
        status = file.stat()
        stream.seek(max(0, status.st_size - TAIL_BYTES))
        tail = hashlib.sha256(stream.read(TAIL_BYTES)).hexdigest()
    return f"{status.st_size} {status.st_mtime_ns} {tail}"


def read_entry(folder: Path, key: str) -> BagOutcome | None:
    """Return what is kept under ``key``, None when nothing is; raises BrokenEntry."""
    try:
        checksum, text = _path(folder, key).read_text(encoding="utf-8").split("\n", 1)
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise BrokenEntry(str(error)) from error
    if checksum != _checksum(text):
        raise BrokenEntry(f"{key}: not as it was written")
    known = json.loads(text)
    return BagOutcome(**known | {name: tuple(known[name]) for name in ("warnings", "unread")})


def write_entry(folder: Path, outcome: BagOutcome) -> None:
    """Keep an outcome under its key: whole and on the medium, or not at all."""
    path = _path(folder, outcome.key)
    path.parent.mkdir(exist_ok=True, parents=True)
    text = json.dumps(asdict(outcome))
    write_atomically(path, f"{_checksum(text)}\n{text}")


def _checksum(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _path(folder: Path, key: str) -> Path:
    return folder / key[:2] / f"{key}.json"
