"""The console script: loads ``rotcal``; a Ctrl-C meanwhile ends it without a traceback."""

from __future__ import annotations

import signal
from contextlib import suppress


def main() -> None:
    """Run ``rotcal``; while it is loaded, Ctrl-C ends the process as any other."""
    before = signal.getsignal(signal.SIGINT)
    with suppress(ValueError):  # not in the main thread
        signal.signal(signal.SIGINT, signal.SIG_DFL if callable(before) else before)
    from rotcal_ros.cli.main import main as rotcal

    with suppress(ValueError):
        signal.signal(signal.SIGINT, before)
    rotcal()
