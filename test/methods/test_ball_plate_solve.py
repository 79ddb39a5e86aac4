"""From a problem to a result: coverage, rejection, bad input, groups."""

from dataclasses import replace

import numpy as np
import pytest
from chances import LONG, most, share
from coded import coded
from plate_data import PAPER_PLATE, RADIUS, grid_rows, in_cmm_order, rotate_z, simulated

from rotcal_ros.adjust.engine import SCATTERS
from rotcal_ros.adjust.kernels import ConstrainedKernel
from rotcal_ros.adjust.outputs import Outputs
from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.errors import DataError, ObservabilityError
from rotcal_ros.methods.ball_plate.solver import BallPlateProblem, select, solve
from rotcal_ros.methods.ball_plate.solver.layout import PlateLayout
from rotcal_ros.methods.ball_plate.solver.screening import TWICE


def at(place_of, grid=72, balls=PAPER_PLATE, noise=1e-7):
    """Centres of balls that stand at ``place_of(step)`` while their rows say ``step``."""
    table, ball = grid_rows(grid, balls)
    place = np.array([place_of(int(b)) for b in ball])
    angle = 2 * np.pi * (table + place) / grid
    centres = RADIUS * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    centres += noise * np.random.default_rng(8).normal(size=centres.shape)
    return BallPlateProblem(grid, RADIUS, table, ball, centres)


def index_of(problem, table, ball):
    return int(np.flatnonzero((problem.position == table) & (problem.ball_step == ball))[0])


@pytest.mark.slow
def test_stated_intervals_contain_the_truth_in_95_percent_of_1000_runs():
    """Of the linear map, all runs at once."""
    problem, _ = simulated(12, [0, 1, 3, 7, 8, 10])
    layout = PlateLayout(problem)
    kernel, outputs = layout.circular.kernel(), Outputs.alone(layout.curves())
    defined = ConstrainedKernel.of(kernel, layout.definitions)
    noise = 5e-8 * np.random.default_rng(1).standard_normal((problem.centres.size, 1000))
    error, left = outputs.times(defined.solve(noise)), noise - kernel.projected(noise)
    variance = (left**2).sum(axis=0) / (len(noise) - kernel.rank)
    std = np.sqrt(variance) * np.sqrt(defined.variances_of(outputs))[:, None]
    inside = (np.abs(error) < 1.96 * std).reshape(6, -1).mean(axis=1)
    assert ((inside > 0.93) & (inside < 0.97)).all(), inside
    assert np.mean(variance) / 5e-8**2 == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
def test_whole_solver_keeps_its_intervals_with_the_paper_plate():
    inside, rejected = [], 0
    for run in range(40 if LONG else 4):
        problem, truth = simulated(72, PAPER_PLATE, seed=run, sigma=5e-8)
        result = solve(problem)
        rejected += len(result.rejected)
        inside += [
            np.abs(result.deviations[n] - truth.component(n)) < 1.96 * result.std[n]
            for n in COMPONENTS
        ]
    low, high = (0.93, 0.97) if LONG else share(0.95, 4 * 72 // 3)
    assert low < np.mean(inside) < high
    assert rejected <= 3  # one run in a hundred may lose a centre


@pytest.mark.slow
def test_six_of_twelve_balls_stay_within_the_stated_uncertainty():
    problem, _ = simulated(72, PAPER_PLATE, seed=12, sigma=5e-8)
    twelve = solve(problem)
    six = solve(select(problem, balls=[0, 12, 28, 37, 50, 58]))
    for name in COMPONENTS:
        difference = six.deviations[name] - twelve.deviations[name]
        stated = 2.0 * np.sqrt(twelve.std[name] ** 2 + six.std[name] ** 2)
        assert np.mean(np.abs(difference) < stated) > 0.97, name  # E_n < 1
        assert np.sqrt(np.mean(difference**2)) < 2.0 * twelve.std[name].mean()
        # nested data: the variance of the difference is the difference of the variances
        expected = np.mean(six.std[name] ** 2 - twelve.std[name] ** 2)
        assert np.mean(difference**2) == pytest.approx(expected, rel=0.35)


def test_same_data_in_ten_degree_steps_agree_with_five_degree_steps():
    problem, _ = simulated(72, PAPER_PLATE, seed=3, sigma=5e-8)
    fine, coarse = solve(problem), solve(select(problem, coarser=2))
    assert coarse.details["groups"][0]["ball_steps"].tolist() == [
        0, 4, 6, 9, 14, 16, 21, 25, 29, 31,
    ]  # fmt: skip
    for name in ("EZC", "ECC"):  # mean removed on different grids
        difference = coarse.deviations[name] - fine.deviations[name][::2]
        difference -= difference.mean()
        limit = 2.5 * np.sqrt(coarse.std[name] ** 2 + fine.std[name][::2] ** 2)
        assert np.mean(np.abs(difference) < limit) > 0.95


def test_stated_noise_is_tested_and_the_larger_one_used():
    problem, _ = simulated(24, [0, 3, 4, 9, 14, 20], noise=2e-7, sigma=1e-7)
    result = solve(problem)
    assert result.verdict == "suspect"
    assert result.sigma0 == pytest.approx(2.0, rel=0.1)
    assert SCATTERS in coded(*result.warnings)
    good = solve(replace(problem, sigma=2e-7))
    assert good.verdict == "ok"
    assert 0.8 < good.std["ECC"][0] / result.std["ECC"][0] < 1.2


@pytest.mark.slow
def test_dirt_is_rejected_and_the_result_stays_right():
    problem, truth = simulated(72, PAPER_PLATE, seed=1)
    centres = problem.centres.copy()
    dirty = [index_of(problem, 5, 8), index_of(problem, 40, 62), index_of(problem, 41, 62)]
    centres[dirty] += [[5e-6, 0, 3e-6], [0, -4e-6, 0], [0, 0, 2e-6]]
    result = solve(replace(problem, centres=centres))
    assert {r.index for r in result.rejected} == {int(problem.rows[r]) for r in dirty}
    assert "ball step 8, table position 5" in " ".join(r.why for r in result.rejected)
    assert result.verdict == "ok"
    assert result.residuals is not None
    rows = sorted(int(problem.rows[r]) for r in dirty)
    assert not result.residuals.used[rows].any()
    assert (result.residuals.residual[rows] > 1.5e-6).all()
    error = result.deviations["ECC"] - truth.component("ECC")
    assert np.abs(error / result.std["ECC"]).max() < 4.5


@pytest.mark.slow
@pytest.mark.parametrize("size", [1e-3])
def test_a_gross_error_costs_no_other_centre(size):
    problem, _ = simulated(72, PAPER_PLATE, seed=6)
    centres = problem.centres.copy()
    centres[200] += size
    result = solve(replace(problem, centres=centres))
    assert [r.index for r in result.rejected] == [200]


def test_nan_is_set_aside_with_its_row():
    problem, _ = simulated(72, PAPER_PLATE)
    centres = problem.centres.copy()
    centres[index_of(problem, 3, 12), 1] = np.nan
    result = solve(replace(problem, centres=centres))
    (rejection,) = result.rejected
    assert "ball step 12, table position 3" in rejection.why
    assert "not finite" in rejection.why
    with pytest.raises(DataError, match="no centre is finite"):
        solve(replace(problem, centres=centres * np.nan))


@pytest.mark.parametrize(
    ("problem", "reason"),
    [
        (at(lambda b: b + 1), "lie 1 grid steps .* mounted shifted"),
        (at(lambda b: b - 2), "lie -2 grid steps .* mounted shifted"),
        (at(lambda b: -b), "mirrored steps: the plate is mounted upside down"),
        (
            at(dict(zip(PAPER_PLATE, [0, *PAPER_PLATE[:0:-1]], strict=True)).get),
            "reverse order: they are numbered the other way round",
        ),
        (at(lambda b: -b, 12, range(12)), "numbered the other way round or mounted upside down"),
        (at(lambda b: 8 if b == 12 else b), "ball 8 was measured twice and ball 12 not at all"),
        (at(lambda b: 14 if b == 12 else b), "ball step 12 lie at step 14"),
        (at(lambda b: 3 * b), "wrong plate file"),
        (
            at(lambda b: {8: 9, 12: 14, 18: 20}.get(b, b)),
            r"at step: 8 at 9, 12 at 14, 18 at 20\): wrong plate file",
        ),
        # Nearest to their own steps, but all by 0.4 of one, or each by another part of one:
        (
            at(lambda b: b + 0.4),
            r"all centres lie 2\.00 degrees from their place.* mounted turned",
        ),
        (
            at({b: b + (0.4, -0.45)[i % 2] for i, b in enumerate(PAPER_PLATE)}.get),
            r"ball step 0 by 2\.00 degrees, .* by -2\.25 degrees.*wrong plate file",
        ),
    ],
)
def test_wrong_set_up_is_refused_with_the_reason(problem, reason):
    with pytest.raises(DataError, match=reason):
        solve(problem)


def test_doubled_ball_with_another_missing_sets_both_aside():
    problem = at(lambda b: b)
    centres, ball = problem.centres.copy(), problem.ball_step.copy()
    wrong = index_of(problem, 10, 12)
    ball[wrong], centres[wrong] = 8, centres[index_of(problem, 10, 8)]
    result = solve(replace(problem, centres=centres, ball_step=ball))
    assert len(result.rejected) == 2
    assert coded(result.rejected[0].why)[TWICE] == [(2, "12")]


@pytest.mark.parametrize(("jump", "moment"), [(3e-7, 431), (3e-6, 300)])
def test_knocked_plate_is_found_and_the_moment_named(jump, moment):
    problem, _ = simulated(72, PAPER_PLATE, seed=7)
    problem = in_cmm_order(problem)
    shift = np.tile([jump, -jump, 0.0], (len(problem.centres), 1))
    moved = rotate_z(shift, problem.angles[problem.position])
    late = (problem.rows >= moment)[:, None]
    result = solve(replace(problem, centres=problem.centres + late * moved))
    assert result.verdict == "suspect"
    assert any("the plate moved on the table from row" in text for text in result.warnings)


def test_good_data_are_not_called_knocked():
    called, seeds = 0, 60 if LONG else 15
    for seed in range(seeds):
        problem, _ = simulated(24, [0, 3, 4, 9, 14, 20], seed=seed)
        called += any("moved" in text for text in solve(in_cmm_order(problem)).warnings)
    assert called <= most(0.01, seeds)


@pytest.mark.slow
def test_contradictory_data_are_refused_not_trimmed():
    problem = at(lambda b: b, grid=36, balls=[0, 3, 4, 9, 14, 20], noise=1e-8)
    rng = np.random.default_rng(0)
    bad = rng.choice(len(problem.centres), 30, replace=False)
    centres = problem.centres.copy()
    centres[bad] += 10.0 ** rng.uniform(-6, -3.5, size=(30, 1)) * rng.choice([-1, 1], (30, 3))
    assert solve(replace(problem, centres=centres, sigma=1e-8)).verdict != "ok"


def test_unseparable_plate_is_refused_in_words():
    problem, _ = simulated(24, range(0, 24, 2))
    with pytest.raises(ObservabilityError, match=r"share the factor 2.*harmonic 12 of ECC"):
        solve(problem)


def test_two_groups_equal_two_closed_forms_and_warn():
    problem, _ = simulated(24, range(0, 24, 2), seed=5)
    # so small that the products, which the closed form neglects, vanish
    small = problem.centres - (1.0 - 1e-4) * problem.deviations
    problem = replace(problem, centres=small)
    result = solve(replace(problem, separate_groups=True))
    assert (
        "The offset between the odd and even table positions is not measured: "
        "each group has its own zero" in result.warnings
    )
    for first in (0, 1):
        # Eq. 1-12 by hand for one group: 0-based, ball j at table position i at 2 pi (i + j)/N
        rows = problem.position % 2 == first
        grid, angle = 12, 2 * np.pi * np.arange(12) / 12
        offset = 2 * np.pi * first / 24
        nominal = offset + angle[:, None] + angle
        x, y, z = np.moveaxis(problem.centres[rows].reshape(grid, grid, 3), 2, 0)
        turn = np.mean(y * np.cos(nominal) - x * np.sin(nominal), axis=0) / RADIUS
        expected = turn - turn.mean()
        np.testing.assert_allclose(result.deviations["ECC"][first::2], expected, atol=2e-15)
        along = z.mean(axis=0) - z.mean()
        np.testing.assert_allclose(result.deviations["EZC"][first::2], along, atol=1e-16)
        plane = (x + 1j * y).mean(axis=0)
        plane = plane - plane.mean()
        plane -= np.mean(plane * np.exp(-1j * (angle + offset))) * np.exp(1j * (angle + offset))
        np.testing.assert_allclose(result.deviations["EXC"][first::2], plane.real, atol=1e-15)
        np.testing.assert_allclose(result.deviations["EYC"][first::2], plane.imag, atol=1e-15)
    apart = result.covariance["ECC"][0::2, 1::2]
    assert np.abs(apart).max() < 1e-15 * result.std["ECC"].max() ** 2
    np.testing.assert_allclose(np.sqrt(np.diag(result.covariance["EXC"])), result.std["EXC"])


def test_the_order_of_the_rows_does_not_change_a_bit_of_the_result():
    problem, _ = simulated(24, [0, 3, 4, 9, 14, 20], seed=2)
    keep = np.arange(len(problem.centres)) != 17
    problem = problem.take(keep)
    shuffle = np.random.default_rng(1).permutation(len(problem.centres))
    mixed = BallPlateProblem(
        24,
        RADIUS,
        problem.position[shuffle],
        problem.ball_step[shuffle],
        problem.centres[shuffle],
        row=problem.rows[shuffle],
    )
    assert solve(problem).to_json() == solve(mixed).to_json()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"position": [24]}, "table position 24 is outside 0..23"),
        ({"ball_step": [-1]}, "ball step -1 is outside 0..23"),
        ({"centres": [[0.0, 1.0]]}, r"centres \(1, 2\)"),
        ({"radius": -1.0}, "radius of the ball circle is -1.0 m"),
        ({"sigma": 0.0}, "stated noise"),
        ({"grid": 2}, "a grid of 2 table positions"),
    ],
)
def test_problem_refuses_nonsense(change, text):
    good = {
        "grid": 24, "radius": RADIUS, "position": [0], "ball_step": [0],
        "centres": [[RADIUS, 0.0, 0.0]],
    }  # fmt: skip
    with pytest.raises(DataError, match=text):
        BallPlateProblem(**{**good, **change})


def test_groups_of_a_plate_with_odd_steps():
    """The same plate, its steps counted from one place further on: the same deviations."""
    even, _ = simulated(24, [0, 2, 4, 8, 14, 20], separate_groups=True, sigma=5e-8)
    angle = 2 * np.pi / 24
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    odd = replace(even, ball_step=even.ball_step + 1, centres=even.centres @ turn)
    one, other = solve(even), solve(odd)
    assert other.verdict == one.verdict
    for name in ("EZC", "ECC"):
        np.testing.assert_allclose(other.deviations[name], one.deviations[name], atol=1e-14)
