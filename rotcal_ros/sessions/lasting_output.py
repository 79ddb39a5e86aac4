"""Keeps the output of a process that outlives its terminal: from then on it goes to a log file."""

from __future__ import annotations

import errno
import io
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Any, Final, TextIO

_STDIN: Final = 0
_OUTPUTS: Final = (1, 2)
_NOBODY_LISTENS: Final = (errno.EIO, errno.EPIPE)
_LOG_FLAGS: Final = os.O_WRONLY | os.O_CREAT | os.O_APPEND


@contextmanager
def lasting_output(log: Path) -> Iterator[None]:
    """Keep this process alive without its terminal or a pipe; its output then goes to ``log``.

    On SIGHUP standard input ends, and all output to terminals goes to ``log`` from then on, also
    after this block. A hang-up that is already ignored (nohup) stays ignored. Call it in the main
    thread.
    """
    terminals = [number for number in (_STDIN, *_OUTPUTS) if os.isatty(number)]

    def hang_up(_number: int, _frame: FrameType | None) -> None:
        for number in terminals:
            _turn(number, log)

    streams = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (_lasting(stream, log) for stream in streams)
    before = signal.getsignal(signal.SIGHUP)
    if before is not signal.SIG_IGN:
        signal.signal(signal.SIGHUP, hang_up)
    try:
        yield
    finally:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        sys.stdout, sys.stderr = streams
        signal.signal(signal.SIGHUP, before)


def go_to_background(log: Path) -> bool:
    """Fork this process; return True in the child, which goes on without a terminal.

    Its output goes to ``log``. No thread may have been started before.
    """
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    # The child gets its own session below, so that the terminal's hang-up does not reach it.
    if os.fork():
        return False
    os.setsid()
    for number in (_STDIN, *_OUTPUTS):
        _turn(number, log)
    return True


class _LastingFile(io.FileIO):
    """A descriptor for output, redirected to a log once its reader is gone."""

    def __init__(self, descriptor: int, log: Path) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self._log = log

    def write(self, data: Any, /) -> int:
        """Write to the descriptor, and from the first failure on to the log."""
        try:
            return super().write(data)
        except OSError as error:
            if error.errno not in _NOBODY_LISTENS:
                raise
            _turn(self.fileno(), self._log)
            return super().write(data)


def _lasting(stream: TextIO, log: Path) -> TextIO:
    """Return a lasting stream for a standard output of the process, any other as it is."""
    stream.flush()
    with suppress(OSError, AttributeError):
        if stream.fileno() in _OUTPUTS:
            file = io.BufferedWriter(_LastingFile(stream.fileno(), log))
            return io.TextIOWrapper(file, stream.encoding, "replace", line_buffering=True)
    return stream


def _turn(number: int, log: Path) -> None:
    """Redirect standard input to nothing, an output to the log or, if that fails, to nothing."""
    descriptor = os.open(os.devnull, os.O_RDWR)
    if number != _STDIN:
        with suppress(OSError):
            opened = os.open(log, _LOG_FLAGS, 0o644)
            os.close(descriptor)
            descriptor = opened
    # The number stays the same: all writers, C libraries too, use the new file from here on.
    os.dup2(descriptor, number)
    os.close(descriptor)
