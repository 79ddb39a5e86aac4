"""The settings of the cell as a whole: group ``cell`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass

from rotcal_ros.foundation.components import check_axis
from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.in_force import UNKNOWN, check_in_force
from rotcal_ros.foundation.settings import check_ros_name, setting


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
    machine_frame: str = setting(
        "machine", doc="frame of targets and probe points, as headers and tf call it"
    )
    table_frame: str = setting(
        "table_base", doc="fixed frame of the table in tf: its origin on the axis, z along it"
    )
    tracer_frame: str = setting(
        "tracer", doc="frame of the tracer in tf, with the table at angle 0"
    )
    frame_tolerance_m: float = setting(
        0.01, doc="m, by which tf and the solution may differ without a warning", minimum=1e-9
    )
    frame_tolerance_deg: float = setting(
        1.0, doc="deg, by which the directions of the axis may differ", minimum=1e-9, maximum=180.0
    )
    volume_from_m: tuple[float, ...] = setting(
        (), doc="m, lowest x, y, z that the probe reaches; a dry run holds the plan against it"
    )
    volume_to_m: tuple[float, ...] = setting(
        (), doc="m, highest x, y, z that the probe reaches; both or none"
    )

    def __post_init__(self) -> None:
        """Refuse names that ROS or a controller file cannot bear, and half a volume or none."""
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
