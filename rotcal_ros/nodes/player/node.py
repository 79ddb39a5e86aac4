"""The player: publishes a recorded bag at its own pace, for nodes and viewers without a machine.

It speaks JSON lines, for ``rotcal replay``: ``reading``, ``left_out``, ``note``, ``playing``,
``solving``, ``result``. SIGINT or SIGTERM ends it.

TopicConflictGuard finds nodes that forbid a replay: a machine that would move, a second source of
a topic. ReplayObserver compares what live nodes made of the bag with the recording.
"""

from __future__ import annotations

import json
import sys
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, Final

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.utilities import remove_ros_args
from rosgraph_msgs.msg import Clock
from rotcal_msgs.msg import CalibrationPlan
from rotcal_msgs.msg import Observation as ObservationMsg
from rotcal_msgs.srv import FinishCalibration

from rotcal_ros.bags import names
from rotcal_ros.bags.definitions import ChannelDefinition
from rotcal_ros.bags.reader import read_blocks
from rotcal_ros.bags.rosbag2_metadata import INFINITE_NS, qos_profiles
from rotcal_ros.bags.unread_data import collect_unread
from rotcal_ros.capture import messages
from rotcal_ros.capture.publishers import RUN, unique_run_name
from rotcal_ros.evaluation.marks import marks
from rotcal_ros.foundation.errors import BagError, ConfigurationError, DataError
from rotcal_ros.foundation.files import write_atomically
from rotcal_ros.foundation.middleware import LOCALHOST
from rotcal_ros.foundation.node_names import NODES, VIEWERS
from rotcal_ros.foundation.node_state import Why
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import NANOSECOND
from rotcal_ros.nodes.player.replayed_bag import CLOCK, ReplayedBag, accepted_by_attempt
from rotcal_ros.nodes.recorder.bookkeeping import NEVER_PAUSE
from rotcal_ros.nodes.runtime.conversions import time_message
from rotcal_ros.nodes.runtime.health import Health
from rotcal_ros.nodes.runtime.message_types import importable_type
from rotcal_ros.nodes.runtime.qos import EVENT
from rotcal_ros.nodes.runtime.running import EndRequest, PeerNode, print_event, run_and_exit

VOLATILE_DEPTH: Final = 5000
"""Messages kept for slow readers: the graph does not show the depth of a publisher's queue."""
_BEST_EFFORT: Final = ("best_effort", 2)
_TRANSIENT_LOCAL: Final = ("transient_local", 1)
"""In words, and the numbers of older bags."""


def offered_qos(text: str) -> QoSProfile:
    """Return the profile that a channel's ``offered_qos_profiles`` asks for.

    Of several publishers it is what all offered; if the bag says nothing it is ROS's default.
    """
    profiles = qos_profiles(text)
    best_effort = any(p["reliability"] in _BEST_EFFORT for p in profiles)
    latched = bool(profiles) and all(p["durability"] in _TRANSIENT_LOCAL for p in profiles)
    known = max((p["depth"] for p in profiles if isinstance(p["depth"], int)), default=0)
    found = QoSProfile(
        depth=max(known, 1) if latched else max(known, VOLATILE_DEPTH),
        reliability=ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
        durability=(DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE),
    )
    for name in ("deadline", "lifespan"):
        limits = [ns for p in profiles if (ns := _finite_ns(p[name])) is not None]
        if limits:
            setattr(found, name, Duration(nanoseconds=max(limits)))
    return found


def _finite_ns(duration: Any) -> int | None:
    """Return a duration of a bag in ns; None if it is no limit."""
    try:
        nanoseconds = int(duration["sec"]) * 1_000_000_000 + int(duration["nsec"])
    except (KeyError, TypeError, ValueError):
        return None
    return nanoseconds if 0 < nanoseconds < INFINITE_NS else None


CLOCK_PERIOD_S: Final = 0.01


class ReplayPace:
    """``rate`` seconds of the recording, which begins at ``start_ns``, pass in one second."""

    def __init__(self, node: Node, start_ns: int, rate: float, *, clock: bool) -> None:
        self._start_ns, self._rate = start_ns, rate
        self._clock = node.create_publisher(Clock, CLOCK, 10) if clock else None
        self._begun_s, self._told_s = time.monotonic(), 0.0

    def begin(self) -> None:
        """Begin now."""
        self._begun_s = time.monotonic()

    def add_pause(self, seconds: float) -> None:
        """Go on after a pause as if there had been none."""
        self._begun_s += seconds

    def passed_s(self) -> float:
        """Return how much of the recording has passed, in s."""
        return (time.monotonic() - self._begun_s) * self._rate

    def left_s(self, log_time_ns: int) -> float:
        """Return how long it is, in s, until a message is due; negative: it is late."""
        due_s = self._begun_s + (log_time_ns - self._start_ns) * NANOSECOND / self._rate
        return due_s - time.monotonic()

    def tick(self) -> None:
        """Publish the time of the recording, when that is due."""
        if self._clock is not None and time.monotonic() - self._told_s > CLOCK_PERIOD_S:
            self._told_s = time.monotonic()
            now_ns = self._start_ns + int(self.passed_s() / NANOSECOND)
            self._clock.publish(Clock(clock=time_message(now_ns)))


def read_arguments(argv: Sequence[str]) -> Namespace:
    """Return the options of the player; wrong ones end the process."""
    parser = ArgumentParser(prog="player")
    parser.add_argument("bag", type=Path)
    parser.add_argument("--rate", type=float, default=1.0)
    parser.add_argument("--clock", action="store_true")
    parser.add_argument("--all", dest="everything", action="store_true")
    parser.add_argument("--no-finish", action="store_true")
    parser.add_argument("--wait-for", dest="nodes", action="append", default=[])
    parser.add_argument("--watcher", dest="watchers", action="append", default=[])
    parser.add_argument("--result", type=Path)
    return parser.parse_args(argv)


LOOK_AROUND_S: Final = 2.0
"""The graph is watched for this long before anything is published."""
LISTENERS_S, PLAN_TAKEN_S, NODES_S = 10.0, 120.0, 60.0
TOLD_PERIOD_S: Final = 0.2
_AHEAD_S: Final = 5e-4  # shorter waits are not worth a sleep


class PlaybackInterruptedError(Exception):
    """The user has ended it."""


class Player:
    """Plays one bag once."""

    def __init__(
        self, peer: PeerNode, bag: ReplayedBag, given: Namespace, end: EndRequest
    ) -> None:
        self._peer, self._bag, self._given, self._end = peer, bag, given, end
        self._node = peer.node
        self._health = Health(self._node, None)
        self._outcome = ReplayObserver(peer, bag, self._health, end, everything=given.everything)
        self._guard = TopicConflictGuard(self._node, self._health, bag, given, self._wait)
        self._told_s = 0.0
        self._pace = ReplayPace(self._node, bag.start_ns, given.rate, clock=given.clock)
        self._publishers: dict[str, Publisher] = {}

    def play(self) -> None:
        """Publish everything, then have the solver finish.

        ConfigurationError if a node forbids it.
        """
        self._wait(lambda: False, LOOK_AROUND_S)
        missing = partial(self._health.missing, self._given.nodes)
        if not self._wait(lambda: not missing(), NODES_S):
            raise ConfigurationError(f"not here within {NODES_S:g} s: {', '.join(missing())}")
        self._guard.poll(*self._bag.channels)
        self._make_publishers()
        unheard = partial(self._outcome.unsubscribed_topics, self._publishers, with_plan=False)
        self._wait(lambda: not unheard(), LISTENERS_S)
        self._pace.begin()
        for scan, block in read_blocks(self._bag.files):
            if block is None:
                continue
            for row in range(len(block)):
                channel = scan.channels[int(block.headers["channel"][row])]
                if channel.topic in self._publishers:
                    self._wait_until(int(block.headers["log_time"][row]))
                    self._publish(channel, block.payload(row))
        print_event("playing", done_s=self._bag.seconds, total_s=self._bag.seconds)
        self._outcome.tell(self._given.result, finish=not self._given.no_finish)

    def _publish(self, channel: ChannelDefinition, data: bytes) -> None:
        role = self._bag.called.role(channel.topic)
        plan = deserialize_message(data, CalibrationPlan) if role == names.PLAN else None
        if plan is not None and unique_run_name(plan) in self._bag.strangers:
            return
        if role in ORDERS:  # a machine may have appeared since the last look
            self._guard.poll(channel.topic)
        self._publishers[channel.topic].publish(data)
        if plan is not None:
            self._have_taken(plan)

    def _make_publishers(self) -> None:
        """Make a publisher for each topic whose type is installed as it was recorded."""
        for topic, channel in self._bag.channels.items():
            try:
                kind = importable_type(channel.type_name, channel.type_hash)
            except BagError as error:
                self._bag.left_out[topic] = str(error)
                continue
            qos = offered_qos(channel.offered_qos)
            self._publishers[topic] = self._node.create_publisher(kind, topic, qos)
        for topic, why in self._bag.left_out.items():
            print_event("left_out", topic=topic, why=why)
        for text in self._outcome.notes(self._given.clock):
            print_event("note", text=text)

    def _have_taken(self, plan: CalibrationPlan) -> None:
        """Let the nodes take a plan before the orders come, as a planner does."""
        nodes, run = sorted(self._outcome.live()), unique_run_name(plan)

        def not_yet() -> list[str]:
            here = self._outcome.live()
            return [n for n in nodes if n in here and self._health.values(n).get(RUN) != run]

        def settled() -> bool:
            states = map(self._health.node_state, nodes)
            return not not_yet() or any(state.has(Why.PLAN_REFUSED) for state in states)

        if not self._wait(settled, PLAN_TAKEN_S) or not_yet():
            states = "; ".join(f"{node}: {self._health.describe(node)}" for node in nodes)
            raise ConfigurationError(
                f"the plan of the bag is not taken ({states}): start the nodes with the bag's "
                "configuration"
            )
        unheard = partial(self._outcome.unsubscribed_topics, self._publishers, with_plan=True)
        if not self._wait(lambda: not unheard(), LISTENERS_S):
            left = ", ".join(sorted(unheard()))
            print_event(
                "note", text=f"warning: {' and '.join(nodes)} do not listen to all of {left}"
            )

    def _wait_until(self, log_time_ns: int) -> None:
        """Wait until it is time for a message; meanwhile the clock runs, and Ctrl-C is handled."""
        while (left_s := self._pace.left_s(log_time_ns)) > _AHEAD_S:
            self._look()
            self._peer.work_until(lambda: False, min(left_s, CLOCK_PERIOD_S))
        self._look()

    def _wait(self, condition: Any, timeout_s: float) -> bool:
        """Wait while the recording stands still; False after the time-out."""
        begun_s = time.monotonic()
        while not (met := condition()) and time.monotonic() - begun_s < timeout_s:
            if self._end:
                raise PlaybackInterruptedError
            self._peer.work_until(condition, CLOCK_PERIOD_S)
        self._pace.add_pause(time.monotonic() - begun_s)
        return bool(met)

    def _look(self) -> None:
        """Do what is due: the clock, the progress, the look at the graph."""
        if self._end:
            raise PlaybackInterruptedError
        now_s = time.monotonic()
        self._pace.tick()
        if now_s - self._told_s > TOLD_PERIOD_S:
            self._told_s = now_s
            self._peer.work_until(lambda: True, 0.0)
            done_s = min(self._pace.passed_s(), self._bag.seconds)
            print_event("playing", done_s=done_s, total_s=self._bag.seconds)
        if self._guard.is_due():
            self._guard.poll(*self._publishers)


def _work() -> None:
    end = EndRequest()
    given = read_arguments(remove_ros_args(sys.argv)[1:])
    told_s = 0.0

    def reading(done: int, total: int) -> None:
        nonlocal told_s
        if time.monotonic() - told_s > TOLD_PERIOD_S:
            told_s = time.monotonic()
            print_event("reading", done=done, total=total)
        if end:
            raise PlaybackInterruptedError

    try:
        with collect_unread() as missing:
            bag = ReplayedBag.read(given.bag, everything=given.everything, progress=reading)
        print_event("unread", texts=list(missing))
        peer = PeerNode("player", bag.namespace, sys.argv)
        try:
            Player(peer, bag, given, end).play()
        finally:
            peer.close()
    except PlaybackInterruptedError:
        print_event("interrupted")


WATCHERS: Final = frozenset({
    *NODES, *VIEWERS.values(), "player", "foxglove_bridge", "rosbridge_websocket",
    "rosbag2_recorder", "rviz", "rviz2", "rqt_gui_py_node",
})  # fmt: skip
"""Nodes that listen to orders but do not obey them."""
ORDERS: Final = (names.TABLE_ANGLE, names.PROBE_TARGET)
"""Roles that move machines."""
_COMMAND_LINE: Final = "_ros2cli"
_OF_THE_PLANNER: Final = (
    names.PLAN, names.TABLE_ANGLE, names.PROBE_TARGET, names.STEP_CHOICE
)  # fmt: skip
"""Roles that an idle planner is known to publish."""
_NAMELESS: Final = "_NODE_NAME_UNKNOWN_"
"""What the middleware calls a node whose topics it discovers before its name."""
_NAMES_S, _PERIOD_S = 10.0, 1.0
Wait = Callable[[Callable[[], bool], float], object]


class TopicConflictGuard:
    """Looks at the graph again and again; ``wait`` waits while the recording stands still.

    A node's topics are known before its name: each gets some time to be named.
    """

    def __init__(
        self, node: Node, health: Health, bag: ReplayedBag, given: Namespace, wait: Wait
    ) -> None:
        self._node, self._health, self._bag, self._given = node, health, bag, given
        self._wait = wait
        self._looked_s = 0.0
        self._had_time = set[bytes]()

    def is_due(self) -> bool:
        """Return whether the last look was long ago."""
        return time.monotonic() - self._looked_s > _PERIOD_S

    def poll(self, *topics: str) -> None:
        """Raise ConfigurationError when a machine, or another source, of ``topics`` is there."""
        self._wait(lambda: not self._nameless(topics), _NAMES_S)
        self._had_time |= self._nameless(topics)
        self._looked_s = time.monotonic()
        if found := topic_conflicts(self._node, self._health, self._bag, topics, self._given):
            raise ConfigurationError("; ".join(found))

    def _nameless(self, topics: Iterable[str]) -> set[bytes]:
        """Return publishers of ``topics`` and listeners to orders without a name, by their gid."""
        publishers, listeners = (
            self._node.get_publishers_info_by_topic,
            self._node.get_subscriptions_info_by_topic,
        )
        ends = [info for topic in topics for info in publishers(topic)]
        orders = [topic for topic in topics if self._bag.called.role(topic) in ORDERS]
        ends += [info for topic in orders for info in listeners(topic)]
        found = {bytes(info.endpoint_gid) for info in ends if info.node_name == _NAMELESS}
        return found - self._had_time


def topic_conflicts(
    node: Node, health: Health, bag: ReplayedBag, topics: Iterable[str], given: Namespace
) -> list[str]:
    """Return why these topics must not be published here, in words."""
    if not given.everything and health.is_calibrating():
        return ["a calibration is running here (node planner): nothing is replayed into it"]
    found = [*_moved(node, bag, topics, given.watchers), *_sources(node, bag, topics)]
    if given.clock and (others := _publishers(node, CLOCK)):
        found.append(f"{', '.join(others)} publishes {CLOCK} already: leave --clock out")
    return found


def _moved(
    node: Node, bag: ReplayedBag, topics: Iterable[str], watchers: Iterable[str]
) -> Iterator[str]:
    """Yield which machines would obey the recorded orders."""
    harmless = WATCHERS | {*watchers}
    for topic in topics:
        if bag.called.role(topic) not in ORDERS:
            continue
        listening = {info.node_name for info in node.get_subscriptions_info_by_topic(topic)}
        for name in sorted(listening - harmless):
            if not name.startswith(_COMMAND_LINE):
                yield (
                    f"node {name} listens to {topic}: replayed orders would move its machine; end "
                    "it, use another ROS_DOMAIN_ID, or declare that it only watches: --watcher "
                    f"{name}"
                )


def _sources(node: Node, bag: ReplayedBag, topics: Iterable[str]) -> Iterator[str]:
    """Yield which topics another node publishes already."""
    for topic in topics:
        others = _publishers(node, topic)
        if bag.called.role(topic) in _OF_THE_PLANNER:
            others = [name for name in others if name != "planner"]
        if others and not topic.startswith(("/rosout", "/diagnostics")):
            yield (
                f"{', '.join(others)} publishes {topic} already: end it, use another "
                "ROS_DOMAIN_ID" + (", or leave --all out" if topic in bag.outputs else "")
            )


def _publishers(node: Node, topic: str) -> list[str]:
    found = {info.node_name for info in node.get_publishers_info_by_topic(topic)}
    return sorted(found - {node.get_name()})


ARRIVAL_S: Final = 10.0
"""The last observations may take this long after the last message."""
SOLVE_S: Final = 3600.0
_SHOWN: Final = 3


class ReplayObserver:
    """Hears what the live capture observes, and has the live solver finish."""

    needed: Final = {
        "capture": (
            names.PLAN, names.TABLE_ANGLE, names.PROBE_TARGET, names.PROBE_POINT, *NEVER_PAUSE
        ),
        "solver": (names.PLAN, names.TABLE_IN_FORCE),
    }  # fmt: skip
    """The roles that a node has to listen to before anything is published."""

    def __init__(
        self,
        peer: PeerNode,
        bag: ReplayedBag,
        health: Health,
        end: EndRequest,
        *,
        everything: bool,
    ) -> None:
        self._peer, self._bag, self._health, self._end = peer, bag, health, end
        self._everything = everything
        self._observed: list[Observation] = []
        topic = bag.called.topic(names.OBSERVATION)
        peer.node.create_subscription(ObservationMsg, topic, self._hear, EVENT)
        self._finish = peer.node.create_client(FinishCalibration, "finish_calibration")

    def live(self) -> set[str]:
        """Return which of the nodes that make the result again are here, not replayed."""
        return set() if self._everything else self._health.present() & self.needed.keys()

    def unsubscribed_topics(
        self, published: Mapping[str, Publisher], *, with_plan: bool
    ) -> set[str]:
        """Return the ``published`` topics to which live nodes do not listen yet that need them.

        Those of another name they know ``with_plan`` only.
        """
        found = set()
        for node in self.live():
            for topic in published.keys() & {*self._bag.roles(*self.needed[node])}:
                listening = self._peer.node.get_subscriptions_info_by_topic(topic)
                matched = published[topic].get_subscription_count() >= len(listening)
                known = with_plan or topic not in self._bag.called.topics.values()
                if known and not (matched and node in {info.node_name for info in listening}):
                    found.add(topic)
        return found

    def notes(self, clock: bool) -> Iterator[str]:
        """Yield what the user should know before it begins."""
        if not self._bag.plan_id:
            yield "the bag holds no plan: capture and solver do not begin"
        elif (missing := sorted(self.needed.keys() - self.live())) and not self._everything:
            yield (
                f"not here: {', '.join(missing)}; messages go to whoever listens (start nodes "
                "first, such as: ros2 run rotcal_ros capture --ros-args -r "
                f"__ns:={self._bag.namespace})"
            )
        if remappings := self._bag.remappings():
            yield (
                "some topics had other names; nodes hear them with the configuration in the bag, "
                f"or --ros-args {' '.join(remappings)}"
            )
        if anew := self._bag.taken_when_sent():
            yield (
                f"warning: {', '.join(anew)}: stamped when they are sent (no header, or "
                "topics.*_clock: sent), which is now; observations differ from the recorded ones, "
                "and together with streams that have recorded stamps there are none: rotcal solve "
                "reads the bag"
            )
        if clock:
            yield "nodes with use_sim_time: true follow /clock"

    def tell(self, result: Path | None, *, finish: bool) -> None:
        """Report the outcome, and keep the result if wanted."""
        found: dict[str, object] = {}
        if "capture" in self.live() and self._bag.plan_id:
            found = self._compared()
        if finish and "solver" in self.live() and self._bag.plan_id:
            found |= self._solved(result)
        elif result is not None:
            raise ConfigurationError(
                f"no result for {result}: no solver was asked for it; start one, or leave out "
                "--result"
            )
        print_event("result", **found)

    def _hear(self, message: ObservationMsg) -> None:
        self._observed.append(messages.observation(message))

    def _compared(self) -> dict[str, object]:
        """Return how the observations compare with those of the recording."""
        recorded = self._bag.accepted
        self._wait(
            lambda: recorded.keys() <= accepted_by_attempt(self._observed).keys(), ARRIVAL_S
        )
        live = accepted_by_attempt(self._observed)
        different = sorted(
            attempt for attempt in recorded.keys() | live.keys()
            if live.get(attempt) != recorded.get(attempt)
        )  # fmt: skip
        first = (f"step {step} (attempt {number})" for _, step, number in different[:_SHOWN])
        return {
            "observed": len(live),
            "recorded": len(recorded),
            "different": len(different),
            "first_different": ", ".join(first),
        }

    def _solved(self, path: Path | None) -> dict[str, object]:
        """Have the solver finish, as a planner does; DataError when it gives no result."""
        print_event("solving")
        if not self._wait(self._finish.service_is_ready, ARRIVAL_S):
            raise DataError(
                "node solver does not offer finish_calibration: look at its log, and start it "
                "again"
            )
        request = FinishCalibration.Request(plan_id=self._bag.plan_id, steps=self._bag.steps)
        future = self._finish.call_async(request)
        if not self._wait(future.done, SOLVE_S):
            raise DataError(
                f"the solver gave no answer within {SOLVE_S:g} s: solve the bag (rotcal solve)"
            )
        answer = future.result()
        if not answer.success:
            raise DataError(f"no result: {answer.message}")
        if path is not None:
            try:
                write_atomically(path, answer.result_json)
            except OSError as error:
                raise ConfigurationError(
                    f"cannot write {path}: {error}; choose another --result"
                ) from error
        result = Result.from_dict(json.loads(answer.result_json))
        return {
            "verdict": answer.verdict,
            "verdict_line": result.verdict_line,
            "marks": [asdict(mark) for mark in marks(result)],
        }

    def _wait(self, condition: object, timeout_s: float) -> bool:
        assert callable(condition)
        self._peer.work_until(lambda: bool(self._end) or condition(), timeout_s)
        return bool(condition())


def main() -> None:
    """Play a bag until its end."""
    run_and_exit(_work, LOCALHOST)


if __name__ == "__main__":
    main()
