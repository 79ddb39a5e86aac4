"""Start values without a guess: exact for lengths without noise, whatever the unit."""

import numpy as np
import pytest
from tracer_scene import low_ring, paper_block, simulate

from rotcal_ros.methods.tracer.solver.problem import arrange_grid
from rotcal_ros.methods.tracer.solver.start import find_start, start_candidates


def exact(layout=low_ring, flat=False):
    """Targets, lengths, which are used, and the true (X, Y, Z, d) of the stations."""
    scene = simulate(n=24, layout=layout, length_std=0.0)
    targets = scene.targets.copy()
    if flat:
        targets[:, 2] = 0.4
    distance = np.linalg.norm(scene.stations[:, None] - targets, axis=2)
    zero = np.linspace(0.2, 0.7, len(distance))
    used = np.ones(distance.shape, dtype=bool)
    used[2, 5] = used[4, 7] = False
    lengths = np.where(used, distance - zero[:, None], 0.0)
    return targets, lengths, used, np.column_stack([scene.stations, zero])


@pytest.mark.parametrize("layout", [low_ring, paper_block])
def test_spread_targets_give_the_stations_at_once(layout):
    targets, lengths, used, truth = exact(layout)
    candidates = start_candidates(targets, lengths, used)
    assert len(candidates) == 1
    np.testing.assert_allclose(candidates[0], truth, atol=1e-10)


@pytest.mark.parametrize("unit", [1e-3, 1e3])
@pytest.mark.parametrize("flat", [False, True])
def test_the_unit_of_length_does_not_matter(unit, flat):
    targets, lengths, used, truth = exact(flat=flat)
    found = start_candidates(unit * targets, unit * lengths, used)
    assert len(found) == (3 if flat else 1)
    assert np.abs(found / unit - truth).max(axis=2).min(axis=0).max() < 1e-6


def test_flat_targets_give_the_station_and_its_mirror_image():
    targets, lengths, used, truth = exact(flat=True)
    _, first, second = start_candidates(targets, lengths, used)
    image = truth * [1, 1, -1, 1] + [0, 0, 0.8, 0]
    for j in range(len(truth)):
        found = sorted([first[j], second[j]], key=lambda place: place[2])
        np.testing.assert_allclose(found, [truth[j], image[j]], atol=1e-7)


def test_of_two_mirror_images_the_lower_one_is_taken():
    scene = simulate(n=24, layout=low_ring)
    scene.targets[:, 2] = 0.4
    distance = np.linalg.norm(scene.stations[:, None] - scene.targets, axis=2)
    scene.length[:] = distance - 0.3
    grid, _ = arrange_grid(scene.problem())
    start, ambiguous = find_start(grid, None)
    assert ambiguous
    np.testing.assert_allclose(start[:, :3], scene.stations, atol=1e-8)
    np.testing.assert_allclose(start[:, 3], 0.3, atol=1e-8)


def test_given_stations_only_lack_their_zero():
    scene = simulate(n=24, layout=low_ring, length_std=0.0)
    keep = np.arange(11 * 24) % 17 != 0
    station, target = np.divmod(np.flatnonzero(keep), 24)
    rows = {"position": station, "target": target, "length": scene.length.ravel()[keep]}
    grid, _ = arrange_grid(scene.problem(**rows))
    start, ambiguous = find_start(grid, scene.stations)
    zero = np.linalg.norm(scene.stations - scene.targets[0], axis=1)
    assert not ambiguous
    np.testing.assert_array_equal(start[:, :3], scene.stations)
    np.testing.assert_allclose(start[:, 3], zero, atol=1e-12)
