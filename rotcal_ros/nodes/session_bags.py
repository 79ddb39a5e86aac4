"""The bags of a session: begun, or gone on with after an interruption."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path
from uuid import uuid4

from rotcal_ros.bags import names
from rotcal_ros.bags.closing import InterruptedSession
from rotcal_ros.bags.recorder_settings import RecorderSettings
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.errors import BagError
from rotcal_ros.session_folder import SessionFolder


class SessionBags:
    """Opens bags as the settings say; the first one may continue an interrupted session."""

    def __init__(self, settings: RecorderSettings) -> None:
        self._settings = settings
        self._earlier: InterruptedSession | None = None
        if settings.run:
            bag = self._folder(settings.session).bag
            left = any(bag.glob("*.mcap"))
            self._earlier = InterruptedSession.read(bag) if left else InterruptedSession()

    def open(self, plan_id: str) -> tuple[SessionFolder, BagWriter]:
        """Return the folder of a new session (or run of one) and the writer of its bag."""
        now = datetime.now(timezone.utc)
        name = self._settings.session or f"{now:%Y%m%dT%H%M%SZ}_{plan_id[:8]}"
        folder = self._folder(name)
        earlier, self._earlier = self._earlier, None
        writer = BagWriter(
            folder.bag, self._settings.writer, earlier=None if earlier is None else earlier.files
        )
        if earlier is not None:
            try:
                earlier.close_before(writer)
            except BagError:
                writer.close()
                raise
        session = (earlier.session if earlier else "") or uuid4().hex
        writer.note(names.RUN, {"number": self._settings.run, "session": session})
        return folder, writer

    def _folder(self, session: str) -> SessionFolder:
        return SessionFolder((Path(self._settings.folder).expanduser() / session).absolute())
