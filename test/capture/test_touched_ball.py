"""Balls that are touched: the capture fits the sphere itself, and says what speaks against it."""

from dataclasses import replace

import numpy as np
import pytest
from capture_scenes import MS, SETTINGS, make_plan, make_scene, probe_sample, replay

from rotcal_ros.foundation.observations import PointKind

RADIUS, TIP = 0.0125, 0.002
AWAY = (0.3e-3, -0.2e-3, 0.1e-3)
UP = np.array(
    [
        *[[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0.6, 0, 0.8], [-0.6, 0, 0.8]],
        *[[0, 0.6, 0.8], [0, -0.6, 0.8]],
        *[[0.48, 0.36, 0.8], [-0.48, 0.36, 0.8], [0.48, -0.36, 0.8]],
    ]
)
"""Unit vectors: where the ball is touched."""


def observed(radius=RADIUS, away=AWAY, tips=(TIP,), dirt=(), noise=0.0, **settings):
    """Touch a ball of the plan with that true radius, ``away`` metres from its planned place."""
    plan = make_plan(PointKind.SURFACE, n_points=len(UP))
    step = replace(plan.steps[0], ball_diameter=2 * RADIUS)
    plan = replace(plan, steps=(step, *plan.steps[1:]))
    scene = make_scene(plan, 1)
    centre = np.array(step.position) + away
    out = np.full(len(UP), radius + TIP) + noise * np.random.default_rng(4).standard_normal(
        len(UP)
    )
    for number, height in dirt:
        out[number] += height
    scene.probe = [
        replace(
            probe_sample(step, (150 + 5 * point) * MS, point=point),
            position=tuple(centre + out[point] * direction),
            tip_radius=tips[point % len(tips)],
        )
        for point, direction in enumerate(UP)
    ]
    (observation,) = replay(plan, scene.by_stamp(), replace(SETTINGS, **settings))
    return observation, centre


def test_the_centre_is_found_where_the_ball_is():
    observation, centre = observed()
    assert observation.accepted, observation.reason
    assert observation.mean == pytest.approx(centre, abs=1e-12)
    assert (observation.n_samples, observation.n_used) == (12, 12)


def test_centre_and_deviations_are_those_of_least_squares():
    """Linear theory: covariance of the centre is (U'U)^-1 times the variance of a touch."""
    observation, centre = observed(noise=1e-6)
    noise = 1e-6 * np.random.default_rng(4).standard_normal(len(UP))
    shift, *_ = np.linalg.lstsq(UP, noise, rcond=None)
    left = noise - UP @ shift
    scatter = np.sqrt(left @ left / (len(UP) - 3))
    std = scatter * np.sqrt(np.diag(np.linalg.inv(UP.T @ UP)))
    assert observation.accepted, observation.reason
    assert np.subtract(observation.mean, centre) == pytest.approx(shift, abs=1e-9)
    assert observation.scatter == pytest.approx((scatter,) * 3, rel=1e-3)
    assert observation.std == pytest.approx(std, rel=1e-3)


@pytest.mark.parametrize(("wrong", "accepted"), [(0.5, True), (1.1, False), (-1.1, False)])
def test_a_radius_may_be_wrong_by_the_largest_form(wrong, accepted):
    observation, _ = observed(radius=RADIUS + wrong * 20e-6, max_form_m=20e-6)
    assert observation.accepted is accepted
    if not accepted:
        diameter = 2e3 * (RADIUS + wrong * 20e-6)
        assert f"ball of diameter {diameter:.4f} mm with the tip radius 2.0000 mm, the plate " in (
            observation.reason
        )
        assert "says 25.0000 mm: check ball diameter" in observation.reason


def test_dirt_is_left_out_until_too_little_is_left():
    one, centre = observed(dirt=[(3, 50e-6)], noise=1e-7)
    assert one.accepted, one.reason
    assert one.n_used == 11
    assert one.mean == pytest.approx(centre, abs=3e-7)
    assert observed(dirt=[(3, 50e-6)], noise=1e-7, min_used_share=11 / 12)[0].accepted
    strict, _ = observed(dirt=[(3, 50e-6)], noise=1e-7, min_used_share=0.92)
    assert not strict.accepted
    assert strict.n_used == 11
    assert strict.reason == (
        "only 11 of 12 touch points fit the ball, expected at least 92%: clean ball and tip"
    )


@pytest.mark.parametrize(("share", "accepted"), [(1.02, True), (0.98, False)])
def test_the_form_is_the_largest_less_the_smallest_distance(share, accepted):
    noise = 5e-6 * np.random.default_rng(4).standard_normal(len(UP))
    shift, *_ = np.linalg.lstsq(UP, noise, rcond=None)
    form = np.ptp(noise - UP @ shift)
    observation, _ = observed(noise=5e-6, max_form_m=share * form)
    assert observation.accepted is accepted
    assert accepted or f"form deviation {form / 1e-6:.3g} um of the touch" in observation.reason


@pytest.mark.parametrize(("limit", "accepted"), [(0.38e-3, True), (0.37e-3, False)])
def test_a_ball_is_expected_where_the_plan_has_it(limit, accepted):
    """The ball is 0.3742 mm away."""
    observation, _ = observed(ball_tolerance_m=limit)
    assert observation.accepted is accepted
    if not accepted:
        assert observation.reason.startswith(
            "the ball of step 0 is 0.3742 mm from its planned place (0.0, 0.0, 1.0) m"
        )
        assert "allowed 0.37 mm" in observation.reason


@pytest.mark.parametrize("tips", [(TIP, 2 * TIP), (-TIP,), (float("nan"),)])
def test_all_points_name_one_tip(tips):
    observation, _ = observed(tips=tips)
    assert not observation.accepted
    assert observation.reason.startswith("the touch points name the tip radii [")


def test_ten_micrometres_of_form_are_allowed_unless_said_otherwise():
    """The noise has a form of 2.5 to 3.5 standard deviations."""
    assert observed(noise=2e-6)[0].accepted
    observation, _ = observed(noise=6e-6)
    assert not observation.accepted
    assert "of the touch points, allowed 10 um: dirt" in observation.reason


def test_a_tip_may_be_a_point():
    observation, _ = observed(radius=RADIUS - TIP, tips=(0.0,))
    assert observation.accepted, observation.reason
