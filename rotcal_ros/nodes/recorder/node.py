"""The recorder node: writes every topic of the cell to disk before the next step begins.

An observation is confirmed by a receipt once it and all readings of its window are on the disk.
The bag begins with the provenance: configuration, versions of packages, parameters of all nodes.
"""

from __future__ import annotations

import json
import platform
import struct
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Final, TypeAlias

from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.client import Client
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.utilities import get_rmw_implementation_identifier
from rotcal_msgs import msg
from rotcal_msgs.srv import StartRecording, StopRecording
from std_srvs.srv import Trigger

from rotcal_ros import __version__
from rotcal_ros.bags import names
from rotcal_ros.bags.dropouts import GAP, REPORTED, UNHEARD, Dropout
from rotcal_ros.bags.settings import RecorderSettings, TopicSettings
from rotcal_ros.bags.topic_roles import TopicRoleFinder
from rotcal_ros.capture.instruments.conventions import OWN, Conventions, single_shots
from rotcal_ros.capture.instruments.interpreter import FAST
from rotcal_ros.capture.messages import stamp_ns
from rotcal_ros.foundation.clock_jumps import jumps_to_metadata
from rotcal_ros.foundation.errors import BagError, ConfigurationError, RotcalError
from rotcal_ros.foundation.middleware import distribution, rclpy_version
from rotcal_ros.foundation.node_state import LOADING, NodeState, State, Why
from rotcal_ros.methods.configuration import read_subject, read_topics
from rotcal_ros.nodes.recorder.bookkeeping import (
    NEEDED,
    NEVER_PAUSE,
    LogTimes,
    PendingReceipts,
    SilenceMonitor,
    TopicLosses,
    WriteReceipt,
)
from rotcal_ros.nodes.recorder.recording import (
    JOINED_WITHIN_S,
    BagRecording,
    Channel,
    DropoutWriter,
    RecordedSession,
    RunBag,
    SerializedMessages,
    SessionBags,
    described_channel,
)
from rotcal_ros.nodes.runtime.beat_values import LISTENS
from rotcal_ros.nodes.runtime.cell_node import IDLE_S, CellNode, wait_for_condition
from rotcal_ros.nodes.runtime.message_types import message_type
from rotcal_ros.nodes.runtime.qos import EVENT, adapted_qos
from rotcal_ros.nodes.runtime.running import run_in_thread, run_node
from rotcal_ros.nodes.runtime.timers_and_subscriptions import (
    GRAPH_PERIOD_S,
    UNWAITED,
    Batch,
    DrainedSubscription,
    handle_events,
    sent_ns,
    steady_timer,
)
from rotcal_ros.planning.settings import SafetySettings

CLOSE_TIMEOUT_S: Final = 15.0
PARAMETERS_TIMEOUT_S: Final = 3.0
"""How long one question for parameters waits for its answer."""
ASKING_S: Final = 60.0
"""How long nodes are asked for their parameters that do not answer."""
_PACKAGES = ("numpy", "scipy", "mcap", "rclpy", "ros-rclpy", "rotcal_msgs")
Request: TypeAlias = StartRecording.Request
Response: TypeAlias = StartRecording.Response


class RecorderNode(CellNode):
    """Listens to everything from the start; writes between start and stop."""

    def __init__(self) -> None:
        super().__init__("recorder")

    def configure(self) -> None:
        """Subscribe to everything, and offer to record."""
        self._settings = self.settings("recorder", RecorderSettings)
        self._bags, self._session = SessionBags(self._settings), RecordedSession()
        self._recording: BagRecording | None = None
        self._silences = SilenceMonitor(self._settings.silence_s, time.monotonic())
        self._jumps_before, self._reading, self._unwanted = 0, False, False
        self._log_times = LogTimes(self._clock_jumps)
        self.offer(StartRecording, "start_recording", self._start)
        self.offer(StartRecording, "continue_recording", self._go_on)
        self.offer(StopRecording, "stop_recording", self._stop, always=True)
        self.offer(Trigger, "recorded_observations", self._session.tell)
        self._called = TopicRoleFinder(self.get_namespace())
        self._dropouts = DropoutWriter(self.resolve_topic_name(f"~/{names.DROPOUTS}"))
        heard = self._take, self._dropouts.note, self._called.topics.values
        self._listener = TopicListener(self, *heard, fast=self._is_fast)
        self._receipts = ReceiptPublisher(self, self._called, self._listener, self._session)
        self.every(GRAPH_PERIOD_S, self._note_losses)

    def deactivated(self) -> None:
        """Write what has arrived and close the bag, even one that is about to be opened."""
        self._unwanted = True
        self._close()

    def stopped(self) -> bool:
        """Return whether the bag is closed."""
        return self._writing() is None and not self._reading

    def batch_period_s(self) -> float:
        """Collect messages while no bag is open."""
        return IDLE_S if not self.configured or self._writing() is None else 0.0

    def _writing(self) -> BagRecording | None:
        """Return the recording whose bag is open."""
        return self._recording if self._recording and not self._recording.finished else None

    def _note_losses(self) -> None:
        """Write losses and their counters into the bag, so that they outlive this node."""
        self._called.poll(self.health.values)
        recording = self._writing()
        if recording is None:
            return
        heard = self._listener.heard_s(self._called.role)
        self._called.keep(recording.note)
        self._dropouts.silences(self._silences.poll(heard, time.monotonic()))
        self._dropouts.write(JOINED_WITHIN_S)
        if counters := self._all_losses() + self._silences.counts:
            recording.note(names.LOSSES, counters)
        if jumps := self.health.clock.since(self._jumps_before):
            recording.note(names.CLOCK_JUMPS, jumps_to_metadata(jumps))

    def _take(self, topic: RecordedTopic, batch: Batch) -> None:
        if (recording := self._writing()) is None:
            return
        if topic.channel.topic == self._called.topic(names.OBSERVATION):
            batch = self._session.of_this_run(batch)
            if not batch:
                return
        messages = SerializedMessages.taken(topic.channel, batch)
        arrived_ns = [received_ns for _, received_ns, _ in messages.items]
        messages = messages.at(self._log_times.ascending(topic.channel.topic, arrived_ns))
        if not recording.put(messages):
            self._dropouts.refused(messages)
        if topic.channel.topic == self._called.topic(names.OBSERVATION):
            self._listener.take_fast()  # its receipt is due once the readings before it are here
        self._receipts.receive(topic, batch)
        for receipt in self._receipts.due(self._all_losses):
            self._dropouts.write()
            recording.confirm(receipt)

    def _is_fast(self, topic: str) -> bool:
        return topic in map(self._called.topic, (*FAST, names.HEARTBEAT))

    def _clock_jumps(self) -> int:
        """Return how often the clock was set, up to now."""
        self.health.clock.poll()
        return self.health.clock.watch.count

    def _all_losses(self) -> Counter[str]:
        """Return what was lost since the bag was opened, on the way here and at the full queue."""
        handle_events(self)
        queued = self._recording.losses if self._recording is not None else Counter[str]()
        return self._listener.losses + queued

    def _start(self, request: Request, response: Response) -> Response:
        try:
            if (open_one := self._writing()) is not None:
                raise BagError(f"the recorder is writing {open_one.file}; stop it first")
            self._begin(request, self._bags.open(request.plan_id), response)
        except (BagError, OSError) as error:
            response.message = str(error)
        return response

    async def _go_on(self, request: Request, response: Response) -> Response:
        """Record the next run of the last session of a plan, after closing an open bag."""
        self._close()
        topic = self._called.topic(names.OBSERVATION)
        try:
            if not await wait_for_condition(self.stopped, CLOSE_TIMEOUT_S):
                raise BagError(
                    "the recorder is still closing the bag of the previous run: wait, "
                    "then try again"
                )
            self._reading, self._unwanted = True, False
            self.health.beat()  # before the reading can delay it
            bag = await run_in_thread(self._bags.go_on, request.plan_id, topic)
            if self._unwanted:
                bag.writer.close()
                raise BagError(
                    "the recorder was deactivated or ended meanwhile: activate it, then try again"
                )
            self._begin(request, bag, response)
        except (RotcalError, OSError) as error:
            response.message = str(error)
        finally:
            self._reading = False
        return response

    def _begin(self, request: Request, bag: RunBag, response: Response) -> None:
        """Record into ``bag`` from now on."""
        self._listener.drain()  # of what came before
        self._receipts.begin()
        self._jumps_before = self.health.clock.watch.count
        self._listener.begin(request.configuration)
        self._silences = SilenceMonitor(self._settings.silence_s, time.monotonic())
        self._session.begin(request.plan_id, bag.run, bag.earlier)
        recording = BagRecording(bag.writer, self._settings.queue_bytes, self._receipts.confirm)
        self._dropouts.begin(recording)
        self._called.keep(recording.note)  # before the configuration, where readers stop to look
        attach_provenance(recording, request.configuration)
        bag.keep(request.configuration)
        self._listener.tell_again(recording.put)
        self._recording = recording
        self._asked = NodeParameters(recording, self)
        self.begin(self._asked.ask)
        response.folder, response.success = str(bag.folder.path), True

    async def _stop(
        self, _request: StopRecording.Request, response: StopRecording.Response
    ) -> StopRecording.Response:
        recording = self._recording
        if recording is None:
            response.message = "nothing is being recorded"
            return response
        self._close()
        await wait_for_condition(lambda: recording.finished, CLOSE_TIMEOUT_S)
        response.success, losses = recording.finished and not recording.error, self._all_losses()
        response.message = recording.error or ", ".join(f"{n}: {k}" for k, n in losses.items())
        response.file, response.messages = recording.file, recording.messages
        response.lost = sum(losses.values())
        return response

    def _close(self) -> None:
        """Take what has arrived and then close the bag."""
        if (recording := self._writing()) is not None:
            self._listener.drain()
            self._asked.attach()
            self._dropouts.silences(self._silences.end(time.monotonic()))
            self._dropouts.write()
            recording.close(self._listener.losses + self._silences.counts)

    def _node_lost(self, name: str) -> None:
        """Close the bag when its planner is lost: the calibration is over."""
        if name == "planner" and self._writing() is not None:
            self.get_logger().error("the planner is lost: closing the bag")
            self._close()

    def _report(self) -> tuple[NodeState, dict[str, Any]]:
        values: dict[str, Any] = {"topics": len(self._listener.topics), **self._listener.refused}
        values[LISTENS] = " ".join(sorted(self._listener.topics))
        values |= self._all_losses() + self._silences.counts
        recording = self._recording
        if recording is not None and recording.error:
            failed = NodeState.of(State.FAILED, Why.RECORDING_FAILED, recording.error)
            return failed, values
        if recording is None or recording.finished:
            return LOADING if self._reading else NodeState(State.IDLE), values
        values |= {"file": recording.file, "messages": recording.messages}
        return NodeState(State.RECORDING), values


ALWAYS: Final = ("/diagnostics", "/rosout", names.TF_STATIC)
"""Topics outside the namespace of the cell that are recorded too."""
FAST_PERIOD_S: Final = 0.02
"""Period at which fast topics are read: a turn costs as much for one message as for many."""
MOST_LATCHED: Final = 100
"""Number of batches of static transforms that are kept for the next bag."""
_STAMP: Final = struct.Struct("<4xiI")
"""CDR encapsulation, then the stamp that begins every message with a header."""


@dataclass
class RecordedTopic:
    """A topic that is recorded: its channel and how far it has come.

    ``heard_s`` is the monotonic time of the latest batch, or of the subscription, ``heard_ns`` the
    log time of the latest message; ``latched`` is what was published once for late subscribers.
    """

    channel: Channel
    heard_s: float = field(default_factory=time.monotonic)
    heard_ns: int = field(default_factory=time.time_ns)
    sent_ns: int = 0
    latest: bytes = b""
    latched: deque[SerializedMessages] = field(default_factory=lambda: deque(maxlen=MOST_LATCHED))
    losses: TopicLosses = field(default_factory=TopicLosses)

    def measured_at_ns(self, role: str, conventions: Conventions) -> int:
        """Return when the newest message was taken, by the common clock; 0: none has come."""
        if not self.latest:
            return 0
        form = conventions.form(role, self.channel.type_name)
        if form is not None and not form.stamped:
            return int(conventions.measured_at_ns(role, self.sent_ns, self.sent_ns))
        seconds, nanoseconds = _STAMP.unpack_from(self.latest)
        stamp_ns = int(seconds) * 1_000_000_000 + int(nanoseconds)
        return int(conventions.measured_at_ns(role, stamp_ns, self.sent_ns))


class TopicListener:
    """Subscribes to topics as they appear and hands their messages to ``take``.

    Gaps go to ``missed`` before the messages that follow them go to ``take``. Recorded are the
    topics of the cell's namespace and the ``further`` ones, by absolute name. Messages of a
    ``fast`` topic do not wake the node: they are taken together. ``topics`` maps absolute names to
    what was heard; ``refused`` holds topics whose type is not installed.
    """

    def __init__(
        self,
        node: CellNode,
        take: Callable[[RecordedTopic, Batch], None],
        missed: Callable[[Dropout], None],
        further: Callable[[], Collection[str]] = tuple,
        fast: Callable[[str], bool] = lambda _: False,
    ) -> None:
        self._node = node
        self._hand_over = take
        self._missed = missed
        self._further = further
        self._is_fast = fast
        self._drained: list[DrainedSubscription] = []
        self._fast: list[DrainedSubscription] = []
        self.topics: dict[str, RecordedTopic] = {}
        self.refused: dict[str, str] = {}
        self._conventions = Conventions(TopicSettings())
        self._incompatible: Counter[str] = Counter()
        stop = node.settings("safety", SafetySettings).emergency_stop
        self._stop = [node.resolve_topic_name(stop)] if stop else []
        node.every(GRAPH_PERIOD_S, self._look)
        steady_timer(node, FAST_PERIOD_S, node.health.guarded(self.take_fast))

    @property
    def losses(self) -> Counter[str]:
        """What the middleware lost, and how many publishers cannot be heard, by topic."""
        lost = {f"{names.LOST} {name}": topic.losses.count for name, topic in self.topics.items()}
        return Counter({name: count for name, count in lost.items() if count}) + self._incompatible

    def begin(self, configuration_text: str) -> None:
        """Begin a bag: count losses from zero, and read the instruments by its configuration."""
        self._conventions = Conventions(read_topics(configuration_text))
        self._incompatible.clear()
        for topic in self.topics.values():
            topic.losses.forget()

    def reached_ns(
        self, rows: Iterable[Iterable[str]], called: Callable[[str], str]
    ) -> int | None:
        """Return how far all ``rows`` have come, each by its first role that has come at all.

        ``called`` returns the topic of a role. None: nothing has come.
        """
        reached = (self._first_reached_ns(roles, called) for roles in rows)
        return min((stamp for stamp in reached if stamp is not None), default=None)

    def _first_reached_ns(self, roles: Iterable[str], called: Callable[[str], str]) -> int | None:
        heard = ((role, self.topics.get(called(role))) for role in roles)
        came = ((role, topic) for role, topic in heard if topic is not None and topic.latest)
        return next((topic.measured_at_ns(role, self._conventions) for role, topic in came), None)

    def heard_s(self, role: Callable[[str], str]) -> dict[str, float]:
        """Return when the topics that never pause were last heard, in monotonic time.

        ``role`` returns the role of a topic.
        """
        steady = set(NEVER_PAUSE) - set(single_shots(self._conventions.settings))
        return {name: t.heard_s for name, t in self.topics.items() if role(name) in steady}

    def tell_again(self, take: Callable[[SerializedMessages], object]) -> None:
        """Hand over latched messages as if they had just come: every bag begins with them."""
        now_ns = time.time_ns()
        for topic in self.topics.values():
            for latched in topic.latched:
                take(
                    SerializedMessages(
                        topic.channel, [(d, now_ns, sent) for d, _, sent in latched.items]
                    )
                )

    def drain(self) -> None:
        """Handle what has arrived and is still waiting."""
        for drained in self._drained:
            drained.drain()

    def take_fast(self) -> None:
        """Handle what has arrived on the fast topics."""
        for drained in self._fast:
            drained.drain()

    def _look(self) -> None:
        """Subscribe to topics that are new in the graph and have publishers."""
        for name, type_name in _wanted_topics(self._node, [*self._further(), *self._stop]).items():
            if name in self.topics or name in self.refused:
                continue
            infos = self._node.get_publishers_info_by_topic(name)
            if not infos:
                continue
            try:
                kind = message_type(type_name)
                topic = RecordedTopic(described_channel(name, type_name, infos))
            except BagError as error:
                self.refused[name] = str(error)
                self._node.get_logger().error(f"{name} cannot be recorded: {error}")
                continue
            qos = adapted_qos([info.qos_profile for info in infos])
            self._subscribe(topic, kind, qos)
            self.topics[name] = topic  # only now: a subscription that fails is tried again

    def _subscribe(self, topic: RecordedTopic, kind: type, qos: QoSProfile) -> None:
        name = topic.channel.topic

        def missed(count: int, to_ns: int, reason: str) -> None:
            self._missed(Dropout(name, min(topic.heard_ns, to_ns), to_ns, count, reason))

        fast = self._is_fast(name)

        def handle(batch: Batch) -> None:
            ours, others = self._node.accepted.split(name, batch)
            if others:  # kept on a topic of their own, apart from the run's publishers
                self._hand_over(_beside_a_run(self._node, topic), others)
            if ours:
                self._heard(topic, ours, missed)

        def message_lost(event: Any) -> None:
            if lost := topic.losses.report(event.total_count_change):
                missed(lost, time.time_ns(), REPORTED)

        def incompatible(event: Any) -> None:
            self._incompatible[f"{names.UNHEARD} {name}"] += event.total_count_change
            for _ in range(event.total_count_change):
                missed(0, time.time_ns(), UNHEARD)

        self._drained.append(
            DrainedSubscription(
                self._node,
                kind,
                name,
                qos,
                self._node.health.guarded(handle),
                raw=True,
                event_callbacks=SubscriptionEventCallbacks(
                    message_lost=message_lost, incompatible_qos=incompatible
                ),
                group=UNWAITED if fast else None,
            )
        )
        if fast:
            self._fast.append(self._drained[-1])

    def _heard(
        self, topic: RecordedTopic, batch: Batch, missed: Callable[[int, int, str], None]
    ) -> None:
        """Note how far a topic has come and what is missing, and hand its messages over."""
        topic.latest, topic.heard_s = batch[-1][0], time.monotonic()
        topic.sent_ns = sent_ns(batch[-1][1])
        if topic.channel.topic == names.TF_STATIC:
            topic.latched.append(SerializedMessages.taken(topic.channel, batch))
        elif topic.channel.topic.endswith((f"/{names.GOAL}", f"/{names.GOAL_STATUS}")):
            topic.latched.clear()  # published before the bag begins; the last one counts
            topic.latched.append(SerializedMessages.taken(topic.channel, batch[-1:]))
        for _, info in batch:
            received_ns = info["received_timestamp"] or time.time_ns()
            if (lost := _lost_before(topic, info)) is not None:
                missed(lost, received_ns, GAP)
            topic.heard_ns = received_ns
        self._hand_over(topic, batch)


def _beside_a_run(node: Node, topic: RecordedTopic) -> RecordedTopic:
    """Return the channel that keeps messages of publishers which a run ignores."""
    last = topic.channel.topic.rpartition("/")[2]
    beside = node.resolve_topic_name(f"~/{last}_{names.LEFT_ALONE}")
    return RecordedTopic(replace(topic.channel, topic=beside))


def _lost_before(topic: RecordedTopic, info: Any) -> int | None:
    """Return how many messages are newly missing before one, by its number; None: none."""
    publisher = info.get("publisher_gid")
    if publisher is None:
        return None
    return topic.losses.number(info.get("publication_sequence_number"), bytes(publisher["data"]))


def _wanted_topics(node: Node, further: Collection[str]) -> dict[str, str]:
    """Return name -> type of all topics to record: namespace, diagnostics, log, others.

    Of the hidden topics only the status of the cell's action is among them.
    """
    prefix = node.get_namespace().rstrip("/") + "/"
    further = {*further, prefix + names.GOAL_STATUS}
    return {
        name: types[0]
        for name, types in node.get_topic_names_and_types()
        if name in further or ((name in ALWAYS or name.startswith(prefix)) and "/_" not in name)
    }


class ReceiptPublisher:
    """Confirms observations on a topic as soon as they and their readings are on disk."""

    def __init__(
        self,
        node: CellNode,
        called: TopicRoleFinder,
        listener: TopicListener,
        session: RecordedSession,
    ) -> None:
        self._clock, self._called, self._listener = node.get_clock(), called, listener
        self._logger, self._awake = node.get_logger(), node.health.awake
        self._session, self._pending = session, PendingReceipts(answered=False)
        self._publisher = node.create_publisher(
            msg.RecordedObservation, names.OBSERVATION_RECORDED, EVENT
        )

    def begin(self) -> None:
        """Forget what is still waiting; called when a bag begins."""
        points = self._listener.topics.get(self._called.topic(names.PROBE_POINT))
        self._pending = PendingReceipts(answered=points is not None and _echoes(points))

    def receive(self, topic: RecordedTopic, batch: Batch) -> None:
        """Note observations, which need a receipt, and the points that answer orders."""
        name = topic.channel.topic
        if name == self._called.topic(names.OBSERVATION):
            for data, _ in batch:
                seen = self._session.take(data)
                self._pending.expect(seen.step, seen.attempt, stamp_ns(seen.window_end))
        elif name == self._called.topic(names.TABLE_ANGLE):
            for data, _ in batch:
                order = deserialize_message(data, msg.TableAngle)
                self._pending.order(order.step, order.attempt, turn=bool(order.turn_speed))
        elif name == self._called.topic(names.PROBE_POINT) and _echoes(topic):
            for data, _ in batch:
                point = deserialize_message(data, msg.ProbePoint)
                self._pending.answer(point.step, point.attempt)

    def due(self, losses: Callable[[], Mapping[str, int]]) -> Iterator[WriteReceipt]:
        """Yield what can be confirmed; ``losses`` counts from the opening of the bag."""
        reached_ns = self._listener.reached_ns(NEEDED, self._called.topic)
        if not self._pending:
            self._pending.reach(reached_ns or 0)
            return
        lost = self._called.lost(losses())
        for receipt in self._pending.due(reached_ns, lost, self._awake.now_s()):
            if not self._pending.is_answered(receipt):
                self._logger.warning(
                    f"step {receipt.step}, attempt {receipt.attempt}: the point that answered the "
                    "order has not arrived; it counts as lost"
                )
            yield receipt

    def confirm(self, receipt: WriteReceipt, file: str) -> None:
        """Publish a receipt; called from the writer's thread."""
        message = msg.RecordedObservation(**asdict(receipt), file=file)
        message.header.stamp = self._clock.now().to_msg()
        self._publisher.publish(message)


def _echoes(points: RecordedTopic) -> bool:
    """Return whether the points say which order they answer."""
    return points.channel.type_name == OWN[names.PROBE_POINT]


def attach_provenance(recording: BagRecording, configuration_text: str) -> None:
    """Put the configuration, what it measures and the versions into a bag."""
    recording.attach(names.CONFIGURATION, "application/yaml", configuration_text.encode())
    recording.note(names.SUBJECT, measured_subject(configuration_text))
    recording.attach(names.VERSIONS, "application/json", versions_json().encode())


def measured_subject(configuration_text: str) -> dict[str, str]:
    """Return what a configuration measures, for a bag's metadata; empty when it says nothing.

    The method is not loaded: that takes longer than a recorder may be silent.
    """
    with suppress(ConfigurationError):
        identity, simulated = read_subject(configuration_text)
        return {"item": identity.title, "simulated": str(simulated).lower()}
    return {}


def versions_json() -> str:
    """Return the versions of packages, Python, operating system and middleware as JSON."""
    installed = {package: _version(package) for package in _PACKAGES}
    versions = {
        "rotcal_ros": __version__,
        "python": platform.python_version(),
        **{package: found for package, found in installed.items() if found},
        "system": platform.platform(),
        "ros_distro": distribution(rclpy_version()) or "",
        "rmw": get_rmw_implementation_identifier(),
    }
    return json.dumps(versions, indent=1)


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


class NodeParameters:
    """The parameters of all nodes, as JSON in a bag: node name -> parameter -> value.

    All are asked at once while the calibration begins, again and again where they are slow. A node
    that has not answered after ASKING_S, or when the bag was closed, is null.
    """

    def __init__(self, recording: BagRecording, node: CellNode) -> None:
        self._recording, self._node = recording, node
        self._found: dict[str, Any] = {}
        self._attached = False

    async def ask(self) -> None:
        """Ask all nodes that beat or are in the cell's namespace."""
        node, namespace = self._node, self._node.get_namespace()
        listed = {n for n, space in node.get_node_names_and_namespaces() if space == namespace}
        others = sorted((listed | node.health.present()) - {node.get_name()})
        own = node.get_parameters_by_prefix("")
        self._found = dict.fromkeys(others)
        self._found[node.get_name()] = {key: _plain(mine.value) for key, mine in own.items()}
        for name in others:
            node.begin(self._ask, name, f"{namespace.rstrip('/')}/{name}")
        await wait_for_condition(lambda: None not in self._found.values(), ASKING_S)
        self.attach()

    async def _ask(self, name: str, remote: str) -> None:
        """Ask one node until it has answered; a silent one does not hold up the others."""
        while self._found[name] is None and not self._attached:
            self._found[name] = await _parameters_of(self._node, remote)

    def attach(self) -> None:
        """Put the answers so far into the bag, once."""
        if not self._attached:
            text = json.dumps(self._found, indent=1, sort_keys=True)
            self._recording.attach(names.PARAMETERS, "application/json", text.encode())
        self._attached = True


async def _parameters_of(node: Node, remote: str) -> dict[str, Any] | None:
    lister = node.create_client(ListParameters, f"{remote}/list_parameters")
    getter = node.create_client(GetParameters, f"{remote}/get_parameters")
    try:
        listed = await _ask(lister, ListParameters.Request())
        if listed is None:
            return None
        wanted = sorted(listed.result.names)
        answer = await _ask(getter, GetParameters.Request(names=wanted))
        values = [] if answer is None else list(answer.values)
        if len(values) == len(wanted):
            return dict(zip(wanted, map(_value, values), strict=True))
        found: dict[str, Any] = {}
        # Asked for several, a node answers with none if one of them has no value.
        for name in wanted:
            answer = await _ask(getter, GetParameters.Request(names=[name]))
            if answer is not None and answer.values:
                found[name] = _value(answer.values[0])
        return found
    finally:
        node.destroy_client(lister)
        node.destroy_client(getter)


async def _ask(client: Client, request: Any) -> Any | None:
    if not await wait_for_condition(client.service_is_ready, PARAMETERS_TIMEOUT_S):
        return None
    future = client.call_async(request)
    return future.result() if await wait_for_condition(future.done, PARAMETERS_TIMEOUT_S) else None


def _value(parameter: ParameterValue) -> Any:
    return _plain(parameter_value_to_python(parameter))


def _plain(value: Any) -> Any:
    return value if value is None or isinstance(value, bool | int | float | str) else list(value)


def main() -> None:
    """Run the recorder."""
    run_node(RecorderNode)


if __name__ == "__main__":
    main()
