import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares

from rotcal_ros.foundation.errors import GeometryError
from rotcal_ros.geometry.plane import circle_centre_jacobian, fit_circle


def arc(centre, radius, start, stop, n):
    angle = np.linspace(start, stop, n)
    return np.asarray(centre) + radius * np.column_stack([np.cos(angle), np.sin(angle)])


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(0.01, 3), st.floats(0.8, 6.3))
def test_exact_points_give_their_circle(x, y, radius, sweep):
    circle = fit_circle(arc([x, y], radius, 0.3, 0.3 + sweep, 9))
    assert circle.centre == pytest.approx([x, y], abs=1e-10)
    assert circle.radius == pytest.approx(radius, abs=1e-10)


def noisy():
    rng = np.random.default_rng(7)
    return arc([2.0, -1.0], 0.5, 0.0, 4.0, 12) + rng.normal(scale=0.01, size=(12, 2))


def test_minimises_the_sum_of_squared_power_differences():
    points = noisy()

    def power(p):
        return ((points - p[:2]) ** 2).sum(axis=1) - p[2] ** 2

    best = least_squares(power, [2, -1, 0.5], xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    circle = fit_circle(points)
    assert [*circle.centre, circle.radius] == pytest.approx(best, abs=1e-8)


def test_jacobian_against_central_differences():
    points, step = noisy(), 1e-6
    numeric = np.empty((2, 12, 2))
    for k in range(12):
        for axis in range(2):
            shift = np.zeros_like(points)
            shift[k, axis] = step
            forward, backward = fit_circle(points + shift), fit_circle(points - shift)
            numeric[:, k, axis] = (forward.centre - backward.centre) / (2 * step)
    assert circle_centre_jacobian(points) == pytest.approx(numeric, abs=1e-9)


@pytest.mark.parametrize("points", [np.zeros((2, 2)), np.outer(np.arange(5.0), [1, 2])])
def test_refuses_points_without_a_circle(points):
    with pytest.raises(GeometryError):
        fit_circle(points)
