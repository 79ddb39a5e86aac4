"""Many bags with one configuration: each is solved once, and its outcome is kept in a cache."""

from __future__ import annotations

import hashlib
import json
import time
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from rotcal_history.fleet.bag_search import is_remote, local_copy, remote_state
from rotcal_ros import __version__
from rotcal_ros.bags import names
from rotcal_ros.bags.reader import bag_files, sha256_of
from rotcal_ros.bags.rosbag2_metadata import METADATA_FILE
from rotcal_ros.bags.session_identity import session_of
from rotcal_ros.bags.unread_data import collect_unread
from rotcal_ros.foundation.errors import ConfigurationError, DataError, RotcalError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.identity import Identity
from rotcal_ros.foundation.plugins import describe_error, failing_plugin
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.settings import load
from rotcal_ros.methods.configuration import Configuration, raw_groups
from rotcal_ros.planning.settings import CellSettings
from rotcal_ros.recordings.replay import Recording, read_recording


@dataclass(frozen=True)
class BagJob:
    """One bag to be solved: ``source`` is a path or an fsspec URL, ``cache`` the cache's folder.

    With ``verify_bytes`` every byte of the bag decides whether the cache has its outcome.
    """

    source: str
    configuration: Configuration
    cache: str
    verify_bytes: bool = False


def solve_bag(job: BagJob) -> BagOutcome:
    """Solve one bag; whatever goes wrong with it becomes part of the outcome."""
    begin = time.perf_counter()
    key, was_damaged = "", False
    try:
        key = fingerprint(job.source, job.configuration, whole=job.verify_bytes)
        try:
            if known := read_entry(Path(job.cache), key):
                return replace(known, source=job.source, cached=True)
        except DamagedEntryError:
            was_damaged = True
        with local_copy(job.source) as path:
            outcome = _solve(job, path, key)
    except Exception as error:  # one bad bag does not stop the rest
        return BagOutcome(
            job.source, key, error=_in_words(error), seconds=time.perf_counter() - begin
        )
    return _cached(job, replace(outcome, seconds=time.perf_counter() - begin, healed=was_damaged))


def _cached(job: BagJob, outcome: BagOutcome) -> BagOutcome:
    """Put a good outcome into the cache; on a full disk it only carries a warning."""
    try:
        write_entry(Path(job.cache), replace(outcome, healed=False))
    except OSError as error:
        warning = f"the result is not kept for the next call: {error.strerror}"
        return replace(outcome, warnings=(*outcome.warnings, warning))
    return outcome


def _in_words(error: Exception) -> str:
    """Return what went wrong; our own errors explain themselves."""
    if isinstance(error, RotcalError):
        return str(error)
    if isinstance(error, MemoryError):
        return "the bag needs more memory than there is"
    if failing_plugin(error):
        return describe_error(error)
    if isinstance(error, OSError) and error.strerror:
        return f"{error.strerror}: {error.filename}" if error.filename else error.strerror
    return f"{type(error).__name__} while solving, which is a fault of rotcal_ros: {error}"


def _solve(job: BagJob, path: Path, key: str) -> BagOutcome:
    with collect_unread() as missing:
        recording = read_recording(path, configuration=job.configuration)
    starts = [v.start_ns for v in recording.verdicts if v.start_ns is not None]
    return BagOutcome(
        source=job.source,
        key=key,
        start_ns=min(starts, default=None),
        session=session_of(path),
        result=_of_its_table(recording).to_dict(),
        warnings=recording.warnings(),
        unread=tuple(missing),
    )


def _of_its_table(recording: Recording) -> Result:
    """Solve a recording; its result is of the table that it was recorded as, if it says which.

    One set-up solves the bags of many tables, but the tolerances that it states count.
    """
    result = recording.solve()
    text = recording.attachments.get(names.CONFIGURATION, b"").decode(errors="replace")
    known = result.circumstances
    with suppress(ConfigurationError):
        _, groups = raw_groups(text, "the recorded configuration")
        recorded = load(Identity, groups.get("identity"), "identity")
        if recorded.serial:
            axis = load(CellSettings, groups.get("cell"), "cell").axis
            agreed = {n: getattr(known.identity, n) or getattr(recorded, n) for n in AGREED}
            known = replace(known, identity=replace(recorded, **agreed), axis=axis)
    return replace(result, circumstances=known)


FORM: Final = 3
"""Version of what the cache keeps."""
AGREED: Final = ("tolerance_arcsec", "tolerance_um")
TAIL_BYTES: Final = 1 << 16
"""Hashed bytes of a file's end: the summary of an MCAP file, the last pages of a database."""


@dataclass(frozen=True)
class BagOutcome:
    """The outcome of one bag; ``error`` is empty if there is a result.

    ``start_ns`` is the log time of the first message, ``session`` is the same for a recording, its
    copies and its repaired twins. ``cached`` says
    that nothing had to be computed, ``healed`` that the cached entry was damaged and was computed
    again. ``unread`` says what of the bag could not be read.
    """

    source: str
    key: str
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


class DamagedEntryError(Exception):
    """A damaged entry of the cache."""


def fingerprint(source: str, configuration: Configuration, *, whole: bool = False) -> str:
    """Return the hash of a bag's state, the configuration and the version that solves it.

    The state is size and time of change of every file and its last 64 KiB; with ``whole`` it is
    all bytes and nothing else.
    """
    digest = hashlib.sha256(f"{__version__} {FORM} {configuration.plan_id} {whole}".encode())
    if is_remote(source):
        for part in remote_state(source, TAIL_BYTES, whole=whole):
            digest.update(part)
        return digest.hexdigest()
    path = Path(source)
    beside = path / METADATA_FILE
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
    """Return the outcome under ``key``, None without one; raises DamagedEntryError."""
    try:
        checksum, text = _path(folder, key).read_text(encoding="utf-8").split("\n", 1)
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise DamagedEntryError(str(error)) from error
    if checksum != _checksum(text):
        raise DamagedEntryError(f"{key}: not as it was written")
    known = json.loads(text)
    return BagOutcome(**known | {name: tuple(known[name]) for name in ("warnings", "unread")})


def cached_result(folder: Path, key: str) -> Result:
    """Return the result under ``key``; DataError where the cache could not keep it."""
    with suppress(DamagedEntryError):
        if (known := read_entry(folder, key)) and (result := known.deviations()) is not None:
            return result
    raise DataError(f"{folder} did not keep the result: make room there, and give the call again")


def write_entry(folder: Path, outcome: BagOutcome) -> None:
    """Write an outcome under its key: whole and on the medium, or not at all."""
    path = _path(folder, outcome.key)
    path.parent.mkdir(exist_ok=True, parents=True)
    text = json.dumps(asdict(outcome))
    write_atomically(path, f"{_checksum(text)}\n{text}")


def _checksum(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _path(folder: Path, key: str) -> Path:
    return folder / key[:2] / f"{key}.json"
