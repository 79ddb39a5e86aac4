"""The planner's side of the recording: opening and closing the bag, keeping the result."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from rotcal_msgs.srv import StartRecording, StopRecording

from rotcal_ros.catalogue import Configuration
from rotcal_ros.files import write_atomically
from rotcal_ros.nodes.goal_watch import Codes, GoalError, GoalWatch
from rotcal_ros.nodes.waiting import until
from rotcal_ros.session_folder import SessionFolder

CLOSE_TIMEOUT_S: Final = 10.0


class SessionRecording:
    """The bag of one goal; ``folder`` is None until the recorder has opened it."""

    def __init__(self, watch: GoalWatch) -> None:
        self._watch = watch
        self._open = False
        self.folder: SessionFolder | None = None

    async def open(self, configuration: Configuration) -> None:
        """Have the recorder open a new session folder with a bag."""
        self._watch.tell("opening the bag")
        request = StartRecording.Request(
            plan_id=configuration.plan_id, configuration=configuration.text
        )
        client = self._watch.links.start_recording
        answer = await self._watch.call(client, request, CLOSE_TIMEOUT_S)
        if not answer.success:
            raise GoalError(Codes.RECORDER_FAILED, answer.message)
        self.folder = SessionFolder(Path(answer.folder))
        self._open = self._watch.recording = True

    async def close(self) -> None:
        """Have the recorder close the bag."""
        self._watch.tell("closing the bag")
        self._open = False
        client = self._watch.links.stop_recording
        answer = await self._watch.call(client, StopRecording.Request(), CLOSE_TIMEOUT_S)
        if not answer.success:
            raise GoalError(Codes.RECORDER_FAILED, answer.message)

    async def close_after_failure(self) -> None:
        """Close the bag if the recorder still lives; a dead one left whole chunks behind."""
        if not self._open or self._lost():
            return
        future = self._watch.links.stop_recording.call_async(StopRecording.Request())
        await until(lambda: future.done() or self._lost(), CLOSE_TIMEOUT_S)

    def keep(self, result_json: str) -> Path:
        """Write the result into the session folder and return its path."""
        assert self.folder is not None
        path = self.folder.result
        try:
            write_atomically(path, result_json)
        except OSError as error:
            raise GoalError(Codes.RECORDER_FAILED, f"cannot write {path}: {error}") from error
        return path

    def _lost(self) -> bool:
        return bool(self._watch.health.missing(["recorder"]))
