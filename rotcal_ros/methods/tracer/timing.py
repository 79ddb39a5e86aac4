"""How long the simulated cell takes for a plan: its drives, and what the capture waits for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import log
from typing import Final

import numpy as np

from rotcal_ros.capture import Capture
from rotcal_ros.foundation.errors import DataError
from rotcal_ros.foundation.observations import Observation
from rotcal_ros.foundation.units import ARCSEC, DEGREE, NANOSECOND
from rotcal_ros.methods.calibration import Calibration
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.methods.simulation.cell import SimulatedCell
from rotcal_ros.planning.plan import Step
from rotcal_ros.planning.sequence_time import Drive, TimeModel

ATTEMPTS: Final = 3
"""At each step, before it is left."""
LONGEST: Final = 3600.0
"""Machine time (s) after which a length is given up."""


def cell_time(configuration: Configuration) -> TimeModel:
    """Return the time model of the simulated cell of ``configuration``, in machine time.

    The capture takes the table for at rest when its lag has decayed to the tolerances of place
    and speed; the feedback tells it half a period later. Then come the settle time and the window,
    which begins half a period of the tracer late, and the feedback that confirms the rest.
    """
    simulation, capture = configuration.simulation, configuration.capture
    table, probe, tracer = simulation.table, simulation.probe, simulation.tracer
    lag, decay = table.settling_arcsec * ARCSEC, table.settling_time_s
    excess = max(
        lag / (capture.position_tolerance_arcsec * ARCSEC),
        lag / decay / (capture.velocity_tolerance_deg_s * DEGREE),
        1.0,
    )
    feedback = 1.0 / table.feedback_rate_hz
    window = (capture.window_samples - 0.5) / tracer.rate_hz
    return TimeModel(
        table=Drive(
            table.speed_deg_s * DEGREE,
            table.acceleration_deg_s2 * DEGREE,
            settle=decay * log(excess),
        ),
        machine=Drive(probe.speed_m_s, probe.acceleration_m_s2),
        report=probe.report_delay_s,
        dwell=0.5 * feedback + capture.settle_time_s + window + 0.5 * feedback,
        overshoot=table.overshoot_deg * DEGREE,
    )


@dataclass(frozen=True)
class CellRun:
    """The last attempt at every step, and the machine time (s) from the first to the last."""

    observations: tuple[Observation, ...]
    seconds: float


def cell_run(calibration: Calibration, tick_s: float = 0.01) -> CellRun:
    """Return what the simulated cell measures and how long it takes, without ROS.

    Every step is ordered as soon as the one before is decided, up to ATTEMPTS times; the cell's
    time is cut into ticks. Raises DataError for a length that never comes.
    """
    cell = calibration.method.simulated_cell(calibration.configuration.simulation)
    capture = calibration.capture()
    observations, ends = [], []
    for step in calibration.plan.steps:
        for attempt in range(ATTEMPTS):
            observation = _observed(cell, capture, step, attempt, tick_s)
            if observation.accepted:
                break
        observations.append(observation)
        ends.append(cell.now_ns)
    return CellRun(tuple(observations), (ends[-1] - ends[0]) * NANOSECOND)


def _observed(
    cell: SimulatedCell, capture: Capture, step: Step, attempt: int, tick_s: float
) -> Observation:
    """Order a step and let the cell's time pass until it is decided."""
    command, begin_ns = step.command(attempt), cell.now_ns
    cell.order_table(command)
    cell.order_probe(command)
    while (cell.now_ns - begin_ns) * NANOSECOND < LONGEST:
        out = cell.advance(tick_s)
        found: tuple[Observation, ...] = ()
        for samples in (out.table, out.probe, out.temperature, out.air, out.tracer):
            for sample in samples:
                found += capture.feed(sample)
        if found:
            return found[0]
    raise DataError(f"step {step.index} is not decided after {LONGEST:g} s")


def plan_seconds(model: TimeModel, steps: Sequence[Step]) -> float:
    """Return the time from the end of the first of ``steps`` to the end of the last, s."""
    angles = np.array([step.table_angle for step in steps])
    ways, at = np.diff(angles), np.array([step.position for step in steps])
    turns = model.turns_by(ways)
    moves = model.machine.time(np.linalg.norm(np.diff(at, axis=0), axis=1)) + model.report
    return float(model.joined(turns, moves).sum())
