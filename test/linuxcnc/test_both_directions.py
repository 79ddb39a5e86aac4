"""Play and harmonics drawn at random are gone on a real LinuxCNC, as far as the export says."""

from datetime import datetime, timezone

import numpy as np
import pytest
from plants import REFERENCE_DEG, SMALLER, Plant, machine_with, true_deviations

from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.foundation.results import Directions, Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE

pytestmark = pytest.mark.linuxcnc

ANGLES = np.arange(18) * 20 * DEGREE
NOISE = 0.05 * ARCSEC


def as_measured(plant, seed):
    """A result of both directions, counted from the zero of their mean, with noise."""
    count, random = len(ANGLES), np.random.default_rng(seed)
    both = np.concatenate([plant.deviation(ANGLES, side) for side in (1, -1)])
    both += random.normal(0.0, NOISE, 2 * count)
    shift = np.eye(2 * count)
    shift[:, [0, count]] -= 0.5
    mean = np.hstack([np.eye(count) / 2] * 2)
    covariance = NOISE**2 * shift @ shift.T
    forward, reverse = np.split(shift @ both, 2)
    of_mean = mean @ covariance @ mean.T
    return Result(
        method="drawn",
        angles=ANGLES,
        deviations={"ECC": (forward + reverse) / 2},
        std={"ECC": np.sqrt(np.diag(of_mean))},
        covariance={"ECC": of_mean},
        sigma0=1.0,
        dof=50,
        n_observations=100,
        verdict="ok",
        directions={"ECC": Directions(ANGLES, forward, reverse, covariance)},
    )


SEED = 3
"""Another plant than that of the closed loop."""


@pytest.mark.long  # test_closed_loop.py does it with all nodes
def test_play_and_harmonics_are_removed_within_the_stated_residual(tmp_path, record_property):
    plant = Plant(SEED)
    axis = machine_with(plant, tmp_path / "axis")
    made = prepare_export(
        table_from_result(
            as_measured(plant, SEED + 1), axis="A", reference_angle=REFERENCE_DEG * DEGREE
        ),
        "linuxcnc",
        now=datetime(2026, 1, 2, tzinfo=timezone.utc),
        spacing=5 * DEGREE,
        settings={"first_turn": -1, "turns": 3, "machine_ini": str(axis.ini)},
    )
    axis.take(made)
    left, there_was = true_deviations(axis), plant.deviations()
    figures = {
        "range before / arcsec": np.ptp(there_was) / ARCSEC,
        "range after / arcsec": np.ptp(left) / ARCSEC,
        "largest left / arcsec": np.max(np.abs(left)) / ARCSEC,
        "stated / arcsec": made.residual.stated / ARCSEC,
    }
    for name, value in figures.items():
        record_property(name, float(value))  # workers of the tests send plain numbers only
    assert np.max(np.abs(left)) < made.residual.stated + 4 * made.residual.std
    assert np.ptp(left) < np.ptp(there_was) / SMALLER
    assert made.residual.following == 0.0  # the play is above the dead band of this machine
