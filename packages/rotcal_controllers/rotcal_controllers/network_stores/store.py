"""The store of a controller behind a link: tables go over it, all records stay on this machine."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final, Protocol

from rotcal_ros.compensation.controller_store import ControllerFolder, call_with_timeout
from rotcal_ros.compensation.writing import PROVENANCE

GRACE_S: Final = 2.0
"""s, for a link to clean up after its own time limit."""


class TableLink(Protocol):
    """A way to a controller; it ends what takes longer than its time limit."""

    address: str

    def read(self, names: list[str]) -> dict[str, str]:
        """Return the tables that exist; ControllerError if that is not known."""

    def write(self, tables: Mapping[str, str | None]) -> None:
        """Replace the tables, None removes one; ControllerError unless all is done."""


class NetworkStore:
    """The store of a controller behind ``link``; lock and provenance are in a local ``folder``."""

    def __init__(self, link: TableLink, folder: Path, timeout_s: float) -> None:
        self._link, self._records = link, ControllerFolder(folder, timeout_s, link.address)
        self._timeout_s = timeout_s + GRACE_S

    def lock(self) -> None:
        """Take the sole right on this machine to feed this controller."""
        self._records.lock()

    def close(self) -> None:
        """Let others feed the controller."""
        self._records.close()

    def busy(self) -> None:
        """Return None: the link does not show what the machine is doing."""

    def address(self, name: str) -> str:
        """Return the path or address of a file, for people."""
        return self._records.address(name) if _is_side(name) else f"{self._link.address}/{name}"

    def read(self, names: Iterable[str]) -> dict[str, str]:
        """Return those of the files that exist."""
        wanted = list(names)
        tables = [name for name in wanted if not _is_side(name)]
        found = call_with_timeout(
            lambda: self._link.read(tables), self._timeout_s, self._link.address, "read"
        )
        return found | self._records.read(filter(_is_side, wanted))

    def write(self, files: Mapping[str, str | None]) -> None:
        """Replace the files, tables first: so provenance never describes a missing table."""
        tables = {name: text for name, text in files.items() if not _is_side(name)}
        call_with_timeout(
            lambda: self._link.write(tables), self._timeout_s, self._link.address, "write"
        )
        self._records.write({name: text for name, text in files.items() if _is_side(name)})


def _is_side(name: str) -> bool:
    return name.endswith(PROVENANCE)
