"""What live nodes made of a replayed bag, held against what was recorded."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Final

from rclpy.publisher import Publisher
from rotcal_msgs.msg import Observation as ObservationMsg
from rotcal_msgs.srv import FinishCalibration

from rotcal_ros import messages
from rotcal_ros.bags import names
from rotcal_ros.errors import ConfigurationError, DataError
from rotcal_ros.evaluation.marks import marks
from rotcal_ros.files import write_atomically
from rotcal_ros.nodes.bookkeeping import NEVER_PAUSE
from rotcal_ros.nodes.health import Health
from rotcal_ros.nodes.json_lines import say
from rotcal_ros.nodes.peer import Peer
from rotcal_ros.nodes.qos import EVENT
from rotcal_ros.nodes.replayed_bag import ReplayedBag, of_attempts
from rotcal_ros.nodes.running import EndRequest
from rotcal_ros.observations import Observation
from rotcal_ros.results import Result

ARRIVAL_S: Final = 10.0
"""So long the last observations may take behind the last message."""
SOLVE_S: Final = 3600.0
_SHOWN: Final = 3


class ReplayOutcome:
    """Hears what the live capture observes, and has the live solver finish."""

    needed: Final = {
        "capture": (
            names.PLAN, names.TABLE_ANGLE, names.PROBE_TARGET, names.PROBE_POINT, *NEVER_PAUSE
        ),
        "solver": (names.PLAN, names.TABLE_IN_FORCE),
    }  # fmt: skip
    """The roles that a node has to listen to before anything is published."""

    def __init__(
        self, peer: Peer, bag: ReplayedBag, health: Health, end: EndRequest, *, everything: bool
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

    def unheard(self, published: Mapping[str, Publisher], *, with_plan: bool) -> set[str]:
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
                "some topics were called otherwise; nodes hear them with the configuration in the "
                f"bag, or --ros-args {' '.join(remappings)}"
            )
        if anew := self._bag.taken_when_sent():
            yield (
                f"warning: {', '.join(anew)}: taken when they are sent (no header, or "
                "topics.*_clock: sent), which is now; observations are not the recorded ones, and "
                "beside streams with stamps of then there are none: rotcal solve reads the bag"
            )
        if clock:
            yield "nodes follow /clock where they have use_sim_time: true"

    def tell(self, result: Path | None, *, finish: bool) -> None:
        """Say what became of it, and keep the result where that is asked for."""
        found: dict[str, object] = {}
        if "capture" in self.live() and self._bag.plan_id:
            found = self._compared()
        if finish and "solver" in self.live() and self._bag.plan_id:
            found |= self._solved(result)
        elif result is not None:
            raise ConfigurationError(f"no result for {result}: no solver was asked for one")
        say("result", **found)

    def _hear(self, message: ObservationMsg) -> None:
        self._observed.append(messages.observation(message))

    def _compared(self) -> dict[str, object]:
        """Return how the observations compare with those of the recording."""
        recorded = self._bag.accepted
        self._wait(lambda: recorded.keys() <= of_attempts(self._observed).keys(), ARRIVAL_S)
        live = of_attempts(self._observed)
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
        say("solving")
        if not self._wait(self._finish.service_is_ready, ARRIVAL_S):
            raise DataError("node solver does not offer finish_calibration")
        request = FinishCalibration.Request(plan_id=self._bag.plan_id, steps=self._bag.steps)
        future = self._finish.call_async(request)
        if not self._wait(future.done, SOLVE_S):
            raise DataError("the solver gave no answer")
        answer = future.result()
        if not answer.success:
            raise DataError(f"no result: {answer.message}")
        if path is not None:
            try:
                write_atomically(path, answer.result_json)
            except OSError as error:
                raise ConfigurationError(f"cannot write {path}: {error}") from error
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
