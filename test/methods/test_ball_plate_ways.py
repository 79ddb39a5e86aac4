"""Dense, spectral, general and closed form: one model, one answer."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from dense_ball_plate import solve_dense
from hypothesis import given, settings
from hypothesis import strategies as st
from plate_data import PAPER_PLATE, RADIUS, simulated, solved
from plate_in_engine import in_the_engine
from scipy.optimize import lsq_linear

from rotcal_ros.adjust.seen import seen_by
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import ObservabilityError, PlanError
from rotcal_ros.methods.ball_plate.solver import closed_form, model, solve
from rotcal_ros.methods.ball_plate.solver.estimate import WithGaps, factored_with_drift, gap_cells
from rotcal_ros.methods.ball_plate.solver.estimate import solved as solve_exactly
from rotcal_ros.methods.ball_plate.solver.general_least_squares import GeneralFit
from rotcal_ros.methods.ball_plate.solver.model import FIELDS, TABLE_COMPONENTS
from rotcal_ros.methods.ball_plate.solver.problem import BallPlateProblem, select
from rotcal_ros.methods.ball_plate.solver.separability import separability
from rotcal_ros.methods.ball_plate.solver.spectral import SpectralFit

AGREE = 1e-9


def random_balls(grid, count, seed):
    rng = np.random.default_rng(seed)
    while True:
        balls = np.sort(rng.choice(grid, count, replace=False))
        found = separability(grid, balls)
        if found.separable and not found.weak:
            return balls.tolist()


def assert_same(first, second, covariance=True):
    for field in FIELDS:
        for part in ("estimate", "unit_std"):
            a, b = getattr(getattr(first, part), field), getattr(getattr(second, part), field)
            np.testing.assert_allclose(b, a, rtol=0, atol=AGREE * np.abs(a).max(), err_msg=field)
    scale = np.abs(first.residuals).max()
    np.testing.assert_allclose(second.residuals, first.residuals, rtol=0, atol=AGREE * scale)
    size = np.abs(first.cofactor()).max()
    np.testing.assert_allclose(second.cofactor(), first.cofactor(), rtol=0, atol=AGREE * size)
    assert second.dof == first.dof
    assert second.weighted_square_sum == pytest.approx(first.weighted_square_sum, rel=AGREE)
    if not covariance:
        return
    for one in TABLE_COMPONENTS:
        for other in TABLE_COMPONENTS:
            a, b = first.unit_covariance(one, other), second.unit_covariance(one, other)
            unit = np.sqrt(
                np.abs(first.unit_covariance(one, one)).max()
                * np.abs(first.unit_covariance(other, other)).max()
            )
            np.testing.assert_allclose(b, a, rtol=0, atol=AGREE * unit, err_msg=one + other)


@pytest.mark.parametrize(
    ("grid", "count"),
    [(12, 5), (12, 8), (12, 12), (24, 5), (24, 9), (24, 24), (36, 5), (36, 12), (72, 5), (72, 12)],
)
def test_three_ways_agree_on_complete_data(grid, count):
    problem, _ = simulated(grid, random_balls(grid, count, grid + count), seed=count)
    dense = solve_dense(problem)
    assert_same(dense, solved(SpectralFit, problem))
    assert_same(dense, solved(GeneralFit, problem), covariance=grid < 72)


@pytest.mark.parametrize(("grid", "count", "positions"), [(12, 12, 7), (24, 9, 19), (36, 8, 30)])
def test_general_agrees_with_dense_on_reduced_positions_and_gaps(grid, count, positions):
    problem, _ = simulated(grid, random_balls(grid, count, 3), seed=grid)
    rng = np.random.default_rng(grid)
    part = select(problem, cmm_positions=np.sort(rng.choice(grid, positions, replace=False)))
    keep = np.ones(len(part.centres), dtype=bool)
    keep[rng.choice(len(keep), 4, replace=False)] = False
    assert_same(solve_dense(part), solved(GeneralFit, part))
    assert_same(solve_dense(part.take(keep)), solved(GeneralFit, part.take(keep)))


@pytest.mark.parametrize(("grid", "count", "missing"), [(12, 7, 3), (24, 8, 9), (72, 6, 12)])
def test_spectral_solution_corrected_for_gaps_agrees_with_dense(grid, count, missing):
    problem, _ = simulated(grid, random_balls(grid, count, 8), seed=grid)
    rng = np.random.default_rng(missing)
    gone = rng.choice(len(problem.centres), missing, replace=False)
    part = problem.take(np.setdiff1d(np.arange(len(problem.centres)), gone))
    gaps = gap_cells(part)
    assert gaps.tolist() == sorted(gone.tolist())
    assert_same(
        solve_dense(part), WithGaps(part, gaps).solve(part.deviations), covariance=grid < 72
    )
    assert solve_exactly(part)[1].way == "spectral with gaps"


def test_gaps_that_leave_something_open_are_refused():
    problem, _ = simulated(24, [0, 3, 4, 9, 14])
    alone = (problem.cmm_index != 5) | (problem.ball_step == 3)
    part = problem.take(alone & ((problem.ball_step != 3) | (problem.cmm_index == 5)))
    with pytest.raises(ObservabilityError):
        WithGaps(part, gap_cells(part))


def test_large_grids_with_gaps_do_not_need_the_elimination():
    problem, truth = simulated(1440, [20 * b + b % 7 for b in PAPER_PLATE], seed=3)
    _, solution = solve_exactly(problem.take(np.arange(len(problem.centres)) != 1234))
    assert solution.way == "spectral with gaps"
    error = solution.estimate.component("ECC") - truth.component("ECC")
    expected = 5e-8 * solution.unit_std.component("ECC")
    assert np.sqrt(np.mean((error / expected) ** 2)) == pytest.approx(1.0, abs=0.07)


def test_general_agrees_with_dense_on_unequal_weights_and_repeated_centres():
    problem, _ = simulated(24, random_balls(24, 8, 1), seed=5)
    rng = np.random.default_rng(2)
    twice = problem.take(np.concatenate([np.arange(len(problem.centres)), [3, 50, 51]]))
    weighted = replace(twice, row=None, std=rng.uniform(0.3, 3.0, twice.centres.shape) * 1e-7)
    assert_same(solve_dense(weighted), solved(GeneralFit, weighted))


@pytest.mark.parametrize("drift", [0, 1, 2])
@pytest.mark.parametrize("kind", ["complete", "gaps", "elimination", "weights"])
def test_each_way_is_the_dense_reference_of_the_engine(kind, drift):
    problem, _ = simulated(24, [0, 3, 4, 9, 14, 20], seed=4, drift=drift)
    n, rng = len(problem.centres), np.random.default_rng(6)
    if kind in ("gaps", "elimination"):
        problem = problem.take(rng.permutation(n) >= (4 if kind == "gaps" else 24))
    if kind == "weights":
        problem = replace(problem, std=rng.uniform(0.3, 3.0, (n, 3)) * 1e-7)
    problem = replace(problem, row=rng.permutation(len(problem.centres)))
    found, dense = factored_with_drift(problem).solve(problem.deviations), in_the_engine(problem)
    assert found.way.startswith({"complete": "spectral", "gaps": "spectral with gaps"}.get(
        kind, "general"
    ))  # fmt: skip
    values = found.estimate.curves().ravel()
    np.testing.assert_allclose(values, dense.value, rtol=0, atol=AGREE * np.abs(values).max())
    covariance = dense.response @ dense.response.T
    blocks = [[found.unit_covariance(one, two) for two in COMPONENTS] for one in COMPONENTS]
    std = np.sqrt(covariance.diagonal())
    np.testing.assert_allclose(
        np.block(blocks) / std / std[:, None], covariance / std / std[:, None], rtol=0, atol=AGREE
    )
    np.testing.assert_allclose(found.unit_std.curves().ravel(), std, rtol=AGREE)
    own = problem.noise_unit
    np.testing.assert_allclose((found.residuals / own).ravel(), dense.white, rtol=0,
                               atol=AGREE * np.abs(dense.white).max())  # fmt: skip
    redundancy = np.einsum("nii->ni", found.cofactor()) / own**2
    np.testing.assert_allclose(redundancy.ravel(), dense.redundancy, rtol=0, atol=AGREE)
    assert found.dof == dense.dof
    assert found.weighted_square_sum == pytest.approx(dense.chi2, rel=AGREE)


@pytest.mark.parametrize("grid", [9, 24])
def test_motions_of_the_plate_by_their_spectra_are_those_of_the_engine(grid):
    problem, _ = simulated(grid, [0, 1, 3, 4, 8], seed=5)
    there = np.random.default_rng(1).random(len(problem.centres)) < 0.4
    found = SpectralFit(problem).seen_of_plate(there)
    columns = model.plate_motion(problem) * there[:, None, None]
    seen = seen_by(in_the_engine(problem), columns.reshape(-1, 6))
    size = np.abs(seen.moved).max()
    np.testing.assert_allclose(found.moved, seen.moved, rtol=0, atol=AGREE * size)
    np.testing.assert_allclose(
        found.information, seen.information, rtol=0, atol=AGREE * seen.whole.max()
    )
    np.testing.assert_allclose(found.whole, seen.whole, rtol=AGREE)


def test_dense_minimises_what_an_independent_solver_minimises():
    problem, _ = simulated(12, [0, 1, 3, 7, 8, 10], seed=9)
    design, constraints = model.design_matrix(problem), model.constraint_matrix(problem)
    stacked = np.vstack([design, 1e4 * constraints])
    target = np.concatenate([problem.deviations.ravel(), np.zeros(19)])
    expected = lsq_linear(stacked, target * 1e6, method="bvls").x * 1e-6
    found = solve_dense(problem).estimate
    reference = model.unpack(problem, expected)
    for field in FIELDS:
        np.testing.assert_allclose(
            getattr(found, field), getattr(reference, field), atol=1e-12, err_msg=field
        )


def test_noise_free_data_return_the_injected_table_errors():
    problem, truth = simulated(72, PAPER_PLATE, seed=4, noise=0.0)
    for solution in (solved(SpectralFit, problem), solve_dense(problem)):
        np.testing.assert_allclose(solution.estimate.translation, truth.translation, atol=1e-15)
        np.testing.assert_allclose(solution.estimate.rotation, truth.rotation, atol=1e-14)
        assert np.abs(solution.residuals).max() < 1e-15


def test_solutions_obey_the_constraints_of_the_paper():
    problem, _ = simulated(24, [0, 3, 4, 9, 14, 20], seed=2)
    angle = problem.angles
    radial = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    tangential = np.column_stack([-np.sin(angle), np.cos(angle), 0 * angle])
    found = solved(SpectralFit, problem).estimate
    phase = np.exp(-1j * angle)
    size = 1e-6
    assert np.abs(found.cmm.sum(axis=0)).max() < 1e-10 * size  # Eq. 15
    assert np.abs(np.cross(radial, found.cmm).sum(axis=0)).max() < 1e-10 * size
    assert abs(np.sum(radial * found.cmm)) < 1e-10 * size  # Eq. 16
    for field in (found.translation, found.rotation):
        assert np.abs(field.sum(axis=0)).max() < 1e-9 * size  # Eq. 17
        assert abs(np.sum((field[:, 0] + 1j * field[:, 1]) * phase)) < 1e-9 * size  # Eq. 18
    assert abs(np.sum(tangential[problem.balls] * found.plate)) < 1e-10 * size  # Eq. 19
    assert abs(found.plate[:, 2].sum()) < 1e-10 * size


def test_invisible_directions_are_nineteen_and_invisible():
    problem, _ = simulated(24, [0, 3, 4, 9, 14], seed=1)
    design, space = model.design_matrix(problem), model.null_space(problem)
    assert np.abs(design @ space).max() < 1e-14
    assert np.linalg.matrix_rank(space) == 19
    assert design.shape[1] - np.linalg.matrix_rank(design) == 19


def test_paper_plate_has_the_papers_uncertainties():
    """k = 2, 0.1 um per centre: 0.03 um, 0.23 urad (tilts) and 0.16 urad are printed."""
    problem, _ = simulated(72, PAPER_PLATE)
    for solution in (solved(SpectralFit, problem), solve_dense(problem)):
        expanded = {
            name: 0.1e-6 * np.sqrt(np.mean(solution.unit_std.component(name) ** 2))
            for name in TABLE_COMPONENTS
        }
        assert round(expanded["EXC"] * 1e6, 3) == round(expanded["EYC"] * 1e6, 3) == 0.030
        assert round(expanded["EZC"] * 1e6, 2) == 0.03
        assert round(expanded["EAC"] * 1e6, 3) == round(expanded["EBC"] * 1e6, 3) == 0.231
        assert round(expanded["ECC"] * 1e6, 3) == 0.163


def test_closed_form_equals_least_squares():
    problem, _ = simulated(12, range(12), seed=6)
    exact = solved(SpectralFit, problem)
    found = closed_form(problem, nominal_radius=True)
    np.testing.assert_allclose(found.translation, exact.estimate.translation, atol=1e-17)
    np.testing.assert_allclose(found.rotation, exact.estimate.rotation, atol=1e-16)
    for at, name in enumerate(TABLE_COMPONENTS):
        np.testing.assert_allclose(exact.unit_std.component(name), found.unit_std[at], rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("balls", [range(12), range(0, 12, 2)], ids=["whole", "two groups"])
def test_the_closed_form_solves_a_whole_calibration(balls):
    problem, _ = simulated(12, balls, seed=6)
    posed = replace(problem, separate_groups=True)
    one, other = solve(posed), solve(replace(posed, closed_form=True))
    for name in COMPONENTS:
        largest = np.abs(one.deviations[name]).max()
        np.testing.assert_allclose(
            other.deviations[name], one.deviations[name], rtol=0, atol=1e-12 * largest
        )
        np.testing.assert_allclose(other.std[name], one.std[name], rtol=1e-12)
    assert other.verdict == one.verdict
    assert [group["way"] for group in other.details["groups"]] == ["closed form"] * (
        len(balls) // 6 % 2 + 1
    )


@pytest.mark.slow
@pytest.mark.parametrize("spoiled", ["a wrong centre", "a gap", "weights", "a noisier axis"])
def test_where_the_closed_form_does_not_exist_the_least_squares_take_its_place(spoiled):
    problem, _ = simulated(12, range(12), seed=6, noise=5e-8)
    centres, more = problem.centres.copy(), {}
    if spoiled == "a wrong centre":
        centres[17, 2] += 3e-6
    if spoiled == "a noisier axis":
        centres[:, 0] += 1e-6 * np.random.default_rng(1).standard_normal(len(centres))
    if spoiled == "weights":
        std = np.full_like(centres, 4e-8)
        std[::2] = 6e-8
        more = {"std": std}
    posed = replace(problem, centres=centres, **more)
    if spoiled == "a gap":
        posed = posed.take(np.arange(1, len(centres)))
    one, other = solve(posed), solve(replace(posed, closed_form=True))
    for name in COMPONENTS:
        np.testing.assert_allclose(other.std[name], one.std[name], rtol=1e-9)
        assert other.deviations[name] == pytest.approx(one.deviations[name], abs=1e-15)
    assert other.verdict == one.verdict
    assert any("the closed form needs" in text for text in other.warnings)


def test_the_closed_form_of_fewer_balls_than_positions_is_refused():
    problem, _ = simulated(12, [0, 1, 3, 6, 7, 9], seed=6)
    with pytest.raises(PlanError, match="the closed form needs 12 balls"):
        solve(replace(problem, closed_form=True))


def test_closed_form_divides_by_the_mean_measured_radius():
    problem, _ = simulated(12, range(12), seed=6)
    measured, nominal = closed_form(problem), closed_form(problem, nominal_radius=True)
    angle = problem.angles[problem.cmm_index]
    expected = np.mean(
        problem.centres[:, 0] * np.cos(angle) + problem.centres[:, 1] * np.sin(angle)
    )
    assert measured.radius == pytest.approx(expected, rel=1e-14)
    np.testing.assert_allclose(
        measured.rotation * measured.radius, nominal.rotation * RADIUS, rtol=0, atol=1e-19
    )


def test_closed_form_refuses_an_incomplete_grid():
    problem, _ = simulated(12, [0, 1, 3, 5, 8])
    with pytest.raises(PlanError, match="12 balls at 12 table positions"):
        closed_form(problem)


def test_general_names_the_table_positions_that_have_too_few_balls():
    problem, _ = simulated(24, [0, 3, 4, 9, 14])
    part = problem.take((problem.position != 7) | (problem.ball_step < 4))
    with pytest.raises(ObservabilityError, match=r"position \(balls\) 7 \(2\)"):
        solved(GeneralFit, part)


def test_spectral_takes_thousands_of_positions_within_little_memory():
    problem, truth = simulated(3600, [50 * b + b % 7 for b in PAPER_PLATE], seed=3)
    tracemalloc.start()
    solution = solved(SpectralFit, problem)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 50e6
    error = solution.estimate.component("ECC") - truth.component("ECC")
    expected = 5e-8 * solution.unit_std.component("ECC")
    assert np.sqrt(np.mean((error / expected) ** 2)) == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
@pytest.mark.slow
def test_a_whole_result_of_thousands_of_positions_holds_no_matrix_of_them():
    problem, _ = simulated(3600, [50 * b + b % 7 for b in PAPER_PLATE], seed=3)
    tracemalloc.start()
    result = solve(problem)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert result.verdict == "ok"
    assert not result.covariance
    assert peak < 1.2 * 8 * 3600**2  # one matrix is 104 MB; there were six


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31), st.integers(5, 9))
def test_the_order_of_the_rows_does_not_change_a_bit(seed, count):
    problem, _ = simulated(12, random_balls(12, count, seed), seed=seed)
    shuffle = np.random.default_rng(seed).permutation(len(problem.centres))
    mixed = BallPlateProblem(
        12,
        RADIUS,
        problem.position[shuffle],
        problem.ball_step[shuffle],
        problem.centres[shuffle],
        row=problem.rows[shuffle],
    )
    first, second = solved(SpectralFit, problem), solved(SpectralFit, mixed)
    for field in FIELDS:
        assert (getattr(first.estimate, field) == getattr(second.estimate, field)).all()


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**31), st.integers(1, 23))
def test_turning_the_plate_by_whole_steps_keeps_the_uncertainty(seed, shift):
    balls = np.array(random_balls(24, 6, seed))
    first, _ = simulated(24, balls)
    second, _ = simulated(24, np.sort((balls + shift) % 24))
    for name in TABLE_COMPONENTS:
        a = np.mean(solved(SpectralFit, first).unit_std.component(name) ** 2)
        b = np.mean(solved(SpectralFit, second).unit_std.component(name) ** 2)
        assert a == pytest.approx(b, rel=1e-9)
