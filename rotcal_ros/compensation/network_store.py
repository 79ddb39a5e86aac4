"""A controller behind a network: tables go over a link, records are kept on this machine."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, Final, Protocol

from rotcal_ros.compensation.bridge_settings import BridgeSettings
from rotcal_ros.compensation.controller import Controller
from rotcal_ros.compensation.controller_folder import ControllerFolder
from rotcal_ros.compensation.controller_store import ControllerStore, answered
from rotcal_ros.compensation.writing import PROVENANCE
from rotcal_ros.foundation.errors import ConfigurationError

GRACE_S: Final = 2.0
"""s, for a link to end what its own time limit has cut off."""


class TableLink(Protocol):
    """A way to a controller; it stops what takes longer than the time that it was given."""

    address: str

    def read(self, names: list[str]) -> dict[str, str]:
        """Return those of the tables that exist; ControllerError when that is not known."""

    def write(self, tables: Mapping[str, str | None]) -> None:
        """Replace the tables, None takes one away; ControllerError when not all is done."""


class NetworkStore:
    """The store of a controller behind ``link``; ``books`` holds the lock and the provenance."""

    def __init__(self, books: ControllerFolder, link: TableLink, timeout_s: float) -> None:
        self._books, self._link = books, link
        self._timeout_s = timeout_s + GRACE_S

    def lock(self) -> None:
        """Take the sole right on this machine to feed this controller."""
        self._books.lock()

    def close(self) -> None:
        """Let others feed the controller."""
        self._books.close()

    def busy(self) -> str:
        """Return nothing: the link cannot tell what the machine is doing."""
        return ""

    def address(self, name: str) -> str:
        """Return where people find the file."""
        return self._books.address(name) if _is_side(name) else f"{self._link.address}/{name}"

    def read(self, names: Iterable[str]) -> dict[str, str]:
        """Return those of the files that exist."""
        wanted = list(names)
        tables = [name for name in wanted if not _is_side(name)]
        found = answered(
            lambda: self._link.read(tables), self._timeout_s, self._link.address, "read"
        )
        return found | self._books.read(filter(_is_side, wanted))

    def write(self, files: Mapping[str, str | None]) -> None:
        """Replace the files, tables first: the provenance never describes what is not there."""
        tables = {name: text for name, text in files.items() if not _is_side(name)}
        answered(lambda: self._link.write(tables), self._timeout_s, self._link.address, "write")
        self._books.write({name: text for name, text in files.items() if _is_side(name)})


def make_store(settings: BridgeSettings, controller: Controller) -> ControllerStore:
    """Return the store that ``settings.transport`` names.

    Raises ConfigurationError, with the extra to install, when its client is missing, and for a
    controller whose tables it cannot carry.
    """
    folder, timeout_s = Path(settings.controller_folder), settings.answer_timeout_s
    if settings.transport == "folder":
        return ControllerFolder(folder, timeout_s)
    if settings.transport == "opcua":
        link = _client("opcua").OpcUaLink(settings.opcua, timeout_s)
    else:
        link = _client("ads").AdsLink(settings.ads, timeout_s, controller)
    return NetworkStore(ControllerFolder(folder, timeout_s, link.address), link, timeout_s)


def _client(transport: str) -> Any:
    """Return the module of a link; what it needs is installed as an extra."""
    try:
        return import_module(f"rotcal_ros.compensation.{transport}_link")
    except ModuleNotFoundError as error:
        package = str(error.name).partition(".")[0]
        raise ConfigurationError(
            f"bridge.transport {transport} needs the package {package}: "
            f"pip install 'rotcal_ros[{transport}]'"
        ) from error


def _is_side(name: str) -> bool:
    return name.endswith(PROVENANCE)
