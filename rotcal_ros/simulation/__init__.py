"""The simulated cell: table, temperature and an instrument as plain physics."""

from rotcal_ros.simulation.cell import CellOutput, SimulatedCell
from rotcal_ros.simulation.settings import SimulationSettings

__all__ = ["CellOutput", "SimulatedCell", "SimulationSettings"]
