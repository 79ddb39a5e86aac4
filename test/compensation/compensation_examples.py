"""Tables and results for the tests of the compensation feed: known curves, nothing measured."""

from dataclasses import replace

import numpy as np

from rotcal_ros.compensation.table import CompensationTable, table_from_result
from rotcal_ros.foundation.protection import Protection
from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC

TAU = 2.0 * np.pi


def even(n):
    return np.arange(n) * TAU / n


def result_of(angles, deviation, std=0.1 * ARCSEC, verdict="ok", **components):
    """A result whose ECC counts from its first angle, as all methods give it."""
    n = len(angles)
    to_first = np.eye(n)
    to_first[:, 0] -= 1.0
    covariance = to_first @ to_first.T * std**2
    deviations = {"ECC": np.asarray(deviation, dtype=float), **components}
    return Result(
        method="simulated",
        angles=np.asarray(angles, dtype=float),
        deviations=deviations,
        std={name: np.sqrt(np.diag(covariance)) for name in deviations},
        covariance=dict.fromkeys(deviations, covariance),
        sigma0=1.0,
        dof=10,
        n_observations=100,
        verdict=verdict,
        protections=(Protection("drift", "tested", "closure", 1.0),),
    )


def wavy(t, amplitudes=((1, 10.0, 0.3), (2, 3.0, 1.0), (5, 1.0, 2.0))):
    """A smooth deviation curve in radians; amplitudes (order, arcsec, phase)."""
    return sum(a * ARCSEC * np.sin(k * np.asarray(t) + p) for k, a, p in amplitudes)


def d4_table():
    """The four-row example with both directions that can be checked by hand, in degrees."""
    up = np.deg2rad([0.0, 0.0050, -0.0030, 0.0010])
    down = np.deg2rad([-0.0020, 0.0030, -0.0050, -0.0010])
    return CompensationTable(
        axis="C1",
        method="example",
        angles=even(4),
        correction_forward=-up,
        correction_reverse=-down,
        std=np.zeros(4),
        period=TAU,
        reference_angle=0.0,
        verdict="ok",
    )


def two_ways(n=24, **changes):
    """Two directions; the correction is minus a curve, zero at the reference on the way up."""
    angles = even(n)
    table = CompensationTable(
        axis="C", method="m", angles=angles,
        correction_forward=-(wavy(angles) - wavy(0.0)),
        correction_reverse=-(wavy(angles, [(1, 9.0, 0.5), (3, 2.0, 1.0)]) + 3.0 * ARCSEC),
        std=(1.0 + np.arange(n) % 5) * 0.1 * ARCSEC, period=TAU, reference_angle=0.0,
        verdict="ok", warnings=("known",),
    )  # fmt: skip
    return replace(table, **changes)


def turn(degrees, angles=None):
    """A table whose correction is minus these degrees in both directions."""
    values = -np.deg2rad(np.asarray(degrees, float))
    angles = even(len(values)) if angles is None else angles
    return CompensationTable(
        axis="C", method="m", angles=angles, correction_forward=values,
        correction_reverse=values, std=np.zeros(len(values)), period=TAU, reference_angle=0.0,
        verdict="ok",
    )  # fmt: skip


def arc(n):
    """A table of ``n`` rows, half a degree apart."""
    angles = np.deg2rad(np.arange(n) * 0.5)
    return table_from_result(result_of(angles, wavy(angles)))
