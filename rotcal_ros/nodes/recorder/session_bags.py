"""Opens the bags of a session, new or continued, and reads what they already hold."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from uuid import uuid4

import numpy as np
from rclpy.serialization import deserialize_message
from rotcal_msgs import msg
from std_srvs.srv import Trigger

from rotcal_ros.bags import names
from rotcal_ros.bags.interrupted_files import InterruptedSession
from rotcal_ros.bags.reader import bag_files, read_blocks
from rotcal_ros.bags.session_identity import file_head
from rotcal_ros.bags.settings import RecorderSettings
from rotcal_ros.bags.writer import BagWriter
from rotcal_ros.capture import messages
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.session_folder import SessionFolder
from rotcal_ros.methods.continuation import Recorded
from rotcal_ros.nodes.runtime.timers_and_subscriptions import Batch


@dataclass(frozen=True)
class OpenBag:
    """A bag that is open for a run; ``earlier`` holds the observations of the runs before."""

    folder: SessionFolder
    writer: BagWriter
    run: int
    earlier: tuple[Observation, ...] = ()

    def keep(self, configuration_text: str) -> None:
        """Put the configuration into the folder, so that ``rotcal run --resume`` can go on there.

        Opening the bag shows whether the disk can be written.
        """
        if not self.folder.configuration.exists():
            with suppress(OSError):
                write_atomically(self.folder.configuration, configuration_text)


class SessionBags:
    """Opens bags as the settings say; the first one may continue an interrupted session."""

    def __init__(self, settings: RecorderSettings) -> None:
        self._settings = settings
        self._earlier: InterruptedSession | None = None
        self._last: SessionFolder | None = None
        if settings.run:
            bag = self._folder(settings.session).bag
            left = any(bag.glob("*.mcap"))
            self._earlier = InterruptedSession.read(bag) if left else InterruptedSession()

    def open(self, plan_id: str) -> OpenBag:
        """Open the bag of a new session (or run of one)."""
        now = datetime.now(timezone.utc)
        name = self._settings.session or f"{now:%Y%m%dT%H%M%SZ}_{plan_id[:8]}"
        folder = self._folder(name)
        earlier, self._earlier = self._earlier, None
        writer = self._writer(folder, earlier)
        self._note(writer, self._settings.run, earlier)
        return OpenBag(folder, writer, self._settings.run)

    def go_on(self, plan_id: str, topic: str) -> OpenBag:
        """Open the next run of the last session of a plan, with the observations on ``topic``.

        Raises BagError when there is none that could be continued.
        """
        folder = self._unfinished(plan_id)
        earlier = InterruptedSession.read(folder.bag)
        files = [folder.bag / file.name for file in earlier.files]
        observed = observations_in(files, topic)
        writer = self._writer(folder, earlier)
        run = len(files)  # no earlier run has this number: each wrote a file at least
        self._note(writer, run, earlier, earlier=names.RECORDED)
        return OpenBag(folder, writer, run, observed)

    def _writer(self, folder: SessionFolder, earlier: InterruptedSession | None) -> BagWriter:
        """Return the writer of a new file that follows the files of ``earlier``."""
        files = None if earlier is None else earlier.files
        writer = BagWriter(folder.bag, self._settings.writer, earlier=files)
        if earlier is not None:
            try:
                earlier.close_before(writer)
            except BagError:
                writer.close()
                raise
        self._last = folder
        return writer

    def _note(
        self, writer: BagWriter, run: int, before: InterruptedSession | None, **more: str
    ) -> None:
        session = (before.session if before else "") or uuid4().hex
        writer.note(names.RUN, {"number": run, "session": session, **more})

    def _unfinished(self, plan_id: str) -> SessionFolder:
        """Return the last session of a plan that has no result yet; BagError: there is none."""
        for folder in self._candidates(plan_id):
            files: tuple[Path, ...] = ()
            with suppress(BagError):
                files = bag_files(folder.bag)
            if files and file_head(files[0]).configuration == plan_id:
                if folder.result.exists():
                    raise BagError(
                        f"the calibration in {folder.path} is finished already; begin a new one"
                    )
                return folder
        place = self._folder(self._settings.session).path
        raise BagError(
            f"{place} holds no session of this plan to continue: it was measured elsewhere, with "
            "another configuration, or not at all; begin a new one with start_index 0"
        )

    def _candidates(self, plan_id: str) -> Iterator[SessionFolder]:
        """Yield where the session of a plan may be, the last one first."""
        if self._last is not None:
            yield self._last
        if self._settings.session:
            yield self._folder(self._settings.session)
        else:
            found = self._folder("").path.glob(f"*_{plan_id[:8]}")
            yield from map(SessionFolder, sorted(found, reverse=True))

    def _folder(self, session: str) -> SessionFolder:
        return SessionFolder((Path(self._settings.folder).expanduser() / session).absolute())


class RecordedSession:
    """The observations of all runs of the session that is being recorded, in order."""

    def __init__(self) -> None:
        self._plan_id, self._run = "", 0
        self._observations: list[Observation] = []

    def begin(self, plan_id: str, run: int = 0, earlier: Iterable[Observation] = ()) -> None:
        """Begin a run; ``earlier`` holds the observations of the runs before it."""
        self._plan_id, self._run = plan_id, run
        self._observations = list(earlier)

    def of_this_run(self, batch: Batch) -> Batch:
        """Return the observations of this run: a turn may outlast the run in which it began.

        What its later angles would need is not in the bag between two runs.
        """
        return [
            (data, info)
            for data, info in batch
            if deserialize_message(data, msg.Observation).run == self._run
        ]

    def take(self, data: bytes) -> msg.Observation:
        """Take an observation that is being recorded, and return its message."""
        message: msg.Observation = deserialize_message(data, msg.Observation)
        self._observations.append(messages.observation(message))
        return message

    def tell(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Answer with all of it, as JSON."""
        recorded = Recorded(self._plan_id, self._run, tuple(self._observations))
        response.success, response.message = bool(self._plan_id), recorded.to_json()
        return response


def observations_in(files: Sequence[Path], topic: str) -> tuple[Observation, ...]:
    """Return the observations on ``topic`` in the files of a session, in their order.

    Raises BagError when a file cannot be read.
    """
    found: list[Observation] = []
    for scan, block in read_blocks(tuple(files)):
        here = [number for number, channel in scan.channels.items() if channel.topic == topic]
        if block is not None and here:
            rows = np.flatnonzero(np.isin(block.headers["channel"], here)).tolist()
            found += (_observation(block.payload(row), scan.path) for row in rows)
    return tuple(found)


def _observation(data: bytes, file: Path) -> Observation:
    """Return a message as the bag holds it, by rclpy: our own decoder takes longer to load."""
    try:
        return messages.observation(deserialize_message(data, msg.Observation))
    except Exception as error:
        raise BagError(
            f"{file}: an observation of another version ({error}): begin a new calibration, or go "
            "on with the version that began it"
        ) from error
