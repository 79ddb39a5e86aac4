"""From streams to observations: in position, settled, stable, n samples, mean and deviation.

The outcome depends on each stream's own order and stamps, never on how the streams interleave
on arrival. The live node and the replay of a bag therefore give equal observations. The capture is
loaded when it is first used: those who need only its settings load no more.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from rotcal_ros.capture.settings import CaptureSettings

if TYPE_CHECKING:
    from rotcal_ros.capture.attempt import CaptureRules
    from rotcal_ros.capture.capture import Capture, Record

__all__ = ["Capture", "CaptureRules", "CaptureSettings", "Record"]
_MODULES: Final = {"Capture": "capture", "CaptureRules": "attempt", "Record": "capture"}
"""Name -> module, for those that are loaded when they are first used."""


def __getattr__(name: str) -> Any:
    """Load the module of a name."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
