"""Clocks of a node: jumps of the system clock, and ``/clock`` with ``use_sim_time``."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping
from typing import Any, Final

from rotcal_ros.foundation.clock_jumps import ClockJump, ClockWatch
from rotcal_ros.foundation.node_names import PREFLIGHT_NODES
from rotcal_ros.foundation.units import NANOSECOND
from rotcal_ros.methods import Configuration
from rotcal_ros.nodes.runtime.beat_values import SIM_CLOCK

JUMPS: Final = "clock_jumps"
"""Value in a beat: how often the clock of a node's machine has jumped."""
JUMP: Final = "clock_jump"
"""Value in a beat: the latest jump in words, if it is large enough to report."""


class ReportedClockJumps:
    """The jumps of this node's clock: logged once, in every beat from then on."""

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self.watch = ClockWatch()
        self.concerns: dict[str, str] = {}

    def poll(self) -> None:
        """Look at the clock; called regularly, and whenever the present time matters."""
        jump = self.watch.poll()
        if jump is None:
            return
        self._logger.warning(f"{jump.describe()}: what is being measured is measured again")
        if jump.named:
            self.concerns = {JUMP: jump.describe()}

    def values(self) -> Mapping[str, int]:
        """Return what goes into every beat."""
        return {JUMPS: self.watch.count} if self.watch.count else {}

    def since(self, count: int) -> tuple[ClockJump, ...]:
        """Return the jumps after the first ``count``, as far as they are still remembered."""
        new = self.watch.count - count
        return tuple(self.watch.jumps)[-new:] if new else ()


def reported_jump_count(beats: Iterable[Mapping[str, str]]) -> int:
    """Return the number of jumps in the values of all beats."""
    return sum(int(values.get(JUMPS, 0)) for values in beats)


def describe_clock_jumps(health: Any) -> tuple[str, ...]:
    """Return the large clock jumps that nodes report, the node of ``health`` first."""
    health.clock.poll()
    beats = [health.clock.concerns, *map(health.values, health.others)]
    return tuple(values[JUMP] for values in beats if JUMP in values)


SIM_TIME: Final = "sim_time_s"
"""Value in a beat: the time of ``/clock`` in s; only of nodes that follow it."""
STILL_S: Final = 1.5
"""``/clock`` may stand still this long before people are told."""
_SETTLING_S: Final = 2.0
"""Streams may need this long to resume after ``/clock`` goes on."""
_PACE_S: Final = 2.0
"""The pace is measured over at least this time."""


class SimClock:
    """The clock of a node, checked regularly; without ``use_sim_time`` there is nothing to report.

    ``now`` and ``steady`` (monotonic, s) give the time.
    """

    def __init__(self, node_clock: Any, steady: Any = time.monotonic) -> None:
        self._clock, self._steady = node_clock, steady
        self._now_ns = 0
        self._moved_s = self._from_s = steady()
        self._from_ns = 0
        self._pace: float | None = None
        self._went_on_s = -math.inf

    @property
    def used(self) -> bool:
        """Whether the node follows ``/clock``."""
        return bool(self._clock.ros_time_is_active)

    def poll(self) -> None:
        """Look at both clocks."""
        now_ns, now_s = self._clock.now().nanoseconds, self._steady()
        if now_ns == self._now_ns:
            return
        if self._still_s() > STILL_S or now_ns < self._now_ns:
            self._from_s, self._from_ns, self._pace = now_s, now_ns, None
            self._went_on_s = now_s
        elif now_s - self._from_s > _PACE_S:
            self._pace = (now_ns - self._from_ns) * NANOSECOND / (now_s - self._from_s)
            self._from_s, self._from_ns = now_s, now_ns
        self._now_ns, self._moved_s = now_ns, now_s

    def values(self) -> dict[str, str]:
        """Return what goes into every beat."""
        return {SIM_TIME: f"{self._now_ns * NANOSECOND:.3f}"} if self.used else {}

    def concerns(self) -> dict[str, str]:
        """Return what people should look at."""
        text = self.standstill()
        return {} if text is None else {SIM_CLOCK: text}

    def stands(self) -> bool:
        """Return whether the node waits for ``/clock`` to go on, or to come at all."""
        return self.used and self._still_s() > STILL_S

    def is_settled(self) -> bool:
        """Return whether streams must be arriving: the clock has been running for a while."""
        return not self.stands() and self._steady() > self._went_on_s + _SETTLING_S

    def standstill(self) -> str | None:
        """Say that the clock stands still; None: it runs, or the node does not follow it."""
        if not self.stands():
            return None
        if not self._now_ns:
            return (
                "use_sim_time is set, and no time came on /clock: start the simulation, or leave "
                "use_sim_time out"
            )
        return (
            f"/clock stands still at {self._now_ns * NANOSECOND:.3f} s: is the simulation paused?"
        )

    def remark(self) -> str | None:
        """Return what an error has to add where the clock may be the cause of a time-out."""
        if not self.used:
            return None
        words = self.standstill()
        if words is None and self._pace is not None:
            words = f"/clock runs at {self._pace:.2g} of it"
        return "time-outs are wall time" + ("" if words is None else f", {words}")

    def _still_s(self) -> float:
        return float(self._steady() - self._moved_s)


def clock_mismatches(health: Any, configuration: Configuration) -> list[str]:
    """Return why the nodes do not share one time, in words."""
    own = health.sim.used
    other = [name for name in PREFLIGHT_NODES if (SIM_TIME in health.values(name)) != own]
    standstill = health.sim.standstill()
    texts = [] if standstill is None else [standstill]
    if other:
        texts.append(
            f"use_sim_time is {str(own).lower()} for node planner, but not for "
            f"{', '.join(other)}: set it to the same value for all nodes of the cell"
        )
    elif configuration.use_sim_time and not own:
        texts.append(
            "the configuration says use_sim_time: true, the nodes run without: start them with "
            "--ros-args -p use_sim_time:=true"
        )
    return texts
