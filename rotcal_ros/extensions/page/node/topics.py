"""What the page takes from topics, and from the beat of the capture.

Topics give plan, deviations, rejected attempts, orders and warnings; the beat gives rates,
readings and temperatures.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Mapping
from typing import Final

from rcl_interfaces.msg import Log
from rclpy.logging import LoggingSeverity
from rclpy.qos import DurabilityPolicy, QoSProfile
from rotcal_msgs.msg import CalibrationPlan, DeviationArray
from rotcal_msgs.msg import Observation as ObservationMsg

from rotcal_ros.bags import names
from rotcal_ros.capture.messages import stamp_ns
from rotcal_ros.extensions.page.board import Board, Course
from rotcal_ros.extensions.page.node import sections as page_sections
from rotcal_ros.extensions.page.state import (
    Cell,
    LiveReading,
    LogLine,
    Pointing,
    Points,
    RejectedAttempt,
    Temperature,
    TopicState,
)
from rotcal_ros.foundation.errors import RotcalError
from rotcal_ros.foundation.observations import Command, LengthStatus, place_in_words
from rotcal_ros.foundation.units import ARCSEC, DEGREE, NANOSECOND
from rotcal_ros.methods import Calibration
from rotcal_ros.nodes.runtime.announced_plan import calibration_of
from rotcal_ros.nodes.runtime.beat_values import NOW, SILENT
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.qos import EVENT, LATCHED

REJECTIONS: Final = 50
LOG_LINES: Final = 100
ROSOUT: Final = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class PageTopics:
    """Shows on a board what its topics say.

    ``uncertainty`` is the largest expanded one (k = 2) of ECC in the latest solution, rad; None
    where it is not known. ``withheld`` says why it may not be stated, else it is empty.
    ``loading`` is true while a plan is read.
    """

    def __init__(self, node: CellNode, board: Board) -> None:
        self._node, self._board = node, board
        self._calibration: Calibration | None = None
        self._rejections: deque[RejectedAttempt] = deque(maxlen=REJECTIONS)
        self._log: deque[LogLine] = deque(maxlen=LOG_LINES)
        self._visited: dict[float, None] = {}
        self.uncertainty: float | None = None
        self.withheld, self.loading = "", False
        node.listen(CalibrationPlan, names.PLAN, self._take_plan, LATCHED)
        node.listen(DeviationArray, "deviations", self._take_deviations, LATCHED)
        # few, and a person is to see all that was rejected, however busy the machine is
        node.listen(ObservationMsg, names.OBSERVATION, self._take_observation, EVENT)
        node.listen(Log, "/rosout", self._take_log, ROSOUT)
        node.take_orders(self._point)

    def begin(self) -> None:
        """Forget what belongs to an earlier goal."""
        self._rejections.clear()
        self._visited.clear()
        self.uncertainty, self.withheld = None, ""
        self._board.show(rejections=(), deviations=None, pointing=None)

    def _take_plan(self, message: CalibrationPlan) -> None:
        self.loading = True
        self._node.health.beat()
        try:
            self._calibration = calibration_of(message)
        except RotcalError as error:
            self._calibration = None
            self._board.show(cell=Cell(), view=None)
            self._node.get_logger().warning(f"the plan cannot be drawn: {error}")
            return
        finally:
            self.loading = False
        self._board.show(
            cell=page_sections.cell(self._calibration, self._node.get_namespace()),
            view=page_sections.plan_view(self._calibration),
        )

    def _take_deviations(self, message: DeviationArray) -> None:
        if self._calibration and message.plan_id == self._calibration.configuration.plan_id:
            identity = self._calibration.configuration.identity
            found = page_sections.deviations(message, identity)
            self._board.show(deviations=found)
            ecc = next((c for c in found.curves if c.name == "ECC"), None)
            known = [u for u in ecc.expanded if u is not None] if ecc else []
            self.uncertainty = max(known) * ARCSEC if known else None
            self.withheld = found.withheld

    def _take_observation(self, message: ObservationMsg) -> None:
        if not message.accepted:
            place = place_in_words(message.table_index, message.target, message.attempt)
            row = RejectedAttempt(time.time(), place, message.reason)
            self._rejections.appendleft(row)
            self._board.show(rejections=tuple(self._rejections))

    def _take_log(self, message: Log) -> None:
        if message.level >= LoggingSeverity.WARN:
            error = message.level >= LoggingSeverity.ERROR
            when_s = stamp_ns(message.stamp) * NANOSECOND
            name = message.name.rpartition(".")[2]
            self._log.appendleft(LogLine(when_s, error, name, message.msg))
            self._board.show(log=tuple(self._log))

    def _point(self, order: Command) -> None:
        if self._calibration is None:
            return
        step = self._calibration.plan.steps[order.step]
        place = self._calibration.stand_at(step)
        angle_deg = round(order.table_angle / DEGREE, 3)
        self._visited[angle_deg % 360.0] = None
        self._board.show(
            pointing=Pointing(
                place=step.in_words(order.attempt),
                table_angle_deg=angle_deg,
                target=page_sections.above(order.position),
                stand=None if place is None else page_sections.above(place),
                visited_deg=tuple(self._visited),
            )
        )


RATE_S: Final = 4.0
LENGTHS_S: Final = 60.0
LENGTH_POINTS: Final = 400
TEMPERATURE_PERIOD_S: Final = 5.0
VALID: Final = "valid."
WORDS: Final = {
    LengthStatus.BEAM_BROKEN.name: "beam broken",
    LengthStatus.UNSTABLE.name: "unstable",
    LengthStatus.UNKNOWN.name: "state unknown",
}
HOUR_S: Final = 3600.0


class CapturedValues:
    """Takes the values of the capture, beat by beat."""

    def __init__(self) -> None:
        self._counts: dict[str, deque[tuple[float, int]]] = {}
        self._lengths: deque[tuple[float, float]] = deque(maxlen=LENGTH_POINTS)
        self._courses: dict[str, Course] = {}
        self._ranges: dict[str, tuple[float, float]] = {}
        self._latest: dict[str, float] = {}
        self._offered_s: dict[str, float] = {}
        self._values: Mapping[str, str] = {}

    def hear(self, values: Mapping[str, str]) -> None:
        """Take the values of a beat."""
        self._values, now = values, time.monotonic()
        for key, value in values.items():
            if key.startswith(VALID):
                counts = self._counts.setdefault(key.removeprefix(VALID), deque())
                counts.append((now, int(value)))
                while now - counts[0][0] > RATE_S:
                    counts.popleft()
        if words := self._reading(names.TRACER_LENGTH):
            length = float(words[0]) * 1e3
            if math.isfinite(length):
                self._lengths.append((round(time.time(), 1), round(length, 4)))
        self._feel()

    def streams(self) -> tuple[TopicState, ...]:
        """Return rate and silence of every topic that was heard."""
        found = []
        for topic, counts in sorted(self._counts.items()):
            (begun_s, first), (end_s, last) = counts[0], counts[-1]
            rate = (last - first) / (end_s - begun_s) if end_s > begun_s else 0.0
            silent = self._values.get(f"{SILENT}{topic}")
            found.append(
                TopicState(topic, round(rate, 1), None if silent is None else float(silent))
            )
        return tuple(found)

    def lengths(self) -> LiveReading | None:
        """Return the live reading: a length, else the probe's position; None before the first."""
        if words := self._reading(names.TRACER_LENGTH):
            length = float(words[0]) * 1e3
            shown = f"{length:.4f} mm" if math.isfinite(length) else "–"
            return LiveReading("Length", shown, WORDS.get(words[1], ""))
        if words := self._reading(names.PROBE_POINT):
            at = "  ".join(f"{float(x) * 1e3:.3f}" for x in words)
            return LiveReading("Probe x y z", f"{at} mm", "")
        return None

    def length_course(self) -> Points:
        """Return the lengths of the last minute, in whole seconds between two changes."""
        until_s = int(time.time())
        return tuple((t, x) for t, x in self._lengths if until_s - LENGTHS_S < t <= until_s)

    def temperatures(self) -> tuple[Temperature, ...]:
        """Return the temperatures of every sensor."""
        return tuple(
            Temperature(sensor, now, *self._ranges[sensor], drift(points), points)
            for sensor, now in sorted(self._latest.items())
            for points in [self._courses[sensor].points]
        )

    def _feel(self) -> None:
        """Take the temperature of the sensor that spoke last."""
        words = self._reading(names.TEMPERATURE)
        if not words or not math.isfinite(value := float(words[0])):
            return
        sensor, now_s = " ".join(words[1:]), round(time.time(), 1)
        course = self._courses.setdefault(sensor, Course())
        if now_s - self._offered_s.get(sensor, -math.inf) >= TEMPERATURE_PERIOD_S:
            self._offered_s[sensor] = now_s  # the history may have left it out
            course.add(now_s, value)
        low, high = self._ranges.get(sensor, (value, value))
        self._ranges[sensor] = min(low, value), max(high, value)
        self._latest[sensor] = round(value, 3)

    def _reading(self, topic: str) -> list[str]:
        return self._values.get(f"{NOW}{topic}", "").split()


def drift(course: Points) -> float | None:
    """Return the slope (K/h) of the best line through the last hour; None in the first minute."""
    last = [(t, y) for t, y in course if t >= course[-1][0] - HOUR_S]
    if len(last) < 3 or last[-1][0] - last[0][0] < 60.0:
        return None
    mean_t = sum(t for t, _ in last) / len(last)
    mean_y = sum(y for _, y in last) / len(last)
    above = sum((t - mean_t) * (y - mean_y) for t, y in last)
    return round(above / sum((t - mean_t) ** 2 for t, _ in last) * HOUR_S, 3)
