"""The journal of a controller: one line per change, and the files that were replaced."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Literal

from rotcal_ros.compensation.writing import write_files
from rotcal_ros.foundation.errors import ControllerError
from rotcal_ros.foundation.files import append_line
from rotcal_ros.foundation.records import record
from rotcal_ros.foundation.untrusted import cause_of, load_json, read_text

Action = Literal["applying", "applied", "restoring", "restored", "rolled_back"]
BEGUN: Final = ("applying", "restoring")
FILE: Final = "journal.jsonl"
CONTENTS: Final = "contents.json"
Contents = Mapping[str, str | None]
"""Names of a controller's files and their texts; None: there is no such file."""


@dataclass(frozen=True)
class JournalEntry:
    """One event at ``time_ns``; ``backup`` names the folder with what was there before.

    ``before_hash`` and ``after_hash`` (:func:`contents_hash`) are the contents before the change
    and the intended ones after it; ``table_hash`` is empty for contents that are not known to be a
    table of rotcal. ``in_force`` is what the controller holds from then on, as
    :func:`in_force_of`; empty while that is open.
    """

    action: Action
    time_ns: int
    table_hash: str
    backup: str
    before_hash: str
    after_hash: str
    in_force: str = ""


def contents_hash(files: Contents) -> str:
    """Return the SHA-256 of names and texts, whatever their order."""
    return hashlib.sha256(json.dumps(dict(files), sort_keys=True).encode()).hexdigest()


def existing_files(files: Contents) -> dict[str, str]:
    """Return the files that exist."""
    return {name: text for name, text in files.items() if text is not None}


def _entry(data: Any) -> JournalEntry:
    entry = record(JournalEntry, data)
    if Path(entry.backup).name != entry.backup:
        raise ValueError(f"the backup {entry.backup!r} is not a folder beside the journal")
    return entry


def _contents(data: Any) -> dict[str, str | None]:
    if isinstance(data, dict) and all(isinstance(v, str | None) for v in data.values()):
        return data
    raise ValueError("expected the texts of files by their names")


class Journal:
    """The journal of one controller in ``folder``, complete on disk after every event."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def entries(self) -> list[JournalEntry]:
        """Return all events; a last line that a crash cut off does not count."""
        path = self.folder / FILE
        if not path.exists():
            return []
        try:
            *lines, _ = read_text(path).split("\n")
            return [_entry(load_json(line)) for line in lines]
        except (OSError, ValueError) as error:
            raise ControllerError(
                f"{path} is damaged: {cause_of(error)}; the last applied table is not known; look "
                "at the controller, then move the file away"
            ) from error

    def note(self, entry: JournalEntry) -> None:
        """Append an event; ControllerError when that is not possible."""
        try:
            append_line(self.folder / FILE, json.dumps(asdict(entry)).encode() + b"\n")
        except OSError as error:
            raise ControllerError(
                f"cannot note '{entry.action}' in {self.folder / FILE}: {error.strerror}; make "
                "room and the folder writable"
            ) from error

    def keep(self, files: Contents, time_ns: int) -> str:
        """Keep what the controller holds (None: no such file); return the folder's name."""
        name, number = f"before-{time_ns}", 0
        while (self.folder / name).exists():
            number += 1
            name = f"before-{time_ns}-{number}"
        write_files({CONTENTS: json.dumps(dict(files)) + "\n"}, self.folder / name)
        return name

    def kept(self, name: str) -> dict[str, str | None]:
        """Return what :meth:`keep` kept under ``name``."""
        path = self.folder / name / CONTENTS
        try:
            return _contents(load_json(read_text(path)))
        except (OSError, ValueError) as error:
            raise ControllerError(
                f"the old table in {path} cannot be read: {cause_of(error)}"
            ) from error

    def backup_before(self, entry: JournalEntry) -> dict[str, str | None]:
        """Return the contents from before ``entry``; ControllerError if changed since."""
        files = self.kept(entry.backup)
        if entry.before_hash != contents_hash(files):
            raise ControllerError(
                f"the old table in {self.folder / entry.backup} is not what was kept there: "
                "somebody changed it; look at it and copy it by hand if it is good"
            )
        return files

    def last_undoable(self) -> JournalEntry | None:
        """Return the last change that was not undone, even one that a crash cut off."""
        stack: list[JournalEntry] = []
        for entry in self.entries():
            if entry.action in BEGUN:
                stack.append(entry)
            elif entry.action == "rolled_back" and stack:
                stack.pop()
            elif entry.action == "restored" and stack:
                self._undo(stack, entry)
        return stack[-1] if stack else None

    def _undo(self, stack: list[JournalEntry], restored: JournalEntry) -> None:
        """Remove the changes that are undone; a restore of anything else is itself a change."""
        for index in range(len(stack) - 2, -1, -1):
            if stack[index].before_hash == restored.after_hash:
                del stack[index:]
                return

    def change_from(self, kept_hash: str) -> JournalEntry | None:
        """Return the last change before which the controller held the contents with this hash."""
        begun = (e for e in reversed(self.entries()) if e.action in BEGUN)
        return next((e for e in begun if e.before_hash == kept_hash), None)

    def unfinished(self) -> JournalEntry | None:
        """Return the change whose begin was noted, but not its end."""
        entries = self.entries()
        return entries[-1] if entries and entries[-1].action in BEGUN else None

    def names(self) -> tuple[str, ...]:
        """Return the names of the controller's files; empty before the first change."""
        entries = self.entries()
        return tuple(self.kept(entries[-1].backup)) if entries else ()

    def history(self) -> list[tuple[int, str]]:
        """Return which tables the controller has held, and since when (ns), as far as noted."""
        return [(e.time_ns, e.in_force) for e in self.entries() if e.in_force]

    def held_while(self, from_ns: int, until_ns: int) -> tuple[tuple[int, str], ...]:
        """Return the tables held between two times, and since when (ns), as far as noted."""
        history = self.history()
        before = [event for event in history if event[0] <= from_ns]
        return (*before[-1:], *(event for event in history if from_ns < event[0] <= until_ns))

    def table_of(self, held_hash: str) -> str | None:
        """Return the hash of the table that was applied as these contents, if one was."""
        done = (e for e in reversed(self.entries()) if e.action == "applied")
        return next((e.table_hash for e in done if e.after_hash == held_hash), None)

    def last_ns(self) -> int:
        """Return the time of the last event, 0 if there is none."""
        return max((e.time_ns for e in self.entries()), default=0)

    def last_restore_ns(self) -> int:
        """Return when a table was last taken back, 0 if never."""
        return max((e.time_ns for e in self.entries() if e.action == "restored"), default=0)
