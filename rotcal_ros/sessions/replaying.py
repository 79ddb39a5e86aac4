"""Running the process that replays a bag, and showing its progress."""

from __future__ import annotations

import json
import os
import signal
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Any, Final, NoReturn

from rotcal_ros.bags.unread_data import note_unread
from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.report.terminal.console import progress, say
from rotcal_ros.sessions.processes import Processes

PLAYER: Final = "player"
_ERRORS: Final = {2: ConfigurationError, 3: DataError}
"""The exit code of the process tells the kind of its error."""


def replay(bag: Path, options: Sequence[str]) -> dict[str, Any]:
    """Have ``bag`` published with the options of the player and return its outcome.

    ``interrupted`` is true when the user ended it. Raises the error that it ended with.
    """
    command = [sys.executable, "-m", f"rotcal_ros.nodes.{PLAYER}", str(bag), *options]
    environment = {"PYTHONUNBUFFERED": "1", "ROTCAL_SUPERVISOR": str(os.getpid())}
    previous = signal.signal(signal.SIGTERM, _interrupt)
    try:
        with (
            tempfile.TemporaryDirectory(prefix="rotcal-replay-") as folder,
            Processes(Path(folder), environment) as processes,
        ):
            processes.start(PLAYER, command, piped=True)
            return _followed(processes)
    except KeyboardInterrupt:
        return {"interrupted": True}
    finally:
        signal.signal(signal.SIGTERM, previous)


def _interrupt(_number: int, _frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt


def _followed(processes: Processes) -> dict[str, Any]:
    """Show what the player reports until it ends."""
    child = processes.children[PLAYER]
    outcome: dict[str, Any] = {}
    assert child.stdout is not None
    with progress("replaying") as shown:
        for line in child.stdout:
            event = json.loads(line)
            match event.pop("event"):
                case "left_out":
                    say(f"left out: {event['topic']}: {event['why']}")
                case "unread":
                    note_unread(event["texts"])
                case "note":
                    say(event["text"])
                case "playing":
                    shown(round(event["done_s"]), max(1, round(event["total_s"])))
                case "result":
                    outcome = event
                case "interrupted":
                    outcome = {"interrupted": True}
    if code := child.wait():
        text = processes.log_tail(PLAYER, 1)
        if not text:
            raise DataError(f"the player ended (exit code {code}) without a message")
        raise _ERRORS.get(code, BagError)(text)
    return outcome
