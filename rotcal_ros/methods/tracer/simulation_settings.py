"""The settings of a simulated laser tracer, its machine and its faults."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from rotcal_ros.foundation.settings import group, setting
from rotcal_ros.simulation.settings import SimulationSettings

TRACER: Final = "tracer"


@dataclass(frozen=True)
class SimulatedReadingsSettings:
    """How the simulated laser tracer reads."""

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
class SimulatedTracerSettings(SimulatedReadingsSettings):
    """The simulated laser tracer on the table."""

    mount_m: tuple[float, float, float] = setting(
        (0.0569, -0.0318, 0.1225), doc="m, centre of the tracer in the table frame at angle 0"
    )


@dataclass(frozen=True)
class SimulatedProbeSettings:
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
class FaultSettings:
    """What goes wrong now and then."""

    blocked_from_deg: float = setting(0.0, doc="deg, start of the sector without a beam")
    blocked_to_deg: float = setting(
        0.0, doc="deg, end of the sector without a beam; equal to the start: none"
    )
    blocked_targets: tuple[int, ...] = setting(
        (-1,), doc="targets without a beam while the table is in the sector; -1 alone: all"
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
        doc="probability that the counter slips a fringe at a reading, and the status stays good",
        minimum=0.0,
        maximum=1.0,
    )
    slip_um: float = setting(
        0.3164, doc="um, a fringe: half a wavelength; that of a HeNe laser", minimum=0.0
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

    instrument: str = setting(
        TRACER, doc="a laser tracer, with a machine for its reflector", choices=(TRACER,)
    )
    tracer: SimulatedReadingsSettings = group(SimulatedReadingsSettings)
    probe: SimulatedProbeSettings = group(SimulatedProbeSettings)
    faults: FaultSettings = group(FaultSettings)


@dataclass(frozen=True)
class TracerSimulationSettings(LengthsSimulationSettings):
    """The simulated cell of the laser-tracer method."""

    tracer: SimulatedTracerSettings = group(SimulatedTracerSettings)
