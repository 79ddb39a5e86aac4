"""Where a controller keeps its table, as the feed sees it: a few files that have names."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from typing import Final, Protocol, TypeVar

from rotcal_ros.foundation.errors import ControllerError

T = TypeVar("T")

ENCODING: Final = "latin-1"
"""Decodes every byte, so that a foreign file is kept and put back as it was."""


class ControllerStore(Protocol):
    """The files of one controller. Every method raises ControllerError when it cannot be done."""

    def lock(self) -> None:
        """Take the sole right to feed this controller, until :meth:`close` or the process ends."""

    def close(self) -> None:
        """Let others feed the controller."""

    def busy(self) -> str:
        """Return what the machine is doing; empty when it rests or cannot be asked."""

    def read(self, names: Iterable[str]) -> dict[str, str]:
        """Return those of the files that exist."""

    def write(self, files: Mapping[str, str | None]) -> None:
        """Replace the files, each of them whole; None takes a file away."""

    def address(self, name: str) -> str:
        """Return where people find the file."""


def answered(action: Callable[[], T], timeout_s: float, place: str, what: str) -> T:
    """Return what ``action`` returns; ControllerError when it fails or takes too long.

    A call into a folder or a library on a network may block for ever: it gets a thread of its own.
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
            f"the controller in {place} does not answer: no {what} within {timeout_s:g} s"
        ) from error
    except OSError as error:
        raise ControllerError(
            f"the controller in {place} does not answer: cannot {what}: {error.strerror or error}"
        ) from error
