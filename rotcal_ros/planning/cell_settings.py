"""The settings of the cell as a whole: group ``cell`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass

from rotcal_ros.components import check_axis
from rotcal_ros.in_force import UNKNOWN, check_in_force
from rotcal_ros.settings import check_ros_name, setting


@dataclass(frozen=True)
class CellSettings:
    """What the cell's parts are called."""

    namespace: str = setting("/cell", doc="ROS namespace of all topics of the cell")
    joint: str = setting("", doc="name of the table's joint in its feedback; empty: the first")
    axis: str = setting("C", doc="letter of the rotary axis, for compensation tables")
    table_in_force: str = setting(
        UNKNOWN,
        doc="compensation table that the controller holds: SHA-256 of its files, none, or "
        "unknown; a bridge announces it by itself",
    )

    def __post_init__(self) -> None:
        """Refuse names that ROS or a controller file cannot bear."""
        check_ros_name(self.namespace, "namespace")
        check_axis(self.axis)
        check_in_force(self.table_in_force)
