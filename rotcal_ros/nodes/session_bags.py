"""Where a recorder puts its bags: one session folder for every calibration."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path

from rotcal_ros.bags import names
from rotcal_ros.bags.reader import session_files
from rotcal_ros.bags.recorder_settings import RecorderSettings
from rotcal_ros.bags.rosbag2_metadata import FileInfo
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.session_folder import SessionFolder


class SessionBags:
    """Opens bags as the settings say; the first one may continue an interrupted session."""

    def __init__(self, settings: RecorderSettings) -> None:
        self._settings = settings
        self._earlier: tuple[FileInfo, ...] | None = None
        if settings.run:
            bag = self._folder(settings.session).bag
            self._earlier = session_files(bag) if any(bag.glob("*.mcap")) else ()

    def open(self, plan_id: str) -> tuple[SessionFolder, BagWriter]:
        """Return the folder of a new session (or run of one) and the writer of its bag."""
        now = datetime.now(timezone.utc)
        name = self._settings.session or f"{now:%Y%m%dT%H%M%SZ}_{plan_id[:8]}"
        folder = self._folder(name)
        writer = BagWriter(folder.bag, self._settings.writer, earlier=self._earlier)
        self._earlier = None
        writer.note(names.RUN, {"number": self._settings.run})
        return folder, writer

    def _folder(self, session: str) -> SessionFolder:
        return SessionFolder((Path(self._settings.folder).expanduser() / session).absolute())
