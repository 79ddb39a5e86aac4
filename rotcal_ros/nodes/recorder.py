"""The recorder: every topic of the cell as raw bytes, on disk before the next step."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from rclpy.serialization import deserialize_message
from rotcal_msgs.msg import Observation, RecordedObservation
from rotcal_msgs.srv import StartRecording, StopRecording

from rotcal_ros.bags import names
from rotcal_ros.bags.recorder_settings import RecorderSettings
from rotcal_ros.clock_jumps import noted
from rotcal_ros.errors import BagError
from rotcal_ros.messages import stamp_ns
from rotcal_ros.nodes.bookkeeping import NEEDED, NEVER_PAUSE, PendingReceipts, Silences
from rotcal_ros.nodes.cell_node import CellNode, until
from rotcal_ros.nodes.draining import GRAPH_PERIOD_S, Batch
from rotcal_ros.nodes.dropouts import TOGETHER_S, DropoutNotes
from rotcal_ros.nodes.health import RECORDING_FAILED
from rotcal_ros.nodes.listening import HeardTopic, Listener
from rotcal_ros.nodes.qos import EVENT
from rotcal_ros.nodes.recording import Messages, Receipt, Recording
from rotcal_ros.nodes.running import run
from rotcal_ros.nodes.session_bags import SessionBags
from rotcal_ros.nodes.surroundings import keep_surroundings, parameters_json
from rotcal_ros.nodes.topic_names import CalledOtherwise

CLOSE_TIMEOUT_S: Final = 15.0


class RecorderNode(CellNode):
    """Listens to everything from the start; writes between start and stop."""

    def __init__(self) -> None:
        super().__init__("recorder")

    def configure(self) -> None:
        """Get ready to write."""
        self._settings = self.settings("recorder", RecorderSettings)
        self._bags = SessionBags(self._settings)
        self._recording: Recording | None = None
        self._silences = Silences(self._settings.silence_s, time.monotonic())
        self._pending = PendingReceipts()
        self._receipts = self.create_publisher(RecordedObservation, "observation_recorded", EVENT)
        self.offer(StartRecording, "start_recording", self._start)
        self.offer(StopRecording, "stop_recording", self._stop, always=True)
        self._called = CalledOtherwise(self.get_namespace())
        self._dropouts = DropoutNotes(self.resolve_topic_name(f"~/{names.DROPOUTS}"))
        further = self._called.topics.values
        self._listener = Listener(self, self._take, self._dropouts.note, further)
        self.every(GRAPH_PERIOD_S, self._note_losses)

    def deactivated(self) -> None:
        """Write what has arrived and close the bag."""
        self._close()

    def stopped(self) -> bool:
        """Return whether the bag is closed."""
        return self._writing() is None

    def _writing(self) -> Recording | None:
        """Return the recording whose bag is open."""
        recording = self._recording
        return None if recording is None or recording.finished else recording

    def _note_losses(self) -> None:
        """Keep losses and their counters in the bag, so that they outlive this node."""
        self._called.look(self.health.values)
        recording = self._writing()
        if recording is None:
            return
        heard = self._listener.heard_s(lambda topic: self._called.role(topic) in NEVER_PAUSE)
        self._called.keep_in(recording)
        self._dropouts.silences(self._silences.look(heard, time.monotonic()))
        self._dropouts.write(TOGETHER_S)
        if counters := self._all_losses() + self._silences.counts:
            recording.note(names.LOSSES, counters)
        if jumps := self.health.clock.since(self._jumps_before):
            recording.note(names.CLOCK_JUMPS, noted(jumps))

    def _take(self, topic: HeardTopic, batch: Batch) -> None:
        if self._recording is not None:
            messages = Messages.taken(topic.channel, batch)
            if not self._recording.put(messages):
                self._dropouts.refused(messages)
        if topic.channel.topic == self._called.topic(names.OBSERVATION):
            for data, _ in batch:
                message = deserialize_message(data, Observation)
                self._pending.expect(message.step, message.attempt, stamp_ns(message.window_end))
        self._settle_receipts()

    def _settle_receipts(self) -> None:
        """Queue a receipt once the readings and the feedback of its window have arrived here."""
        if self._recording is None:
            return
        needed = ([self._called.topic(role) for role in either] for either in NEEDED)
        came = map(self._listener.reached_ns, needed)
        reached_ns = min((stamp for stamp in came if stamp is not None), default=None)
        if not self._pending:
            self._pending.reach(reached_ns or 0)
            return
        lost = self._called.lost(self._all_losses())
        for receipt in self._pending.due(reached_ns, lost):
            self._dropouts.write()
            self._recording.confirm(receipt)

    def _all_losses(self) -> Counter[str]:
        """Return what was lost since the bag was opened, here and at the full queue."""
        queued = self._recording.losses if self._recording is not None else Counter[str]()
        return self._listener.losses + queued

    def _confirm(self, receipt: Receipt, file: str) -> None:
        """Publish a receipt; called from the writer's thread."""
        message = RecordedObservation(**asdict(receipt), file=file)
        message.header.stamp = self.get_clock().now().to_msg()
        self._receipts.publish(message)

    def _start(
        self, request: StartRecording.Request, response: StartRecording.Response
    ) -> StartRecording.Response:
        try:
            folder = self._open(request)
            response.folder, response.success = str(folder), True
        except (BagError, OSError) as error:
            response.message = str(error)
        return response

    def _open(self, request: StartRecording.Request) -> Path:
        if (open_one := self._writing()) is not None:
            raise BagError(f"the recorder is writing {open_one.file}; stop it first")
        folder, writer = self._bags.open(request.plan_id)
        self._pending = PendingReceipts()
        self._jumps_before = self.health.clock.watch.count
        self._listener.forget_losses()
        self._silences = Silences(self._settings.silence_s, time.monotonic())
        recording = Recording(writer, self._settings.queue_bytes, self._confirm)
        self._dropouts.begin(recording)
        self._called.keep_in(recording)  # before the configuration, where readers stop to look
        keep_surroundings(recording, request.configuration)
        self._listener.tell_again(recording.put)
        self._recording = recording
        self.begin(self._attach_parameters, recording)
        return folder.path

    async def _attach_parameters(self, recording: Recording) -> None:
        """Ask all nodes for their parameters, while the calibration begins."""
        text = await parameters_json(self, self.health.present())
        recording.attach(names.PARAMETERS, "application/json", text.encode())

    async def _stop(
        self, _request: StopRecording.Request, response: StopRecording.Response
    ) -> StopRecording.Response:
        recording = self._recording
        if recording is None:
            response.message = "nothing is being recorded"
            return response
        self._close()
        await until(lambda: recording.finished, CLOSE_TIMEOUT_S)
        response.success = recording.finished and not recording.error
        losses = self._all_losses()
        response.message = recording.error or ", ".join(f"{n}: {k}" for k, n in losses.items())
        response.file, response.messages = recording.file, recording.messages
        response.lost = sum(losses.values())
        return response

    def _close(self) -> None:
        """Take what has arrived and close the bag behind it."""
        if (recording := self._writing()) is not None:
            self._listener.drain()
            self._dropouts.silences(self._silences.end(time.monotonic()))
            self._dropouts.write()
            recording.close(self._listener.losses + self._silences.counts)

    def _node_lost(self, name: str) -> None:
        """Without its planner a calibration is over: close the bag."""
        if name == "planner" and self._writing() is not None:
            self.get_logger().error("the planner is lost: closing the bag")
            self._close()

    def _report(self) -> tuple[str, dict[str, Any]]:
        values = {"topics": len(self._listener.topics), **self._listener.refused}
        values |= self._all_losses() + self._silences.counts
        recording = self._recording
        if recording is not None and recording.error:
            return f"{RECORDING_FAILED}: {recording.error}", values
        if recording is None or recording.finished:
            return "idle", values
        return "recording", values | {"file": recording.file, "messages": recording.messages}


def main() -> None:
    """Run the recorder."""
    run(RecorderNode)


if __name__ == "__main__":
    main()
