"""The joint solve against scipy, a dense covariance, and simulated truth."""

import numpy as np
import pytest
from coded import coded
from scipy_tracer_six import SparseSix
from six_scene import LENGTH_STD, TARGET_STD, good_targets, on_circle, scene

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.methods.tracer_six.solver import SixProblem, adjust, solve
from rotcal_ros.methods.tracer_six.solver.problem import FEW_PLACES
from rotcal_ros.methods.tracer_six.solver.solve import NO_DEVIATIONS

KNOWN = {"scatter_translation_std": 0.0, "scatter_rotation_std": 0.0}


def referee(problem, zero, target_std=TARGET_STD):
    return SparseSix(
        problem.position, problem.place, problem.target, zero, problem.length, LENGTH_STD,
        problem.targets, target_std, problem.table_angles, len(problem.places),
    )  # fmt: skip


def begin(problem, scipy, zero):
    """Nominal places, a table without deviations, zeros to match."""
    m = len(problem.table_angles)
    x = np.zeros(scipy.sizes[-1])
    x[scipy.sizes[1] : scipy.sizes[2]] = problem.places.ravel()
    x[scipy.sizes[3] :] = problem.targets.ravel()
    first = scipy.misfit(x)[: len(problem.length)] * LENGTH_STD
    x[scipy.sizes[2] : scipy.sizes[3]] = np.bincount(zero, first) / np.bincount(zero)
    assert len(x) == 6 * m + 3 * len(problem.places) + len(np.unique(zero)) + problem.targets.size
    return x


def curves(result):
    return np.array([result.deviations[name] for name in COMPONENTS])


@pytest.mark.parametrize("zero", ["per_run", "per_station", "per_segment"])
def test_same_minimum_as_scipy(zero):
    truth = scene(
        np.random.default_rng(1), m=7, zero="per_station" if zero == "per_station" else "per_run"
    )
    rows = {**truth.rows, "zero": zero}
    number = rows["place"]
    if zero == "per_station":
        number = rows["place"] * 7 + rows["position"]
    if zero == "per_segment":  # two beams broke, one of them in the middle of a station
        number = 2 * rows["place"] + (rows["position"] * 24 + rows["target"] >= 60)
        rows["segment"] = number + 5
    problem = SixProblem(**rows, **KNOWN)
    scipy = referee(problem, number)
    found = scipy.solve(
        begin(problem, scipy, number), tr_options={"atol": 1e-14, "btol": 1e-14, "maxiter": 4000}
    )
    c, d, q, _, targets = scipy.split(found.x)
    solution = adjust(problem)
    assert solution.found.fit.chi2 == pytest.approx(2.0 * found.cost, rel=1e-7)
    stations = scipy._arms(scipy._turned(c), q) + d[problem.position]
    ours = solution.lengths.stands(solution.found.fit.x)[0]
    assert np.abs(ours - stations[solution.lengths.row]).max() < 3e-10
    assert np.abs(solution.targets - targets).max() < 3e-10


def dense_covariance(problem, zero, target_std):
    """Derivatives of the curves' errors by a Jacobian of differences, and a pseudo-inverse."""
    scipy = referee(problem, zero, target_std)
    x = begin(problem, scipy, zero)
    step = 1e-6
    jacobian = np.empty((len(scipy.misfit(x)), len(x)))
    for column in range(len(x)):
        move = np.zeros(len(x))
        move[column] = step
        jacobian[:, column] = (scipy.misfit(x + move) - scipy.misfit(x - move)) / (2.0 * step)
    m = len(problem.table_angles)
    about = np.zeros((m, 3, 3))
    cos, sin = np.cos(problem.table_angles), np.sin(problem.table_angles)
    about[:, 0, 0] = about[:, 1, 1] = cos
    about[:, 1, 0], about[:, 0, 1], about[:, 2, 2] = sin, -sin, 1.0
    unmoved = np.tile(np.eye(3), (m, 1))
    motions = np.hstack([unmoved, about.reshape(-1, 3)])[:, :5]  # z stands and turns alike
    free = np.eye(3 * m) - motions @ np.linalg.pinv(motions)
    size = np.sqrt((jacobian**2).sum(axis=0))
    inverse = np.linalg.pinv(jacobian / size, rcond=1e-9) / size[:, None]
    gain = np.concatenate([free @ inverse[3 * m : 6 * m], free @ inverse[: 3 * m]])
    return (gain @ gain.T).diagonal().reshape(2, m, 3).transpose(0, 2, 1).reshape(6, m)


@pytest.mark.parametrize("zero", ["per_run", "per_station"])
@pytest.mark.parametrize(
    ("datum", "heights"), [("prior", 0.0), ("free", 0.0), ("free", [0, 0.04, 0.1])]
)
def test_covariance_is_that_of_the_dense_jacobian(zero, datum, heights):
    places = on_circle(heights=heights)
    truth = scene(
        np.random.default_rng(2), good_targets()[:14], places, m=5, noise=0.0, mounted=0.0,
        curves=(0.0, 0.0), zero=zero,
    )  # fmt: skip
    problem = SixProblem(**truth.rows, **KNOWN, datum=datum, slip=0.0)
    number = problem.place if zero == "per_run" else problem.place * 5 + problem.position
    expected = dense_covariance(problem, number, TARGET_STD if datum == "prior" else None)
    result = solve(problem)
    std = np.array([result.std[name] for name in COMPONENTS])
    assert std == pytest.approx(np.sqrt(expected), rel=2e-5)


def test_tilts_of_a_milliradian_and_a_leaning_axis_are_exact():
    truth = scene(
        np.random.default_rng(3), noise=0.0, curves=(0.0, 0.0), lean=(1e-3, -2e-3), mounted=2e-3
    )
    clean = curves(solve(SixProblem(**truth.rows, **KNOWN)))
    assert np.abs(clean[:3]).max() < 1e-12
    assert np.abs(clean[3:]).max() < 1e-11
    # one known turn of a milliradian at a single position, seen from its neighbours
    angles = np.arange(12) * np.pi / 6
    large = scene(np.random.default_rng(3), noise=0.0, curves=(0.0, 1e-3), angles=angles)
    solution = adjust(SixProblem(**large.rows, **KNOWN))
    assert solution.found.fit.chi2 < 1e-9
    # back from the curves to the stations: the frames and the curves together are the poses
    found, lengths = solution.curves, solution.lengths
    from scipy.spatial.transform import Rotation

    turned = Rotation.from_rotvec(found.rotation) * Rotation.from_euler("z", angles[:, None])
    arm = turned.as_matrix()[lengths.position] @ solution.places[lengths.place][:, :, None]
    again = found.origin + (found.translation[lengths.position] + arm[:, :, 0]) @ found.axes.T
    assert np.abs(again - lengths.stands(solution.found.fit.x)[0]).max() < 1e-14


def test_the_order_of_the_rows_does_not_change_a_bit():
    rows = scene(np.random.default_rng(4), good_targets()[:12], m=5).rows
    shuffled = np.random.default_rng(5).permutation(len(rows["length"]))
    columns = ("position", "place", "target", "length", "arrival")
    mixed = {**rows, **{name: rows[name][shuffled] for name in columns}}
    first, second = solve(SixProblem(**rows)), solve(SixProblem(**mixed))
    assert np.array_equal(curves(first), curves(second))
    assert np.array_equal(first.residuals.residual[shuffled], second.residuals.residual)


def test_gaps_closure_and_missing_positions():
    rng = np.random.default_rng(6)
    angles = np.append(np.arange(8) * np.pi / 4, 2.0 * np.pi)
    truth = scene(rng, angles=angles, curves=(2e-6, 1e-5))
    rows = dict(truth.rows)
    keep = rng.uniform(size=len(rows["length"])) > 0.2
    keep &= ~((rows["place"] == 2) & (rows["position"] == 3))
    for name in ("position", "place", "target", "length", "arrival"):
        rows[name] = rows[name][keep]
    result = solve(SixProblem(**rows, **KNOWN))
    assert result.verdict == "suspect"
    assert coded(*result.warnings)[NO_DEVIATIONS] == [("3",)]
    assert len(result.angles) == 8
    assert 3 in [at for at, _ in coded(*(r.why for r in result.rejected))[FEW_PLACES]]
    # angle 0 and 2 pi were given deviations of their own: the closure finds 10 urad
    closed = {one["what"].split()[0]: one["error"][0] for one in result.details["closed"]}
    assert closed["ECC"] == pytest.approx(truth.c[8, 2] - truth.c[0, 2], abs=3e-6)


def test_outliers_go_and_are_named():
    rows = scene(np.random.default_rng(7)).rows
    rows["length"][100] += 4e-6
    rows["length"][500] -= 2e-4
    result = solve(SixProblem(**rows))
    assert [r.index for r in result.rejected] == [100, 500]
    assert "place 0, position 4, target 4" in result.rejected[0].why
    assert not result.residuals.used[[100, 500]].any()
    assert result.residuals.residual[500] == pytest.approx(-2e-4, abs=2e-6)


def test_larger_noise_is_found_and_used():
    rows = scene(np.random.default_rng(8)).rows
    result = solve(SixProblem(**{**rows, "length_std": LENGTH_STD / 2.0}))
    assert result.verdict == "suspect"
    assert "the scatter of the lengths is 2" in result.warnings[0]
    stated = solve(SixProblem(**rows))
    for name in COMPONENTS:
        assert result.std[name] == pytest.approx(stated.std[name], rel=0.2)


def test_reaches_the_stated_uncertainty():
    rows = scene(np.random.default_rng(9), noise=0.0, mounted=0.0, curves=(0.0, 0.0)).rows
    result = solve(SixProblem(**rows, **KNOWN, slip=0.0))
    expanded = {name: 2e6 * result.std[name].max() for name in COMPONENTS}
    assert len(rows["length"]) == 864
    assert max(expanded["EXC"], expanded["EYC"]) < 0.12
    assert expanded["EZC"] < 0.08
    assert max(expanded["EAC"], expanded["EBC"]) < 0.66
    assert expanded["ECC"] < 0.56
