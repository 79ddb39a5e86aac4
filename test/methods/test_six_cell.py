"""The simulated tracer that goes from place to place, on a table that scatters."""

from pathlib import Path

import numpy as np
import pytest

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.units import ARCSEC, MICROMETRE
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods import changed, prepare, read_configuration
from rotcal_ros.methods.simulation.table import SimulatedTable, table_poses
from rotcal_ros.methods.tracer_six.method import METHOD

DEMO = Path(__file__).parents[2] / "config" / "tracer_six_demo.yaml"
SMALL = ("plan.table_positions=3", "plan.table_step_deg=120.0", "plan.box_points=[2, 2, 2]")
STILL = (
    *SMALL,
    "simulation.tracer.noise_um=0", "simulation.tracer.noise_um_per_m=0",
    "simulation.tracer.zero_shift_um=0", "simulation.tracer.mounting_zero_um=0",
    "simulation.tracer.placing_mm=0", "simulation.probe.systematic_um=0",
    "simulation.probe.repeatability_um=0", "simulation.probe.following_um=0",
    "simulation.faults.spike_probability=0", "simulation.faults.non_finite_probability=0",
    "simulation.temperature.length_um_per_m_k=0",
    "simulation.temperature.dead_distance_um_per_k=0",
    "simulation.table.repeatability_um=0", "simulation.table.repeatability_arcsec=0",
    "simulation.table.repeatability_tilt_arcsec=0",
)  # fmt: skip


def configured(*changes):
    return changed(read_configuration(DEMO), changes)


def read(cell, step, attempt=0):
    """Return the last reading of a step, everything having come to rest."""
    command = step.command(attempt)
    cell.order_table(command)
    cell.order_probe(command)
    return cell.advance(5.0).tracer[-1].length


def test_lengths_are_those_of_the_place_on_a_table_with_six_deviations():
    configuration = configured(*STILL)
    plan, settings = prepare(configuration).plan, configuration.simulation
    cell = METHOD.simulated_cell(settings)
    for step in (plan.steps[0], plan.steps[13], plan.steps[30], plan.steps[65]):
        place = np.reshape(settings.tracer.places_m, (-1, 3))[step.station]
        rotation, shift = table_poses(settings.table, np.array([step.table_angle]))
        station = rotation[0] @ place + shift[0]
        expected = np.linalg.norm(np.array(step.position) - station)
        found = read(cell, step) + settings.tracer.dead_distance_m
        assert found == pytest.approx(expected, abs=1e-10)
        # The six deviations are in it: a perfect table differs.
        perfect = rotation_about_z(step.table_angle) @ place
        assert abs(np.linalg.norm(np.array(step.position) - perfect) - found) > 1e-7


def test_a_tracer_that_is_fixed_anew_stands_elsewhere_and_counts_from_elsewhere():
    configuration = configured(
        *STILL, "simulation.tracer.mounting_zero_um=50", "simulation.tracer.misplaced_place=1"
    )
    plan = prepare(configuration).plan
    cell = METHOD.simulated_cell(configuration.simulation)
    still = METHOD.simulated_cell(configured(*STILL).simulation)
    first, second = plan.steps[24], plan.steps[25]
    away = read(cell, first) - read(still, first)
    assert 1e-3 < abs(away) < 0.051  # the mistake, along the beam
    # Repeated at once it stays; repeated after another step the person has put it right.
    assert read(cell, first, 1) - read(still, first) == pytest.approx(away, abs=1e-10)
    read(cell, second)
    zero = read(cell, first, 2) - read(still, first)
    assert 1e-7 < abs(zero) < 200e-6
    assert read(cell, second, 1) - read(still, second) == pytest.approx(zero, abs=1e-10)


def test_a_place_that_the_cell_does_not_have_is_refused():
    configuration = configured(*SMALL, "plan.places=4")
    plan = prepare(configuration).plan
    cell = METHOD.simulated_cell(configuration.simulation)
    with pytest.raises(ConfigurationError, match=r"places_m has 3 places, the plan needs.* 3"):
        read(cell, plan.steps[-1])


def test_the_table_scatters_in_all_six_and_comes_back_to_rest_the_same():
    quiet = configured().simulation.table
    none = configured(
        "simulation.table.repeatability_um=0", "simulation.table.repeatability_arcsec=0",
        "simulation.table.repeatability_tilt_arcsec=0",
    ).simulation.table  # fmt: skip
    still, moved = [], []
    for settings, found in ((none, still), (quiet, moved)):
        table = SimulatedTable(settings, 5, 0)
        for arrival in range(300):
            now = arrival * 10_000_000_000
            table.order(now, float(arrival % 2), 1)
            found.append(table.poses(np.array([now + 9_000_000_000, now + 9_500_000_000])))
    shifts = np.array([b[1] - a[1] for a, b in zip(still, moved, strict=True)])
    np.testing.assert_allclose(shifts[:, 0], shifts[:, 1], atol=1e-12)
    np.testing.assert_allclose(shifts[:, 0].std(axis=0), 0.05 * MICROMETRE, rtol=0.15)
    turns = np.array([b[0][0] @ a[0][0].T for a, b in zip(still, moved, strict=True)])
    rotation = np.column_stack([turns[:, 2, 1], turns[:, 0, 2], turns[:, 1, 0]])
    np.testing.assert_allclose(rotation.std(axis=0), 0.1 * ARCSEC, rtol=0.15)
