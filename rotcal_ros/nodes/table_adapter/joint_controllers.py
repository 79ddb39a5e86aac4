"""Sends controllers of ros2_control where a joint has to go: by topics, or by goals."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Final

from builtin_interfaces.msg import Duration
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.units import NANOSECOND
from rotcal_ros.nodes.runtime.cell_node import CellNode
from rotcal_ros.nodes.runtime.qos import EVENT
from rotcal_ros.planning.approach import JointPath
from rotcal_ros.planning.settings import TableAdapterSettings

SETPOINT_PERIOD_S: Final = 0.02
LATEST_S: Final = 1.5 * SETPOINT_PERIOD_S
"""Longest time that one step makes up for: on a busy computer the joint slows, never jumps."""


@dataclass(frozen=True, slots=True)
class ControllerReport:
    """What a controller says: ``trouble`` why it does not move, ``done`` that it has arrived."""

    trouble: str | None = None
    done: bool = False


class JointController(ABC):
    """Accepts ways to go; a new one replaces the present one."""

    @abstractmethod
    def heard(self) -> bool:
        """Return whether a controller receives what is sent."""

    @abstractmethod
    def send(self, way: JointPath) -> None:
        """Start the joint on a way."""

    @abstractmethod
    def halt(self) -> str:
        """End the present way though the position is not known; return what was done."""

    def setpoint(self) -> tuple[float, float] | None:
        """Return where (rad) and how fast (rad/s) it was sent last on its way, if known.

        None also for a controller that goes over from one way to the next by itself.
        """
        return None

    def forget(self) -> None:  # noqa: B027  a controller that has it all ends it by itself
        """Send nothing more of the present way."""

    def report(self) -> ControllerReport:
        """Return what the controller says of the latest way; a topic has no answer."""
        return ControllerReport()


def choose_interface(settings: TableAdapterSettings) -> str:
    """Return the interface to use: goals, trajectory or positions.

    Raises ConfigurationError for goals where their messages are not installed.
    """
    interface, with_goals = settings.interface, find_spec("control_msgs") is not None
    if interface == "goals" and not with_goals:
        raise ConfigurationError(
            "table_adapter.interface: goals need the package control_msgs, which is not installed "
            "here; install it, or set trajectory, which needs nothing"
        )
    if interface == "auto":
        return "goals" if with_goals else "trajectory"
    return interface


def trajectory_message(joint: str, way: JointPath) -> JointTrajectory:
    """Return a way as a trajectory that begins when it arrives: its stamp is zero."""
    points = [
        JointTrajectoryPoint(positions=[angle], velocities=[0.0], time_from_start=_lasting(at))
        for angle, at in zip(way.angles, way.times_s, strict=True)
    ]
    return JointTrajectory(joint_names=[joint], points=points)


class TrajectoryController(JointController):
    """joint_trajectory_controller: all stops at once, each with time and no velocity."""

    def __init__(self, node: CellNode, controller: str, joint: str) -> None:
        self._joint = joint
        self._publisher = node.create_publisher(
            JointTrajectory, f"{controller}/joint_trajectory", EVENT
        )

    def heard(self) -> bool:
        """Return whether a controller receives what is sent."""
        return bool(self._publisher.get_subscription_count())

    def send(self, way: JointPath) -> None:
        """Publish it."""
        self._publisher.publish(trajectory_message(self._joint, way))

    def halt(self) -> str:
        """Do nothing: only a new target replaces the trajectory."""
        return "a trajectory sent by topic cannot be taken back, it goes on to its end"


class PositionController(JointController):
    """A controller that passes on positions at once: it gets the way in small steps."""

    def __init__(self, node: CellNode, controller: str, joint: str) -> None:
        self._publisher = node.create_publisher(Float64MultiArray, f"{controller}/commands", EVENT)
        self._way: JointPath | None = None
        self._elapsed_s = self._stepped_s = 0.0
        node.every(SETPOINT_PERIOD_S, self._step)

    def heard(self) -> bool:
        """Return whether a controller receives what is sent."""
        return bool(self._publisher.get_subscription_count())

    def setpoint(self) -> tuple[float, float] | None:
        """Return where the joint was sent last: a new way begins there, not where it lags."""
        return None if self._way is None else self._way.at(self._elapsed_s)

    def send(self, way: JointPath) -> None:
        """Begin to go that way."""
        self._way, self._elapsed_s, self._stepped_s = way, 0.0, time.monotonic()

    def forget(self) -> None:
        """Leave the joint where it was sent last."""
        self._way = None

    def halt(self) -> str:
        """Leave the joint where it was sent last."""
        self.forget()
        return "it gets no further positions"

    def _step(self) -> None:
        """Publish where the joint shall be now; the last position once."""
        if self._way is None:
            return
        before, self._stepped_s = self._stepped_s, time.monotonic()
        self._elapsed_s += min(self._stepped_s - before, LATEST_S)
        self._publisher.publish(Float64MultiArray(data=[self._way.at(self._elapsed_s)[0]]))
        if self._elapsed_s >= self._way.times_s[-1]:
            self._way = None


def _lasting(seconds: float) -> Duration:
    whole, rest = divmod(round(seconds / NANOSECOND), 1_000_000_000)
    return Duration(sec=whole, nanosec=rest)
