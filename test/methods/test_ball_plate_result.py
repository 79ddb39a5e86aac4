"""Every number of a result against the dense solution as printed, and refits without a row."""

import re
from dataclasses import replace

import numpy as np
import pytest
from coded import coded
from dense_ball_plate import solve_dense
from plate_data import RADIUS, in_cmm_order, rotate_z, simulated

from rotcal_ros.adjust import engine as module
from rotcal_ros.adjust.engine import SCATTERS
from rotcal_ros.adjust.look import BEYOND
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import PlanError
from rotcal_ros.methods.ball_plate.solver import select, solve

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
        "gaps": complete.take(np.arange(N) % 31 != 0),
        "weighted": uneven(),
    }


@pytest.mark.parametrize("name", cases())
def test_a_result_is_the_dense_solution_with_its_noise(name):
    problem = cases()[name]
    result, dense = solve(problem), solve_dense(problem)
    assert result.rejected == ()
    assert result.dof == dense.dof
    assert result.n_observations == len(problem.centres)
    assert result.verdict == ("suspect" if "too small" in name else "ok")
    assert (SCATTERS in coded(*result.warnings)) == ("too small" in name)
    unit = 1.0 if problem.std is not None else problem.sigma
    for component in COMPONENTS:
        expected = dense.component(component)
        size = np.abs(expected).max()
        np.testing.assert_allclose(result.deviations[component], expected, atol=1e-4 * size)
        if name in ("stated", "gaps", "weighted"):
            std = unit * dense.std(component)
            np.testing.assert_allclose(result.std[component], std, rtol=1e-6)
        variance = result.covariance[component].diagonal()
        np.testing.assert_allclose(result.std[component] ** 2, variance, rtol=1e-9)
    (group,) = result.details["groups"]
    for key, field in FIELDS.items():
        expected = dense.estimate[field].reshape(np.shape(group[key]))
        np.testing.assert_allclose(group[key], expected, atol=1e-4 * np.abs(expected).max())
        if name in ("stated", "gaps", "weighted"):
            std = unit * dense.unit_std[field].reshape(np.shape(group[key]))
            np.testing.assert_allclose(group[f"{key}_std"], std, rtol=1e-6)
    assert group["ball_steps"].tolist() == BALLS
    np.testing.assert_array_equal(group["table_positions"], np.arange(24))
    np.testing.assert_array_equal(group["cmm_positions"], np.arange(24))
    assert (result.details["grid"], result.details["radius"]) == (24, RADIUS)


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
    np.testing.assert_allclose(more["vector"], dense.residuals[order], atol=1e-11)
    length = np.linalg.norm(dense.residuals, axis=1)[order]
    np.testing.assert_allclose(rows.residual, length, atol=1e-11)
    assert rows.used.all()
    assert 3.0 * rows.redundancy.sum() == pytest.approx(result.dof, rel=1e-6)


def dirty(count, size=4e-6, **fields):
    problem, _ = simulated(24, BALLS, seed=3, **fields)
    rows = 1 + 31 * np.arange(count)  # of balls, positions and CMM positions of their own
    centres = problem.centres.copy()
    centres[rows, 0] += size
    return replace(problem, centres=centres), rows


@pytest.mark.parametrize("count", [2, 5])
def test_more_than_two_percent_rejected_are_suspicious(count):
    problem, rows = dirty(count, sigma=5e-8)
    result = solve(problem)
    assert [r.index for r in result.rejected] == sorted(rows)
    assert (f"{count} of {N} centres were rejected; more" in " ".join(result.warnings)) == (
        count > 2
    )
    assert result.n_observations == N
    assert not result.residuals.used[rows].any()
    assert (result.residuals.redundancy[rows] == 0.0).all()
    assert result.residuals.residual[rows] == pytest.approx(4e-6, rel=1.0)
    assert BEYOND in coded(result.rejected[0].why)


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
    assert result.verdict != "ok"
    seen = [t for t in result.warnings if t.startswith("it looks as if the plate moved")]
    (text,) = [t for t in seen if "this was corrected" in t]
    assert abs(int(re.search(r"from row (\d+)", text)[1]) - 80) <= 4
    (knock,) = [e for e in result.details["effects_found"] if e["effect"] == "knock"]
    assert knock["size"] is not None


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
    assert len(result.zeros.free) == 2 * 10
    assert "the 3 groups of table positions" in result.verdict_line
    assert np.linalg.matrix_rank(result.zeros.of("EZC", 24)) == 2
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
