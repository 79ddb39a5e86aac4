"""What stops a cell from outside: group ``safety`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass

from rotcal_ros.foundation.settings import check_ros_name, setting


@dataclass(frozen=True)
class SafetySettings:
    """Who stops the cell; every node that moves something listens. No safety function."""

    emergency_stop: str = setting(
        "emergency_stop",
        doc="topic of a std_msgs/Bool that is true while nothing may be ordered, also outside the "
        "namespace; empty: none",
    )
    stop_on_diagnostics: tuple[str, ...] = setting(
        (),
        doc="names on /diagnostics whose ERROR or STALE stops the cell: the whole name, or what "
        "stands behind its last '/' or ': '",
    )
    silent_s: float = setting(
        0.0,
        doc="s, silence of the topic, or of one of the names, that stops the cell too; 0: none",
        minimum=0.0,
        maximum=3600.0,
    )

    def __post_init__(self) -> None:
        """Refuse a name that no topic can bear."""
        if self.emergency_stop:
            check_ros_name(self.emergency_stop, "emergency_stop")
