"""Many bags with one configuration: each solved by itself, wherever it lies, and kept."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from rotcal_ros.bags import names
from rotcal_ros.bags.session_identity import session_of
from rotcal_ros.bags.unread_data import unread
from rotcal_ros.foundation.errors import ConfigurationError, RotcalError
from rotcal_ros.foundation.plugins import culprit, in_words
from rotcal_ros.methods.configuration import Configuration, parse_configuration
from rotcal_ros.recordings.outcome_cache import (
    BagOutcome,
    BrokenEntry,
    fingerprint,
    read_entry,
    write_entry,
)
from rotcal_ros.recordings.remote import local
from rotcal_ros.recordings.replay import Recording, read_recording


@dataclass(frozen=True)
class Job:
    """One bag to be solved: ``source`` is a path or an fsspec URL; ``cache`` takes the outcome.

    With ``verify_bytes`` every byte of the bag decides whether it is known already.
    """

    source: str
    configuration: Configuration
    cache: str
    verify_bytes: bool = False


def solve_bag(job: Job) -> BagOutcome:
    """Solve one bag; whatever goes wrong with it becomes part of the outcome."""
    begin = time.perf_counter()
    key, healed = "", False
    try:
        key = fingerprint(job.source, job.configuration, whole=job.verify_bytes)
        try:
            if known := read_entry(Path(job.cache), key):
                return replace(known, source=job.source, cached=True)
        except BrokenEntry:
            healed = True
        with local(job.source) as path:
            outcome = _solve(job, path, key)
    except Exception as error:  # one bad bag does not stop the rest
        return BagOutcome(
            job.source, key, error=_in_words(error), seconds=time.perf_counter() - begin
        )
    return _kept(job, replace(outcome, seconds=time.perf_counter() - begin, healed=healed))


def _kept(job: Job, outcome: BagOutcome) -> BagOutcome:
    """Keep a good outcome; a full disk does not make it worse."""
    try:
        write_entry(Path(job.cache), replace(outcome, healed=False))
    except OSError as error:
        why = f"the result is not kept for the next call: {error.strerror}"
        return replace(outcome, warnings=(*outcome.warnings, why))
    return outcome


def _in_words(error: Exception) -> str:
    """Return what went wrong; our own errors explain themselves."""
    if isinstance(error, RotcalError):
        return str(error)
    if isinstance(error, MemoryError):
        return "the bag needs more memory than there is"
    if culprit(error):
        return in_words(error)
    if isinstance(error, OSError) and error.strerror:
        return f"{error.strerror}: {error.filename}" if error.filename else error.strerror
    return f"{type(error).__name__} while solving, which is a fault of rotcal_ros: {error}"


def _solve(job: Job, path: Path, key: str) -> BagOutcome:
    with unread() as missing:
        recording = read_recording(path, configuration=job.configuration)
    starts = [v.start_ns for v in recording.verdicts if v.start_ns is not None]
    return BagOutcome(
        source=job.source,
        key=key,
        table=_table(recording, job.source),
        start_ns=min(starts, default=None),
        session=session_of(path),
        result=recording.solve().to_dict(),
        warnings=recording.warnings(),
        unread=tuple(missing),
    )


def _table(recording: Recording, source: str) -> str:
    """Return what tells tables apart: namespace and axis as recorded, else the folder's name."""
    text = recording.attachments.get(names.CONFIGURATION, b"").decode(errors="replace")
    with suppress(ConfigurationError):
        recorded = parse_configuration(text, groups=("cell",))
        if "cell" in recorded.given:
            return f"{recorded.cell.namespace} {recorded.cell.axis}"
    return source.rstrip("/").rpartition("/")[0].rpartition("/")[2]
