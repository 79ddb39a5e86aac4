"""The settings of the laser-tracer method: its solver, its plan, its simulated cell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any, ClassVar, Final, Literal

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import expert, group, setting
from rotcal_ros.methods.simulation.settings import SimulationSettings
from rotcal_ros.planning.plan import Point
from rotcal_ros.planning.points import serpentine_grid
from rotcal_ros.planning.table_angles import (
    TableAngleSettings,
    passing_setting,
    run_up_setting,
)

Variant = Literal["station", "joint"]
Datum = Literal["prior", "free"]
Zero = Literal["auto", "per_station", "per_segment"]


@dataclass(frozen=True)
class TracerLimits:
    """When a length is rejected, and when a result is no longer called ok.

    The significance of a rejection is two-sided and shared among the lengths; 0.01 means
    |test value| > 4.3 at 704 lengths.
    """

    rejection_significance: float = expert(
        0.01,
        minimum=1e-9,
        maximum=0.5,
        doc="probability of rejecting any length at all when all are good",
    )
    noise_significance: float = expert(
        0.01,
        minimum=1e-9,
        maximum=0.5,
        doc="probability of estimating the noise from the residuals although it is as stated",
    )
    test_significance: float = expert(
        0.001,
        minimum=1e-9,
        maximum=0.5,
        doc="probability of a false alarm of each global test (chi-squared, closure, motion)",
    )
    max_rejected_share: float = expert(
        0.03,
        minimum=0.001,
        maximum=0.5,
        doc="share of rejected lengths beyond which the verdict is suspect",
    )
    max_station_std: ClassVar[
        Annotated[
            float,
            "of the radius; a station that is known worse makes the linear model of its circle "
            "untrue",
        ]
    ] = 0.01

    def __post_init__(self) -> None:
        """Refuse shares and probabilities that are none; a file's ranges are narrower."""
        for limit in fields(TracerLimits):
            value = getattr(self, limit.name)
            if not 0.0 < value < 1.0:
                raise ConfigurationError(
                    f"tracer setting {limit.name} is {value}, expected 0 < value < 1"
                )


@dataclass(frozen=True)
class LengthNoiseSettings(TracerLimits):
    """How well the tracer measures and the machine places its targets."""

    length_std_m: float = setting(
        0.2e-6,
        minimum=1e-9,
        maximum=1e-2,
        first=True,
        doc="m, standard deviation of one captured length, repeatability included",
    )
    length_std_relative: float = setting(
        0.0,
        minimum=0.0,
        maximum=1e-2,
        doc="m/m, part of the standard deviation of a length that grows with the distance",
    )
    target_std_m: float = setting(
        1e-6,
        minimum=1e-9,
        maximum=1.0,
        first=True,
        doc="m, standard deviation of each coordinate of a target, from the errors of the machine",
    )
    slip_m: float = expert(
        0.3164e-6,
        minimum=0.0,
        maximum=1e-5,
        doc="m, a fringe by which the counter may slip unnoticed where lengths share zeros; what "
        "the residuals would not show of it is part of the uncertainty; 0: the counter does not "
        "slip",
    )
    lag_s: float | None = expert(
        None,
        minimum=-1.0,
        maximum=1.0,
        doc="s, by which the feedback of a table that turns is late behind the lengths; none: "
        "estimated where runs of several speeds tell it from the table's reversal, else the mean "
        "reversal is called zero",
    )
    lag_std_s: float = expert(
        1e-6, minimum=1e-9, maximum=1.0, doc="s, standard uncertainty (k = 1) of lag_s"
    )


@dataclass(frozen=True)
class TracerSolverSettings(LengthNoiseSettings):
    """How the laser-tracer method is solved."""

    variant: Variant = setting(
        "joint", doc="station by station with known targets, or joint self-calibration"
    )
    datum: Datum = setting(
        "prior",
        doc="joint variant: targets as weighted prior, or as mere start values (free network)",
    )
    zero: Zero = setting(
        "auto",
        doc="the unknown zero of the lengths: one per_station, or one per_segment of unbroken "
        "beam, which measures better and needs the variant joint; auto: per segment for a table "
        "with the column segment, else per station",
    )
    zero_walk_std_m: float | None = expert(
        0.0,
        minimum=0.0,
        maximum=1e-4,
        doc="m, with a zero per_segment: standard deviation of its change from one length to the "
        "next, as by temperature; 0: it does not change; none (null): estimated from the lengths",
    )
    position_std_m: float = expert(
        1e-7,
        minimum=0.0,
        maximum=1e-3,
        doc="m, standard deviation of each coordinate of the reflector from one arrival to the "
        "next, besides target_std_m, which stays the same: what a resumed plan measures again "
        "may differ by it",
    )
    circle_std_m: float | None = expert(
        None,
        minimum=1e-9,
        maximum=1e-2,
        doc="m, standard deviation of the stations from one circle about the table's axis, "
        "radially and along it; none: no circle is assumed, and every station is found by itself",
    )
    error_motion_std_m: float | None = setting(
        None,
        minimum=0.0,
        maximum=1e-2,
        doc="m, standard deviation of the table's radial error motion at the tracer's height; 0: "
        "no such motion; none: as circle_std_m, else estimated from the circle of the stations",
    )


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
    drifting_um: float = expert(
        0.0, doc="um, standard deviation of what air adds to readings that follow each other",
        minimum=0.0,
    )  # fmt: skip
    drifting_s: float = expert(
        0.1, doc="s, in which that is forgotten to 1/e", minimum=1e-6, maximum=1e6
    )
    lag_s: float = expert(
        0.0, doc="s, by which a reading is older than its stamp", minimum=-1.0, maximum=1.0
    )
    jitter_s: float = expert(
        0.0, doc="s, standard deviation of that from one reading to the next", minimum=0.0
    )
    dead_time_s: float = expert(
        0.0, doc="s, without a reading after the beam was broken", minimum=0.0
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
    blocked_times: int = setting(
        0, doc="how often it is blocked there, the first times; 0: always", minimum=0
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
        return serpentine_grid(self.box_centre_m, self.box_size_m, self.box_points)


@dataclass(frozen=True)
class TurningBlockSettings(BlockSettings):
    """The same, and how fast a table turns that does not stop at its angles."""

    turning_deg_s: tuple[float, ...] = expert(
        (),
        doc="deg/s, speeds at which the table turns once for each target while lengths are read, "
        "negative for back, as 12 and -12; none: it stops at every angle",
    )
    run_up_deg: float = run_up_setting()
    passing_deg: float = passing_setting(0.5)


@dataclass(frozen=True)
class TracerPlanSettings(TurningBlockSettings):
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
        doc="how often all table angles are measured; ISO 230-2 requires 5",
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
        return self.runs > 1 or self.bidirectional or len(self.turning_deg_s) > 1

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
