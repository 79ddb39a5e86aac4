"""What a wanted uncertainty takes: against dense least squares, other plans and known figures."""

import numpy as np
import pytest

from rotcal_ros.errors import ObservabilityError
from rotcal_ros.methods.tracer.angles import bearing_jacobian
from rotcal_ros.planning.effort import unit_std
from rotcal_ros.planning.plate_trade import bound, plate_trade
from rotcal_ros.planning.sequence_time import PAPER
from rotcal_ros.planning.tracer_design.information import Information
from rotcal_ros.planning.tracer_design.scene import Scene, on_table
from rotcal_ros.planning.tracer_trade import (
    DETECTABLE,
    LEAST_REDUNDANCY,
    Surroundings,
    largest_hidden_effect,
    lengths_bound,
    trade,
)
from rotcal_ros.units import ARCSEC

M = 11
ANGLES = tuple(np.radians(-145.0 + 30.0 * np.arange(M)))
GOAL = 1.202 * ARCSEC
COARSE = Surroundings(ANGLES, spacing=0.28)


def scene_of(surroundings, length_std=2e-7):
    stations = on_table((0.06517, 0.0, surroundings.height), ANGLES)
    targets = surroundings.targets()
    return Scene(stations, np.array(ANGLES), targets, np.array(1e-6), length_std)


@pytest.mark.parametrize(("zero_per_station", "known"), [(False, 25.8), (True, 25.9)])
def test_the_bound_is_the_known_one(zero_per_station, known):
    """25.8 and 25.9 lengths in this volume, by a multiplicative algorithm on another grid."""
    surroundings = Surroundings(ANGLES)
    scene = scene_of(surroundings)
    candidates = surroundings.candidates(scene, zero_per_station)
    start = Information(scene, candidates[:80], M if zero_per_station else 1)
    found = lengths_bound(start, candidates, (GOAL / 2.0) ** 2)
    assert found == pytest.approx(known, rel=0.03)


def test_beams_are_long_and_steep_enough():
    surroundings = Surroundings(ANGLES)
    scene = scene_of(surroundings)
    pairs = surroundings.candidates(scene, False)
    beam = scene.targets[pairs.target] - scene.stations[pairs.position]
    elevation = np.arcsin(beam[:, 2] / np.linalg.norm(beam, axis=1))
    assert np.degrees(elevation.min()) >= 10.0 - 1e-9
    assert np.linalg.norm(beam, axis=1).min() >= 0.25
    apart = np.linalg.norm(scene.targets - scene.targets[:, None], axis=2)
    assert apart[apart > 0.0].min() >= 0.17 - 1e-9


def test_a_hidden_error_does_what_dense_least_squares_says():
    scene, rng = scene_of(COARSE), np.random.default_rng(2)
    every = COARSE.candidates(scene, False)
    few = every[np.isin(every.target, rng.choice(every.target, 14, replace=False))]
    picked = few[np.sort(rng.choice(len(few), 90, replace=False))]
    used, own = np.unique(picked.target, return_inverse=True)
    k, unknowns = len(picked), 3 * M + 1 + 3 * len(used)
    beam = scene.stations[picked.position] - scene.targets[picked.target]
    unit = beam / np.linalg.norm(beam, axis=1)[:, None]
    design = np.zeros((k + 3 * len(used), unknowns))
    for row in range(k):
        design[row, 3 * picked.position[row] : 3 * picked.position[row] + 3] = unit[row]
        design[row, 3 * M] = -1.0
        at = 3 * M + 1 + 3 * own[row]
        design[row, at : at + 3] = -unit[row]
    design[k:, 3 * M + 1 :] = np.eye(3 * len(used))
    std = np.concatenate([np.full(k, 2e-7), np.full(3 * len(used), 1e-6)])
    inverse = np.linalg.pinv(design / std[:, None])
    redundancy = 1.0 - np.einsum("ij,ji->i", design / std[:, None], inverse)[:k]
    bearing = bearing_jacobian(scene.stations, scene.motion)
    bearing = bearing - bearing.mean(axis=0)
    effect = bearing @ inverse[: 3 * M, :k] * (DETECTABLE / np.sqrt(redundancy))
    found = largest_hidden_effect(Information(scene, picked, 1))
    assert found == pytest.approx(np.abs(effect).max(), rel=1e-3)


def test_more_noise_takes_more_lengths_and_a_larger_circle_fewer():
    radii, sigmas = (0.065, 0.13), (2e-7, 4e-7)
    rows = trade(COARSE, GOAL, radii, sigmas, target_std=1e-6, time=PAPER)
    quiet, loud, wide, both = rows
    assert quiet.lengths < loud.lengths
    assert wide.lengths <= quiet.lengths
    assert both.lengths < loud.lengths
    for row in rows:
        assert row.lengths == M * row.targets
        assert row.bound <= row.lengths
        assert row.redundancy >= LEAST_REDUNDANCY
        assert row.expanded <= GOAL
        assert row.seconds == pytest.approx(5.0 * row.lengths + 10.0 * M, abs=0.01)
    # information grows with (R / sigma)^2 wherever the targets are: so does the bound fall
    assert both.bound == pytest.approx(quiet.bound, rel=0.02)
    assert loud.bound == pytest.approx(4.0 * quiet.bound, rel=0.02)


def test_all_scaled_alike_takes_the_same():
    once, half = (
        trade(COARSE, s * GOAL, (0.065,), (s * 2e-7,), target_std=s * 1e-6, time=PAPER)[0]
        for s in (1.0, 0.5)
    )
    assert half.lengths == once.lengths
    assert half.expanded == pytest.approx(0.5 * once.expanded, rel=1e-6)


def test_what_no_plan_reaches_is_said():
    (row,) = trade(COARSE, 0.02 * ARCSEC, (0.065,), (4e-7,), target_std=1e-6, time=PAPER)
    assert row.lengths is None
    assert row.expanded > 0.02 * ARCSEC


def test_no_pattern_of_a_plate_beats_its_bound():
    rng, grid = np.random.default_rng(0), 12
    tried = 0
    for _ in range(30):
        balls = rng.choice(grid, rng.integers(5, 10), replace=False)
        positions = rng.choice(grid, rng.integers(6, 13), replace=False)
        try:
            std = unit_std(grid, np.sort(balls), np.sort(positions), 1.0)["ECC"]
        except ObservabilityError:
            continue
        tried += 1
        assert (std**2).mean() >= (1.0 - 1e-9) * bound(grid, len(balls) * len(positions))
    assert tried > 15
    every = np.arange(grid)
    full = unit_std(grid, every, every, 1.0)["ECC"]
    assert (full**2).mean() == pytest.approx(bound(grid, grid**2), rel=1e-9)


def test_a_plate_of_that_radius_or_noise_reaches_the_goal():
    goal = 0.05 * ARCSEC
    for row in plate_trade(12, (6, 8), goal, radius=0.185, sigma=5e-8, centre_s=30.0):
        unit = unit_std(12, np.array(row.ball_steps), np.arange(12), 1.0)["ECC"]
        rms = 2.0 * np.sqrt((unit**2).mean())
        assert row.expanded == pytest.approx(rms * 5e-8 / 0.185, rel=1e-9)
        assert rms * 5e-8 / row.radius == pytest.approx(goal, rel=1e-9)
        assert rms * row.sigma / 0.185 == pytest.approx(goal, rel=1e-9)
        assert row.seconds == 12 * row.balls * 30.0
        assert 0.0 < row.saving < 0.15
