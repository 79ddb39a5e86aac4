"""The verdict on a whole session: which files are missing, where ``metadata.yaml`` is wrong.

A repaired bag keeps a record of the bag that it was made from; that record counts too.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Final

from rotcal_ros.bags import names
from rotcal_ros.bags.compression import COMPRESSED
from rotcal_ros.bags.reader import sha256_of
from rotcal_ros.bags.rosbag2_metadata import (
    METADATA_FILE,
    MISSING_KEY,
    BagDescription,
    FileEntry,
    read_description,
    recorded_files,
)
from rotcal_ros.bags.storage_scan import FileVerdict
from rotcal_ros.bags.unread_data import note_unread
from rotcal_ros.foundation.errors import BagError

_TOLERANCE_NS: Final = 1_000_000
_MOST_SENTENCES: Final = 100
"""Most sentences of one kind: a damaged metadata.yaml may list a million files."""


@dataclass(frozen=True)
class SessionVerdict:
    """Sentences on what is wrong beyond the single files.

    ``missing`` is about missing data: a result from the rest is suspect. ``differing``
    says where metadata.yaml is wrong, ``repaired`` what was lost before the bag was repaired,
    ``closed`` which files were closed after an interruption, without a loss.
    """

    missing: tuple[str, ...] = ()
    differing: tuple[str, ...] = ()
    repaired: tuple[str, ...] = ()
    closed: tuple[str, ...] = ()

    @property
    def sound(self) -> bool:
        """Whether nothing is missing, and all agrees with metadata.yaml, if there is one."""
        return not self.missing and not self.differing

    def sentences(self) -> tuple[str, ...]:
        """Return all, what matters most first."""
        return (*self.missing, *self.differing, *self.repaired, *self.closed)

    def to_dict(self) -> dict[str, Any]:
        """Return the machine-readable form."""
        return {
            "sound": self.sound,
            "missing": list(self.missing),
            "differing": list(self.differing),
            "repaired": list(self.repaired),
            "closed": list(self.closed),
        }


def judge_session(path: Path, verdicts: Sequence[FileVerdict]) -> SessionVerdict:
    """Return the verdict on the bag at ``path``, a folder or one file, whose files were read."""
    folder = path if path.is_dir() else path.parent
    wrong: list[str] = []
    try:
        metadata = read_description(folder)
    except BagError as error:
        metadata = None
        wrong.append(f"{error}; rebuild it: rotcal bag reindex {folder}")
    files = _FilesRead(verdicts)
    listed = () if metadata is None else tuple(f for f in metadata.files if files.find(f) is None)
    if metadata is not None and len(listed) == len(metadata.files) > 0:
        wrong.append(f"{METADATA_FILE} is about other files: {', '.join(metadata.names[:3])}")
        metadata, listed = None, ()
    if not path.is_dir():
        wrong.clear()  # one file was named: metadata.yaml may be about others
    missing = dict(_missing_files(folder, files, listed))
    if path.is_dir():
        missing = {**_missing_numbers(folder, files, metadata), **missing}
    if metadata is not None:
        wrong += _differences(metadata, files, whole=path.is_dir() and not missing)
        missing |= {
            text: text for text in (metadata.custom or {}).get(MISSING_KEY, "").splitlines()
        }
    before = (text for v in verdicts for text in missing_before_repair(v.notes))
    shortened = _shortened_files(metadata, files)
    lacking = _first_sentences(dict.fromkeys((*missing.values(), *shortened, *before)))
    note_unread(lacking)
    return SessionVerdict(
        lacking,
        _first_sentences(wrong),
        tuple(text for v in verdicts for text in repairs_in_words(v.notes)),
        tuple(_interruptions(verdicts)),
    )


def _first_sentences(sentences: Iterable[str]) -> tuple[str, ...]:
    """Return the first ones, and how many more there are."""
    every = tuple(sentences)
    more = len(every) - _MOST_SENTENCES
    return every if more <= 0 else (*every[:_MOST_SENTENCES], f"and {more} more")


class _FilesRead:
    """The files that were read, by their present names and those they were recorded under."""

    def __init__(self, verdicts: Sequence[FileVerdict]) -> None:
        self.verdicts = verdicts
        self.entries = {v.path.name: recorded_files(v.notes) for v in verdicts}
        self.recorded = {name: tuple(f.name for f in es) for name, es in self.entries.items()}
        by_recorded_name = {
            files[-1]: v for v in verdicts if (files := self.recorded[v.path.name])
        }
        self.by_name = {**by_recorded_name, **{v.path.name: v for v in verdicts}}

    def find(self, entry: FileEntry) -> FileVerdict | None:
        """Return the file that ``entry`` describes, even if it was renamed or unpacked."""
        for name in (entry.name, entry.name.removesuffix(COMPRESSED)):
            if name in self.by_name:
                return self.by_name[name]
        if not entry.messages:
            return None
        same_start = (v for v in self.verdicts if v.start_ns == entry.start_ns)
        alike = (v for v in same_start if v.messages == entry.messages or not v.whole)
        return next(alike, None)


def _missing_files(
    folder: Path, files: _FilesRead, listed: Sequence[FileEntry]
) -> Iterator[tuple[str, str]]:
    """Yield (name, sentence) of every file that belongs to the session and was not read."""
    stated: dict[str, str] = {}
    for verdict in files.verdicts:
        for name in files.recorded[verdict.path.name]:
            stated.setdefault(name, f"it was there when {verdict.path.name} was recorded")
        following = verdict.notes.get(names.CONTINUED, {}).get("in", "")
        if following:
            stated[following] = f"the session went on in it after {verdict.path.name}"
    for entry in listed:
        about = entry.describe()
        stated[entry.name] = f"{METADATA_FILE} lists it{f' with {about}' if about else ''}"
    for name, evidence in stated.items():
        if name not in files.by_name:
            yield name, _missing_sentence(folder, name, evidence)


def _missing_sentence(folder: Path, name: str, evidence: str) -> str:
    if "/" in name or not _exists(folder / name):
        return f"the file {name} of the session is missing: {evidence}"
    return f"the file {name} of the session was not read, only other files were named: {evidence}"


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # its name is too long, or leads to a folder that may not be read
        return False


def _missing_numbers(
    folder: Path, files: _FilesRead, metadata: BagDescription | None
) -> dict[str, str]:
    """Return the files that are missing in the numbering of a recorder's files.

    Other recorders may delete their oldest files: for theirs ``metadata`` counts, if any.
    """
    renamed = {f.name for f in metadata.files if files.find(f) is not None} if metadata else set()
    found: dict[str, str] = {}
    pattern = re.compile(r"(.+)_(\d{1,6})(\.\w+(?:\.zstd)?)$")
    matches = [m for v in files.verdicts if (m := pattern.match(v.path.name))]
    for stem, ending in {(m[1], m[3]) for m in matches}:
        mine = [m for m in matches if (m[1], m[3]) == (stem, ending)]
        ours = any(files.recorded[m[0]] for m in mine)
        if not ours and (stem != folder.name or metadata is not None):
            continue
        numbers = {int(m[2]) for m in mine}
        if ours and len(mine) == 1:
            continue  # a file may be renamed, and says itself which ones it follows
        for number in sorted(set(range(min(max(numbers), 10_000))) - numbers):
            name = f"{stem}_{number}{ending}"
            if name in renamed or name in files.by_name:
                continue
            found[name] = _missing_sentence(folder, name, "the files are numbered without a gap")
    return found


def _shortened_files(metadata: BagDescription | None, files: _FilesRead) -> Iterator[str]:
    """Yield which files hold less than ``metadata`` or a later file says, torn or not."""
    stated = [(METADATA_FILE, metadata.files)] if metadata is not None else []
    short: set[Path] = set()
    for source, entries in (*stated, *files.entries.items()):
        for entry in entries:
            verdict = files.find(entry)
            if verdict is None or verdict.path in short:
                continue
            if verdict.messages + verdict.lost < (entry.messages or 0):
                short.add(verdict.path)
                yield (
                    f"{verdict.path.name} holds {verdict.messages} of the {entry.messages} "
                    f"messages that {source} lists: it was cut off, replaced or shortened"
                )
    found = [] if metadata is None else [files.find(entry) for entry in metadata.files]
    held = sum(v.messages + v.lost for v in found if v is not None)
    if metadata is not None and not short and None not in found and held < metadata.messages:
        yield f"there are {held} of the {metadata.messages} messages that {METADATA_FILE} lists"


def _differences(metadata: BagDescription, files: _FilesRead, *, whole: bool) -> Iterator[str]:
    """Yield where metadata.yaml is wrong about files that are complete."""
    described = {id(v) for entry in metadata.files if (v := files.find(entry)) is not None}
    if whole:
        for verdict in files.verdicts:
            if id(verdict) not in described:
                yield f"{METADATA_FILE} does not list {verdict.path.name}"
    for entry in metadata.files:
        found = files.find(entry)
        if found is None:
            continue
        yield from _another_name(entry, found)
        if not found.whole or entry.messages is None:
            continue
        if found.messages > entry.messages:
            yield (
                f"{METADATA_FILE} lists {entry.messages} messages in {found.path.name}, it "
                f"holds {found.messages}"
            )
    if whole and all(v.whole and id(v) in described for v in files.verdicts):
        yield from _totals(metadata, files.verdicts)


def _another_name(entry: FileEntry, found: FileVerdict) -> Iterator[str]:
    """Yield files that have another name than listed, or the content of another file."""
    name = found.path.name
    if name not in (entry.name, entry.name.removesuffix(COMPRESSED)):
        yield (
            f"{METADATA_FILE} lists {entry.name}, which is called {name} here: other programs do "
            "not find it; rename it back, or rebuild the list (rotcal bag reindex)"
        )
    elif entry.messages and found.whole and None not in (found.start_ns, entry.start_ns):
        apart_ns = (found.start_ns or 0) - (entry.start_ns or 0)
        if abs(apart_ns) > _TOLERANCE_NS:
            yield (
                f"{name} begins {apart_ns / 1e9:+.3f} s from what {METADATA_FILE} lists of it: "
                "it is another file, or files have exchanged their names"
            )


def _totals(metadata: BagDescription, verdicts: Sequence[FileVerdict]) -> Iterator[str]:
    """Yield where counts by topic, begin or duration of the whole bag differ."""
    counted = Counter[str]()
    for verdict in verdicts:
        counted.update({name: topic.messages for name, topic in verdict.topics.items()})
    for topic in sorted(metadata.topics.keys() | +counted):
        if metadata.topics.get(topic, 0) != counted[topic]:
            yield (
                f"{METADATA_FILE} lists {metadata.topics.get(topic, 0)} messages of {topic}, "
                f"there are {counted[topic]}"
            )
    starts = [v.start_ns for v in verdicts if v.start_ns is not None]
    ends = [v.end_ns for v in verdicts if v.end_ns is not None]
    if starts and abs(min(starts) - metadata.start_ns) > _TOLERANCE_NS:
        yield (
            f"{METADATA_FILE} lets the bag begin at {metadata.start_ns} ns, its first message is "
            f"of {min(starts)} ns"
        )
    if starts and abs(max(ends) - min(starts) - metadata.duration_ns) > _TOLERANCE_NS:
        yield (
            f"{METADATA_FILE} lists {metadata.duration_ns / 1e9:.3f} s, the messages span "
            f"{(max(ends) - min(starts)) / 1e9:.3f} s"
        )


def _interruptions(verdicts: Sequence[FileVerdict]) -> Iterator[str]:
    for verdict in verdicts:
        note = verdict.notes.get(names.CONTINUED, {})
        if "interrupted_at_byte" in note:
            yield (
                f"{verdict.path.name} was interrupted at byte {note['interrupted_at_byte']} and "
                f"closed on {note.get('closed', 'an unknown day')}"
            )


Notes = Mapping[str, Mapping[str, str]]
_DATE: Final = "date"
_MISSING: Final = "missing"
_EARLIER: Final = "earlier"
_LOST: Final = " lost"
_DETAILS: Final = (" sha256", _LOST, " damages")
"""Endings of the keys about a file, after its name."""


def repair_record(before: Sequence[FileVerdict], missing: Sequence[str]) -> dict[str, str]:
    """Return the metadata record for the bag that is made from the files ``before``.

    By file name it holds the verdict, followed by the hash, the messages known to be lost by topic
    and the bytes at which the file is damaged; ``missing`` are sentences about files that were not
    there. A record of an earlier repair is kept inside.
    """
    record = {_DATE: f"{datetime.now(timezone.utc):%Y-%m-%dT%H:%M:%SZ}"}
    for verdict in before:
        hashed, lost, damages = (f"{verdict.path.name}{what}" for what in _DETAILS)
        record[verdict.path.name] = verdict.describe()
        record[hashed] = sha256_of(verdict.path)
        record[lost] = json.dumps({n: t.lost for n, t in verdict.topics.items() if t.lost})
        record[damages] = json.dumps([[d.offset, d.what] for d in verdict.damages])
        if earlier := verdict.notes.get(names.REPAIR):
            record[_EARLIER] = json.dumps(dict(earlier))
    uncounted = [
        f"{v.path.name}: {v.describe()}"
        for v in before
        if v.shows_loss and not v.lost and not any(v.path.name in text for text in missing)
    ]
    if missing or uncounted:
        record[_MISSING] = json.dumps([*missing, *uncounted])
    return record


def repairs_in_words(notes: Notes) -> tuple[str, ...]:
    """Return a sentence for each damaged file that a repaired one was made from."""
    record = notes.get(names.REPAIR, {})
    date = record.get(_DATE, "")
    return tuple(
        f"repaired {f'on {date} ' if date else ''}from {name}: {sentence}"
        for name, sentence in record.items()
        if name not in (_DATE, _MISSING, _EARLIER)
        and not name.endswith(_DETAILS)
        and sentence != "complete"
    )


def missing_before_repair(notes: Notes) -> tuple[str, ...]:
    """Return what was already missing when a repaired file was made."""
    record = notes.get(names.REPAIR, {})
    try:
        sentences = [str(sentence) for sentence in json.loads(record.get(_MISSING, "[]"))]
        for name, text in record.items():
            if name.endswith(_LOST) and (lost := sum(json.loads(text).values())):
                file = name.removesuffix(_LOST)
                sentences.append(f"{file} had lost {lost} messages before it was repaired")
        return tuple(sentences)
    except (ValueError, TypeError, AttributeError, RecursionError):
        return ()
