"""The settings of the simulated cell: group ``simulation`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

from rotcal_ros.errors import ConfigurationError
from rotcal_ros.settings import group, setting
from rotcal_ros.simulation.touch_settings import SimulatedPlateSettings, TouchProbeSettings
from rotcal_ros.simulation.tracker_settings import SimulatedMirrorSettings, TrackerSettings

TRACER: Final = "tracer"
TRACKER: Final = "tracker"
TOUCH_PROBE: Final = "touch_probe"


@dataclass(frozen=True)
class LinearHarmonics:
    """A translation deviation: sum of amplitude_k cos(k angle + phase_k), k = 1, 2, ..."""

    amplitudes_um: tuple[float, ...] = setting((0.0,), doc="um, amplitude of each order from 1")
    phases_deg: tuple[float, ...] = setting((0.0,), doc="deg, phase of each order from 1")


@dataclass(frozen=True)
class AngularHarmonics:
    """A rotation deviation: sum of amplitude_k cos(k angle + phase_k), k = 1, 2, ..."""

    amplitudes_arcsec: tuple[float, ...] = setting(
        (0.0,), doc="arcsec, amplitude of each order from 1"
    )
    phases_deg: tuple[float, ...] = setting((0.0,), doc="deg, phase of each order from 1")


@dataclass(frozen=True)
class CompensationSettings:
    """The correction table that the table's control applies, linear between its rows."""

    angles_deg: tuple[float, ...] = setting(
        (), doc="deg, ascending commanded angles; 0 to 360 repeats; none: no compensation"
    )
    forward_arcsec: tuple[float, ...] = setting(
        (), doc="arcsec, added to the command when the angle increases, one for each row"
    )
    reverse_arcsec: tuple[float, ...] = setting(
        (), doc="arcsec, added to the command when the angle decreases, one for each row"
    )

    def __post_init__(self) -> None:
        counts = {len(self.angles_deg), len(self.forward_arcsec), len(self.reverse_arcsec)}
        if len(counts) > 1 or any(b <= a for a, b in pairwise(self.angles_deg)):
            raise ConfigurationError(
                f"simulation.table.compensation: {len(self.angles_deg)} angles with "
                f"{len(self.forward_arcsec)} forward and {len(self.reverse_arcsec)} reverse "
                "corrections: expected ascending angles and one of both for each"
            )


@dataclass(frozen=True)
class TableSettings:
    """The rotary table: deviations, axis, motion and feedback."""

    exc: LinearHarmonics = group(LinearHarmonics)
    eyc: LinearHarmonics = group(LinearHarmonics)
    ezc: LinearHarmonics = group(LinearHarmonics)
    eac: AngularHarmonics = group(AngularHarmonics)
    ebc: AngularHarmonics = group(AngularHarmonics)
    ecc: AngularHarmonics = group(AngularHarmonics)
    compensation: CompensationSettings = group(CompensationSettings)
    external: bool = setting(
        False, doc="another program moves the table and tells its actual angle on table_actual"
    )
    backlash_arcsec: float = setting(
        0.0, doc="arcsec, by which the angle stays larger when approached from above"
    )
    repeatability_arcsec: float = setting(
        0.0,
        doc="arcsec, standard deviation of the angle from one arrival to the next",
        minimum=0.0,
    )
    axis_offset_m: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0), doc="m, origin of the table axis in the machine frame"
    )
    axis_tilt_arcsec: tuple[float, float] = setting(
        (0.0, 0.0), doc="arcsec, rotation of the table axis about x, then y of the machine"
    )
    initial_angle_deg: float = setting(0.0, doc="deg, angle at the start")
    speed_deg_s: float = setting(20.0, doc="deg/s, largest speed", minimum=1e-3)
    acceleration_deg_s2: float = setting(40.0, doc="deg/s^2, acceleration", minimum=1e-3)
    overshoot_deg: float = setting(
        2.0, doc="deg, by which the table passes an angle to approach it from the other side",
        minimum=1e-3,
    )  # fmt: skip
    settling_arcsec: float = setting(5.0, doc="arcsec, lag at the end of a motion", minimum=0.0)
    settling_time_s: float = setting(
        0.05, doc="s, time constant with which the lag decays", minimum=1e-6
    )
    feedback_rate_hz: float = setting(
        100.0, doc="Hz, rate of the table feedback", minimum=0.1, maximum=10_000.0
    )
    feedback_noise_arcsec: float = setting(
        0.02, doc="arcsec, noise of one table feedback", minimum=0.0
    )


@dataclass(frozen=True)
class TracerSettings:
    """The laser tracer on the table."""

    mount_m: tuple[float, float, float] = setting(
        (0.0569, -0.0318, 0.1225), doc="m, centre of the tracer in the table frame at angle 0"
    )
    dead_distance_m: float = setting(
        1.0, doc="m, distance at which the tracer reads zero", minimum=0.0
    )
    zero_shift_um: float = setting(
        0.0, doc="um, standard deviation of the zero from one start of the tracer to the next",
        minimum=0.0,
    )  # fmt: skip
    rate_hz: float = setting(1000.0, doc="Hz, rate of readings", minimum=0.1, maximum=10_000.0)
    noise_um: float = setting(0.2, doc="um, noise of one reading at distance 0", minimum=0.0)
    noise_um_per_m: float = setting(
        0.2, doc="um/m, growth of the noise with the distance", minimum=0.0
    )


@dataclass(frozen=True)
class ProbeSettings:
    """The coordinate measuring machine whose probe carries the reflector."""

    initial_position_m: tuple[float, float, float] = setting(
        (0.0, 0.0, 1.0), doc="m, position of the probe at the start"
    )
    systematic_um: float = setting(
        1.0, doc="um, standard deviation of the error of a target, the same at each visit",
        minimum=0.0,
    )  # fmt: skip
    repeatability_um: float = setting(
        0.1, doc="um, standard deviation of a coordinate from one arrival to the next", minimum=0.0
    )
    following_um: float = setting(
        0.5, doc="um, standard deviation of the reported from the commanded position", minimum=0.0
    )
    speed_m_s: float = setting(0.1, doc="m/s, largest speed", minimum=1e-6)
    acceleration_m_s2: float = setting(0.5, doc="m/s^2, acceleration", minimum=1e-6)
    settling_um: float = setting(2.0, doc="um, lag at the end of a motion", minimum=0.0)
    settling_time_s: float = setting(
        0.05, doc="s, time constant with which the lag decays", minimum=1e-6
    )
    report_delay_s: float = setting(
        0.05, doc="s, from the end of a motion to the report of the point", minimum=1e-3
    )


@dataclass(frozen=True)
class TemperatureSettings:
    """The temperature of the air and what it does."""

    mean_c: float = setting(20.0, doc="degC, temperature at the start")
    drift_k_per_h: float = setting(0.1, doc="K/h, steady drift")
    swing_k: float = setting(0.05, doc="K, amplitude of the periodic part", minimum=0.0)
    swing_period_s: float = setting(900.0, doc="s, period of the periodic part", minimum=1e-3)
    noise_k: float = setting(0.002, doc="K, noise of one reading", minimum=0.0)
    rate_hz: float = setting(1.0, doc="Hz, rate of readings", minimum=0.01, maximum=1000.0)
    length_um_per_m_k: float = setting(
        0.0, doc="um/(m K), growth of a reading with distance and temperature from the start"
    )
    dead_distance_um_per_k: float = setting(
        0.0, doc="um/K, growth of every reading with the temperature from the start"
    )


@dataclass(frozen=True)
class FaultSettings:
    """What goes wrong now and then."""

    blocked_from_deg: float = setting(0.0, doc="deg, start of the sector without a beam")
    blocked_to_deg: float = setting(
        0.0, doc="deg, end of the sector without a beam; equal to the start: none"
    )
    blocked_targets: tuple[int, ...] = setting(
        (-1,), doc="targets without a beam while the table is in the sector; -1 alone: all"
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
class SimulationSettings:
    """The simulated cell: a table, a temperature, and one of the instruments."""

    instrument: str = setting(
        TRACER,
        doc="what measures: a laser tracer with a machine for its reflector, a machine that "
        "touches the balls of a plate, or a laser tracker with a mirror",
        choices=(TRACER, TOUCH_PROBE, TRACKER),
    )
    seed: int = setting(1, doc="seed of all random numbers", minimum=0, maximum=2**31 - 1)
    time_scale: float = setting(
        1.0,
        doc="machine seconds in a second while something moves or settles; 1: life speed",
        minimum=0.01,
        maximum=1000.0,
    )
    hold_s: float = setting(
        2.0, doc="s, machine time after the last motion that still counts as busy", minimum=0.0
    )
    table: TableSettings = group(TableSettings)
    tracker: TrackerSettings = group(TrackerSettings)
    mirror: SimulatedMirrorSettings = group(SimulatedMirrorSettings)
    plate: SimulatedPlateSettings = group(SimulatedPlateSettings)
    touch_probe: TouchProbeSettings = group(TouchProbeSettings)
    tracer: TracerSettings = group(TracerSettings)
    probe: ProbeSettings = group(ProbeSettings)
    temperature: TemperatureSettings = group(TemperatureSettings)
    faults: FaultSettings = group(FaultSettings)

    def __post_init__(self) -> None:
        if self.table.external and self.time_scale != 1.0:
            raise ConfigurationError(
                f"simulation: an external table moves at life speed, time_scale is "
                f"{self.time_scale:g}: set it to 1"
            )
