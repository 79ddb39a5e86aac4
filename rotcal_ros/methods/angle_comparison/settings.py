"""The settings of the comparison of two circles, without what makes and solves a plan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final, Literal

from rotcal_ros.foundation.settings import group, setting
from rotcal_ros.methods.simulation.settings import (
    AngleReaderSettings,
    AngularHarmonics,
    SimulationSettings,
)
from rotcal_ros.planning.table_angles import TableAngleSettings

Counting = Literal["with the table", "against the table"]
SIGNS: Final[Mapping[Counting, float]] = {"with the table": 1.0, "against the table": -1.0}
"""Of a reading where the table has turned too far."""


@dataclass(frozen=True)
class ComparisonPlanSettings(TableAngleSettings):
    """Where the table stops, and how the reference is shifted against it."""

    shifts_deg: tuple[float, ...] = setting(
        (0.0, 30.0, 150.0), first=True,
        doc="deg, table angle at which the reference shows its zero, for each setting of it",
    )  # fmt: skip
    bidirectional: bool = setting(
        False, doc="in every setting measure on the way up and, from the other side, down"
    )
    by_hand: bool = setting(
        True, doc="a person shifts the reference; false: it shifts by itself, or there are heads"
    )
    readings: int = setting(3, doc="readings at each position", minimum=1, maximum=1000)
    alignment_arcsec: float = setting(
        60.0, doc="arcsec, largest first reading of a setting: else align again", minimum=0.1
    )


@dataclass(frozen=True)
class ComparisonSolverSettings:
    """How sure a reading is, how it counts, and what is known about the reference."""

    sigma_arcsec: float = setting(
        0.05, minimum=1e-6, first=True,
        doc="arcsec, standard deviation of a reading, the table's repeatability included",
    )  # fmt: skip
    readings_count: Counting = setting(
        "with the table", first=True,
        doc="whether a table that turns too far reads more, or less (against the table)",
    )  # fmt: skip
    reference_errors_arcsec: tuple[float, ...] = setting(
        (), first=True,
        doc="arcsec, certificate: errors (actual - nominal, counter-clockwise) of the reference "
        "at the angles it shows, in their ascending order; none: unknown",
    )  # fmt: skip
    reference_std_arcsec: float = setting(
        0.05, minimum=1e-6,
        doc="arcsec, standard uncertainty (k = 1) of the errors of the certificate",
    )  # fmt: skip
    largest_shift_arcsec: ClassVar[
        Annotated[
            float,
            "a drift or a knock by more is seen by anybody at the readings",
        ]
    ] = 10.0


@dataclass(frozen=True)
class SimulatedReferenceSettings:
    """The reference as it really is, and how it is really set."""

    errors: AngularHarmonics = group(AngularHarmonics)
    mark_arcsec: float = setting(
        0.0, doc="arcsec, standard deviation of the error of each mark or face", minimum=0.0
    )
    shifts_deg: tuple[float, ...] = setting(
        (0.0, 30.0, 150.0), doc="deg, as plan.shifts_deg, as it is really set"
    )
    setting_arcsec: float = setting(
        10.0, doc="arcsec, standard deviation with which a person aligns it", minimum=0.0
    )
    readings_count: Counting = setting(
        "with the table", doc="as solver.readings_count, as it is really read"
    )


@dataclass(frozen=True)
class ComparisonSimulationSettings(SimulationSettings):
    """The simulated cell of the comparison of two circles."""

    reference: SimulatedReferenceSettings = group(SimulatedReferenceSettings)
    reader: AngleReaderSettings = group(AngleReaderSettings)


SETTINGS: Final[Mapping[str, type[Any]]] = {
    "plan": ComparisonPlanSettings,
    "solver": ComparisonSolverSettings,
    "simulation": ComparisonSimulationSettings,
}
"""The groups that this method declares for itself."""
