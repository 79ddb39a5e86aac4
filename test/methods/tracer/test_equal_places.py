"""A machine that comes to a target anew for every length, and what its reports are worth."""

from dataclasses import replace

import numpy as np
import pytest
from chances import LONG, most, scatter, share, squares
from coded import coded
from tracer_scene import arc, low_ring, simulate

from rotcal_ros.foundation.units import ARCSEC
from rotcal_ros.methods.tracer.solver.reported import NOT_FOLLOWED
from rotcal_ros.methods.tracer.solver.solution import adjust
from rotcal_ros.methods.tracer.solver.solve import solve

STD = 4e-8
CORNERS = np.array(
    [[x, y, z] for x in (-0.45, 0.45) for y in (-0.45, 0.45) for z in (0.3, 0.7)]
)  # fmt: skip


def solved(problem, shift):
    return solve(replace(problem, moved=shift))


def weighed(problem, shift):
    return adjust(replace(problem, moved=shift))


def world(seed, move, noise, m=6, variant="joint"):
    """Every length to its target, ``move`` (m) off; reports are ``noise`` (m) off the place.

    Returns the problem as a cell without reports would pose it, the deviations, and the reports
    less their mean at each target.
    """
    rng = np.random.default_rng(seed)
    angles = 2 * np.pi / m * np.arange(m)
    deviation = 5 * ARCSEC * (np.cos(angles - 0.4) + 0.4 * np.cos(2 * angles + 1.0))
    actual = angles + deviation
    mount = np.array([0.30, 0.05, 0.15])
    turns = np.array([[[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]]
                      for a in actual])  # fmt: skip
    stations = turns @ mount
    off = rng.normal(0.0, move, (m, 8, 3))
    corners = CORNERS + rng.normal(0.0, 2e-7, (8, 3))
    length = np.linalg.norm(corners + off - stations[:, None], axis=2) - 0.2718
    length += rng.normal(0.0, STD, length.shape)
    report = off + rng.normal(0.0, noise, off.shape)
    mean = report.mean(axis=0)
    position, target = np.divmod(np.arange(8 * m), 8)
    problem = simulate(angles=angles, n=8, layout=lambda n, _: CORNERS + mean).problem(
        length_std=STD, target_std=2e-7, variant=variant, length=length.ravel(),
        table_angles=angles, error_motion_std=1e-8, position=position, target=target,
    )  # fmt: skip
    return problem, deviation - deviation[0], (report - mean).reshape(-1, 3)


def test_reported_following_errors_do_not_reach_the_angle():
    scene = simulate(3, angles=arc(9), n=16, layout=low_ring, length_std=0.0)
    exact = scene.problem(variant="joint", target_std=1e-6)
    stations = solve(exact).details["stations"]
    shift = np.random.default_rng(1).normal(0.0, 5e-6, (len(exact.length), 3))
    places = exact.targets[exact.target]
    apart = [
        np.linalg.norm(p - stations[exact.position], axis=1) for p in (places, places + shift)
    ]
    measured = replace(exact, length=exact.length + apart[1] - apart[0])
    wrong = solve(measured).deviations["ECC"] - solve(exact).deviations["ECC"]
    assert np.abs(wrong).max() > 0.5 * ARCSEC
    right = weighed(measured, shift)
    assert right.reported.weight == 1.0
    error = right.deviations - solve(exact).deviations["ECC"]
    assert np.abs(error).max() < 1e-3 * ARCSEC


def test_what_no_length_notices_changes_nothing():
    problem = simulate(3, angles=arc(9), n=16, layout=low_ring).problem()
    shift = np.full((len(problem.length), 3), 1e-9)
    assert weighed(problem, shift).reported is None


@pytest.mark.parametrize("variant", ["joint", "station"])
@pytest.mark.parametrize("noise", [1e-7, 1e-6, 1e-5])
def test_noisy_reports_of_a_machine_that_stands_still_change_nothing(noise, variant):
    """To the last bit: the lengths are those of a machine that reports no noise."""
    for seed in range(2):
        problem, _, shift = world(seed, 0.0, noise, variant=variant)
        plain, found = solve(problem), solved(problem, shift)
        assert found.details["reported_places"]["weight"] == 0.0
        np.testing.assert_array_equal(found.deviations["ECC"], plain.deviations["ECC"])
        np.testing.assert_array_equal(found.std["ECC"], plain.std["ECC"])
        assert found.verdict == plain.verdict
        assert found.warnings[:-1] == plain.warnings
        assert found.warnings[-1].startswith("reported places: ")
        assert NOT_FOLLOWED in coded(found.warnings[-1])


@pytest.mark.parametrize("variant", ["joint", "station"])
@pytest.mark.parametrize("move", [1e-6, 1e-5, 5e-5])
def test_true_reports_of_a_machine_that_moves_are_believed_wholly(move, variant):
    """As without the moves: both cells have the same noise of the lengths."""
    for seed in range(2):
        problem, _, shift = world(seed, move, 0.0, variant=variant)
        found = solved(problem, shift)
        still, _, _ = world(seed, 0.0, 0.0, variant=variant)
        assert found.details["reported_places"]["weight"] == 1.0
        assert not any("reported places" in text for text in found.warnings)
        expected = solve(still)
        std = np.maximum(expected.std["ECC"], 1e-12)
        apart = found.deviations["ECC"] - expected.deviations["ECC"]
        assert (np.abs(apart) < 4 * std + 2e-3 * move).all()
        np.testing.assert_allclose(found.std["ECC"][1:], std[1:], rtol=0.5)


@pytest.mark.slow
def test_half_true_reports_are_half_believed():
    """Moves and noise of equal size: the weight is 1/2, and S/2 of the move stays unknown."""
    size = 4e-7
    weights, left = [], []
    for seed in range(10):
        problem, _, shift = world(seed, size, size, m=12)
        reported = weighed(problem, shift).reported
        weights.append(reported.weight)
        left.append(reported.left)
    assert np.mean(weights) == pytest.approx(0.5, abs=0.06)
    assert np.median(left) == pytest.approx(size / np.sqrt(2), rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(("move", "noise"), [(0.0, 1e-7), (2e-6, 0.0), (1e-7, 1e-7), (2e-8, 1e-7)])
def test_the_stated_uncertainty_holds_and_sound_cells_are_not_suspect(move, noise):
    """95 % of the angles within 1.96 u; 1 cell of 60 is suspect without reports.

    Where a part of the reports is noise, some cells cannot separate it from noise of the lengths.
    """
    inside, square, suspect = [], [], 0
    cells = 60 if LONG else 8
    for seed in range(cells):
        problem, truth, shift = world(100 + seed, move, noise, m=12)
        found = solved(problem, shift)
        error = (found.deviations["ECC"] - truth)[1:] / found.std["ECC"][1:]
        inside.append(np.abs(error) < 1.96)
        error = (found.deviations["ECC"] - truth)[1:]
        square.append(squares(error, found.covariance["ECC"][1:, 1:]) / len(error))
        suspect += found.verdict != "ok"
    assert share(0.95, cells)[0] <= np.mean(inside)
    assert np.mean(square) < scatter(np.size(inside))[1]
    if LONG:
        assert 0.90 < np.mean(inside) < 0.995
    assert suspect <= most(0.1 if move and noise else 1 / 60, cells)


@pytest.mark.slow
def test_reports_that_spoil_the_fit_are_named():
    """0.2 um of noise in reports of 0.5 um moves: too little to tell the slope from 1."""
    believed = 0
    for seed in range(12):
        problem, truth, shift = world(100 + seed, 5e-7, 2e-7, m=12)
        found = solved(problem, shift)
        assert any("reported places" in text for text in found.warnings)
        error = (found.deviations["ECC"] - truth)[1:] / found.std["ECC"][1:]
        assert np.abs(error).max() < 4.0
        believed += found.verdict == "suspect"
    assert believed >= 4


def test_noisy_lengths_are_not_blamed_on_reports_that_hardly_move():
    problem, _, shift = world(1, 1e-7, 0.0)
    noise = np.random.default_rng(5).normal(0.0, 1e-6, len(problem.length))
    found = solved(replace(problem, length=problem.length + noise), shift)
    assert found.verdict != "ok"
    assert found.details["reported_places"]["spoils"] == 0.0


@pytest.mark.slow
def test_no_other_weight_does_better():
    """Of the errors of the angles, against weights that nobody had to find."""
    errors = {w: [] for w in ("found", 0.0, 1.0)}
    for seed in range(20):
        problem, truth, shift = world(seed, 2e-7, 2e-7, m=8)
        plain = solve(problem)
        stations = plain.details["stations"]
        beam = problem.targets[problem.target] - stations[problem.position]
        beam /= np.linalg.norm(beam, axis=1, keepdims=True)
        whole = replace(problem, length=problem.length - (beam * shift).sum(axis=1))
        found = {"found": solved(problem, shift), 0.0: plain, 1.0: solve(whole)}
        for w, kept in errors.items():
            kept.append(found[w].deviations["ECC"] - truth)
    rms = {w: np.sqrt(np.mean(np.square(kept))) for w, kept in errors.items()}
    assert rms["found"] < 0.95 * min(rms[0.0], rms[1.0])
