"""A machine that comes to a target anew for every length: each is reduced to the same place."""

from dataclasses import replace

import numpy as np
from tracer_scene import arc, low_ring, simulate

from rotcal_ros.methods.tracer.joins import at_equal_places
from rotcal_ros.methods.tracer.solve import solve
from rotcal_ros.units import ARCSEC


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
    right = at_equal_places(measured, shift)
    np.testing.assert_allclose(right.length, exact.length, atol=2e-9)
    error = solve(right).deviations["ECC"] - solve(exact).deviations["ECC"]
    assert np.abs(error).max() < 1e-3 * ARCSEC


def test_what_no_length_notices_changes_nothing():
    problem = simulate(3, angles=arc(9), n=16, layout=low_ring).problem()
    shift = np.full((len(problem.length), 3), 1e-9)
    assert at_equal_places(problem, shift) is problem
