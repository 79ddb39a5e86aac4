"""The person at the cell: told what to do, asked to press Enter when it is done."""

from __future__ import annotations

import select
import sys

from rotcal_ros.cli.console import say
from rotcal_ros.cli.session import Session
from rotcal_ros.planning.cell_settings import CellSettings
from rotcal_ros.planning.plan import PAUSED


class Person:
    """Does the work that a plan leaves to a person, or tells when it is done.

    In a simulated cell, or with ``at_once``, the work is done as soon as it is asked for. In a
    terminal Enter says so. Without one only the service ``resume`` of the cell does.
    """

    def __init__(self, session: Session, at_once: bool) -> None:
        cell = session.configuration.group("cell", CellSettings)
        self._service = f"{cell.namespace.rstrip('/')}/resume"
        self._simulated = session.simulated
        self._at_once = at_once
        self._asked = False

    def ask(self, instruction: str) -> None:
        """Show what has to be done."""
        self._asked = True
        if self._simulated:
            say(f"{instruction}: done by the simulated person")
        elif self._at_once:
            say(f"{instruction}: taken as done (--yes)")
        elif sys.stdin.isatty():
            say(f"{instruction}; then press Enter")
        else:
            say(f"{instruction}; then call the service {self._service} (std_srvs/srv/Trigger)")

    def is_done(self) -> bool:
        """Return True once for every work that is done."""
        done = self._asked and (self._simulated or self._at_once or _enter_pressed())
        self._asked = self._asked and not done
        return done

    def follow(self, activity: str) -> None:
        """Note what the planner does: once it goes on, whoever told it so, nothing is asked."""
        self._asked = self._asked and activity.startswith(PAUSED)


def _enter_pressed() -> bool:
    """Return whether a line was entered in the terminal; never waits."""
    if not sys.stdin.isatty() or not select.select([sys.stdin], [], [], 0.0)[0]:
        return False
    sys.stdin.readline()
    return True
