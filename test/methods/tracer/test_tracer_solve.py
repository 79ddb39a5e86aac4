"""Against truth, against scipy, and against itself in another order or place."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy_tracer import DenseNetwork, locate_station
from tracer_scene import arc, low_ring, simulate

from rotcal_ros.foundation.results import Result
from rotcal_ros.foundation.units import ARCSEC, DEGREE
from rotcal_ros.geometry.rotations import rotation_about_z
from rotcal_ros.methods.tracer.solver import solve

FREE_CIRCLE = 1e-2
"""Error motion (m) that says nothing of where stations are."""
VARIANTS = [
    {"variant": "station"},
    {"variant": "joint", "datum": "prior", "target_std": 1e-6},
    {"variant": "joint", "datum": "free"},
]


@pytest.mark.parametrize("options", VARIANTS)
def test_exact_lengths_give_the_truth(options):
    scene = simulate(length_std=0.0)
    result = solve(scene.problem(**options))
    assert result.deviations["ECC"] == pytest.approx(scene.deviation, abs=2e-5 * ARCSEC)
    assert result.adjacent_deviations == pytest.approx(np.diff(scene.deviation), abs=4e-5 * ARCSEC)
    assert result.details["stations"] == pytest.approx(scene.stations, abs=2e-10)
    assert result.details["circle"]["radius"] == pytest.approx(0.065, abs=1e-10)
    assert result.verdict == "ok"


def test_station_variant_is_scipys_minimum():
    scene = simulate(seed=3)
    result = solve(scene.problem())
    start = np.array([-0.065, -0.0066, 0.1225, 1.1285])  # one for all, as in the paper
    for j, lengths in enumerate(scene.length):
        best = locate_station(scene.targets, lengths, start)
        assert result.details["stations"][j] == pytest.approx(best[:3], abs=1e-9)
        assert result.details["distances"][j] == pytest.approx(best[3], abs=1e-9)


@pytest.mark.parametrize("datum", ["prior", "free"])
def test_joint_variant_is_scipys_minimum(datum):
    scene = simulate(seed=4, angles=arc(9), n=20, layout=low_ring, target_std=1e-6)
    options = {"variant": "joint", "datum": datum, "error_motion_std": FREE_CIRCLE}
    result = solve(scene.problem(target_std=1e-6, **options))
    ours = result.details
    start = np.concatenate(
        [np.column_stack([scene.stations, ours["distances"]]).ravel(), scene.targets.ravel()]
    )
    spread = ours["stations"] - ours["stations"].mean(axis=0)
    radius = np.sqrt((spread**2).sum(axis=1).mean())
    target_std = 1e-6 if datum == "prior" else None
    network = DenseNetwork(scene.targets, scene.length, 2e-7, target_std, radius)
    best = network.solve(start)
    apart = ours["stations"] - best[:36].reshape(9, 4)[:, :3]
    assert (np.abs(apart) < 0.01 * ours["station_std"]).all()
    apart = ours["targets"] - best[36:].reshape(-1, 3)
    assert (np.abs(apart) < 0.01 * ours["target_corrections_std"]).all()
    chi2 = (network.misfit(best) ** 2).sum()
    assert result.sigma0**2 * result.dof == pytest.approx(chi2, rel=1e-6)


@pytest.mark.parametrize("options", VARIANTS)
def test_order_of_rows_does_not_change_a_bit(options):
    scene = simulate(seed=5, angles=arc(8), n=24, target_std=1e-6)
    problem = scene.problem(**options)
    order = np.random.default_rng(1).permutation(len(problem.length))
    shuffled = scene.problem(
        position=problem.position[order],
        target=problem.target[order],
        length=problem.length[order],
        **options,
    )
    first, second = solve(problem), solve(shuffled)
    assert (first.deviations["ECC"] == second.deviations["ECC"]).all()
    assert (first.covariance["ECC"] == second.covariance["ECC"]).all()
    assert (first.residuals.residual[order] == second.residuals.residual).all()
    assert (first.residuals.redundancy[order] == second.residuals.redundancy).all()


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(st.floats(-3, 3), st.floats(-2, 2), st.floats(-2, 2), st.sampled_from(VARIANTS))
def test_place_and_heading_of_the_machine_do_not_matter(turn, x, y, options):
    scene = simulate(seed=6, angles=arc(8), n=24, target_std=1e-6)
    moved = scene.targets @ rotation_about_z(turn).T + [x, y, 0.3]
    here, there = solve(scene.problem(**options)), solve(scene.problem(**options, targets=moved))
    change = there.deviations["ECC"] - here.deviations["ECC"]
    assert np.abs(change).max() < 1e-6 * here.std["ECC"].max()
    assert there.std["ECC"] == pytest.approx(here.std["ECC"], rel=1e-5)


def test_stations_measured_in_reverse_give_the_reversed_steps():
    scene = simulate(seed=7)
    problem = scene.problem(target_std=1e-6)
    reverse = scene.problem(
        target_std=1e-6, position=10 - problem.position, table_angles=scene.angles[::-1]
    )
    forward, backward = solve(problem), solve(reverse)
    assert backward.adjacent_deviations == pytest.approx(
        -forward.adjacent_deviations[::-1], abs=1e-6 * ARCSEC
    )
    # the noise is estimated, to some digits
    assert backward.adjacent_std == pytest.approx(forward.adjacent_std[::-1], rel=1e-3)


@pytest.mark.parametrize("options", VARIANTS)
def test_unequal_steps_full_circle_and_missing_lengths(options):
    angles = DEGREE * np.array([0.0, 17, 60, 100, 150, 210, 222, 290, 330, 360])
    scene = simulate(seed=8, angles=angles, n=30, layout=low_ring, length_std=0.0)
    blocked = np.random.default_rng(2).random(scene.length.size) < 0.2
    problem = scene.problem(**options)
    keep = ~blocked
    gaps = scene.problem(
        position=problem.position[keep],
        target=problem.target[keep],
        length=problem.length[keep],
        **options,
    )
    result = solve(gaps)
    assert result.deviations["ECC"] == pytest.approx(scene.deviation, abs=1e-4 * ARCSEC)
    (closure,) = result.details["closure"]
    assert (closure["first"], closure["last"]) == (0, 9)
    assert closure["error"] == pytest.approx(0.0, abs=1e-4 * ARCSEC)
    assert closure["std"] == pytest.approx(result.std["ECC"][-1], rel=1e-9)


def test_redundancies_count_the_degrees_of_freedom():
    scene = simulate(seed=9, angles=arc(8), n=24)
    circle = 8 - 3  # of an error motion that is stated
    for options, dof in ((VARIANTS[0], 8 * 24 - 32), (VARIANTS[2], 8 * 24 - 32 - 72 + 7)):
        result = solve(scene.problem(**options))
        assert result.dof == dof + circle
        checked = result.residuals.redundancy.sum()
        assert dof < checked < dof + circle
        assert result.details["redundancy_per_station"].sum() == pytest.approx(checked, rel=1e-6)


@pytest.mark.parametrize("options", VARIANTS)
def test_result_survives_json(options):
    result = solve(simulate(seed=10).problem(**options))
    again = Result.from_dict(json.loads(result.to_json()))
    assert (again.deviations["ECC"] == result.deviations["ECC"]).all()
    assert again.details["circle"]["radius"] == result.details["circle"]["radius"]


@pytest.mark.parametrize(("m", "n"), [(9, 8), (5, 30)])
def test_either_side_may_be_eliminated(m, n):
    """9 x 8 keeps the targets, 5 x 30 the stations; both against the dense inverse."""
    scene = simulate(seed=21, angles=arc(m, 36.0), n=n, layout=low_ring, target_std=1e-6)
    options = {"variant": "joint", "error_motion_std": FREE_CIRCLE}
    result = solve(scene.problem(target_std=1e-6, **options))
    ours = result.details
    network = DenseNetwork(scene.targets, scene.length, 2e-7, 1e-6)
    state = np.column_stack([ours["stations"], ours["distances"]])
    slope = network.slope(np.concatenate([state.ravel(), ours["targets"].ravel()]))
    covariance = np.linalg.inv(slope.T @ slope)
    std = np.sqrt(covariance.diagonal()[: 4 * m].reshape(m, 4)[:, :3])
    assert ours["station_std"] == pytest.approx(std, rel=1e-6)
    leverage = np.einsum("ka,ab,kb->k", slope, covariance, slope)[: m * n]
    assert result.residuals.redundancy == pytest.approx(1.0 - leverage, abs=1e-6)
    assert np.sqrt(sum(s**2 for s in result.budget.values())) == pytest.approx(result.std["ECC"])


def test_one_station_off_the_circle_shows_where_it_stands():
    """Of m even stations each takes 3 / m of its own offset into circle and plane."""
    scene = simulate(length_std=0.0, angles=arc(12), n=24)
    m, k, off = 12, 4, 2e-6
    actual = scene.angles[k] + scene.deviation[k]
    outward = np.array([np.cos(actual), np.sin(actual), 0.0])
    for direction, radial, axial in ((outward, 0.75, 0.0), (np.array([0.0, 0.0, 1.0]), 0.0, 0.75)):
        stations = scene.stations.copy()
        stations[k] += off * direction
        distance = np.linalg.norm(stations[:, None] - scene.targets, axis=2)
        found = solve(scene.problem(length=(distance - 0.4).ravel())).details
        assert found["radial"][k] == pytest.approx(off * radial, abs=1e-9)
        assert found["axial"][k] == pytest.approx(off * axial, abs=1e-9)
        assert np.sum(found["radial"]) == pytest.approx(0.0, abs=1e-9)
        assert np.sum(found["axial"]) == pytest.approx(0.0, abs=1e-9)
        assert found["distances"] == pytest.approx(np.full(m, 0.4), abs=1e-8)
