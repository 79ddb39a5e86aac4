"""The settings of the adapter to ros2_control: group ``table_adapter`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import check_ros_name, setting

Interface = Literal["auto", "goals", "trajectory", "positions"]


@dataclass(frozen=True)
class TableAdapterSettings:
    """Which controller moves the table's joint, how fast, and how it reaches its angles.

    Raises ConfigurationError for limits that leave no travel.
    """

    controller: str = setting("/table_controller", doc="ROS name of the controller")
    interface: Interface = setting(
        "auto",
        doc="what the controller takes: goals (its action follow_joint_trajectory; the package "
        "control_msgs is needed), trajectory (trajectory_msgs/JointTrajectory on its topic "
        "joint_trajectory) or positions (std_msgs/Float64MultiArray on its topic commands); "
        "auto: goals where control_msgs is installed, else trajectory",
    )
    feedback: str = setting(
        "/joint_states", doc="topic of sensor_msgs/JointState that tells where the joint is"
    )
    speed_deg_s: float = setting(
        10.0, doc="deg/s, largest speed of the table", minimum=1e-3, maximum=36_000.0
    )
    acceleration_deg_s2: float = setting(
        20.0, doc="deg/s^2, largest acceleration", minimum=1e-3, maximum=1e6
    )
    overshoot_deg: float = setting(
        2.0,
        doc="deg, shortest way on which an ordered side of approach is kept; a table that stands "
        "nearer, or beyond, goes back so far first",
        minimum=1e-3,
        maximum=180.0,
    )
    lower_deg: float | None = setting(None, doc="deg, end of the travel; none: it turns endlessly")
    upper_deg: float | None = setting(None, doc="deg, end of the travel; none: it turns endlessly")
    many_turns: bool = setting(
        False, doc="the joint may stand more than two turns from its zero when it begins"
    )
    tolerance_arcsec: float = setting(
        5.0, doc="arcsec, the joint is where it was sent", minimum=1e-3, maximum=36_000.0
    )
    silence_s: float = setting(
        2.0, doc="s without feedback, or without motion, that are complained of", minimum=0.1
    )

    def __post_init__(self) -> None:
        """Refuse names that ROS cannot bear, and half a travel or none."""
        check_ros_name(self.controller, "controller")
        check_ros_name(self.feedback, "feedback")
        if (self.lower_deg is None) != (self.upper_deg is None):
            raise ConfigurationError("lower_deg and upper_deg: give both ends of the travel")
        lower, upper = self.lower_deg, self.upper_deg
        if lower is not None and upper is not None and not lower < upper:
            raise ConfigurationError(f"upper_deg {upper:g} must be above lower_deg {lower:g}")
