"""The settings of the six-deviations method: its plan, its solver, its simulated cell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final, Literal

from rotcal_ros.foundation.settings import expert, group, setting
from rotcal_ros.methods.tracer.settings import (
    STATIONS_PER_TARGET,
    TARGETS_PER_STATION,
    Datum,
    LengthNoiseSettings,
    LengthsSimulationSettings,
    SimulatedReadingsSettings,
    TurningBlockSettings,
)


@dataclass(frozen=True)
class CarriedTracerSettings(SimulatedReadingsSettings):
    """The simulated laser tracer, and the person who fixes it at its places."""

    places_m: tuple[float, ...] = expert(
        (0.15, 0.0, 0.12, -0.075, 0.1299, 0.12, -0.075, -0.1299, 0.12),
        doc="m, x y z of place 0, then of place 1 and so on, in the table frame at angle 0",
        minimum=-10.0,
        maximum=10.0,
    )
    placing_mm: float = expert(
        0.5, doc="mm, by which the person misses each coordinate of a place", minimum=0.0
    )
    mounting_zero_um: float = expert(
        0.0, doc="um, standard deviation of the zero from one mounting to the next", minimum=0.0
    )
    misplaced_place: int = expert(
        -1, doc="number of a place that the person mistakes; -1: none", minimum=-1
    )
    misplaced_mm: ClassVar[
        Annotated[float, "beyond plan.place_tolerance_m; misplaced_place says whether and where"]
    ] = 50.0


@dataclass(frozen=True)
class SixSimulationSettings(LengthsSimulationSettings):
    """The simulated cell of the six-deviations method."""

    tracer: CarriedTracerSettings = group(CarriedTracerSettings)


@dataclass(frozen=True)
class SixPlanSettings(TurningBlockSettings):
    """Where the tracer stands on the table, where the table turns, where the reflector goes.

    Several tracers at once are not planned for: one goes from place to place.
    """

    places: int = setting(
        3,
        minimum=1,
        maximum=24,
        first=True,
        doc="number of places of the tracer on the table, evenly around its axis",
    )
    place_radius_m: float = setting(
        0.15,
        minimum=0.001,
        maximum=10.0,
        first=True,
        doc="m, distance of the places from the table axis",
    )
    place_azimuth_deg: float = expert(
        0.0, doc="deg, direction of the first place with the table at angle 0"
    )
    place_height_m: float = setting(
        0.12,
        minimum=-5.0,
        maximum=10.0,
        first=True,
        doc="m, height of the tracer's centre at the first place",
    )
    place_height_step_m: float = setting(
        0.0,
        minimum=-1.0,
        maximum=1.0,
        doc="m, by which each place is higher than the one before; unequal heights where each "
        "station has a zero of its own",
    )
    places_m: tuple[float, ...] = setting(
        (),
        minimum=-10.0,
        maximum=10.0,
        doc="m, x y z of place 0, then of place 1 and so on, with the table at angle 0; replaces "
        "places, place_radius_m, place_azimuth_deg, place_height_m and place_height_step_m",
    )
    place_tolerance_m: float = expert(
        0.01,
        minimum=1e-5,
        maximum=0.05,
        doc="m, by which the tracer may miss its place before the person is asked again",
    )
    box_centre_m: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.61), doc="m, centre of the block of targets"
    )
    box_size_m: tuple[float, float, float] = setting(
        (1.0, 1.0, 0.82), doc="m, size of the block of targets", minimum=0.0
    )
    box_points: tuple[int, int, int] = setting(
        (4, 3, 2), doc="number of targets along x, y and z in the block", minimum=1, maximum=1000
    )
    targets_m: tuple[float, ...] = setting(
        (),
        minimum=-50.0,
        maximum=50.0,
        first=True,
        doc="m, x y z of target 0, then of target 1 and so on; empty: the block of box_centre_m, "
        "box_size_m and box_points",
    )
    order: str = setting(
        TARGETS_PER_STATION,
        doc="what changes fastest: the target, so that the table comes to each angle once, or the "
        "table",
        choices=(TARGETS_PER_STATION, STATIONS_PER_TARGET),
    )
    bidirectional: bool = setting(
        False,
        doc="at every place go up through the angles and, approaching from the other side, down "
        "again",
    )
    arrivals: int = setting(
        1,
        minimum=1,
        maximum=20,
        doc="how often the table comes to each angle from each place; 2 show its scatter better",
    )
    closes: bool = setting(
        False, doc="measure the first angle again at the end of every place, or of every target"
    )


Zero = Literal["per_run", "per_station", "per_segment"]
ZeroSetting = Literal["auto", Zero]


@dataclass(frozen=True)
class TracerSixSolverSettings(LengthNoiseSettings):
    """How six deviations are solved from lengths."""

    datum: Datum = setting(
        "prior", doc="targets as weighted prior, or as mere start values (free network)"
    )
    zero: ZeroSetting = setting(
        "auto",
        doc="which lengths share the unknown zero of the counter: all from one place (per_run: a "
        "beam that never broke), those of an angle and place (per_station), or those of one "
        "unbroken beam (per_segment); auto: per segment where the measurement names the "
        "segments, else per run",
    )
    scatter_translation_std_m: float | None = expert(
        None,
        minimum=0.0,
        maximum=1e-2,
        doc="m, standard deviation of the table's place from one arrival to the next, along each "
        "axis; 0: known to repeat; none: estimated from the distances between the places",
    )
    scatter_rotation_std_rad: float | None = expert(
        None,
        minimum=0.0,
        maximum=1e-2,
        doc="rad, standard deviation of the table's attitude from one arrival to the next, about "
        "each axis; 0: known to repeat; none: estimated from the distances between the places",
    )
    tilt_std_rad: float | None = setting(
        None,
        minimum=1e-9,
        maximum=1e-2,
        doc="rad, known standard deviation of the table's tilts EAC and EBC; two places need it; "
        "none: nothing is known",
    )


SETTINGS: Final[Mapping[str, type[Any]]] = {
    "plan": SixPlanSettings,
    "solver": TracerSixSolverSettings,
    "simulation": SixSimulationSettings,
}
"""The groups that this method declares for itself."""
