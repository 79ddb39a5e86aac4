"""The simulated cell: table, temperature and an instrument as plain physics.

The cell is loaded when it is first asked for: solving needs the settings only.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from rotcal_ros.methods.simulation.settings import SimulationSettings

if TYPE_CHECKING:
    from rotcal_ros.methods.simulation.cell import CellOutput, SimulatedCell

__all__ = ["CellOutput", "SimulatedCell", "SimulationSettings"]


def __getattr__(name: str) -> Any:
    """Load the cell for its names."""
    if name in ("CellOutput", "SimulatedCell"):
        return getattr(import_module("rotcal_ros.methods.simulation.cell"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
