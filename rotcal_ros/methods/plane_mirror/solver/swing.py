"""A drift that is no straight line: how far the tracker swings between two rounds of nests.

What its azimuth turns by while a station's positions are measured, and back again before the nests
are looked at again, leaves no trace in them. Between two knots of the drift the departure from the
straight line is

    a1 sin(pi t) + a2 sin(2 pi t),    t from 0 to 1,

the first terms of a random walk that is tied at both ends (Karhunen-Loeve). Both amplitudes are
held to be N(0, s^2): s is the stated ``uneven_drift_std`` for knots a whole station apart, less by
the root of the time for closer ones. What they do to the deviations joins the covariance.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from rotcal_ros.foundation.arrays import Floats
from rotcal_ros.methods.plane_mirror.solver.linear import Linear
from rotcal_ros.methods.plane_mirror.solver.prepare import PreparedWay

TERMS: Final = 2
"""Half sines between two knots."""


def swings(prepared: PreparedWay) -> Floats:
    """Return by how much each point moves (n, 3, K), m, per amplitude of one standard deviation.

    K is zero where no drift is known or nothing is stated.
    """
    problem = prepared.problem
    courses = [np.zeros((len(problem.xyz), 0))]
    for station in prepared.drift.stations if problem.uneven_drift_std > 0.0 else ():
        own = problem.station == station.station
        lasting = np.diff(station.knots)
        size = problem.uneven_drift_std * np.sqrt(lasting / lasting.sum())
        share = np.clip((problem.moment[:, None] - station.knots[:-1]) / lasting, 0.0, 1.0)
        courses += [
            size * np.sin(term * np.pi * share) * own[:, None] for term in range(1, TERMS + 1)
        ]
    course = np.concatenate(courses, axis=1)
    sideways = np.cross([0.0, 0.0, 1.0], problem.xyz)
    return np.asarray(sideways[:, :, None] * course[:, None, :])


def swing_covariance(prepared: PreparedWay, points: Linear) -> Floats:
    """Return the expected square (N, N), rad^2, of what swings do to the deviations."""
    moved = points.response(swings(prepared))
    return np.asarray(moved @ moved.T)
