"""The verdict on a whole session: which files are missing, where ``metadata.yaml`` is wrong."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from rotcal_ros.bags import names
from rotcal_ros.bags.file_compression import PACKED
from rotcal_ros.bags.repair_record import missing_before_repair, repairs_in_words
from rotcal_ros.bags.rosbag2_reading import (
    METADATA_FILE,
    MISSING_KEY,
    BagDescription,
    FileEntry,
    read_description,
    recorded_files,
)
from rotcal_ros.bags.unread_data import note_unread
from rotcal_ros.bags.verdict import FileVerdict
from rotcal_ros.foundation.errors import BagError

_TOLERANCE_NS: Final = 1_000_000
_NAMED: Final = 100
"""Faults of a kind that are told one by one; nobody reads more, and anybody may list a million."""


@dataclass(frozen=True)
class SessionVerdict:
    """Sentences on what is not in order beyond the single files.

    ``missing`` tells of data that are not there: a result from the rest is suspect. ``differing``
    tells where metadata.yaml is wrong, ``repaired`` what was lost before the bag was repaired,
    ``closed`` which files were closed after an interruption, without a loss.
    """

    missing: tuple[str, ...] = ()
    differing: tuple[str, ...] = ()
    repaired: tuple[str, ...] = ()
    closed: tuple[str, ...] = ()

    @property
    def sound(self) -> bool:
        """Whether everything is there and metadata.yaml, if there is one, says so."""
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
        known = read_description(folder)
    except BagError as error:
        known = None
        wrong.append(f"{error}; rebuild it: rotcal bag reindex {folder}")
    present = _Present(verdicts)
    listed = () if known is None else tuple(f for f in known.files if present.find(f) is None)
    if known is not None and len(listed) == len(known.files) > 0:
        wrong.append(f"{METADATA_FILE} is about other files: {', '.join(known.names[:3])}")
        known, listed = None, ()
    if not path.is_dir():
        wrong.clear()  # one file was named, the folder may be anybody's
    missing = dict(_missing(folder, present, listed))
    if path.is_dir():
        missing = {**_gaps(folder, present, known), **missing}
    short: list[str] = []
    if known is not None:
        wrong += _differences(known, present, whole=path.is_dir() and not missing)
        short += _short(known, present)
        missing |= {text: text for text in (known.custom or {}).get(MISSING_KEY, "").splitlines()}
    before = (text for v in verdicts for text in missing_before_repair(v.notes))
    lacking = _few(dict.fromkeys((*missing.values(), *short, *before)))
    note_unread(lacking)
    return SessionVerdict(
        lacking,
        _few(wrong),
        tuple(text for v in verdicts for text in repairs_in_words(v.notes)),
        tuple(_closed(verdicts)),
    )


def _few(sentences: Iterable[str]) -> tuple[str, ...]:
    """Return the first ones, and how many more there are."""
    every = tuple(sentences)
    more = len(every) - _NAMED
    return every if more <= 0 else (*every[:_NAMED], f"and {more} more")


class _Present:
    """The files that were read, under their names and those that they were recorded with."""

    def __init__(self, verdicts: Sequence[FileVerdict]) -> None:
        self.verdicts = verdicts
        self.recorded = {v.path.name: recorded_files(v.notes) for v in verdicts}
        own = {files[-1]: v for v in verdicts if (files := self.recorded[v.path.name])}
        self.by_name = {**own, **{v.path.name: v for v in verdicts}}

    def find(self, entry: FileEntry) -> FileVerdict | None:
        """Return the file that ``entry`` describes, be it renamed or unpacked."""
        for name in (entry.name, entry.name.removesuffix(PACKED)):
            if name in self.by_name:
                return self.by_name[name]
        if not entry.messages:
            return None
        alike = (v for v in self.verdicts if v.start_ns == entry.start_ns)
        return next((v for v in alike if v.messages == entry.messages), None)


def _missing(
    folder: Path, present: _Present, listed: Sequence[FileEntry]
) -> Iterator[tuple[str, str]]:
    """Yield (name, sentence) of every file that belongs to the session and was not read."""
    stated: dict[str, str] = {}
    for verdict in present.verdicts:
        for name in present.recorded[verdict.path.name]:
            stated.setdefault(name, f"it was there when {verdict.path.name} was recorded")
        following = verdict.notes.get(names.CONTINUED, {}).get("in", "")
        if following:
            stated[following] = f"the session went on in it after {verdict.path.name}"
    for entry in listed:
        about = entry.in_words()
        stated[entry.name] = f"{METADATA_FILE} lists it{f' with {about}' if about else ''}"
    for name, why in stated.items():
        if name not in present.by_name:
            yield name, _sentence(folder, name, why)


def _sentence(folder: Path, name: str, why: str) -> str:
    if "/" in name or not _exists(folder / name):
        return f"the file {name} of the session is missing: {why}"
    return f"the file {name} of the session was not read, only a part of it was named: {why}"


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except OSError:  # its name is too long, or leads to where nobody may look
        return False


def _gaps(folder: Path, present: _Present, known: BagDescription | None) -> dict[str, str]:
    """Return the files that are missing in the row of numbers of a recorder's files.

    Other recorders may delete their oldest files: for theirs ``known`` says it, if it is there.
    """
    renamed = {f.name for f in known.files if present.find(f) is not None} if known else set()
    found: dict[str, str] = {}
    pattern = re.compile(r"(.+)_(\d{1,6})(\.\w+(?:\.zstd)?)$")
    matches = [m for v in present.verdicts if (m := pattern.match(v.path.name))]
    for stem, ending in {(m[1], m[3]) for m in matches}:
        mine = [m for m in matches if (m[1], m[3]) == (stem, ending)]
        ours = any(present.recorded[m[0]] for m in mine)
        if not ours and (stem != folder.name or known is not None):
            continue
        numbers = {int(m[2]) for m in mine}
        if ours and len(mine) == 1:
            continue  # a file may be renamed, and says itself which ones it follows
        for number in sorted(set(range(min(max(numbers), 10_000))) - numbers):
            name = f"{stem}_{number}{ending}"
            if name in renamed or name in present.by_name:
                continue
            found[name] = _sentence(folder, name, "the files are numbered without a gap")
    return found


def _short(known: BagDescription, present: _Present) -> Iterator[str]:
    """Yield which files hold less than was recorded, though nothing in them says so."""
    for entry in known.files:
        verdict = present.find(entry)
        if verdict is None or not verdict.whole or entry.messages is None:
            continue
        if verdict.messages < entry.messages:
            yield (
                f"{verdict.path.name} holds {verdict.messages} of the {entry.messages} messages "
                f"that {METADATA_FILE} lists: it was replaced or shortened"
            )


def _differences(known: BagDescription, present: _Present, *, whole: bool) -> Iterator[str]:
    """Yield where the description is wrong about files that are complete."""
    described = {id(v) for entry in known.files if (v := present.find(entry)) is not None}
    if whole:
        for verdict in present.verdicts:
            if id(verdict) not in described:
                yield f"{METADATA_FILE} does not list {verdict.path.name}"
    for entry in known.files:
        found = present.find(entry)
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
    if whole and all(v.whole and id(v) in described for v in present.verdicts):
        yield from _totals(known, present.verdicts)


def _another_name(entry: FileEntry, found: FileVerdict) -> Iterator[str]:
    """Yield that a file has another name than the one listed, or the content of another file."""
    name = found.path.name
    if name not in (entry.name, entry.name.removesuffix(PACKED)):
        yield (
            f"{METADATA_FILE} lists {entry.name}, which is called {name} here: others do not find "
            "it; give it its name again, or rebuild the list (rotcal bag reindex)"
        )
    elif entry.messages and found.whole and None not in (found.start_ns, entry.start_ns):
        apart_ns = (found.start_ns or 0) - (entry.start_ns or 0)
        if abs(apart_ns) > _TOLERANCE_NS:
            yield (
                f"{name} begins {apart_ns / 1e9:+.3f} s from what {METADATA_FILE} lists of it: "
                "it is another file, or files have exchanged their names"
            )


def _totals(known: BagDescription, verdicts: Sequence[FileVerdict]) -> Iterator[str]:
    """Yield where counts by topic, begin or duration of the whole bag differ."""
    counted = Counter[str]()
    for verdict in verdicts:
        counted.update({name: topic.messages for name, topic in verdict.topics.items()})
    for topic in sorted(known.topics.keys() | +counted):
        if known.topics.get(topic, 0) != counted[topic]:
            yield (
                f"{METADATA_FILE} lists {known.topics.get(topic, 0)} messages of {topic}, there "
                f"are {counted[topic]}"
            )
    starts = [v.start_ns for v in verdicts if v.start_ns is not None]
    ends = [v.end_ns for v in verdicts if v.end_ns is not None]
    if starts and abs(min(starts) - known.start_ns) > _TOLERANCE_NS:
        yield (
            f"{METADATA_FILE} lets the bag begin at {known.start_ns} ns, its first message is of "
            f"{min(starts)} ns"
        )
    if starts and abs(max(ends) - min(starts) - known.duration_ns) > _TOLERANCE_NS:
        yield (
            f"{METADATA_FILE} lists {known.duration_ns / 1e9:.3f} s, the messages span "
            f"{(max(ends) - min(starts)) / 1e9:.3f} s"
        )


def _closed(verdicts: Sequence[FileVerdict]) -> Iterator[str]:
    for verdict in verdicts:
        note = verdict.notes.get(names.CONTINUED, {})
        if "interrupted_at_byte" in note:
            yield (
                f"{verdict.path.name} was interrupted at byte {note['interrupted_at_byte']} and "
                f"closed on {note.get('closed', 'an unknown day')}"
            )
