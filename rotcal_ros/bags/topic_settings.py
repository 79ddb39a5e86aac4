"""The settings of somebody else's topics: group ``topics`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass

from rotcal_ros.settings import check_ros_name, setting


@dataclass(frozen=True)
class TopicSettings:
    """Topics of a bag that bear other names, and the units of bare numbers."""

    tracer_length: str = setting("", doc="topic of the lengths; empty: by its last name")
    probe_point: str = setting("", doc="topic of the probe; empty: by its last name")
    joint_states: str = setting("", doc="topic of the table's feedback; empty: by its last name")
    temperature: str = setting("", doc="topic of the temperature; empty: by its last name")
    air_pressure: str = setting("", doc="topic of the air pressure; empty: by its last name")
    relative_humidity: str = setting("", doc="topic of the humidity; empty: by its last name")
    length_unit_m: float = setting(
        1.0, doc="m, unit of a Float64 length; negative where it shrinks with distance"
    )
    angle_unit_rad: float = setting(
        1.0, doc="rad, unit of a Float64 angle; negative where the table counts clockwise"
    )

    def __post_init__(self) -> None:
        """Refuse names that no topic can bear."""
        for role, topic in self.renamed().items():
            check_ros_name(topic, role)

    def renamed(self) -> dict[str, str]:
        """Return role -> topic of those that were given."""
        roles = (
            "tracer_length", "probe_point", "joint_states", "temperature", "air_pressure",
            "relative_humidity",
        )  # fmt: skip
        return {role: getattr(self, role) for role in roles if getattr(self, role)}
