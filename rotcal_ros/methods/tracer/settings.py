"""The settings of the laser-tracer method: its plan, and its simulated cell with the faults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import expert, group, setting
from rotcal_ros.methods.simulation.settings import SimulationSettings
from rotcal_ros.methods.tracer.solver_settings import TracerSolverSettings
from rotcal_ros.planning.plan import Point
from rotcal_ros.planning.points import block
from rotcal_ros.planning.table_angles import TableAngleSettings

TRACER: Final = "tracer"
STATIONS_PER_TARGET = "stations_per_target"
TARGETS_PER_STATION = "targets_per_station"


@dataclass(frozen=True)
class SimulatedReadingsSettings:
    """How the simulated laser tracer reads."""

    dead_distance_m: float = expert(
        1.0, doc="m, distance at which the tracer reads zero", minimum=0.0
    )
    zero_shift_um: float = expert(
        0.0, doc="um, standard deviation of the zero from one start of the tracer to the next",
        minimum=0.0,
    )  # fmt: skip
    rate_hz: float = expert(1000.0, doc="Hz, rate of readings", minimum=0.1, maximum=10_000.0)
    noise_um: float = setting(0.2, doc="um, noise of one reading at distance 0", minimum=0.0)
    noise_um_per_m: float = expert(
        0.2, doc="um/m, growth of the noise with the distance", minimum=0.0
    )


@dataclass(frozen=True)
class SimulatedTracerSettings(SimulatedReadingsSettings):
    """The simulated laser tracer on the table."""

    mount_m: tuple[float, float, float] = expert(
        (0.0569, -0.0318, 0.1225), doc="m, centre of the tracer in the table frame at angle 0"
    )


@dataclass(frozen=True)
class SimulatedProbeSettings:
    """The coordinate measuring machine whose probe carries the reflector."""

    initial_position_m: tuple[float, float, float] = expert(
        (0.0, 0.0, 1.0), doc="m, position of the probe at the start"
    )
    systematic_um: float = setting(
        1.0, doc="um, standard deviation of the error of a target, the same at each visit",
        minimum=0.0,
    )  # fmt: skip
    repeatability_um: float = expert(
        0.1, doc="um, standard deviation of a coordinate from one arrival to the next", minimum=0.0
    )
    following_um: float = expert(
        0.5, doc="um, standard deviation of the reported from the commanded position", minimum=0.0
    )
    speed_m_s: float = expert(0.1, doc="m/s, largest speed", minimum=1e-6)
    acceleration_m_s2: float = expert(0.5, doc="m/s^2, acceleration", minimum=1e-6)
    settling_um: float = expert(2.0, doc="um, lag at the end of a motion", minimum=0.0)
    settling_time_s: float = expert(
        0.05, doc="s, time constant with which the lag decays", minimum=1e-6
    )
    report_delay_s: float = expert(
        0.05, doc="s, from the end of a motion to the report of the point", minimum=1e-3
    )


@dataclass(frozen=True)
class FaultSettings:
    """What goes wrong now and then."""

    blocked_from_deg: float = setting(
        0.0, doc="deg, start of the sector in which the beam is blocked"
    )
    blocked_to_deg: float = setting(
        0.0, doc="deg, end of the sector in which the beam is blocked; equal to the start: none"
    )
    blocked_targets: tuple[int, ...] = setting(
        (-1,), doc="targets whose beam is blocked while the table is in the sector; -1 alone: all"
    )
    break_probability: float = setting(
        0.0, doc="probability that the beam is broken at a reading", minimum=0.0, maximum=1.0
    )
    break_shift_um: float = setting(
        0.0,
        doc="um, standard deviation of the zero's change whenever the beam has been broken, in a "
        "sector without a beam too",
        minimum=0.0,
    )
    slip_probability: float = setting(
        0.0,
        minimum=0.0,
        maximum=1.0,
        doc="probability that the counter slips a fringe at a reading, and the status stays good",
    )
    spike_probability: float = setting(
        0.0, doc="probability that a reading is a spike", minimum=0.0, maximum=1.0
    )
    spike_um: float = setting(20.0, doc="um, magnitude of a spike", minimum=0.0)
    dropout_probability: float = setting(
        0.0, doc="probability that a reading is the first of a drop-out", minimum=0.0, maximum=1.0
    )
    dropout_samples: int = setting(5, doc="readings lost in a drop-out", minimum=1, maximum=10_000)
    non_finite_probability: float = setting(
        0.0, doc="probability that a reading is not a number", minimum=0.0, maximum=1.0
    )


@dataclass(frozen=True)
class LengthsSimulationSettings(SimulationSettings):
    """A simulated cell with a tracer on the table and a reflector on a machine."""

    instrument: str = expert(
        TRACER, doc="a laser tracer, with a machine for its reflector", choices=(TRACER,)
    )
    tracer: SimulatedReadingsSettings = group(SimulatedReadingsSettings)
    probe: SimulatedProbeSettings = group(SimulatedProbeSettings)
    faults: FaultSettings = group(FaultSettings, expert=True)


@dataclass(frozen=True)
class TracerSimulationSettings(LengthsSimulationSettings):
    """The simulated cell of the laser-tracer method."""

    tracer: SimulatedTracerSettings = group(SimulatedTracerSettings)


@dataclass(frozen=True)
class BlockSettings(TableAngleSettings):
    """Where the table turns and where the reflector goes."""

    box_centre_m: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.6), doc="m, centre of the block of targets", first=True
    )
    box_size_m: tuple[float, float, float] = setting(
        (0.45, 0.6, 0.45), doc="m, size of the block of targets", minimum=0.0, first=True
    )
    box_points: tuple[int, int, int] = setting(
        (4, 4, 4),
        minimum=1,
        maximum=1000,
        first=True,
        doc="number of targets along x, y and z in the block",
    )
    targets_m: tuple[float, ...] = setting(
        (), doc="m, explicit targets: x, y, z of target 0, of target 1, ...; replaces the block"
    )

    @property
    def block(self) -> tuple[Point, ...]:
        """The targets (m) of the block."""
        return block(self.box_centre_m, self.box_size_m, self.box_points)


@dataclass(frozen=True)
class TracerPlanSettings(BlockSettings):
    """Where the table turns and where the reflector goes."""

    order: str = setting(
        STATIONS_PER_TARGET,
        doc="what changes fastest: the table (the paper's order) or the target",
        choices=(STATIONS_PER_TARGET, TARGETS_PER_STATION),
    )
    runs: int = setting(
        1,
        minimum=1,
        maximum=100,
        doc="how often all table angles are measured; ISO 230-2 asks for 5",
    )
    bidirectional: bool = setting(
        False, doc="measure every run on the way up and, from the other side, on the way down"
    )
    targets_file: str = setting(
        "",
        doc="CSV file beside the configuration with the explicit targets: target,x_m,y_m,z_m; "
        "read into targets_m",
    )
    pairs: tuple[int, ...] = expert(
        (),
        doc="explicit steps in their order: table position and target of the first, of the "
        "second, ...; replaces the order",
        minimum=0,
    )
    pairs_file: str = expert(
        "",
        doc="CSV file beside the configuration with the explicit steps: "
        "step,table_position,target; read into pairs",
    )

    tracer_m: tuple[float, ...] = setting(
        (),
        doc="m, x, y, z of the tracer on the table at angle 0, to a few centimetres, where the "
        "solver starts; empty: not known; until_goal (except in a simulation), min_elevation_deg "
        "and min_distance_m need it",
        first=True,
    )
    min_elevation_deg: float | None = setting(
        None,
        minimum=-90.0,
        maximum=90.0,
        doc="deg, lowest beam above the tracer's horizon; pairs with a lower one are left out of "
        "the plan; none: no pair is",
    )
    min_distance_m: float = setting(
        0.0, doc="m, shortest beam; pairs with a shorter one are left out of the plan", minimum=0.0
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
