"""Order by order, by groups, dense and in closed form: one model, one answer."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from coded import coded
from dense_ball_plate import design_of, solve_dense
from hypothesis import given, settings
from hypothesis import strategies as st
from plate_data import PAPER_PLATE, RADIUS, in_cmm_order, simulated

from rotcal_ros.adjust.kernels import ConstrainedKernel, DenseKernel, LowRankUpdateKernel
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import ObservabilityError, PlanError
from rotcal_ros.methods.ball_plate.solver import closed_form, solve
from rotcal_ros.methods.ball_plate.solver.layout import PlateLayout
from rotcal_ros.methods.ball_plate.solver.plate_model import PlateRows, plate_model
from rotcal_ros.methods.ball_plate.solver.problem import select
from rotcal_ros.methods.ball_plate.solver.result import NOT_CLOSED_FORM
from rotcal_ros.methods.ball_plate.solver.separability import separability

AGREE = 1e-9


def random_balls(grid, count, seed):
    rng = np.random.default_rng(seed)
    while True:
        balls = np.sort(rng.choice(grid, count, replace=False))
        found = separability(grid, balls)
        if found.separable and not found.weak:
            return balls.tolist()


def linear(problem):
    """Return the kernel of a problem, the deviations of the linear model, unit std, residuals."""
    layout = PlateLayout(problem)
    rows, model = PlateRows(layout), plate_model(layout)
    own = np.ones(len(model.std)) if problem.std is None else model.std
    white = model.linearised(model.first)[1].weighted(1.0 / own)
    kernel = white.kernel() or DenseKernel.of(white, np.zeros(0, dtype=int))
    defined = ConstrainedKernel.of(kernel, model.definitions)
    read = rows.of(problem.deviations[layout.row][:, :, None]).ravel() / own
    x = defined.solve(read)
    outputs = model.output_rows
    left = rows.frame.swapaxes(1, 2) @ (own * (read - white.times(x))).reshape(-1, 3, 1)
    residuals = np.empty_like(problem.centres)
    residuals[layout.row] = left[:, :, 0]
    found = outputs.times(x), np.sqrt(defined.variances_of(outputs))
    return kernel, *(each.reshape(6, -1) for each in found), residuals


def assert_dense(problem):
    dense = solve_dense(problem)
    kernel, values, std, residuals = linear(problem)
    for row, name in enumerate(COMPONENTS):
        for found, expected in ((values[row], dense.component(name)), (std[row], dense.std(name))):
            size = np.abs(expected).max()
            np.testing.assert_allclose(found, expected, rtol=0, atol=AGREE * size, err_msg=name)
    scale = np.abs(dense.residuals).max()
    np.testing.assert_allclose(residuals, dense.residuals, rtol=0, atol=AGREE * scale)
    assert problem.centres.size - kernel.rank == dense.dof
    return kernel


@pytest.mark.parametrize(
    ("grid", "count"), [(12, 5), (12, 8), (12, 12), (24, 5), (24, 24), (36, 12), (72, 12)]
)
def test_order_by_order_is_the_dense_form(grid, count):
    problem, _ = simulated(grid, random_balls(grid, count, grid + count), seed=count)
    assert isinstance(assert_dense(problem), LowRankUpdateKernel)


@pytest.mark.parametrize(("grid", "count", "positions"), [(12, 12, 7), (24, 9, 19), (36, 8, 30)])
def test_reduced_positions_and_gaps_are_the_dense_form(grid, count, positions):
    problem, _ = simulated(grid, random_balls(grid, count, 3), seed=grid)
    rng = np.random.default_rng(grid)
    part = select(problem, cmm_positions=np.sort(rng.choice(grid, positions, replace=False)))
    keep = np.ones(len(part.centres), dtype=bool)
    keep[rng.choice(len(keep), 4, replace=False)] = False
    for each in (part, part.take(keep)):
        assert not isinstance(assert_dense(each), LowRankUpdateKernel)


@pytest.mark.parametrize(("grid", "count", "missing"), [(12, 7, 3), (24, 8, 9), (72, 6, 12)])
def test_a_few_gaps_are_a_low_rank_beside_the_orders(grid, count, missing):
    problem, _ = simulated(grid, random_balls(grid, count, 8), seed=grid)
    rng = np.random.default_rng(missing)
    gone = rng.choice(len(problem.centres), missing, replace=False)
    part = problem.take(np.setdiff1d(np.arange(len(problem.centres)), gone))
    assert isinstance(assert_dense(part), LowRankUpdateKernel)


def test_unequal_weights_and_repeated_centres_are_the_dense_form():
    problem, _ = simulated(24, random_balls(24, 8, 1), seed=5)
    rng = np.random.default_rng(2)
    twice = problem.take(np.concatenate([np.arange(len(problem.centres)), [3, 50, 51]]))
    assert isinstance(assert_dense(replace(twice, row=None)), LowRankUpdateKernel)
    weighted = replace(twice, row=None, std=rng.uniform(0.3, 3.0, twice.centres.shape) * 1e-7)
    assert_dense(weighted)


def test_gaps_that_leave_something_open_are_refused():
    problem, _ = simulated(24, [0, 3, 4, 9, 14])
    alone = (problem.cmm_index != 5) | (problem.ball_step == 3)
    part = problem.take(alone & ((problem.ball_step != 3) | (problem.cmm_index == 5)))
    with pytest.raises(ObservabilityError):
        solve(part)


def test_noise_free_data_return_the_injected_table_errors():
    problem, truth = simulated(72, PAPER_PLATE, seed=4, noise=0.0)
    _, values, _, residuals = linear(problem)
    np.testing.assert_allclose(values[:3].T, truth.translation, atol=1e-15)
    np.testing.assert_allclose(values[3:].T, truth.rotation, atol=1e-14)
    assert np.abs(residuals).max() < 1e-15


def test_solutions_obey_the_constraints_of_the_paper():
    problem, _ = simulated(24, [0, 3, 4, 9, 14, 20], seed=2)
    angle = problem.angles
    radial = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    tangential = np.column_stack([-np.sin(angle), np.cos(angle), 0 * angle])
    result = solve(problem)
    (found,) = result.details["groups"]
    phase, size = np.exp(-1j * angle), 1e-6
    cmm, plate = found["cmm_errors"], found["plate_errors"]
    assert np.abs(cmm.sum(axis=0)).max() < 1e-9 * size  # Eq. 15
    assert np.abs(np.cross(radial, cmm).sum(axis=0)).max() < 1e-9 * size
    assert abs(np.sum(radial * cmm)) < 1e-9 * size  # Eq. 16
    for names in (("EXC", "EYC", "EZC"), ("EAC", "EBC", "ECC")):
        x, y, z = (result.deviations[name] for name in names)
        assert max(abs(each.sum()) for each in (x, y, z)) < 1e-8 * size  # Eq. 17
        assert abs(np.sum((x + 1j * y) * phase)) < 1e-8 * size  # Eq. 18
    assert abs(np.sum(tangential[problem.balls] * plate)) < 1e-9 * size  # Eq. 19
    assert abs(plate[:, 2].sum()) < 1e-9 * size


def test_what_is_open_is_open_and_the_definitions_fix_it():
    """Nineteen directions as the paper counts: thirteen, and the pose of the axis."""
    problem, _ = simulated(24, [0, 3, 4, 9, 14], seed=1)
    layout, printed = PlateLayout(problem), design_of(problem)
    assert printed.shape[1] - np.linalg.matrix_rank(printed) == 19
    assert layout.unknowns - np.linalg.matrix_rank(layout.rows.toarray()) == 13
    open_ = layout.circular.kernel().directions
    assert np.abs(layout.rows @ open_).max() < 1e-13
    assert np.linalg.cond(layout.definitions @ open_) < 1e6


@pytest.mark.parametrize("seed", range(3))
def test_the_design_is_that_of_the_exact_equations(seed):
    """By differences: the derivatives at the nominal places, where products are small."""
    problem, _ = simulated(9, [0, 1, 3, 5, 8], seed=seed)
    layout = PlateLayout(problem)
    step = 1e-6 * np.random.default_rng(seed).standard_normal(layout.unknowns)
    moved = (layout.computed(step) - layout.computed(-step)).ravel() / 2.0
    np.testing.assert_allclose(moved, layout.rows @ step, rtol=0, atol=1e-15)


def test_paper_plate_has_the_papers_uncertainties():
    """k = 2, 0.1 um per centre: 0.03 um, 0.23 urad (tilts) and 0.16 urad are printed."""
    problem, _ = simulated(72, PAPER_PLATE)
    unit = PlateLayout(problem).unit_std()
    expanded = {name: 0.1e-6 * np.sqrt(np.mean(std**2)) for name, std in unit.items()}
    assert round(expanded["EXC"] * 1e6, 3) == round(expanded["EYC"] * 1e6, 3) == 0.030
    assert round(expanded["EZC"] * 1e6, 2) == 0.03
    assert round(expanded["EAC"] * 1e6, 3) == round(expanded["EBC"] * 1e6, 3) == 0.231
    assert round(expanded["ECC"] * 1e6, 3) == 0.163


def test_closed_form_equals_least_squares():
    problem, _ = simulated(12, range(12), seed=6)
    _, values, std, _ = linear(problem)
    found = closed_form(problem, nominal_radius=True)
    np.testing.assert_allclose(found.translation, values[:3].T, atol=1e-16)
    np.testing.assert_allclose(found.rotation, values[3:].T, atol=1e-15)
    np.testing.assert_allclose(std, np.tile(found.unit_std[:, None], 12), rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("balls", [range(12), range(0, 12, 2)], ids=["whole", "two groups"])
def test_the_closed_form_solves_a_whole_calibration(balls):
    problem, _ = simulated(12, balls, seed=6)
    posed = replace(problem, separate_groups=True)
    one, other = solve(posed), solve(replace(posed, closed_form=True))
    for name in COMPONENTS:
        # the closed form is linear: products of small angles are the difference
        apart = np.abs(other.deviations[name] - one.deviations[name])
        assert 0.0 < apart.max() < 1e-3 * np.abs(one.deviations[name]).max()
        np.testing.assert_allclose(other.std[name], one.std[name], rtol=1e-12)
    assert other.verdict == one.verdict
    assert NOT_CLOSED_FORM not in coded(*other.warnings)


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
    assert NOT_CLOSED_FORM in coded(*other.warnings)


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


def test_thousands_of_positions_take_little_memory():
    problem, _ = simulated(3600, [50 * b + b % 7 for b in PAPER_PLATE], seed=3)
    tracemalloc.start()
    unit = PlateLayout(problem).unit_std()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 400e6
    assert unit["ECC"].min() > 0.0


@pytest.mark.slow
def test_a_whole_result_of_thousands_of_positions_holds_no_matrix_of_them():
    problem, truth = simulated(3600, [50 * b + b % 7 for b in PAPER_PLATE], seed=3)
    result = solve(in_cmm_order(replace(problem, sigma=5e-8)))
    assert result.verdict == "ok"
    assert not result.covariance
    error = (result.deviations["ECC"] - truth.component("ECC")) / result.std["ECC"]
    assert np.sqrt(np.mean(error**2)) == pytest.approx(1.0, abs=0.05)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**31), st.integers(1, 23))
def test_turning_the_plate_by_whole_steps_keeps_the_uncertainty(seed, shift):
    balls = np.array(random_balls(24, 6, seed))
    first, _ = simulated(24, balls)
    second, _ = simulated(24, np.sort((balls + shift) % 24))
    one, other = (PlateLayout(problem).unit_std() for problem in (first, second))
    for name in COMPONENTS:
        assert np.mean(one[name] ** 2) == pytest.approx(np.mean(other[name] ** 2), rel=1e-9)
