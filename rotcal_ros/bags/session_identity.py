"""Finds the session of a file: its runs, splits and repaired copies are one measurement."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Final

import numpy as np

from rotcal_ros.bags import names
from rotcal_ros.bags.reader import bag_files, scan_file
from rotcal_ros.bags.rosbag2_metadata import recorded_files
from rotcal_ros.bags.settings import DEFAULT_LIMITS, ReadingLimits
from rotcal_ros.foundation.errors import BagError

_SHOWN: Final = 8
"""Characters of an identity that people are shown."""
_NAMED: Final = 10
"""Sessions that an error names."""


@dataclass(frozen=True, slots=True)
class FileHead:
    """What the beginning of a file says about its session.

    ``stated`` is the identity that the recorder gave, ``configuration`` the hash of the attached
    one, ``item`` what is measured: empty if the file does not say. ``first_ns`` is the log time
    of the first message, ``begins`` whether the file is the first one of its session.
    """

    path: Path
    stated: str
    configuration: str
    item: str
    run: str
    first_ns: int | None
    begins: bool

    @property
    def session(self) -> str:
        """The stated identity, else one that follows from the content, so that copies share it."""
        if self.stated:
            return self.stated
        return sha256(f"{self.configuration} {self.item} {self.first_ns}".encode()).hexdigest()

    @property
    def is_anonymous(self) -> bool:
        """Whether nothing identifies the session: another recorder, or no message in the file."""
        known = self.first_ns is not None and (self.configuration or self.item)
        return not (self.stated or known)

    def describe(self) -> str:
        """Return in words what distinguishes the session from others."""
        begun = "" if self.first_ns is None else str(np.datetime64(self.first_ns // 10**9, "s"))
        known = (
            self.item,
            f"configuration {self.configuration[:_SHOWN]}" if self.configuration else "",
            f"begun {begun} UTC" if begun else "",
        )
        return f"session {self.session[:_SHOWN]}: {', '.join(filter(None, known))}"


def file_head(path: Path, limits: ReadingLimits = DEFAULT_LIMITS) -> FileHead:
    """Read ``path`` up to its first messages; raises BagError when it cannot be read at all."""
    scan = scan_file(path, limits)
    first = next(iter(scan.blocks()), None)
    run = scan.metadata.get(names.RUN, {})
    attached = scan.attachments.get(names.CONFIGURATION)
    listed = recorded_files(scan.metadata)
    return FileHead(
        path,
        run.get("session", ""),
        sha256(attached.data).hexdigest() if attached else "",
        scan.metadata.get(names.SUBJECT, {}).get("item", ""),
        run.get("number", ""),
        None if first is None or not len(first) else int(first.headers["log_time"][0]),
        len(listed) == 1,
    )


def session_of(path: Path) -> str:
    """Return the identity of the session of a bag, a folder or one file of it.

    It is the same for all files of a session and for a repaired copy. A bag without a stated
    identity has one that follows from the configuration and the first message: then only the first
    file or the folder gives that of the session. Raises BagError when there is no bag.
    """
    return file_head(bag_files(path)[0]).session


def sessions_in(
    files: Iterable[Path], limits: ReadingLimits = DEFAULT_LIMITS
) -> dict[str, tuple[FileHead, ...]]:
    """Return the files by the session that they belong to, in their order.

    Files that say nothing about their session belong to the session beside them.
    """
    heads = [file_head(file, limits) for file in files]
    unnamed: dict[tuple[str, str], str] = {}
    found: dict[str, list[FileHead]] = {}
    waiting: list[FileHead] = []
    name = ""
    for head in heads:
        if head.is_anonymous and not name:
            waiting.append(head)
            continue
        if not head.is_anonymous:
            name = _identity(head, unnamed)
        found.setdefault(name, []).extend((*waiting, head))
        waiting.clear()
    if waiting:
        found[waiting[0].session] = waiting
    return {name: tuple(members) for name, members in found.items()}


def _identity(head: FileHead, unnamed: dict[tuple[str, str], str]) -> str:
    """Return the identity; ``unnamed`` holds that of the first file for the later ones."""
    key = (head.configuration, head.item)
    if head.stated:
        return head.stated
    if head.begins or key not in unnamed:
        unnamed[key] = head.session
    return unnamed[key]


def require_one_session(files: Sequence[Path], limits: ReadingLimits = DEFAULT_LIMITS) -> None:
    """Raise BagError unless all files belong to one session and none is a copy of another."""
    if len(files) < 2:
        return
    found = sessions_in(files, limits)
    if len(found) > 1:
        groups = "; ".join(
            f"{', '.join(head.path.name for head in heads)} ({heads[0].describe()})"
            for heads in list(found.values())[:_NAMED]
        )
        groups += "; ..." * (len(found) > _NAMED)
        raise BagError(
            f"{files[0].parent} holds files of {len(found)} measurements: {groups}; put each into "
            f"a folder of its own, or name the file itself, such as {files[0]}"
        )
    (heads,) = found.values()
    by_start: dict[tuple[str, int], FileHead] = {}
    for head in heads:
        if head.first_ns is None or head.is_anonymous:
            continue
        twin = by_start.setdefault((head.run, head.first_ns), head)
        if twin is not head:
            raise BagError(
                f"{head.path} begins with the same message as {twin.path.name}: one is a copy of "
                f"the other, perhaps repaired; name the one to be read, such as {head.path}"
            )
