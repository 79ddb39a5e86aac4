"""The settings of the capture: group ``capture`` of a configuration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.settings import expert, setting

MAX_WINDOW_SAMPLES = 50_000


@dataclass(frozen=True)
class CaptureSettings:
    """When a stream of samples becomes an observation, and when it is rejected.

    All times are machine time, which means differences of stamps.
    """

    position_tolerance_arcsec: float = setting(
        20.0,
        minimum=0.01,
        maximum=36_000.0,
        doc="arcsec, largest difference of the table feedback from the commanded angle; of a "
        "table that turns on, from even motion while it passes",
    )
    velocity_tolerance_deg_s: float = setting(
        0.02,
        minimum=1e-6,
        maximum=10.0,
        doc="deg/s, largest speed at which the table counts as at rest",
    )
    speed_tolerance: ClassVar[
        Annotated[
            float,
            "a rotary drive in order keeps its speed far better; what is off by more is not "
            "turning evenly",
        ]
    ] = 0.01
    passing_samples: ClassVar[
        Annotated[
            int,
            "fewer readings on a side show no curvature and no scatter of the passing",
        ]
    ] = 3
    table_silence_s: float = expert(
        1.0,
        minimum=1e-3,
        maximum=3600.0,
        doc="s, longest gap in the table feedback while the table is at rest, or passes an angle",
    )
    settle_time_s: float = setting(
        0.5,
        doc="s, wait from table in position and probe at its target to the start of the window; "
        "the stamps of lengths may be ahead of the table's by at most as much",
        minimum=0.0,
    )
    window_samples: int = setting(
        200,
        minimum=1,
        maximum=MAX_WINDOW_SAMPLES,
        doc="number of tracer readings in a window; 1: single readings, which show no scatter",
    )
    max_std_m: float = setting(
        2e-6, doc="m, largest standard deviation of the readings of a window", minimum=0.0
    )
    max_drift_m: float = setting(
        2e-6, doc="m, largest change over a window of the line fitted to its readings", minimum=0.0
    )
    min_used_share: float = expert(
        0.8, doc="smallest share of usable readings in a window", minimum=0.01, maximum=1.0
    )
    spike_limit: ClassVar[
        Annotated[
            float,
            "normal noise goes beyond six robust standard deviations once in 5e8 readings",
        ]
    ] = 6.0
    spike_floor_m: float = expert(
        0.1e-6, doc="m, a reading this close to the median is never a spike", minimum=0.0
    )
    max_length_m: float = expert(
        20.0, doc="m, largest plausible reading, of either sign", minimum=1e-3, maximum=1000.0
    )
    max_length_speed_m_s: ClassVar[
        Annotated[
            float,
            "no machine moves a reflector so fast; a faster length has lost its zero",
        ]
    ] = 10.0
    max_silence_s: ClassVar[
        Annotated[
            float,
            "instruments send many readings a second; after a longer gap the zero may be another",
        ]
    ] = 1.0
    probe_tolerance_m: float = setting(
        1e-3, doc="m, largest distance of the probe from its target", minimum=1e-9, maximum=10.0
    )
    ball_tolerance_m: float = setting(
        3e-3, doc="m, largest distance of a ball from its planned place", minimum=1e-6, maximum=1.0
    )
    max_form_m: float = setting(
        10e-6,
        minimum=1e-9,
        maximum=1e-2,
        doc="m, largest form deviation of a ball's touch points, and largest error of its radius",
    )
    step_timeout_s: float = setting(
        30.0,
        minimum=0.01,
        maximum=86_400.0,
        doc="s, longest time from the probe at its target to the end of the window; "
        "planner.step_timeout_s must be longer",
    )
    clock_tolerance_s: float = expert(
        10.0,
        minimum=0.01,
        maximum=86_400.0,
        doc="s, largest difference between the stamps of two streams, delays on arrival included",
    )
    stamp_offset_s: float = expert(
        2.0,
        minimum=0.01,
        maximum=1e9,
        doc="s, largest constant delay of a stream, from its stamps to its arrival, beyond that "
        "of the table's feedback; more means two clocks, and nothing measured meanwhile is "
        "accepted",
    )
    temperature_expected: bool = setting(
        True,
        doc="an observation carries a temperature and waits for it; false: without a thermometer",
    )
    pressure_expected: bool = setting(
        False, doc="an observation carries the pressure of the air and waits for it"
    )
    humidity_expected: bool = setting(
        False, doc="an observation carries the humidity of the air and waits for it"
    )
    temperature_lag_s: float = expert(
        3.0,
        minimum=0.0,
        maximum=3600.0,
        doc="s, by which temperature, pressure and humidity must have been read before the probe "
        "reached its target; so only the first observation waits for a slow sensor",
    )

    def __post_init__(self) -> None:
        """Refuse settings that leave no time to measure."""
        if self.settle_time_s >= self.step_timeout_s:
            raise ConfigurationError(
                f"settle_time_s = {self.settle_time_s:g} leaves no time for a window;"
                f" expected less than step_timeout_s = {self.step_timeout_s:g}"
            )
