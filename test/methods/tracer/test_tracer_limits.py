"""Where the limits of the tracer's checks lie: just inside is taken, just outside refused."""

import re
from dataclasses import replace

import numpy as np
import pytest
from tracer_scene import arc, low_ring, simulate

from rotcal_ros.foundation.errors import DataError, GeometryError, RotcalError
from rotcal_ros.geometry.rotations import rotation_from_vector
from rotcal_ros.methods.tracer.solver import solve
from rotcal_ros.methods.tracer.solver.circle import table_motion
from rotcal_ros.methods.tracer.solver.observability import prior_datum_advice
from rotcal_ros.methods.tracer.solver.problem import arrange_grid

M, N = 9, 24


def scene(**more):
    return simulate(3, angles=arc(M), n=N, layout=low_ring, **more)


@pytest.mark.parametrize("reach", [99.9, 100.1])
def test_targets_further_apart_than_a_tracer_reaches_are_in_another_unit(reach):
    wide = scene(length_std=0.0)
    targets = wide.targets * reach / np.linalg.norm(np.ptp(wide.targets, axis=0))
    distance = np.linalg.norm(wide.stations[:, None] - targets, axis=2)
    problem = wide.problem(targets=targets, length=distance.ravel())
    if reach < 100.0:
        assert arrange_grid(problem)[0].used.all()
        return
    with pytest.raises(
        DataError, match=r"lie up to 100.1 m apart, no tracer reaches beyond 100 m"
    ):
        arrange_grid(problem)


@pytest.mark.parametrize("target_std", [0.0, 1e-3])
@pytest.mark.parametrize("margin", [-1e-6, 1e-6])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_length_may_differ_by_the_diagonal_of_the_targets(margin, target_std, sign):
    """From the station's median; ten standard deviations of length and coordinate come to it."""
    good = scene(length_std=0.0)
    span = np.linalg.norm(np.ptp(good.targets, axis=0)) + 10 * 1e-4 + 10 * target_std
    length = good.length.copy()
    length[4, 7] = 1e3 * sign
    middle = np.median(length[4])
    length[4, 7] = middle + sign * (span + margin)
    problem = good.problem(length=length.ravel(), length_std=1e-4, target_std=target_std)
    grid, absent = arrange_grid(problem)
    unfit = absent.unfit
    assert absent.repeated == {}
    assert grid.used[4, 7] == (margin < 0)
    if margin > 0:
        assert unfit == {
            4 * N + 7: (
                f"station 4, target 7: differs by {span:.4g} m from the station's median, but the "
                f"targets lie at most {span:.4g} m apart"
            )
        }


@pytest.mark.parametrize("count", [54, 55])
def test_more_than_a_quarter_of_impossible_lengths_is_another_unit(count):
    good = scene(length_std=0.0)
    length = good.length.ravel().copy()
    rows = np.random.default_rng(5).permutation(M * N)[:count]
    # to and fro, so that the medians stay among the others
    length[rows] += 50.0 * np.where(np.arange(count) % 2, 1.0, -1.0)
    problem = good.problem(length=length)
    if count <= 0.25 * M * N:
        assert len(arrange_grid(problem)[1].unfit) >= count
        return
    with pytest.raises(DataError, match="are the lengths in millimetres"):
        arrange_grid(problem)


@pytest.mark.parametrize("factor", [0.98, 1.02])
def test_lengths_that_hardly_differ_belong_to_another_unit(factor):
    """A thousandth of the targets' spread is where nine tenths of the differences must lie."""
    good = scene(length_std=0.0)
    middle = np.median(good.length, axis=1, keepdims=True)
    usual = np.quantile(np.abs(good.length - middle), 0.9)
    span = np.linalg.norm(np.ptp(good.targets, axis=0)) + 10 * 1e-9
    length = middle + (good.length - middle) * factor * 1e-3 * span / usual
    problem = good.problem(length=length.ravel(), length_std=1e-9)
    if factor > 1.0:
        arrange_grid(problem)
        return
    with pytest.raises(DataError, match=r"spread over .* m only, but the targets lie .* m apart"):
        arrange_grid(problem)


@pytest.mark.parametrize("lean_deg", [44.9, 45.1])
def test_the_axis_leans_by_less_than_half_a_right_angle(lean_deg):
    angle = np.radians(np.arange(0.0, 330.0, 30.0))
    flat = 0.07 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    stations = flat @ rotation_from_vector(np.radians([lean_deg, 0.0, 0.0])).T
    if lean_deg < 45.0:
        motion = table_motion(stations, angle)
        assert np.degrees(motion.tilt) == pytest.approx(lean_deg)
        np.testing.assert_allclose(motion.cumulative, 0.0, atol=1e-12)
        np.testing.assert_allclose(motion.radial, 0.0, atol=1e-15)
        assert motion.radius == pytest.approx(0.07)
        return
    with pytest.raises(GeometryError, match=r"turn about an axis 45\.1 deg away from"):
        table_motion(stations, angle)


@pytest.mark.parametrize("off", [0.0999, 0.1001])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_station_stands_within_a_tenth_of_a_radian_of_its_command(off, sign):
    good = scene(length_std=0.0)
    angles = good.angles.copy()
    angles[5] += sign * off + good.deviation[5]
    problem = good.problem(table_angles=angles)
    if off < 0.1:
        assert solve(problem).deviations["ECC"][5] == pytest.approx(-sign * off, abs=1e-9)
        return
    told, far = np.degrees(angles[5]), np.degrees(-sign * off)
    text = re.escape(
        f"station 5 stands at {told + far:.4f} degrees where {told:.4f} were commanded, {far:+.4f}"
    )
    with pytest.raises(DataError, match=text):
        solve(problem)


def test_lengths_with_the_sign_turned_round_are_told_so_and_not_to_spread_the_targets():
    good = scene()
    problem = good.problem()
    with pytest.raises(DataError, match="opposite sign they fit: turn their sign round"):
        solve(replace(problem, length=-problem.length))


def test_readings_below_zero_that_grow_with_the_distance_are_as_good_as_any():
    good = scene()
    problem = good.problem()
    below = solve(replace(problem, length=problem.length - 5.0))
    assert below.verdict == "ok"
    assert below.deviations["ECC"] == pytest.approx(solve(problem).deviations["ECC"], abs=1e-9)


@pytest.mark.parametrize("wrong", ["clockwise", "two axes exchanged", "an axis turned round"])
def test_a_left_handed_frame_is_named_beside_a_clockwise_table(wrong):
    problem = scene().problem()
    targets = problem.targets
    changed = {
        "clockwise": {"table_angles": -problem.table_angles},
        "two axes exchanged": {"targets": targets[:, [1, 0, 2]]},
        "an axis turned round": {"targets": targets * np.array([1.0, -1.0, 1.0])},
    }[wrong]
    with pytest.raises(DataError) as refused:
        solve(replace(problem, **changed))
    text = str(refused.value)
    assert "opposite sign" in text
    assert "Clockwise: negate the table angles." in text
    assert "left-handed" in text


def test_a_table_that_never_turned_is_not_told_to_spread_the_targets():
    """Every station stands where the first one does."""
    good = scene(length_std=0.0)
    first = good.problem()
    still = first.length[first.position == 0]
    length = np.concatenate([still] * (first.position.max() + 1))
    order = np.argsort(first.position, kind="stable")
    problem = replace(
        first, position=first.position[order], target=first.target[order], length=length
    )
    with pytest.raises(RotcalError) as refused:
        solve(problem)
    assert "does the table turn" in str(refused.value)
    assert "spread the targets" not in str(refused.value)


def test_advice_that_is_followed_already_is_not_given():
    assert prior_datum_advice(free=False) == ""
    assert "datum 'prior'" in prior_datum_advice(free=True)
    problem = scene(length_std=0.0).problem()
    exchanged = problem.targets[::-1].copy()
    for datum in ("prior", "free"):
        with pytest.raises(RotcalError) as refused:
            solve(replace(problem, targets=exchanged, variant="joint", datum=datum))
        if datum == "prior":
            assert "datum 'prior'" not in str(refused.value)
