"""The latest reading of every instrument, in the heartbeat of the capture.

People see it live without a subscription of their own to a stream of a kilohertz.
"""

from __future__ import annotations

from typing import Final

from rotcal_ros.capture import Record
from rotcal_ros.foundation.observations import (
    HumiditySample,
    LengthStatus,
    PressureSample,
    ProbeSample,
    TableSample,
    TracerSample,
)
from rotcal_ros.foundation.observations import TemperatureSample as Thermometer
from rotcal_ros.instruments.steps import Position

NOW: Final = "now."
"""How the values of the capture begin that tell the latest reading of a topic."""
FRAME: Final = "frame."
"""How the values of the capture begin that tell the frame that a topic is stamped with."""
HOPELESS: Final = "hopeless"
"""Value in the capture's beat: why no attempt at any step will ever be accepted."""
WAITING_FOR: Final = "waiting_for"
"""Value of the capture: what its oldest undecided attempt waits for, in words."""
RATE: Final = "rate_hz."
"""How the values of the capture begin that tell how often a stream comes."""
REFUSED: Final = "refused."
"""How the values of the capture begin that tell why a topic's message type cannot be used."""
SILENT: Final = "silent_s."
"""How the values of the capture begin that tell the silence of a stream in seconds."""
JOINT: Final = "joint."
"""How the values of the capture begin that tell angle (rad) and velocity (rad/s) of a joint."""
MOST_JOINTS: Final = 32
"""So many joints are told at most, beside the chosen one once there is a plan."""


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
