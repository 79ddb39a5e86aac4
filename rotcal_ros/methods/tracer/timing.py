"""How long the simulated cell takes for a plan: its drives, and what the capture waits for."""

from __future__ import annotations

from collections.abc import Sequence
from math import log

import numpy as np

from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods.configuration import Configuration
from rotcal_ros.planning.plan import Step
from rotcal_ros.planning.sequence_time import Drive, TimeModel


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


def plan_seconds(model: TimeModel, steps: Sequence[Step]) -> float:
    """Return the time from the end of the first of ``steps`` to the end of the last, s."""
    angles = np.array([step.table_angle for step in steps])
    ways, at = np.diff(angles), np.array([step.position for step in steps])
    turns = model.turns_by(ways)
    moves = model.machine.time(np.linalg.norm(np.diff(at, axis=0), axis=1)) + model.report
    return float(model.joined(turns, moves).sum())
