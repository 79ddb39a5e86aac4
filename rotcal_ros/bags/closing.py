"""Closing a file whose recorder died: what is missing is appended, no whole record changes.

The bytes of a torn last record, which no reader can use, stay in the file as an attachment: the
file as the interruption left it is its first ``interrupted_at_byte`` bytes and that attachment.
While a file is being closed a journal stands beside it; whoever dies meanwhile leaves what the
next one needs to do it again.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Final

from mcap.records import Metadata

from rotcal_ros.bags import names
from rotcal_ros.bags.mcap_file import LIBRARY
from rotcal_ros.bags.mcap_tail import Contents
from rotcal_ros.bags.reader import bag_files, file_info, read_blocks
from rotcal_ros.bags.rosbag2_metadata import FileInfo
from rotcal_ros.bags.session_identity import file_head
from rotcal_ros.bags.verdict import FileVerdict
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.errors import BagError
from rotcal_ros.files import (
    remove_durably,
    replace_atomically,
    replace_tail,
    sync_file,
    write_durably,
)

JOURNAL_SUFFIX: Final = ".closing"


@dataclass(frozen=True)
class InterruptedSession:
    """What an interrupted session left: its ``files`` for the writer that continues it.

    ``session`` is its identity, empty where nothing says one. Nothing is changed before
    :meth:`close`.
    """

    files: tuple[FileInfo, ...] = ()
    session: str = ""
    open_ends: tuple[OpenEnd, ...] = ()

    @classmethod
    def read(cls, folder: Path) -> InterruptedSession:
        """Read the bag in ``folder``; raises BagError when there is none."""
        files = bag_files(folder)
        heads = (file_head(file) for file in files)
        session = next((head.session for head in heads if not head.silent), "")
        scans = [scan for scan, block in read_blocks(files) if block is None]
        ends = tuple(end for scan in scans if (end := open_end(scan.verdict())) is not None)
        return cls(tuple(map(file_info, scans)), session, ends)

    def close_before(self, writer: BagWriter) -> None:
        """:meth:`close` for a writer that continues the session and watches its files."""
        self.close(writer.path.name)
        writer.expect_earlier()

    def close(self, continued_in: str = "") -> None:
        """Close the files that the interruption left open; call it with the right to write.

        More than one is left when the recorder died while it went on in a new file.
        Raises BagError when that fails: nothing is lost, and the next call does it again.
        """
        row = [file.name for file in self.files]
        following = dict(zip(row, [*row[1:], continued_in], strict=True))
        try:
            for end in self.open_ends:
                end.close(following[end.path.name])
        except OSError as error:
            raise BagError(
                f"cannot close {end.path}, which an interruption left open: "
                f"{error.strerror or error}; make room and the file writable, then go on"
            ) from error


@dataclass(frozen=True)
class OpenEnd:
    """An interrupted file: ``torn`` stands behind the ``contents`` of its whole records."""

    path: Path
    size: int
    torn: bytes
    contents: Contents

    @property
    def end(self) -> int:
        """The byte at which the whole records end."""
        return self.contents.end

    def close(self, continued_in: str = "") -> None:
        """Append what is missing; the session goes on in the file ``continued_in``, if at all.

        Raises OSError when the disk fails; the next call on the same file does it again.
        """
        if self.path.stat().st_size != self.size:
            raise BagError(f"{self.path} has changed since it was read; nothing was done to it")
        journal = _journal(self.path)
        sync_file(self.path)  # the journal must not outlive bytes that it counts on
        if not journal.exists():
            head = json.dumps({"end": self.end}).encode() + b"\n"
            replace_atomically(journal, lambda path: write_durably(path, head + self.torn))
        tail = self.contents.tail(self._record(continued_in), self.torn, LIBRARY)
        replace_tail(self.path, self.end, tail)
        remove_durably(journal)

    def _record(self, continued_in: str) -> Metadata:
        return Metadata(
            name=names.CONTINUED,
            metadata={
                **({"in": continued_in} if continued_in else {}),
                "interrupted_at_byte": str(self.end),
                "torn_bytes": str(len(self.torn)),
                "closed": f"{datetime.now(timezone.utc):%Y-%m-%dT%H:%M:%SZ}",
            },
        )


def open_end(verdict: FileVerdict) -> OpenEnd | None:
    """Return how an interrupted file is closed; None when it is closed, or damaged.

    A damaged file is left as it is, and so is one that no recorder of ours wrote.
    """
    path = verdict.path
    journal = _journal(path)
    if verdict.state != "truncated":
        if verdict.state == "complete":
            remove_durably(journal)
        return None
    begun = _begun(journal)
    with path.open("rb") as file:
        contents = Contents.of(file, begun[0] if begun else verdict.damages[0].offset)
        file.seek(contents.end)
        torn = begun[1] if begun else file.read()
    return OpenEnd(path, path.stat().st_size, torn, contents) if contents.plain else None


def _journal(path: Path) -> Path:
    return path.with_name(path.name + JOURNAL_SUFFIX)


def _begun(journal: Path) -> tuple[int, bytes] | None:
    """Return where the data end and what stood there, from a closing that was interrupted."""
    if not journal.is_file():
        return None
    head, _, torn = journal.read_bytes().partition(b"\n")
    return int(json.loads(head)["end"]), torn
