"""Groups of a configuration that no method owns: cell, health, safety, planner, table_adapter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from rotcal_ros.foundation.components import check_axis
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.in_force import UNKNOWN, check_in_force
from rotcal_ros.foundation.settings import check_ros_name, expert, setting
from rotcal_ros.planning.choices import AS_LISTED, UNTIL_GOAL


@dataclass(frozen=True)
class CellSettings:
    """Names of the cell's parts."""

    namespace: str = setting("/cell", doc="ROS namespace of all topics of the cell", first=True)
    joint: str = setting(
        "", doc="name of the table's joint in joint_states; empty: the first one there", first=True
    )
    axis: str = setting("C", doc="letter of the rotary axis, as compensation tables name it")
    table_in_force: str = setting(
        UNKNOWN,
        doc="compensation table that the controller applies during the measurement: SHA-256 of "
        "its files, none, or unknown; a bridge announces it itself",
    )
    machine_frame: str = expert(
        "machine", doc="frame of targets and probe points in headers and tf"
    )
    table_frame: str = expert(
        "table_base", doc="fixed frame of the table in tf: its origin on the axis, z along it"
    )
    tracer_frame: str = expert(
        "tracer", doc="frame of the tracer in tf, with the table at angle 0"
    )
    frame_tolerance_m: ClassVar[
        Annotated[
            float,
            "tf in a cell is good to millimetres; more is another place, not an inaccurate one",
        ]
    ] = 0.01
    frame_tolerance_deg: ClassVar[
        Annotated[
            float,
            "tf in a cell is good to tenths of a degree; more is another direction",
        ]
    ] = 1.0
    volume_from_m: tuple[float, ...] = setting(
        (), doc="m, lowest x, y, z that the probe reaches; a dry run compares the plan with it"
    )
    volume_to_m: tuple[float, ...] = setting(
        (), doc="m, highest x, y, z that the probe reaches; both or none"
    )

    def __post_init__(self) -> None:
        """Refuse names that ROS or a controller file cannot hold, and half a volume or none."""
        check_ros_name(self.namespace, "namespace")
        check_axis(self.axis)
        check_in_force(self.table_in_force)
        _check_volume(self.volume_from_m, self.volume_to_m)


def _check_volume(low: tuple[float, ...], high: tuple[float, ...]) -> None:
    if {len(low), len(high)} not in ({0}, {3}):
        raise ConfigurationError(
            f"volume_from_m and volume_to_m: give x, y, z of both, found {len(low)} and "
            f"{len(high)} numbers"
        )
    if not all(a < b for a, b in zip(low, high, strict=True)):
        raise ConfigurationError("volume_to_m must be above volume_from_m in x, y and z")


@dataclass(frozen=True)
class HealthSettings:
    """How late a sign of life may be; a process that is gone is lost at once."""

    slow_after_s: ClassVar[
        Annotated[
            float,
            "nodes beat five times a second; a loaded computer delays a beat by less",
        ]
    ] = 1.5
    lost_after_s: float = expert(
        300.0,
        minimum=1.0,
        maximum=86_400.0,
        doc="s, time after which a node that is slow, or an instrument that is silent, is given "
        "up: the session ends and can be resumed",
    )


@dataclass(frozen=True)
class SafetySettings:
    """Who stops the cell.

    Every node that moves something listens. This is not a safety function.
    """

    emergency_stop: str = setting(
        "emergency_stop",
        doc="topic of type std_msgs/Bool; nothing is ordered while it is true; it may lie "
        "outside the namespace; empty: none",
    )
    stop_on_diagnostics: tuple[str, ...] = setting(
        (),
        doc="names on /diagnostics whose ERROR or STALE stops the cell: the whole name, or what "
        "follows its last '/' or ': '",
    )
    silent_s: float = setting(
        0.0,
        minimum=0.0,
        maximum=3600.0,
        doc="s, silence of the topic, or of one of the names, after which the cell stops too; 0: "
        "silence stops nothing",
    )

    def __post_init__(self) -> None:
        """Refuse a name that no topic can have."""
        if self.emergency_stop:
            check_ros_name(self.emergency_stop, "emergency_stop")


@dataclass(frozen=True)
class PlannerSettings:
    """What the planner measures next, and how long it waits, by the wall clock."""

    policy: str = setting(
        AS_LISTED,
        doc="which step comes next: as_listed takes all steps of the plan in order, until_goal "
        "only those that goal_arcsec needs",
        choices=(AS_LISTED, UNTIL_GOAL),
    )
    goal_arcsec: float = setting(
        0.0,
        minimum=0.0,
        maximum=3600.0,
        doc="arcsec, expanded uncertainty (k = 2) of ECC about its mean, root mean square over "
        "the table angles, at which until_goal stops; 0: not given",
    )
    expected_std_m: float = expert(
        0.0,
        minimum=0.0,
        maximum=1e-2,
        doc="m, standard deviation of a length that until_goal assumes for its first sweep; 0: "
        "that of the solver",
    )
    step_s: float = expert(
        5.0,
        minimum=0.001,
        maximum=3600.0,
        doc="s, expected duration of a step, for predicted times and for the choices of "
        "until_goal",
    )
    turn_s: float = expert(
        10.0,
        minimum=0.0,
        maximum=3600.0,
        doc="s, expected duration of a turn of the table from one angle to the next",
    )
    pause_s: float = expert(
        0.0,
        minimum=0.0,
        maximum=86_400.0,
        doc="s, expected duration of a person's work before a step, for predicted times; 0: it is "
        "not counted",
    )

    max_attempts: int = expert(
        3, doc="attempts at one step before it is skipped", minimum=1, maximum=100
    )
    max_failed_steps: int = expert(
        3,
        minimum=0,
        maximum=100_000,
        doc="consecutive steps that may fail, with all their attempts, before the planner gives "
        "up; ten times as many if something stood in the beam; 0: it never gives up",
    )
    preflight_timeout_s: float = expert(
        15.0,
        minimum=0.1,
        maximum=3600.0,
        doc="s, time within which all nodes and topics must appear",
    )
    step_timeout_s: float = setting(
        60.0, doc="s, longest time from an order to its observation", minimum=0.1, maximum=86_400.0
    )
    receipt_timeout_s: ClassVar[
        Annotated[
            float,
            "the recorder writes every 0.5 s; a disk that takes longer has failed",
        ]
    ] = 10.0
    stream_timeout_s: float = expert(
        2.0,
        minimum=0.1,
        maximum=3600.0,
        doc="s, silence of an instrument after which the planner waits for it; it is lost when "
        "no node publishes its topic any more, or after health.lost_after_s",
    )
    join_steps: ClassVar[
        Annotated[
            int,
            "so many finished steps are measured again when a plan is resumed: their mean gives "
            "the new zero to a third of a length's noise, and shows what else has moved",
        ]
    ] = 8
    solve_timeout_s: ClassVar[
        Annotated[
            float,
            "solving takes seconds; a solver that takes longer has failed, and the bag solves "
            "again",
        ]
    ] = 120.0


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
        "auto: goals if control_msgs is installed, else trajectory",
    )
    feedback: str = setting(
        "/joint_states", doc="topic of sensor_msgs/JointState with the position of the joint"
    )
    speed_deg_s: float = setting(
        10.0, doc="deg/s, largest speed of the table", minimum=1e-3, maximum=36_000.0
    )
    acceleration_deg_s2: float = setting(
        20.0, doc="deg/s^2, largest acceleration", minimum=1e-3, maximum=1e6
    )
    overshoot_deg: float = expert(
        2.0,
        minimum=1e-3,
        maximum=180.0,
        doc="deg, shortest final motion to an angle, so that it is reached from the ordered "
        "side; a table that is nearer, or beyond the angle, first moves back by this much",
    )
    lower_deg: float | None = setting(None, doc="deg, end of the travel; none: it turns endlessly")
    upper_deg: float | None = setting(None, doc="deg, end of the travel; none: it turns endlessly")
    many_turns: bool = expert(
        False, doc="the joint may be more than two turns away from its zero at the start"
    )
    tolerance_arcsec: float = expert(
        5.0,
        minimum=1e-3,
        maximum=36_000.0,
        doc="arcsec, distance from the ordered angle within which the joint has arrived",
    )
    silence_s: float = expert(
        2.0,
        doc="s, time without feedback, or without motion, after which an error is reported",
        minimum=0.1,
    )

    def __post_init__(self) -> None:
        """Refuse names that ROS cannot use, and half a travel or none."""
        check_ros_name(self.controller, "controller")
        check_ros_name(self.feedback, "feedback")
        if (self.lower_deg is None) != (self.upper_deg is None):
            raise ConfigurationError("lower_deg and upper_deg: give both ends of the travel")
        lower, upper = self.lower_deg, self.upper_deg
        if lower is not None and upper is not None and not lower < upper:
            raise ConfigurationError(f"upper_deg {upper:g} must be above lower_deg {lower:g}")
