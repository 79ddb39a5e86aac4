"""The settings of the simulated cell: group ``simulation`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, ClassVar

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import expert, group, setting


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
                f"{len(self.angles_deg)} angles with "
                f"{len(self.forward_arcsec)} forward and {len(self.reverse_arcsec)} reverse "
                "corrections: expected ascending angles and one of each for every angle"
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
    compensation: CompensationSettings = group(CompensationSettings, expert=True)
    external: bool = expert(
        False, doc="another program moves the table and publishes its actual angle on table_actual"
    )
    backlash_arcsec: float = expert(
        0.0, doc="arcsec, by which the angle stays larger when approached from above"
    )
    repeatability_arcsec: float = expert(
        0.0, minimum=0.0,
        doc="arcsec, standard deviation of the angle from one arrival to the next",
    )  # fmt: skip
    repeatability_um: float = expert(
        0.0, minimum=0.0,
        doc="um, standard deviation of the shifts along x, y and z from one arrival to the next",
    )  # fmt: skip
    repeatability_tilt_arcsec: float = expert(
        0.0, minimum=0.0,
        doc="arcsec, standard deviation of the tilts about x and y from one arrival to the next",
    )  # fmt: skip
    axis_offset_m: tuple[float, float, float] = expert(
        (0.0, 0.0, 0.0), doc="m, origin of the table axis in the machine frame"
    )
    axis_tilt_arcsec: tuple[float, float] = expert(
        (0.0, 0.0), doc="arcsec, rotation of the table axis about x, then y of the machine"
    )
    initial_angle_deg: float = expert(0.0, doc="deg, angle at the start")
    speed_deg_s: float = expert(20.0, doc="deg/s, largest speed", minimum=1e-3)
    acceleration_deg_s2: float = expert(40.0, doc="deg/s^2, acceleration", minimum=1e-3)
    overshoot_deg: float = expert(
        2.0, doc="deg, by which the table passes an angle to approach it from the other side",
        minimum=1e-3,
    )  # fmt: skip
    settling_arcsec: float = expert(5.0, doc="arcsec, lag at the end of a motion", minimum=0.0)
    settling_time_s: float = expert(
        0.05, doc="s, time constant with which the lag decays", minimum=1e-6
    )
    feedback_rate_hz: float = expert(
        100.0, doc="Hz, rate of the table feedback", minimum=0.1, maximum=10_000.0
    )
    feedback_noise_arcsec: ClassVar[
        Annotated[
            float,
            "resolution of a good encoder, far below what is measured",
        ]
    ] = 0.02
    feedback_lag_s: float = expert(
        0.0, minimum=-1.0, maximum=1.0,
        doc="s, by which the feedback is late while the table moves",
    )  # fmt: skip
    ripple_arcsec: float = expert(
        0.0, minimum=0.0, doc="arcsec, amplitude about even motion while the table turns on"
    )
    ripple_hz: ClassVar[
        Annotated[float, "slow enough for the feedback to show it, fast enough to average out"]
    ] = 3.0


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
        0.0, doc="um/(m*K), growth of a reading with distance and temperature from the start"
    )
    dead_distance_um_per_k: float = setting(
        0.0, doc="um/K, growth of every reading with the temperature from the start"
    )


@dataclass(frozen=True)
class SimulatedAirSettings:
    """Pressure and humidity of the air; its temperature is that of the group beside it."""

    published: bool = setting(
        False, doc="air_pressure and relative_humidity are published, as often as the temperature"
    )
    pressure_pa: float = setting(
        101_325.0, doc="Pa, pressure at the start", minimum=20e3, maximum=130e3
    )
    pressure_swing_pa: float = setting(0.0, doc="Pa, amplitude of the periodic part", minimum=0.0)
    pressure_swing_period_s: ClassVar[
        Annotated[float, "minutes, as with doors; pressure_swing_pa says whether there is any"]
    ] = 600.0
    humidity: float = setting(0.5, doc="relative humidity, 0 to 1", minimum=0.0, maximum=1.0)
    noise_pa: float = setting(1.0, doc="Pa, noise of one reading", minimum=0.0)
    vacuum_lengths: bool = setting(
        False, doc="the tracer counts vacuum wavelengths: its lengths are not corrected"
    )
    vacuum_wavelength_nm: float = setting(
        632.8, doc="nm, its wavelength in vacuum", minimum=300.0, maximum=1700.0
    )


@dataclass(frozen=True)
class AngleReaderSettings:
    """An instrument at rest that reads small angles: an autocollimator, an interferometer."""

    noise_arcsec: float = setting(0.03, doc="arcsec, noise of one reading", minimum=0.0)
    range_arcsec: ClassVar[Annotated[float, "as of a common electronic autocollimator"]] = 300.0
    settling_time_s: float = setting(1.0, doc="s, from table at rest to reading", minimum=0.0)
    reading_time_s: ClassVar[Annotated[float, "as of a common electronic autocollimator"]] = 0.2
    readings: int = setting(3, doc="readings for each order", minimum=1, maximum=1000)


@dataclass(frozen=True)
class SimulationSettings:
    """The simulated cell: a table, a temperature, and the instrument of a method."""

    seed: int = setting(1, doc="seed of all random numbers", minimum=0, maximum=2**31 - 1)
    run: int = expert(
        0, minimum=0, maximum=2**31 - 1,
        doc="another number: the same machine measured again, with other noise",
    )  # fmt: skip
    time_scale: float = setting(
        1.0, minimum=0.01, maximum=1000.0,
        doc="machine seconds in a second of the clock while something moves or settles; 1: real "
        "time",
    )  # fmt: skip
    hold_s: float = expert(
        2.0, doc="s, machine time after the last motion that still counts as busy", minimum=0.0
    )
    person: bool = expert(
        True,
        doc="a simulated person does at once what the plan asks for; false: a real one says when "
        "it is done, to rehearse",
    )
    table: TableSettings = group(TableSettings)
    temperature: TemperatureSettings = group(TemperatureSettings, expert=True)
    air: SimulatedAirSettings = group(SimulatedAirSettings, expert=True)

    @property
    def noise_seed(self) -> int:
        """Seed of what each run draws anew; ``seed`` alone is that of what the machine is."""
        return self.seed + (self.run << 32)

    def __post_init__(self) -> None:
        if self.table.external and self.time_scale != 1.0:
            raise ConfigurationError(
                f"an external table moves at life speed, time_scale is "
                f"{self.time_scale:g}: set it to 1"
            )
