"""The bag of a goal: begun, gone on with in another run, and closed, by the recorder."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from rotcal_msgs.srv import StartRecording, StopRecording
from std_srvs.srv import Trigger

from rotcal_ros.catalogue import Configuration
from rotcal_ros.catalogue.continuation import Recorded
from rotcal_ros.errors import DataError
from rotcal_ros.files import write_atomically
from rotcal_ros.nodes.cell_node import until
from rotcal_ros.nodes.crew import Codes, GoalError
from rotcal_ros.nodes.goal_watch import GoalWatch
from rotcal_ros.session_folder import SessionFolder

BAG_TIMEOUT_S: Final = 10.0
OPEN_TIMEOUT_S: Final = 120.0
"""To go on, a recorder reads what the runs before have recorded."""
LAST_TIMEOUT_S: Final = 2.0
"""So long the bag stays open for observations that have come here and not yet to the recorder."""


class GoalBag:
    """``folder`` is that of the session, None before there is one."""

    def __init__(self, configuration: Configuration, watch: GoalWatch) -> None:
        self._configuration = configuration
        self._watch, self._services = watch, watch.links.services
        self._is_open = False
        self.folder: SessionFolder | None = None

    async def open(self, *, goes_on: bool) -> None:
        """Have the recorder open a bag, of a new session or of the next run of the last one."""
        self._watch.tell("opening the bag")
        request = StartRecording.Request(
            plan_id=self._configuration.plan_id, configuration=self._configuration.text
        )
        if not goes_on:
            await self.close_after_failure()  # of a run that was lost before it had begun
        client = self._services.continue_recording if goes_on else self._services.start_recording
        self._is_open = True  # or soon: a cancel does not wait for the answer
        answer = await self._recorder_did(client, request, OPEN_TIMEOUT_S)
        self._watch.recording = True
        self.folder = SessionFolder(Path(answer.folder))

    async def recorded(self) -> Recorded:
        """Return what the recorder has of the session, its earlier runs too."""
        asked = self._services.recorded_observations
        answer = await self._recorder_did(asked, Trigger.Request(), OPEN_TIMEOUT_S)
        try:
            return Recorded.from_json(answer.message)
        except DataError as error:
            raise GoalError(Codes.RECORDER_FAILED, str(error)) from error

    async def close(self) -> None:
        """Have the recorder close the bag."""
        self._watch.tell("closing the bag")
        await self._have_all_recorded()
        self._is_open = self._watch.recording = False
        await self._recorder_did(
            self._services.stop_recording, StopRecording.Request(), BAG_TIMEOUT_S
        )

    async def close_after_failure(self) -> None:
        """Close the bag if the recorder still lives; a dead one left whole chunks behind."""
        health = self._watch.links.health
        if self._is_open and not health.missing(["recorder"]):
            await self._have_all_recorded()
            future = self._services.stop_recording.call_async(StopRecording.Request())
            await until(lambda: future.done() or bool(health.missing(["recorder"])), BAG_TIMEOUT_S)

    async def _have_all_recorded(self) -> None:
        """Let the recorder take the observations of the last steps, rejected ones too."""
        links = self._watch.links
        await until(
            lambda: (
                links.observations.keys() <= links.receipts.keys()
                or bool(links.health.missing(["recorder"]))
            ),
            LAST_TIMEOUT_S,
        )

    def keep_result(self, result_json: str) -> str:
        """Write the result into the session folder and return its path."""
        assert self.folder is not None
        path = self.folder.result
        try:
            write_atomically(path, result_json)
        except OSError as error:
            raise GoalError(Codes.RECORDER_FAILED, f"cannot write {path}: {error}") from error
        return str(path)

    async def _recorder_did(self, client: Any, request: Any, timeout_s: float) -> Any:
        """Return the answer of the recorder; GoalError when it could not do it."""
        answer = await self._watch.call(client, request, timeout_s)
        if not answer.success:
            raise GoalError(Codes.RECORDER_FAILED, answer.message)
        return answer
