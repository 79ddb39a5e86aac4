"""From streams to observations: in position, settled, stable, n samples, mean and deviation.

The outcome depends on each stream's own order and stamps, never on how the streams interleave
on arrival. The live node and the replay of a bag therefore give equal observations. The capture is
loaded when it is first asked for: what can be set is told without it.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rotcal_ros.capture.settings import CaptureSettings

if TYPE_CHECKING:
    from rotcal_ros.capture.capture import Capture, Record
    from rotcal_ros.capture.rules import CaptureRules

__all__ = ["Capture", "CaptureRules", "CaptureSettings", "Record"]


def __getattr__(name: str) -> Any:
    """Load the module of a name."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{'rules' if 'Rules' in name else 'capture'}"), name)
