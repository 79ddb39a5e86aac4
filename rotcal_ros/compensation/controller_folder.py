"""The place where a controller keeps its table: a folder, often on another machine.

A folder on a network may stop answering at any moment, and a call into it then blocks for
ever. Every access therefore happens in a thread of its own, for a limited time.
"""

from __future__ import annotations

import fcntl
import os
import socket
import threading
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from pathlib import Path
from typing import Final, TypeVar

from rotcal_ros.compensation.writing import check_file_name
from rotcal_ros.errors import ControllerError
from rotcal_ros.files import sync_folder, write_atomically

T = TypeVar("T")

STATE_FOLDER: Final = ".rotcal"
"""Below the controller's folder: lock, journal, and the tables that were there before."""
ENCODING: Final = "latin-1"
"""Takes every byte, so that a foreign file is kept and put back as it was."""


class ControllerFolder:
    """The folder of one controller; ``timeout_s`` limits every access.

    Every method raises ControllerError when the folder does not answer.
    """

    def __init__(self, folder: Path, timeout_s: float) -> None:
        self.folder = folder
        self._timeout_s = timeout_s
        self._lock: int | None = None

    def lock(self) -> None:
        """Become the only one who feeds this controller, until :meth:`close` or the end."""
        if self._lock is None:
            self._lock = self._answered(self._take_lock, "lock")

    def close(self) -> None:
        """Let others feed the controller."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def read(self, names: Iterable[str]) -> dict[str, str]:
        """Return those of the files that there are."""
        wanted = [check_file_name(name) for name in names]
        return self._answered(lambda: self._read(wanted), "read")

    def write(self, files: Mapping[str, str | None]) -> None:
        """Replace the files, each of them whole; None takes a file away."""
        for name in files:
            check_file_name(name)
        self._answered(lambda: self._write(files), "write")

    def _take_lock(self) -> int:
        state = self.folder / STATE_FOLDER
        state.mkdir(exist_ok=True)
        descriptor = os.open(state / "lock", os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = os.read(descriptor, 200).decode(errors="replace").strip() or "somebody"
            os.close(descriptor)
            raise ControllerError(
                f"the controller in {self.folder} is fed by {owner} already: one controller has "
                "one bridge; end the other one"
            ) from None
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
        return descriptor

    def _read(self, names: list[str]) -> dict[str, str]:
        self.folder.stat()  # a folder that is gone is not an empty one
        paths = {name: self.folder / name for name in names}
        return {n: p.read_bytes().decode(ENCODING) for n, p in paths.items() if p.exists()}

    def _write(self, files: Mapping[str, str | None]) -> None:
        for name, text in files.items():
            path = self.folder / name
            if text is None:
                path.unlink(missing_ok=True)
            else:
                write_atomically(path, text, ENCODING)
        sync_folder(self.folder)

    def _answered(self, action: Callable[[], T], what: str) -> T:
        """Return what ``action`` returns; ControllerError when it fails or takes too long."""
        answer: Future[T] = Future()

        def run() -> None:
            try:
                answer.set_result(action())
            except BaseException as error:
                answer.set_exception(error)

        # A daemon: a call that never returns must not keep the process from ending.
        threading.Thread(target=run, name="controller", daemon=True).start()
        try:
            return answer.result(self._timeout_s)
        except FutureTimeout as error:
            raise ControllerError(
                f"the controller in {self.folder} does not answer: no {what} within "
                f"{self._timeout_s:g} s"
            ) from error
        except OSError as error:
            raise ControllerError(
                f"the controller in {self.folder} does not answer: cannot {what}: "
                f"{error.strerror or error}"
            ) from error
