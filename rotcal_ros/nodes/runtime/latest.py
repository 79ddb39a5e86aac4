"""The latest reading of every instrument, in the heartbeat of the capture.

People see it live without a subscription of their own to a stream of a kilohertz.
"""

from __future__ import annotations

from typing import Final

from rotcal_ros.capture import Record
from rotcal_ros.capture.instruments.steps import Position
from rotcal_ros.foundation.observations import (
    HumiditySample,
    LengthStatus,
    PressureSample,
    ProbeSample,
    TableSample,
    TracerSample,
)
from rotcal_ros.foundation.observations import TemperatureSample as Thermometer

NOW: Final = "now."
"""Beginning of the capture's values with the latest reading of a topic."""
FRAME: Final = "frame."
"""Beginning of the capture's values with the frame that a topic is stamped with."""
HOPELESS: Final = "hopeless"
"""Value in the capture's beat: why no attempt at any step will ever be accepted."""
WAITING_FOR: Final = "waiting_for"
"""Value of the capture: what its oldest undecided attempt waits for, in words."""
RATE: Final = "rate_hz."
"""Beginning of the capture's values with the rate of a stream."""
REFUSED: Final = "refused."
"""Beginning of the capture's values with the reason why a topic's message type cannot be used."""
SILENT: Final = "silent_s."
"""Beginning of the capture's values with the silence of a stream in seconds."""
JOINT: Final = "joint."
"""Beginning of the capture's values with angle (rad) and velocity (rad/s) of a joint."""
MOST_JOINTS: Final = 32
"""Largest number of joints in a beat, besides the chosen one once there is a plan."""


def reading(record: Record | Position) -> str:
    """Return a reading in SI: length and status, point, angle, or the air and its sensor."""
    match record:
        case TracerSample():
            return f"{record.length:.9f} {LengthStatus(record.status).name}"
        case ProbeSample() | Position():
            return " ".join(f"{x:.7f}" for x in record.position)
        case TableSample():
            return f"{record.angle:.9f}"
        case Thermometer():
            return f"{record.temperature_c:.4f} {record.sensor}"
        case PressureSample():
            return f"{record.pressure_pa:.1f} {record.sensor}"
        case HumiditySample():
            return f"{record.humidity:.4f} {record.sensor}"
    return ""
