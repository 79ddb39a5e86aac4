"""What was done to a controller: one line per event, and the tables that were there before."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final, Literal

from rotcal_ros.compensation.writing import write_files
from rotcal_ros.errors import ControllerError

Action = Literal["applying", "applied", "rolled_back", "restored"]
FILE: Final = "journal.jsonl"
CONTENTS: Final = "contents.json"


@dataclass(frozen=True)
class Entry:
    """One event at ``time_ns``; ``backup`` names the folder with what was there before."""

    action: Action
    time_ns: int
    table_hash: str
    backup: str


class Journal:
    """The journal of one controller in ``folder``, complete on disk after every event."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def entries(self) -> list[Entry]:
        """Return all events; a last line that was cut off by a crash never happened."""
        path = self.folder / FILE
        if not path.exists():
            return []
        *lines, _ = path.read_text(encoding="utf-8").split("\n")
        try:
            return [Entry(**json.loads(line)) for line in lines]
        except (ValueError, TypeError) as error:
            raise ControllerError(
                f"{path} is damaged: {error}; what was applied last is not known, move the file "
                "away after looking at the controller"
            ) from error

    def note(self, entry: Entry) -> None:
        """Append an event; ControllerError when that is not possible."""
        try:
            self._append(json.dumps(asdict(entry)).encode() + b"\n")
        except OSError as error:
            raise ControllerError(
                f"cannot note '{entry.action}' in {self.folder / FILE}: {error.strerror}"
            ) from error

    def _append(self, line: bytes) -> None:
        with (self.folder / FILE).open("ab+") as stream:
            stream.seek(0)
            stream.truncate(stream.read().rfind(b"\n") + 1)  # a line that a crash cut off
            stream.write(line)
            stream.flush()
            os.fsync(stream.fileno())

    def keep(self, files: Mapping[str, str | None], time_ns: int) -> str:
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
            files: dict[str, str | None] = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise ControllerError(f"the old table in {path} cannot be read: {error}") from error
        return files

    def to_undo(self) -> Entry | None:
        """Return the last application that was not undone, also one that a crash cut off."""
        stack: list[Entry] = []
        for entry in self.entries():
            if entry.action == "applying":
                stack.append(entry)
            elif entry.action in ("rolled_back", "restored") and stack:
                stack.pop()
        return stack[-1] if stack else None

    def last_restore_ns(self) -> int:
        """Return when a table was taken back last, 0 if never."""
        return max((e.time_ns for e in self.entries() if e.action == "restored"), default=0)
