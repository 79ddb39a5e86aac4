"""The settings of deviations that are known already, without what makes a result of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from rotcal_ros.foundation.settings import group, setting
from rotcal_ros.methods.simulation.settings import AngleReaderSettings, SimulationSettings
from rotcal_ros.planning.table_angles import TableAngleSettings


@dataclass(frozen=True)
class DeviationPlanSettings(TableAngleSettings):
    """Where the table stops, how often, and from which side."""

    runs: int = setting(1, doc="runs through all table angles", minimum=1, maximum=1000)
    bidirectional: bool = setting(
        False, doc="in every run measure on the way up and, from the other side, down"
    )
    readings: int = setting(3, doc="readings at each position", minimum=1, maximum=1000)


@dataclass(frozen=True)
class DeviationSolverSettings:
    """How sure a deviation is."""

    u_arcsec: float = setting(
        0.0, minimum=0.0, first=True,
        doc="arcsec, standard uncertainty (k = 1) of each deviation, the same in all runs, where "
        "the table states none; 0: not known",
    )  # fmt: skip


@dataclass(frozen=True)
class DeviationSimulationSettings(SimulationSettings):
    """A simulated table, and an interferometer with an indexer that follows it."""

    reader: AngleReaderSettings = group(AngleReaderSettings)


SETTINGS: Final[Mapping[str, type[Any]]] = {
    "plan": DeviationPlanSettings,
    "solver": DeviationSolverSettings,
    "simulation": DeviationSimulationSettings,
}
"""The groups that this method declares for itself."""
