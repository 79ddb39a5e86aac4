"""From streams to observations: in position, settled, stable, n samples, mean and deviation.

The outcome depends on each stream's own order and stamps, never on how the streams interleave
on arrival. The live node and the replay of a bag therefore give equal observations.
"""

from rotcal_ros.capture.capture import Capture, Record
from rotcal_ros.capture.rules import CaptureRules
from rotcal_ros.capture.settings import CaptureSettings

__all__ = ["Capture", "CaptureRules", "CaptureSettings", "Record"]
