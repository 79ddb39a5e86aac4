"""The names of everything inside the folder of a session, and what goes on with it."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Final

VERIFICATION: Final = "verification.json"
"""The figures of two sessions, before and after compensation, beside their folders."""
REQUEST: Final = "verify.json"
"""The request of a verification, beside its first session."""
CONFIGURATION: Final = "configuration.yaml"
"""File in a session's folder, and attachment in its bag."""

MEETING_POINT: Final = "running.json"
"""File in a session's folder while it runs, with the address of its socket."""


@dataclass(frozen=True, slots=True)
class SessionFolder:
    """The folder of one calibration with all its runs; nothing here touches the disk."""

    path: Path

    @property
    def configuration(self) -> Path:
        """The configuration, as the user wrote it."""
        return self.path / CONFIGURATION

    @property
    def parameters(self) -> Path:
        """The configuration as a parameter file of the nodes."""
        return self.path / "parameters.yaml"

    @property
    def bag(self) -> Path:
        """Folder of the bag."""
        return self.path / "bag"

    @property
    def result(self) -> Path:
        """The result; its presence means that the calibration is finished."""
        return self.path / "result.json"

    @property
    def truth(self) -> Path:
        """What a simulation injected."""
        return self.path / "truth.json"

    @property
    def report(self) -> Path:
        """The page about the calibration."""
        return self.path / "report.html"

    @property
    def compensation(self) -> Path:
        """Folder of the controller files."""
        return self.path / "compensation"

    @property
    def socket_file(self) -> Path:
        """Where others can attach to the calibration while it runs."""
        return self.path / MEETING_POINT

    def log(self, run: int = 0) -> Path:
        """Return the folder that takes what the nodes of a run print."""
        return self.path / (f"log_{run}" if run else "log")

    def continuation(self, run: int) -> Path:
        """Return the file with what is left of the plan for a run."""
        return self.path / f"continuation_{run}.json"


def resume_command(session: Path) -> str:
    """Return the command line that goes on with an interrupted session, for a shell.

    A measurement of a verification goes on as a part of it.
    """
    for whole in (session, session.parent):
        if (whole / REQUEST).is_file():
            return shlex.join(("rotcal", "verify", "--resume", str(whole)))
    return shlex.join(("rotcal", "run", "--resume", str(session)))


def unfinished(session: Path) -> bool:
    """Return whether a folder is a session that was begun, and has no result."""
    folder = SessionFolder(session)
    return folder.configuration.is_file() and folder.bag.is_dir() and not folder.result.exists()
