"""Links the planner to the cell: what it publishes and receives, and what is missing.

The pause of a running goal is published on ``pause`` and ended by the service ``resume``.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Collection, Iterable, Sequence
from math import nan
from typing import Final

from rotcal_msgs import msg
from rotcal_msgs.srv import FinishCalibration, StartRecording, StopRecording
from std_srvs.srv import Trigger

from rotcal_ros.bags import names
from rotcal_ros.bags.topic_roles import TOPIC, plain_name
from rotcal_ros.capture import messages
from rotcal_ros.capture.publishers import RUN, Offers, PublisherList, publisher_of
from rotcal_ros.evaluation.marks import why_verdict_withholds
from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.foundation.middleware import discovery_in_words
from rotcal_ros.foundation.node_names import PREFLIGHT_NODES, VIEWERS
from rotcal_ros.foundation.node_state import STOPS, Reason
from rotcal_ros.foundation.observations import Command, Observation
from rotcal_ros.nodes.runtime import conversions
from rotcal_ros.nodes.runtime.accepted_publishers import APART, HEARS, accepted_publishers_hash
from rotcal_ros.nodes.runtime.announced_plan import REFUSED_RUN
from rotcal_ros.nodes.runtime.beat_values import LISTENS, set_warning
from rotcal_ros.nodes.runtime.cell_graph import ORDERS, CellGraph
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.managed_node import inactive_node_hints
from rotcal_ros.nodes.runtime.message_types import ONE_VERSION
from rotcal_ros.nodes.runtime.qos import EVENT, LATCHED
from rotcal_ros.planning.plan import MACHINE_FRAME, OperatorMove


class CellServices:
    """One client for each service."""

    def __init__(self, node: CellNode) -> None:
        self.start_recording = node.create_client(StartRecording, "start_recording")
        self.continue_recording = node.create_client(StartRecording, "continue_recording")
        self.recorded_observations = node.create_client(Trigger, "recorded_observations")
        self.stop_recording = node.create_client(StopRecording, "stop_recording")
        self.finish_calibration = node.create_client(FinishCalibration, "finish_calibration")

    def missing(self) -> list[str]:
        """Return which services are not offered, in words."""
        of_recorder = (
            self.start_recording,
            self.continue_recording,
            self.recorded_observations,
            self.stop_recording,
        )
        needed = [("recorder", client) for client in of_recorder]
        return [
            f"node {node} does not offer {client.srv_name}"
            for node, client in (*needed, ("solver", self.finish_calibration))
            if not client.service_is_ready()
        ]


SPARE: Final = frozenset({"bridge", *VIEWERS.values()})
"""Nodes that may be inactive while a calibration runs."""
OWNERS: Final = {
    names.OBSERVATION: "capture", names.OBSERVATION_RECORDED: "recorder",
    **dict.fromkeys((*ORDERS, names.PLAN, names.GOAL, names.STEP_CHOICE), "planner"),
}  # fmt: skip
"""Topic -> the only node whose messages count there."""
Attempt = tuple[int, int]
"""Step and attempt."""


class CellLinks:
    """Publishers, subscriptions and clients, and what has arrived for the steps so far."""

    def __init__(self, node: CellNode) -> None:
        self.node = node
        self.health = node.health
        self.graph = CellGraph(node)
        self.observations: dict[Attempt, Observation] = {}
        self.receipts: dict[Attempt, int] = {}
        self.current_std = math.nan
        self._plan_id = ""
        self.goals = node.create_publisher(msg.CalibrationGoal, names.GOAL, LATCHED)
        self.progress = node.create_publisher(msg.CalibrationProgress, names.PROGRESS, EVENT)
        self._publish()
        node.listen(msg.Observation, names.OBSERVATION, self._observed, EVENT, judged=True)
        node.listen(
            msg.RecordedObservation, names.OBSERVATION_RECORDED, self._recorded, EVENT, judged=True
        )
        node.listen(msg.DeviationArray, "deviations", self._solved, LATCHED)
        self.services = CellServices(node)

    def _publish(self) -> None:
        node = self.node
        self._plans = node.create_publisher(msg.CalibrationPlan, names.PLAN, LATCHED)
        self._tables = node.create_publisher(msg.TableAngle, names.TABLE_ANGLE, EVENT)
        self._probes = node.create_publisher(msg.ProbeTarget, names.PROBE_TARGET, EVENT)
        self._choices = node.create_publisher(msg.StepChoice, names.STEP_CHOICE, EVENT)

    def publish_anew(self) -> None:
        """Replace all publishers: new ones may be discovered even if the old ones were not."""
        for publisher in (self._plans, self._tables, self._probes, self._choices):
            self.node.destroy_publisher(publisher)
        self._publish()

    def forget(self) -> None:
        """Forget what arrived for an earlier goal."""
        self.observations.clear()
        self.receipts.clear()
        self.current_std = math.nan

    def last_accepted(self, attempts: Iterable[Attempt]) -> Observation | None:
        """Return the last accepted observation among these attempts."""
        came = (self.observations.get(attempt) for attempt in attempts)
        return max(
            (o for o in came if o is not None and o.accepted),
            key=lambda o: o.attempt,
            default=None,
        )

    def announce(self, plan: msg.CalibrationPlan) -> None:
        """Publish the plan."""
        self._plan_id = plan.plan_id
        self._plans.publish(plan)

    def publish_choice(self, choice: msg.StepChoice) -> None:
        """Publish what is measured next, and why."""
        self._choices.publish(choice)

    def order(self, command: Command) -> None:
        """Order the table to its angle and the probe to its target."""
        table, probe = conversions.command_messages(command, self.node.now_ns())
        self._tables.publish(table)
        self._probes.publish(probe)

    def warn(self, key: str, texts: Sequence[str]) -> None:
        """Show what looks wrong; with no texts the warning is over."""
        for text in texts:
            self.node.get_logger().warning(text)
        set_warning(self.health, key, "; ".join(texts))

    def instrument(self, role: str) -> str:
        """Return the absolute name of an instrument's topic, as the capture knows it."""
        plain = plain_name(self.node.get_namespace(), role)
        return self.health.values("capture").get(TOPIC + role, plain)

    def missing_nodes(self) -> list[str]:
        """Return what keeps the nodes of the suite from working together, in words."""
        lost = [f"node {name} does not beat" for name in self.health.missing(PREFLIGHT_NODES)]
        lost += self.idle_nodes()
        return lost or self.services.missing()[:1]

    def other_versions(self, topics: Collection[str] = ()) -> list[str]:
        """Return which nodes have other definitions of the messages of a run, in words.

        Those that beat; with ``topics`` of instruments also who publishes these, or obeys orders.
        """
        heard = [names.HEARTBEAT, *map(self.instrument, topics)]
        found = dict.fromkeys(self.graph.other_versions(heard, ORDERS if topics else ()))
        return [*found, ONE_VERSION] if found else []

    def idle_nodes(self, but: Collection[str] = ()) -> list[str]:
        """Return which nodes of the calibration are present but not active, in words."""
        return inactive_node_hints(self.health, sorted(self.health.present() - SPARE - {*but}))

    def missing_topics(
        self, topics: Sequence[str], silent: Collection[str] = (), stop: str = ""
    ) -> list[str]:
        """Return what the instrument topics and the orders still lack, in words.

        Topics that are ``silent`` before the first order need not deliver anything yet, and the
        emergency ``stop`` need not be published.
        """
        graph, heard = self.graph, self.health.values("capture")
        measured = [self.instrument(topic) for topic in topics]
        lacking = [
            text
            for topic, name in zip(topics, measured, strict=True)
            for text in graph.instrument_faults(
                name, topic in silent or heard.get(f"valid.{topic}", "0") != "0"
            )
        ]
        lacking += self.elsewhere(topics)
        here = [] if all(map(graph.publishers, measured)) else [discovery_in_words(os.environ)]
        lacking += [text for topic in ORDERS for text in graph.machine_faults(topic)]
        stops = [stop] if stop and graph.publishers(stop) else []
        recorded = (*measured, *ORDERS, names.PLAN, names.OBSERVATION, names.STEP_CHOICE, *stops)
        unheard = (graph.resolve(topic) for topic in recorded if not self._is_recorded(topic))
        return lacking + here + [self._unrecorded(name) for name in unheard]

    def elsewhere(self, topics: Iterable[str]) -> list[str]:
        """Return where instrument topics without a publisher may be instead, in words."""
        absent = self.unpublished(topics).items()
        hints = ((name, self.graph.elsewhere(role, name)) for role, name in absent)
        return [f"{name}: {hint}" for name, hint in hints if hint]

    def _is_recorded(self, topic: str) -> bool:
        """Return whether the recorder listens to a topic, by its own word or by the graph.

        On a busy machine the graph sometimes never names the node of an end that it knows.
        """
        stated = self.health.values("recorder").get(LISTENS, "").split()
        return self.graph.resolve(topic) in stated or "recorder" in self.graph.listeners(topic)

    def _unrecorded(self, name: str) -> str:
        """Say that the recorder does not listen to a topic yet, or why it cannot."""
        reason = self.health.values("recorder").get(name, "")
        return f"the recorder does not listen to {name}{': ' + reason if reason else ' yet'}"

    def accepted(self, instruments: Collection[str]) -> PublisherList:
        """Return the present publishers of a run's topics: our nodes and the ``instruments``."""
        namespace = self.node.get_namespace()
        publishers = {
            self.instrument(role): self.graph.offers(self.instrument(role)) for role in instruments
        }
        for topic, owner in OWNERS.items():
            offers = self.graph.offers(topic)
            own = [i for i in offers if (i.node_name, i.node_namespace) == (owner, namespace)]
            publishers[self.graph.resolve(topic)] = own
        return PublisherList({
            topic: tuple(sorted(publisher_of(info.endpoint_gid) for info in infos))
            for topic, infos in publishers.items()
            if infos
        })  # fmt: skip

    def offered(self, roles: Collection[str]) -> Offers:
        """Return the present publishers of these instruments, with the paths of their nodes."""
        return {
            (name := self.instrument(role)): {
                publisher_of(
                    info.endpoint_gid
                ): f"{info.node_namespace.rstrip('/')}/{info.node_name}"
                for info in self.graph.offers(name)
            }
            for role in roles
        }

    def unclear(self, instruments: Collection[str]) -> list[str]:
        """Return which topics do not have exactly one publisher yet, in words."""
        accepted, texts = self.accepted(()).publishers, list[str]()
        for topic, owner in OWNERS.items():
            name = self.graph.resolve(topic)
            count = len(accepted.get(name, ()))
            if count > 1:
                texts.append(
                    f"{count} nodes are called {owner} and publish {name}: end the others"
                )
            elif not count:
                texts.append(f"node {owner} does not publish {name} yet")
        called = (self.instrument(role) for role in instruments)
        return texts + [text for name in called for text in self.graph.duplicate_publishers(name)]

    def missing_connections(self, accepted: PublisherList) -> list[str]:
        """Return which nodes are not connected to the publishers of a run yet, in words."""
        others = (*PREFLIGHT_NODES, *self._own_machines())
        beats = {name: self.health.values(name) for name in others}
        beats[self.node.get_name()] = self.node.accepted.values()
        return [
            f"node {name} has no connection both ways yet on {apart}"
            if (apart := values.get(APART))
            else f"node {name} has not confirmed the publishers of this run"
            for name, values in beats.items()
            if values.get(HEARS) != accepted_publishers_hash(accepted)
        ] + self._missing_machines()

    def _own_machines(self) -> list[str]:
        """Return the machines that obey orders and beat like nodes of the suite."""
        obey = {name for topic in ORDERS for name in self.graph.machines(topic)}
        return sorted(obey & self.health.present())

    def _missing_machines(self) -> list[str]:
        """Return the orders that do not yet reach all machines that beat, in words."""
        publishers = {names.TABLE_ANGLE: self._tables, names.PROBE_TARGET: self._probes}
        return [
            f"the planner has not reached all nodes yet that obey {self.graph.resolve(topic)}"
            for topic, publisher in publishers.items()
            if publisher.get_subscription_count()
            < len(self.health.present().intersection(self.graph.listeners(topic)))
        ]

    def unpublished(self, expected: Iterable[str]) -> dict[str, str]:
        """Return role -> absolute name of those ``expected`` topics without a publisher."""
        called = {role: self.instrument(role) for role in expected}
        return {role: name for role, name in called.items() if not self.graph.publishers(name)}

    def missing_plan(
        self, run: str | None, nodes: Sequence[str] = ("capture", "solver")
    ) -> list[str]:
        """Return which nodes have not taken the plan of this run, with their states."""
        return [
            f"node {name} has not taken the plan ({self.health.describe(name)})"
            for name in nodes
            if self.health.values(name).get(RUN) != run
        ]

    def refused_plan(self, run: str, nodes: Sequence[str] = ("capture", "solver")) -> list[str]:
        """Return which nodes cannot take the plan of this run, and why."""
        refusals = {name: self.health.values(name).get(REFUSED_RUN, "") for name in nodes}
        return [
            f"node {name} refuses the plan: {refusal.removeprefix(f'{run} ')}"
            for name, refusal in refusals.items()
            if refusal.startswith(f"{run} ")
        ]

    def _observed(self, message: msg.Observation) -> None:
        self.observations[message.step, message.attempt] = messages.observation(message)

    def _recorded(self, message: msg.RecordedObservation) -> None:
        self.receipts[message.step, message.attempt] = int(message.lost)

    def _solved(self, message: msg.DeviationArray) -> None:
        if message.plan_id == self._plan_id and message.ecc_std:
            doubtful = message.final and why_verdict_withholds(message.verdict, message.warnings)
            self.current_std = math.nan if doubtful else max(message.ecc_std)


RESUME: Final = "resume"
UNKNOWN_PLACE: Final = (nan, nan, nan)


class GoalPauses:
    """What the goal waits for; ``waiting`` is True until somebody has called ``resume``.

    ``require_free`` raises RotcalError while it cannot go on; ``busy`` says what the planner is
    doing.
    """

    def __init__(
        self, node: CellNode, require_free: Callable[[], None], busy: Callable[[], str]
    ) -> None:
        self._node, self._require_free, self._busy = node, require_free, busy
        self._publisher = node.create_publisher(msg.Pause, names.PAUSE, LATCHED)
        node.offer(Trigger, RESUME, self._resume)
        self._latest = msg.Pause()
        self._stops = 0
        self.waiting = False

    def begin(self, plan_id: str, run: int, step: int, stops: int) -> None:
        """Wait from now on, before ``step`` of a run of a plan; ``stops`` have come so far."""
        self._stops = stops
        self._latest = msg.Pause(plan_id=plan_id, run=run, step=step, waiting=True)
        self.waiting = True

    def show(self, asked: Reason, move: OperatorMove | None = None) -> None:
        """Publish what is waited for if that has changed."""
        latest, instruction = self._latest, asked.instruction or ""
        if latest.instruction == instruction:
            return
        place = move or OperatorMove("", 0)
        latest.kind = msg.Pause.KIND_MOVE if move else msg.Pause.KIND_WORK
        latest.kind = msg.Pause.KIND_STOP if asked.code in STOPS else latest.kind
        latest.what, latest.station = place.what, place.station
        latest.position = place.position or UNKNOWN_PLACE
        latest.instruction = instruction
        latest.resume = self._node.resolve_service_name(RESUME)
        self._publish(place.frame)

    def stop_between(self, stops: int) -> bool:
        """Return, once, whether a stop has come since the pause began."""
        before, self._stops = self._stops, stops
        return stops > before

    def end(self) -> None:
        """Publish that the pause is over."""
        self.waiting = False
        if self._latest.waiting:
            latest = self._latest
            self._latest = msg.Pause(plan_id=latest.plan_id, run=latest.run, step=latest.step)
            self._latest.position = UNKNOWN_PLACE
            self._publish(MACHINE_FRAME)

    def _publish(self, frame: str) -> None:
        self._latest.header = conversions.make_header(self._node.now_ns(), frame)
        self._publisher.publish(self._latest)

    def _resume(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Go on after the work is done, unless something keeps the cell from it."""
        if not self.waiting:
            response.message = f"nothing is waiting to be resumed: the planner is {self._busy()}"
            return response
        try:
            self._require_free()
        except RotcalError as error:
            response.message = f"not resumed: {error}"
        else:
            self.waiting, response.success = False, True
        return response
