"""By what a self-calibration corrects the targets: by what was wrong, as well as it says."""

from dataclasses import replace

import numpy as np
import pytest
from six_scene import LENGTH_STD, TARGET_STD, scene
from tracer_scene import low_ring, simulate

from rotcal_ros.methods.tracer.figures import tables
from rotcal_ros.methods.tracer.solver import solve
from rotcal_ros.methods.tracer_six import solver as tracer_six

WRONG = 2e-6


def rigid(points):
    """What shifts and turns do to ``points`` (n, 3), (3 n, 6)."""
    turns = [np.cross(axis, points).ravel() for axis in np.eye(3)]
    return np.column_stack([*np.tile(np.eye(3), (len(points), 1)).T, *turns])


def misstated(seed, wrong=None, **options):
    """Return a result, and by how much (n, 3) its true targets differ from the stated ones."""
    real = simulate(seed, n=24, layout=low_ring)
    true = WRONG * np.random.default_rng([seed if wrong is None else wrong, 1]).standard_normal(
        real.targets.shape
    )
    stated = replace(real, targets=real.targets - true)
    return solve(stated.problem(target_std=WRONG, variant="joint", **options)), true


def corrections(result):
    keys = ("target_corrections", "target_corrections_std")
    return tuple(np.asarray(result.details[key]) for key in keys)


def still(points, moved):
    """Return what (n, 3) of a motion is no shift and no turn of all points."""
    motions = rigid(points - points.mean(axis=0))
    return moved - (motions @ np.linalg.lstsq(motions, moved.ravel(), rcond=None)[0]).reshape(
        -1, 3
    )


def test_corrections_are_the_errors_of_the_stated_targets_within_their_std():
    squares = []
    for seed in range(8):
        result, true = misstated(seed)
        moved, std = corrections(result)
        assert np.all(std < 1.001 * WRONG), "the lengths only add to what was stated"
        squares.append(((moved - true) / std) ** 2)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.25)


def test_a_free_network_tells_them_less_a_shift_and_a_turn_and_scatters_as_it_says():
    """Seven measurements of the same targets: their corrections differ by the noise alone."""
    found, said = [], []
    for seed in range(7):
        result, _ = misstated(seed, wrong=1, datum="free")
        moved, std = corrections(result)
        rest = still(np.asarray(result.details["targets"]), moved)
        np.testing.assert_allclose(rest, moved, rtol=0.0, atol=1e-3 * WRONG)
        found.append(moved)
        said.append(std)
    scatter = np.var(found, axis=0, ddof=1) / np.mean(np.square(said), axis=0)
    assert np.mean(scatter) == pytest.approx(1.0, abs=0.35)


def test_targets_that_are_taken_as_known_have_no_corrections():
    result = solve(simulate(1, n=24, layout=low_ring).problem())
    assert "target_corrections" not in result.details
    assert "target_corrections" not in {table.name for table in tables(result)}


def test_the_table_has_micrometres_and_says_what_they_count_from():
    result, _ = misstated(2)
    (table,) = (t for t in tables(result) if t.name == "target_corrections")
    moved, std = corrections(result)
    assert table.title.endswith("(datum prior)")
    assert table.heads() == [
        "target", "x / µm", "y / µm", "z / µm", "U(x) / µm", "U(y) / µm", "U(z) / µm",
    ]  # fmt: skip
    cells = np.array([row[1:] for row in table.rows])
    np.testing.assert_allclose(cells, 1e6 * np.hstack([moved, 2.0 * std]), rtol=1e-12)
    free, _ = misstated(2, datum="free")
    (table,) = (t for t in tables(free) if t.name == "target_corrections")
    assert "less a shift and a turn" in table.title


@pytest.mark.slow
def test_lengths_from_three_places_correct_their_targets_too():
    squares = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        rows = scene(rng, noise=0.0).rows
        true = TARGET_STD * rng.standard_normal(rows["targets"].shape)
        rows["length"] = rows["length"] + LENGTH_STD * rng.standard_normal(len(rows["length"]))
        rows["targets"] = rows["targets"] - true
        details = tracer_six.solve(tracer_six.SixProblem(**rows)).details
        moved, std = details["target_corrections"], details["target_corrections_std"]
        np.testing.assert_allclose(details["targets"] - moved, rows["targets"], atol=1e-15)
        squares.append(((moved - true) / std) ** 2)
    assert np.mean(squares) == pytest.approx(1.0, abs=0.4)  # a shift of all weighs much
