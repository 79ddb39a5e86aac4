"""Where a controller keeps its table: a few named files, accessed through one protocol.

The files are in a folder, often on another machine, or behind a link to the controller, whose
records (lock, journal, old tables) are then in a folder of this machine. Either may stop answering
at any moment, and a call then blocks forever: every access happens in a thread of its own, for a
limited time.
"""

from __future__ import annotations

import fcntl
import os
import socket
import stat
import threading
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, Protocol, TypeVar

from rotcal_ros.compensation import journal
from rotcal_ros.compensation.bridge_settings import FOLDER, BridgeSettings
from rotcal_ros.compensation.controller import Controller
from rotcal_ros.compensation.writing import check_file_name
from rotcal_ros.foundation import plugins
from rotcal_ros.foundation.errors import ControllerError
from rotcal_ros.foundation.files import make_folder, sync_folder, write_atomically
from rotcal_ros.foundation.untrusted import cause_of, read_bytes, read_text

T = TypeVar("T")

ENCODING: Final = "latin-1"
"""An encoding for any byte, so that a foreign file is kept and put back as it was."""


class ControllerStore(Protocol):
    """The files of one controller. Every method raises ControllerError if it fails."""

    def lock(self) -> None:
        """Take the sole right to feed this controller, until :meth:`close` or the process ends."""

    def close(self) -> None:
        """Let others feed the controller."""

    def busy(self) -> str | None:
        """Return what the machine is doing; None if it rests or cannot be asked."""

    def read(self, names: Iterable[str]) -> dict[str, str]:
        """Return those of the files that exist."""

    def write(self, files: Mapping[str, str | None]) -> None:
        """Replace the files, each as a whole; None removes a file."""

    def address(self, name: str) -> str:
        """Return the path or address of a file, for people."""


StoreMaker = Callable[[Any, Path, float, Controller], ControllerStore]
"""Makes a store from the settings of its transport, the folder of the records, the time (s) that
an access may take, and the controller."""


def call_with_timeout(action: Callable[[], T], timeout_s: float, place: str, what: str) -> T:
    """Return what ``action`` returns; ControllerError when it fails or takes too long.

    A call into a folder or a library on a network may block forever: it gets a thread of its own.
    """
    answer: Future[T] = Future()

    def run() -> None:
        try:
            answer.set_result(action())
        except BaseException as error:
            answer.set_exception(error)

    # A daemon: a call that never returns must not keep the process from ending.
    threading.Thread(target=run, name="controller", daemon=True).start()
    try:
        return answer.result(timeout_s)
    except FutureTimeout as error:
        raise ControllerError(
            f"the controller in {place} does not answer: no {what} within {timeout_s:g} s; "
            "make sure that it runs and its drive is mounted, or raise bridge.answer_timeout_s"
        ) from error
    except OSError as error:
        raise ControllerError(
            f"the controller in {place} does not answer: cannot {what}: {cause_of(error)}"
        ) from error


STATE_FOLDER: Final = ".rotcal"
"""Folder below the controller's: lock, journal, and earlier tables."""
LOCK: Final = "lock"
OWNER: Final = "controller"
"""File in the state folder with the address of the controller that the journal is about."""


class ControllerFolder:
    """The folder of one controller; ``timeout_s`` limits every access.

    ``owner`` is the address of a controller elsewhere, for which this folder only keeps the
    records: lock, journal, old tables, provenance. Every method raises ControllerError when the
    folder does not answer.
    """

    def __init__(self, folder: Path, timeout_s: float, owner: str = "") -> None:
        self.folder = folder
        self._timeout_s = timeout_s
        self._owner = owner
        self._lock: int | None = None

    def lock(self) -> None:
        """Take the sole right to feed this controller, until :meth:`close` or the process ends.

        A lock whose folder was moved away in the meantime locks nothing: it is taken again.
        """
        if self._lock is not None and self._answered(self._lost_lock, "lock"):
            self.close()
        if self._lock is None:
            self._lock = self._answered(self._take_lock, "lock")

    def busy(self) -> None:
        """Return None: a folder does not show what the machine is doing."""

    def close(self) -> None:
        """Let others feed the controller."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def read(self, names: Iterable[str]) -> dict[str, str]:
        """Return those of the files that exist."""
        wanted = [check_file_name(name) for name in names]
        return self._answered(lambda: self._read(wanted), "read")

    def write(self, files: Mapping[str, str | None]) -> None:
        """Replace the files, each as a whole; None removes a file."""
        for name in files:
            check_file_name(name)
        self._answered(lambda: self._write(files), "write")

    def address(self, name: str) -> str:
        """Return the path of a file."""
        return str(self.folder / name)

    def _lost_lock(self) -> bool:
        assert self._lock is not None
        try:
            there = (self.folder / STATE_FOLDER / LOCK).lstat()
        except FileNotFoundError:
            return True
        return not os.path.samestat(there, os.fstat(self._lock))

    def _take_lock(self) -> int:
        state = self.folder / STATE_FOLDER
        if not state.exists():
            self._make(state)
        if state.is_symlink():
            raise ControllerError(f"{state} is a link: expected a folder of its own")
        descriptor = os.open(state / LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = os.read(descriptor, 200).decode(errors="replace").strip() or "another process"
            os.close(descriptor)
            raise ControllerError(
                f"the controller in {self.folder} is already fed by {owner}: one controller has "
                "one bridge; end the other one"
            ) from None
        try:
            self._own(state)
        except BaseException:
            os.close(descriptor)
            raise
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
        return descriptor

    def _make(self, state: Path) -> None:
        if not self._owner:
            self.folder.stat()  # a folder that is gone is not created again
        with suppress(FileExistsError):
            make_folder(state)

    def _own(self, state: Path) -> None:
        """Refuse a journal of another controller: its old tables would go to the wrong machine."""
        path = state / OWNER
        noted = read_text(path) if path.exists() else ""
        if noted == self._owner:
            return
        if noted or (state / journal.FILE).exists():
            raise ControllerError(
                f"the journal in {state} is that of {noted or 'this folder itself'}, not of "
                f"{self._owner or 'this folder itself'}: give every controller a folder of its own"
            )
        write_atomically(path, self._owner)

    def _read(self, names: list[str]) -> dict[str, str]:
        self.folder.stat()  # a folder that is gone is not an empty one
        paths = {name: self.folder / name for name in names}
        return {n: read_bytes(p).decode(ENCODING) for n, p in paths.items() if _is_file(p)}

    def _write(self, files: Mapping[str, str | None]) -> None:
        for name in files:
            _is_file(self.folder / name)
        for name, text in files.items():
            path = self.folder / name
            if text is None:
                path.unlink(missing_ok=True)
            else:
                write_atomically(path, text, ENCODING)
        sync_folder(self.folder)

    def _answered(self, action: Callable[[], T], what: str) -> T:
        return call_with_timeout(action, self._timeout_s, str(self.folder), what)


def _is_file(path: Path) -> bool:
    """Return whether there is a plain file; ControllerError for what replacing destroys.

    A link must remain a link: a file in its place would cut the controller off from its target.
    """
    try:
        status = path.lstat()
    except FileNotFoundError:
        return False
    if not stat.S_ISREG(status.st_mode):
        kind = "a link" if stat.S_ISLNK(status.st_mode) else "not a plain file"
        raise ControllerError(
            f"{path} is {kind}: set controller_folder to the folder that holds the table itself; "
            "nothing was changed"
        )
    if status.st_nlink > 1:
        raise ControllerError(
            f"{path} has {status.st_nlink} names (hard links), of which only this one would get "
            "the new table: leave it one name; nothing was changed"
        )
    return True


def make_store(settings: BridgeSettings, controller: Controller) -> ControllerStore:
    """Return the store that ``settings.transport`` names.

    Raises ConfigurationError, with the extra to install, when its client is missing, and for a
    controller whose tables it cannot carry.
    """
    folder, timeout_s = Path(settings.controller_folder), settings.answer_timeout_s
    name = settings.transport
    if name == FOLDER:
        return ControllerFolder(folder, timeout_s)
    make: StoreMaker = plugins.extension(plugins.STORES, name, f"bridge.transport {name}")
    return make(getattr(settings, name), folder, timeout_s, controller)
