"""The person at the cell: shown what to do, asked to press Enter when it is done."""

from __future__ import annotations

import select
import sys
from collections.abc import Mapping
from typing import Any

from rotcal_ros.catalogue import Configuration
from rotcal_ros.planning.plan import PAUSED


class Person:
    """Does the work that a plan leaves to a person, or says when it is done.

    In a simulated cell, or with ``at_once``, the work is done as soon as it is asked for. In a
    terminal Enter says so. Without one only the service ``resume`` of the cell does.
    """

    def __init__(self, configuration: Configuration, at_once: bool) -> None:
        self._service = f"{configuration.cell.namespace.rstrip('/')}/resume"
        self._simulated = configuration.simulated
        self._at_once = at_once or configuration.simulated
        self._asked = False

    def hear(self, event: Mapping[str, Any]) -> str:
        """Take an event of the client and return what the person has to read, often nothing."""
        if event["event"] == "paused":
            self._asked = True
            return f"{event['instruction']}{self._what_then()}"
        if event["event"] == "resumed" and not event["success"]:
            return str(event["reason"])
        if event["event"] == "feedback":  # the service may have been called by anybody
            self._asked = self._asked and event["activity"].startswith(PAUSED)
        return ""

    def is_done(self) -> bool:
        """Return True once for every work that is done."""
        done = self._asked and (self._at_once or _enter_pressed())
        self._asked = self._asked and not done
        return done

    def _what_then(self) -> str:
        if self._simulated:
            return ": done by the simulated person"
        if self._at_once:
            return ": taken as done (--yes)"
        if sys.stdin.isatty():
            return "; then press Enter"
        return f"; then call the service {self._service} (std_srvs/srv/Trigger)"


def _enter_pressed() -> bool:
    """Return whether a line was entered in the terminal; never waits."""
    if not sys.stdin.isatty() or not select.select([sys.stdin], [], [], 0.0)[0]:
        return False
    sys.stdin.readline()
    return True
