"""Every number of a result against the dense solution as printed, and refits without a row."""

from dataclasses import replace

import numpy as np
import pytest
from dense_ball_plate import solve_dense
from plate_data import RADIUS, in_cmm_order, rotate_z, simulated
from scipy.stats import chi2, f

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.methods.ball_plate.solver import result as module
from rotcal_ros.methods.ball_plate.solver import select, solve
from rotcal_ros.methods.ball_plate.solver.estimate import factored
from rotcal_ros.methods.ball_plate.solver.rejection import judge_centres

BALLS = [0, 3, 4, 9, 14, 20]
N = 24 * len(BALLS)
FIELDS = {
    "plate_errors": "plate",
    "cmm_errors": "cmm",
    "axis_rotation": "axis_rotation",
    "axis_shift": "axis_shift",
}


def small(noise=5e-8, **fields):
    """Errors so small that their products, which the dense form neglects, are no more."""
    exact, _ = simulated(24, BALLS, noise=0.0, **fields)
    noisy, _ = simulated(24, BALLS, noise=noise, **fields)
    return replace(noisy, centres=noisy.centres - (1.0 - 1e-3) * exact.deviations)


def of_axes(problem, dense, stated, follow):
    """Standard deviations that x and y, x and y, and z of a centre have."""
    own = np.ones((len(problem.centres), 3)) if problem.std is None else problem.std
    square = np.sum((dense.residuals / own) ** 2, axis=0)
    kept = np.einsum("nii,ni->i", dense.cofactor(), 1.0 / own**2)
    plane, along = np.sqrt(square[:2].sum() / kept[:2].sum()), np.sqrt(square[2] / kept[2])
    found = np.array([plane, plane, along])
    if stated is None:
        return found
    return np.where(follow & (found > stated), found, stated)


def uneven(seed=4):
    """Noise of its own for each coordinate, and so stated."""
    std = np.random.default_rng(seed).uniform(3e-8, 9e-8, (N, 3))
    problem = small(noise=0.0)
    noise = std * np.random.default_rng([seed, 2]).normal(size=(N, 3))
    return replace(problem, centres=problem.centres + noise, std=std)


def cases():
    complete = small(sigma=5e-8)
    return {
        "stated": complete,
        "from residuals": replace(complete, sigma=None),
        "too small": replace(complete, sigma=2e-8),
        "too large": replace(complete, sigma=2e-7),
        "gaps": complete.take(np.arange(N) % 31 != 0),
        "weighted": uneven(),
        "weighted, too small": replace(uneven(), std=0.4 * uneven().std),
    }


@pytest.mark.parametrize("name", cases())
def test_a_result_is_the_dense_solution_with_its_noise(name):
    problem = cases()[name]
    result, dense = solve(problem), solve_dense(problem)
    assert result.rejected == ()
    total, dof = dense.weighted_square_sum, dense.dof
    stated = 1.0 if problem.std is not None else problem.sigma
    found = np.sqrt(total / dof)
    tail = 1.0 if stated is None else chi2.sf(total / stated**2, dof)
    p_value = 2.0 * min(tail, 1.0 - tail)
    larger = stated is None or (p_value < 0.01 and found > stated)
    used = of_axes(problem, dense, stated, larger)
    turned = used[[2, 2, 0]]
    of = {"plate": used, "cmm": used, "axis_rotation": turned, "axis_shift": used}
    of |= dict(zip(COMPONENTS, (*used, *turned), strict=True))
    assert result.dof == dof
    assert result.n_observations == len(problem.centres)
    assert result.sigma0 == pytest.approx(1.0 if stated is None else found / stated, rel=1e-6)
    details = result.details
    assert details["sigma_centre"] == pytest.approx(found, rel=1e-6)
    assert details["sigma_used"] == pytest.approx(np.sqrt(np.mean(used**2)), rel=1e-6)
    test = details["chi_square"]
    assert test["dof"] == dof
    if stated is None:
        assert test["p_value"] is None
        assert test["passed"] is True
    else:
        assert test["p_value"] == pytest.approx(p_value, rel=1e-4, abs=1e-12)
        assert test["passed"] == (p_value >= 0.01)
    assert result.verdict == ("suspect" if "too small" in name else "ok")
    contradicted = [text for text in result.warnings if "contradict" in text]
    assert len(contradicted) == ("too" in name)
    if contradicted:
        small = "they are larger: uncertainties follow the residuals"
        assert contradicted[0].endswith(small if "small" in name else "they are smaller")
        assert f"(sigma0 = {result.sigma0:.3f}, p = {test['p_value']:.2g})" in contradicted[0]
    for component in COMPONENTS:
        expected = dense.estimate.component(component)
        size = np.abs(expected).max()
        np.testing.assert_allclose(result.deviations[component], expected, atol=1e-6 * size)
        std = of[component] * dense.unit_std.component(component)
        np.testing.assert_allclose(result.std[component], std, rtol=1e-6)
        covariance = of[component] ** 2 * dense.unit_covariance(component, component)
        scale = 1e-6 * np.abs(covariance).max()
        np.testing.assert_allclose(result.covariance[component], covariance, atol=scale)
    (group,) = details["groups"]
    for key, field in FIELDS.items():
        expected = getattr(dense.estimate, field)
        np.testing.assert_allclose(group[key], expected, atol=1e-6 * np.abs(expected).max())
        expected = of[field] * getattr(dense.unit_std, field)
        np.testing.assert_allclose(group[f"{key}_std"], expected, rtol=1e-6)
    assert group["ball_steps"].tolist() == BALLS
    assert group["turn"] == 0.0
    np.testing.assert_array_equal(group["table_positions"], np.arange(24))
    np.testing.assert_array_equal(group["cmm_positions"], np.arange(24))
    assert (details["grid"], details["radius"]) == (24, RADIUS)


@pytest.mark.parametrize("name", ["stated", "from residuals", "gaps", "weighted"])
def test_residuals_stand_in_the_order_of_measurement(name):
    problem = in_cmm_order(cases()[name])
    result, dense = solve(problem), solve_dense(problem)
    order = np.argsort(problem.rows)
    rows, more = result.residuals, result.details["residual_rows"]
    np.testing.assert_array_equal(more["row"], problem.rows[order])
    np.testing.assert_array_equal(more["cmm_index"], problem.cmm_index[order])
    np.testing.assert_array_equal(rows.table_position, problem.position[order])
    np.testing.assert_array_equal(rows.target, problem.ball_step[order])
    np.testing.assert_allclose(more["vector"], dense.residuals[order], atol=1e-13)
    length = np.linalg.norm(dense.residuals, axis=1)[order]
    np.testing.assert_allclose(rows.residual, length, atol=1e-13)
    assert rows.used.all()
    assert 3.0 * rows.redundancy.sum() == pytest.approx(result.dof, rel=1e-6)


@pytest.mark.parametrize("name", ["stated", "from residuals", "too large", "gaps", "weighted"])
def test_a_test_value_is_what_a_fit_without_the_row_gains(name):
    """w'w falls by the gain; the other rows, or the larger statement, say how much it may."""
    problem = cases()[name]
    dense = solve_dense(problem)
    result = solve(problem)
    n = len(problem.centres)
    stated = 1.0 if problem.std is not None else problem.sigma
    sigma = stated
    test = judge_centres(problem, dense, sigma)
    np.testing.assert_allclose(result.residuals.test_value, test.value, rtol=1e-5)
    critical = np.sqrt(f.isf(0.01 / n, 3, dense.dof - 3))
    np.testing.assert_allclose(test.critical, critical, rtol=1e-9)
    own = np.ones((n, 3)) if problem.std is None else problem.std**2
    kept = np.einsum("nii,ni->n", dense.cofactor(), 1.0 / own) / 3.0
    np.testing.assert_allclose(result.residuals.redundancy, kept, rtol=1e-6)
    for row in (0, 17, 60, n - 1):
        others = solve_dense(problem.take(np.arange(n) != row))
        gain = dense.weighted_square_sum - others.weighted_square_sum
        assert test.gain[row] == pytest.approx(gain, rel=1e-5)
        variance = others.weighted_square_sum / (dense.dof - 3)
        variance = max(variance, 0.0 if sigma is None else sigma**2)
        assert test.value[row] == pytest.approx(np.sqrt(gain / 3 / variance), rel=1e-5)


def dirty(count, size=4e-6, **fields):
    problem, _ = simulated(24, BALLS, seed=3, **fields)
    rows = 1 + 31 * np.arange(count)  # of balls, positions and CMM positions of their own
    centres = problem.centres.copy()
    centres[rows, 0] += size
    return replace(problem, centres=centres), rows


@pytest.mark.parametrize("count", [2, 3])
def test_more_than_two_percent_rejected_are_suspicious(count):
    problem, rows = dirty(count, sigma=5e-8)
    result = solve(problem)
    assert [r.index for r in result.rejected] == sorted(rows)
    assert result.verdict == ("ok" if count < 0.02 * N else "suspect")
    text = f"{count} of {N} centres were rejected"
    assert (text in result.warnings) == (count > 0.02 * N)
    assert result.n_observations == N
    assert not result.residuals.used[rows].any()
    assert (result.residuals.test_value[rows] == 0.0).all()
    assert (result.residuals.redundancy[rows] == 0.0).all()
    assert result.residuals.residual[rows] == pytest.approx(4e-6, rel=0.3)


def test_the_reason_of_a_rejection_tells_residual_and_limit():
    problem, rows = dirty(1, sigma=5e-8)
    dense = solve_dense(problem)
    test = judge_centres(problem, dense, 5e-8)
    size = np.linalg.norm(dense.residuals[rows[0]]) * 1e6
    (rejection,) = solve(problem).rejected
    assert rejection.why == (
        f"row 1 (ball step 0, table position 1): residual {size:.3g} um, normalised "
        f"{test.value[1]:.1f} where {test.critical[1]:.1f} is the limit"
    )


@pytest.mark.parametrize("std", [None, 5e-8])
@pytest.mark.parametrize("turned", [False, True])
def test_a_knock_is_found_whatever_states_the_noise(std, turned):
    problem, _ = simulated(24, BALLS, seed=7)
    problem = in_cmm_order(problem)
    shift = np.tile([0.0, 2e-6, 0.0], (N, 1))
    if turned:  # about the x axis of the table, which raises a ball at y
        ball = problem.angles[problem.ball_step]
        place = RADIUS * np.column_stack([np.cos(ball), np.sin(ball), 0 * ball])
        shift = np.cross([2e-5, 0.0, 0.0], place)
    moved = rotate_z(shift, problem.angles[problem.position])
    late = (problem.rows >= 80)[:, None]
    given = {} if std is None else {"std": np.full((N, 3), std)}
    result = solve(replace(problem, centres=problem.centres + late * moved, **given))
    assert result.verdict == "failed"
    knock = result.details["groups"][0]["knock"]
    assert (knock["last_row"], knock["first_row"]) == (79, 80)
    scale = 1e-6 if turned else 2e-7
    expected = [[0, 0, 0], [2e-5, 0, 0]] if turned else [[0, 2e-6, 0], [0, 0, 0]]
    np.testing.assert_allclose(knock["rotation"][:2], expected[1][:2], atol=scale / RADIUS)
    np.testing.assert_allclose(knock["shift"][:2], expected[0][:2], atol=scale)
    first = int(np.flatnonzero(problem.rows == 80)[0])
    (text,) = [text for text in result.warnings if "the plate moved" in text]
    where = f"ball step {problem.ball_step[first]} at table position {problem.position[first]}"
    assert f"between rows 79 and 80 (before {where})" in text
    x, y, z = knock["shift"] * 1e6
    a, b, c = np.degrees(knock["rotation"]) * 3600
    assert f"displaced by about ({x:.2f}, {y:.2f}, {z:.2f}) um" in text
    assert f"turned by ({a:.2f}, {b:.2f}, {c:.2f}) arcsec" in text


def test_covariances_are_given_up_to_a_size(monkeypatch):
    problem, _ = simulated(24, BALLS)
    monkeypatch.setattr(module, "COVARIANCE_LIMIT", 24)
    assert set(solve(problem).covariance) == set(COMPONENTS)
    monkeypatch.setattr(module, "COVARIANCE_LIMIT", 23)
    result = solve(problem)
    assert result.covariance == {}
    assert (result.std["ECC"] > 0.0).all()


def test_a_selection_keeps_what_was_asked_and_renumbers():
    problem, _ = simulated(24, [0, 2, 3, 4, 8, 14, 20], std=np.full((168, 3), 1e-7))
    part = select(problem, balls=[0, 2, 8, 14, 20], cmm_positions=range(0, 24, 2), coarser=2)
    assert part.grid == 12
    assert part.balls.tolist() == [0, 1, 4, 7, 10]
    assert part.cmm_positions.tolist() == list(range(12))
    keep = (problem.ball_step % 2 == 0) & (problem.ball_step != 4) & (problem.position % 2 == 0)
    np.testing.assert_array_equal(part.rows, problem.rows[keep])
    np.testing.assert_array_equal(part.centres, problem.centres[keep])
    np.testing.assert_array_equal(part.std, problem.std[keep])
    np.testing.assert_allclose(part.angles, np.radians(30.0 * np.arange(12)))
    few = select(problem, balls=[2, 8], cmm_positions=[3, 5])
    assert {*zip(few.ball_step.tolist(), few.cmm_index.tolist(), strict=True)} == {
        (2, 3), (2, 5), (8, 3), (8, 5),
    }  # fmt: skip
    assert len(select(problem).centres) == 168
    for wrong, text in (
        ({"coarser": 0}, "0 times coarser"),
        ({"cmm_positions": [3, 24]}, r"CMM positions \[24\] were not measured"),
        ({"coarser": 3, "cmm_positions": [1]}, "no centre is left"),
    ):
        with pytest.raises(PlanError, match=text):
            select(problem, **wrong)


def test_three_groups_have_three_zeros():
    problem, truth = simulated(24, [0, 3, 6, 12, 15, 21], separate_groups=True, sigma=5e-8)
    result = solve(problem)
    assert result.warnings[0] == (
        "The offset between the 3 groups of table positions is not measured: each group has its "
        "own zero"
    )
    groups = result.details["groups"]
    assert [group["table_positions"].tolist() for group in groups] == [
        list(range(first, 24, 3)) for first in range(3)
    ]
    for first in range(3):
        error = (result.deviations["EZC"] - truth.component("EZC"))[first::3]
        error -= error.mean()
        assert np.abs(error).max() < 5.0 * result.std["EZC"].max()
    # of each group: 48 centres; 6 balls, 8 CMM positions, 8 table positions of six, the pose
    assert result.dof == 3 * (3 * 48 - (18 + 24 + 48 + 6) + 19)
    assert result.details["residual_rows"]["vector"].shape == (N, 3)


@pytest.mark.parametrize("name", ["stated", "gaps", "many gaps", "weighted", "weighted, gaps"])
def test_the_linear_fit_leaves_what_no_parameter_explains(name):
    """Of any deviations, not only small ones: those of the dense solution of the same rows."""
    problem = uneven() if "weighted" in name else cases()["stated"]
    every = {"gaps": 29, "many gaps": 5, "weighted, gaps": 17}.get(name)
    if every:
        problem = problem.take(np.arange(N) % every != 3)
    observed = np.random.default_rng(6).normal(size=problem.centres.shape) * 1e-5
    nominal = problem.centres - problem.deviations
    expected = solve_dense(replace(problem, centres=nominal + observed)).residuals
    _, found = factored(problem).fit(observed)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
