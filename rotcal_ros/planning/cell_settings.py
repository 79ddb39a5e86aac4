"""The settings of the cell as a whole: group ``cell`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass

from rotcal_ros.components import check_axis
from rotcal_ros.settings import check_ros_name, setting


@dataclass(frozen=True)
class CellSettings:
    """What the cell's parts are called."""

    namespace: str = setting("/cell", doc="ROS namespace of all topics of the cell")
    joint: str = setting("", doc="name of the table's joint in its feedback; empty: the first")
    axis: str = setting("C", doc="letter of the rotary axis, for compensation tables")

    def __post_init__(self) -> None:
        """Refuse names that ROS or a controller file cannot bear."""
        check_ros_name(self.namespace, "namespace")
        check_axis(self.axis)
