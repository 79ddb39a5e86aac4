"""The settings of the design of a tracer's plan: goal, volume, what is in the way, and noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Final

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.protection import TOLERABLE
from rotcal_ros.foundation.settings import expert, setting
from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.tracer.settings import TracerLimits, TracerSolverSettings
from rotcal_ros.planning.table_angles import TableAngleSettings

Triple = tuple[float, float, float]
SHARED = "one"
PER_STATION = "per_station"
ANY = "any"
DIRECTION = "direction"
AXIS = "axis"
CHECK_FILE: Final = "check.yaml"
"""The configuration of a quick check that was planned."""
LEAST_REDUNDANCY: Final = 0.25
"""Below it an error of one length would hardly show in its residual."""


@dataclass(frozen=True)
class TracerDesignSettings(TableAngleSettings):
    """What a plan has to reach, where the reflector may go, and how well all is known.

    Lengths in metres in the machine's frame. A list of boxes has six numbers for each: smallest
    x, y, z, largest x, y, z. A list of sectors has two: from, to.
    """

    need_arcsec: float = setting(
        1.2,
        doc="arcsec, required expanded uncertainty U(ECC) (k = 2), root mean square over the "
        "angles, without their mean",
        minimum=1e-6,
    )
    need_largest_arcsec: float | None = setting(
        None,
        doc="arcsec, required U(ECC) at the worst angle; none: 1.1 times need_arcsec",
        minimum=1e-6,
    )
    mount_m: Triple = setting(
        (0.0569, -0.0318, 0.1225), doc="m, centre of the tracer in the table frame at angle 0"
    )
    axis_m: tuple[float, float] = setting(
        (0.0, 0.0), doc="m, where the table axis meets the machine's xy-plane"
    )
    volume_min_m: Triple = setting((-0.6, -0.5, 0.17), doc="m, smallest x, y, z of a target")
    volume_max_m: Triple = setting((0.6, 0.5, 1.02), doc="m, largest x, y, z of a target")
    spacing_m: float = setting(
        0.11,
        doc="m, least distance between two targets; closer ones share the machine's error",
        minimum=1e-3,
    )
    keep_out_m: tuple[float, ...] = setting(
        (), doc="m, boxes where neither target nor beam may be"
    )
    margin_m: float = setting(
        0.0, doc="m, margin by which the boxes of keep_out_m are widened", minimum=0.0
    )
    min_distance_m: float = setting(0.25, doc="m, least distance from the tracer", minimum=0.0)
    max_distance_m: float = setting(15.0, doc="m, reach of the tracer", minimum=0.0)
    min_elevation_deg: float = setting(
        10.0, doc="deg, lowest beam above the tracer's horizon", minimum=-90.0, maximum=90.0
    )
    max_elevation_deg: float = setting(
        90.0, doc="deg, highest beam above the tracer's horizon", minimum=-90.0, maximum=90.0
    )
    blocked_azimuth_deg: tuple[float, ...] = setting(
        (),
        doc="deg, sectors without a beam, as directions in the machine frame seen from the tracer",
    )
    blocked_on_table_deg: tuple[float, ...] = setting(
        (), doc="deg, sectors without a beam that turn with the table"
    )
    reflector_faces: str = setting(
        ANY,
        doc="where the reflector looks: wherever the tracer is, in one direction, or to the axis",
        choices=(ANY, DIRECTION, AXIS),
    )
    reflector_direction: Triple = setting(
        (0.0, 0.0, -1.0),
        doc="direction in which the reflector looks, if reflector_faces is direction",
    )
    reflector_acceptance_deg: float = setting(
        50.0,
        minimum=0.0,
        maximum=180.0,
        doc="deg, largest angle between the beam and where the reflector looks",
    )
    length_std_m: float = setting(
        0.2e-6, doc="m, standard deviation of one length", minimum=1e-9, maximum=1e-2
    )
    length_std_relative: float = setting(
        0.0,
        minimum=0.0,
        maximum=1e-2,
        doc="m/m, part of the standard deviation of a length that grows with the distance",
    )
    target_std_m: Triple = setting(
        (1e-6, 1e-6, 1e-6), doc="m, standard deviation of a target along x, y, z", minimum=0.0
    )
    error_motion_std_m: float | None = setting(
        None,
        minimum=0.0,
        maximum=1e-2,
        doc="m, standard deviation of the table's radial error motion: part of U, and written "
        "down for the solver; 0: no such motion; none: as circle_std_m, else the solver "
        "estimates it from the circle, which takes more lengths",
    )
    zero: str = setting(
        PER_STATION,
        doc="zeros of the lengths: of each station, or one for all (the beam is never broken)",
        choices=(PER_STATION, SHARED),
    )
    circle_std_m: float | None = setting(
        None,
        doc="m, standard deviation of the stations from one circle; none: no circle is assumed",
        minimum=1e-9,
    )
    slip_m: float = expert(
        TracerSolverSettings().slip_m,
        minimum=0.0,
        maximum=1e-5,
        doc="m, if zero is one: a fringe that may slip unseen and is part of U, as solver.slip_m; "
        "0: none slips",
    )
    confidence: float = expert(
        0.9,
        minimum=0.5,
        maximum=0.99,
        doc="probability with which the result's own U meets the goal",
    )
    repeats: int = setting(
        1,
        minimum=1,
        maximum=1000,
        doc="how often a pair of table angle and target may be measured",
    )
    min_redundancy: ClassVar[
        Annotated[
            float,
            "below it the residuals hardly show an error of the length",
        ]
    ] = LEAST_REDUNDANCY
    max_undetected: ClassVar[
        Annotated[
            float,
            "an error that nothing shows may be as large as U and no larger",
        ]
    ] = 1.0
    rejection_significance: float = expert(
        0.01,
        minimum=1e-9,
        maximum=0.5,
        doc="probability of rejecting any length at all when all are good, as "
        "solver.rejection_significance",
    )
    power: ClassVar[Annotated[float, "the usual power of Baarda's minimal detectable error"]] = 0.8
    checked: bool = setting(
        True, doc="every length is checked by others; false: the fewest lengths, unchecked"
    )
    exchanges: int = expert(
        600, doc="exchanges of lengths in each search for a plan with fewer", minimum=1
    )
    starts: int = expert(
        3, doc="number of searches, of which the best counts", minimum=1, maximum=100
    )
    seed: int = expert(0, doc="seed of the random numbers of the search", minimum=0)
    max_unseen: ClassVar[
        Annotated[
            float,
            "as rotcal plan sequence has it, where --limit changes it",
        ]
    ] = TOLERABLE
    length_s: float = setting(
        5.0, doc="s, time for a length, without turns of the table", minimum=0.0
    )
    rotation_s: float = setting(
        10.0, doc="s, time for a turn of the table from one angle to the next", minimum=0.0
    )
    machine_speed_m_s: float | None = setting(
        None,
        doc="m/s, largest speed of the reflector; none: its motion is part of length_s",
        minimum=1e-6,
    )
    machine_acceleration_m_s2: float = setting(
        0.5, doc="m/s^2, acceleration of the reflector", minimum=1e-6
    )

    def __post_init__(self) -> None:
        """Refuse settings that do not go together."""
        for name, size in (("keep_out_m", 6), ("blocked_azimuth_deg", 2),
                           ("blocked_on_table_deg", 2)):  # fmt: skip
            if len(getattr(self, name)) % size:
                raise ConfigurationError(
                    f"{name} has {len(getattr(self, name))} numbers, expected {size} for each"
                )
        for box in zip(*(iter(self.keep_out_m),) * 6, strict=True):
            if any(a > b for a, b in zip(box[:3], box[3:], strict=True)):
                raise ConfigurationError(
                    f"keep_out_m: {list(box)} is no box: expected smallest x, y, z, then largest"
                )
        if any(a > b for a, b in zip(self.volume_min_m, self.volume_max_m, strict=True)):
            raise ConfigurationError(
                f"volume_min_m {self.volume_min_m} lies beyond volume_max_m {self.volume_max_m}: "
                "give the smallest x, y, z first"
            )

    @property
    def limits(self) -> TracerLimits:
        """The solver's limits that a plan counts on."""
        return TracerLimits(rejection_significance=self.rejection_significance)

    @property
    def error_motion(self) -> float | None:
        """The error motion (m) that the solver will hold to; None: it estimates it."""
        return self.circle_std_m if self.error_motion_std_m is None else self.error_motion_std_m

    @property
    def largest_arcsec(self) -> float:
        """Required U at the worst angle, arcsec."""
        return self.need_largest_arcsec or 1.1 * self.need_arcsec

    @property
    def goal(self) -> tuple[float, float]:
        """Required U, rms over the angles and at the worst one, rad."""
        return self.need_arcsec * ARCSEC, self.largest_arcsec * ARCSEC
