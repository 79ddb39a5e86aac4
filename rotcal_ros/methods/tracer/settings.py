"""The settings of the laser-tracer method, without what makes and solves a plan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import setting
from rotcal_ros.methods.tracer.simulation_settings import TracerSimulationSettings
from rotcal_ros.methods.tracer.solver_settings import TracerSolverSettings
from rotcal_ros.planning.table_angles import TableAngleSettings

STATIONS_PER_TARGET = "stations_per_target"
TARGETS_PER_STATION = "targets_per_station"


@dataclass(frozen=True)
class TracerPlanSettings(TableAngleSettings):
    """Where the table turns and where the reflector goes."""

    box_centre_m: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.6), doc="m, centre of the block of targets"
    )
    box_size_m: tuple[float, float, float] = setting(
        (0.45, 0.6, 0.45), doc="m, size of the block of targets", minimum=0.0
    )
    box_points: tuple[int, int, int] = setting(
        (4, 4, 4), doc="number of targets along x, y and z", minimum=1, maximum=1000
    )
    order: str = setting(
        STATIONS_PER_TARGET,
        doc="what changes fastest: the table (the paper's order) or the target",
        choices=(STATIONS_PER_TARGET, TARGETS_PER_STATION),
    )
    runs: int = setting(
        1,
        doc="how often all table angles are measured; ISO 230-2 asks for 5",
        minimum=1,
        maximum=100,
    )
    bidirectional: bool = setting(
        False, doc="measure every run on the way up and, from the other side, on the way down"
    )
    targets_m: tuple[float, ...] = setting(
        (), doc="m, explicit targets: x, y, z of target 0, of target 1, ...; replaces the box"
    )
    targets_file: str = setting(
        "",
        doc="CSV file beside the configuration with the explicit targets: target,x_m,y_m,z_m; "
        "read into targets_m",
    )
    pairs: tuple[int, ...] = setting(
        (),
        doc="explicit steps in their order: table position and target of the first, of the "
        "second, ...; replaces the order",
        minimum=0,
    )
    pairs_file: str = setting(
        "",
        doc="CSV file beside the configuration with the explicit steps: "
        "step,table_position,target; read into pairs",
    )

    tracer_m: tuple[float, ...] = setting(
        (),
        doc="m, where the tracer stands on the table at angle 0, to a few centimetres: x, y, z; "
        "the solver starts there, until_goal and the two below need it; absent: not known, and "
        "until_goal takes that of a simulation",
    )
    min_elevation_deg: float | None = setting(
        None,
        doc="deg, lowest beam over the tracer's horizon; pairs below are left out of the plan; "
        "absent: none is",
        minimum=-90.0,
        maximum=90.0,
    )
    min_distance_m: float = setting(
        0.0, doc="m, pairs with a shorter beam are left out of the plan", minimum=0.0
    )

    def __post_init__(self) -> None:
        """Refuse lists that are incomplete, and files whose content is not here."""
        for name, length, what in (
            ("targets_m", 3, "x, y, z of each target"),
            ("pairs", 2, "table position and target of each step"),
        ):
            if len(getattr(self, name)) % length:
                raise ConfigurationError(
                    f"{name} has {len(getattr(self, name))} numbers, expected {what}"
                )
        for name, lists in (("targets_file", "targets_m"), ("pairs_file", "pairs")):
            if getattr(self, name):
                raise ConfigurationError(
                    f"{name}: {getattr(self, name)} is read with the configuration file that "
                    f"names it; here there is no file: give {lists} instead"
                )

    @property
    def listed(self) -> tuple[tuple[int, int], ...]:
        """The explicit pairs of table position and target, in their order."""
        return tuple(zip(self.pairs[::2], self.pairs[1::2], strict=True))

    @property
    def repeated(self) -> bool:
        """Whether the table comes to an angle more than once."""
        return self.runs > 1 or self.bidirectional

    @property
    def limited(self) -> bool:
        """Whether pairs with a beam that is too low or too short are left out."""
        return self.min_elevation_deg is not None or self.min_distance_m > 0.0


SETTINGS: Final[Mapping[str, type[Any]]] = {
    "plan": TracerPlanSettings,
    "solver": TracerSolverSettings,
    "simulation": TracerSimulationSettings,
}
"""The groups that this method declares for itself."""
