"""The simulated control: what its correction table does, and a table that others move."""

import numpy as np
import pytest

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.settings import load
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.methods.simulation.settings import TableSettings
from rotcal_ros.methods.simulation.table import (
    SimulatedTable,
    correction,
    true_deviations,
    true_runs,
)
from rotcal_ros.methods.tracer.method import METHOD
from rotcal_ros.methods.tracer.settings import TracerSimulationSettings

ECC = {"amplitudes_arcsec": [20.0], "phases_deg": [0.0]}


def table_settings(**more):
    return load(TableSettings, {"ecc": ECC, **more}, "table")


def rows(forward, reverse=None, angles=(0.0, 90.0, 180.0, 270.0, 360.0)):
    return {
        "angles_deg": list(angles),
        "forward_arcsec": list(forward),
        "reverse_arcsec": list(reverse or forward),
    }


def test_the_correction_is_linear_repeats_every_turn_and_knows_the_direction():
    settings = table_settings(
        compensation=rows([0.0, 20.0, 40.0, 20.0, 0.0], [2.0, 2.0, 2.0, 2.0, 2.0])
    )
    angles = np.array([0.0, 45.0, 405.0, -315.0, 180.0]) * DEGREE
    up = correction(settings, angles, Approach.POSITIVE) / ARCSEC
    np.testing.assert_allclose(up, [0.0, 10.0, 10.0, 10.0, 40.0], atol=1e-9)
    down = correction(settings, angles, Approach.NEGATIVE) / ARCSEC
    np.testing.assert_allclose(down, 2.0)


def test_the_table_goes_where_command_correction_and_deviation_lead():
    """ECC is 20 arcsec cos(angle); the rows take it away at 90 degrees steps."""
    settings = table_settings(
        compensation=rows([0.0, 20.0, 40.0, 20.0, 0.0]), overshoot_deg=2.0, settling_arcsec=0.0
    )
    table = SimulatedTable(settings, seed=1, start_ns=0)
    table.order(0, 90.0 * DEGREE, Approach.POSITIVE)
    rotation, _ = table.poses(np.array([table.rest_ns + 10**9]))
    turned = np.arctan2(rotation[0, 1, 0], rotation[0, 0, 0])
    moved = 90.0 * DEGREE + 20.0 * ARCSEC
    assert turned == pytest.approx(moved + 20.0 * ARCSEC * np.cos(moved), abs=1e-13)
    # The feedback shows the commanded angle: a control hides its correction.
    assert table.angles(np.array([table.rest_ns + 10**9]))[0] == pytest.approx(np.pi / 2)


def test_the_truth_includes_what_the_control_corrects():
    settings = table_settings(compensation=rows([0.0, 20.0, 40.0, 20.0, 0.0]))
    angles = np.arange(0, 360, 90) * DEGREE
    # Of second order stays what the curve rises over the correction: 20 arcsec x 20 arcsec.
    left = true_deviations(settings, angles)["ECC"]
    np.testing.assert_allclose(
        left, [0.0, -1.0, 0.0, 1.0] * np.array((20 * ARCSEC) ** 2), atol=2e-12
    )


def test_iso_runs_of_the_true_angle():
    raw = {"table": {"ecc": ECC, "backlash_arcsec": 3.0, "repeatability_arcsec": 0.5}, "seed": 7}
    settings = load(TracerSimulationSettings, raw, "simulation")
    targets = np.arange(0, 360, 30) * DEGREE
    up, down = true_runs(settings, targets, 400)
    exact = 20.0 * np.cos(targets)
    np.testing.assert_allclose(up.mean(axis=1) / ARCSEC, exact, atol=0.15)
    np.testing.assert_allclose(down.mean(axis=1) / ARCSEC, exact + 3.0, atol=0.15)
    np.testing.assert_allclose(up.std(axis=1) / ARCSEC, 0.5, rtol=0.2)


@pytest.mark.parametrize(
    "wrong",
    [
        {"angles_deg": [0.0, 90.0], "forward_arcsec": [1.0], "reverse_arcsec": [1.0, 2.0]},
        {"angles_deg": [90.0, 0.0], "forward_arcsec": [1.0, 2.0], "reverse_arcsec": [1.0, 2.0]},
    ],
)
def test_a_control_table_that_does_not_fit_is_refused(wrong):
    with pytest.raises(ConfigurationError, match="expected ascending angles and one of each"):
        table_settings(compensation=wrong)


def external(**more):
    raw = {"table": {"external": True}, **more}
    return load(TracerSimulationSettings, raw, "simulation")


def test_an_external_table_moves_at_life_speed_only():
    with pytest.raises(ConfigurationError, match="set it to 1"):
        external(time_scale=2.0)


def test_the_cell_follows_a_table_that_others_move_and_never_gets_ahead_of_it():
    cell = METHOD.simulated_cell(external(), start_ns=0)
    still = cell.follow_table(1_000_000_000, 0.0)
    assert still.table == ()
    assert len(still.tracer) == 1001
    turned = cell.follow_table(2_000_000_000, np.pi)
    assert cell.now_ns == 2_000_000_000
    mount = np.array(cell.settings.tracer.mount_m)
    target = np.array(cell.settings.probe.initial_position_m)
    stations = mount, mount * [-1, -1, 1]
    for output, station in ((still, stations[0]), (turned, stations[1])):
        expected = np.linalg.norm(target - station) - cell.settings.tracer.dead_distance_m
        assert output.tracer[-1].length == pytest.approx(expected, abs=5e-6)
    # Half way in time is half way in angle.
    distance = cell.instrument.distances(np.array([1_500_000_000]))[0]
    quarter = np.array([-mount[1], mount[0], mount[2]])
    assert distance == pytest.approx(np.linalg.norm(target - quarter), rel=1e-12)
    late = cell.follow_table(1_700_000_000, 1.0)
    assert (late.tracer, cell.now_ns) == ((), 2_000_000_000)
