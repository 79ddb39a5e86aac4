"""When a node is slow, and when it is given up: group ``health`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass

from rotcal_ros.foundation.settings import setting


@dataclass(frozen=True)
class HealthSettings:
    """How late a sign of life may be; a process that is gone is lost at once."""

    slow_after_s: float = setting(
        1.5,
        doc="s without a sign that a node answers, after which it is slow: the measurement waits "
        "at the next safe place and goes on by itself",
        minimum=0.6,
        maximum=3600.0,
    )
    lost_after_s: float = setting(
        300.0,
        doc="s after which a node that is slow, or an instrument that is silent, is given up: the "
        "session ends and can be resumed",
        minimum=1.0,
        maximum=86_400.0,
    )
