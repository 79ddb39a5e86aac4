"""Roots, against scipy.optimize.brentq."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from rotcal_ros.adjust.roots import root_between
from rotcal_ros.foundation.errors import DataError

FUNCTIONS = {
    "cubic": (lambda x: x**3 - 2.0 * x - 5.0, 2.0, 3.0),
    "bent": (lambda x: math.exp(5.0 * x) - 40.0, -1.0, 1.5),
    "steep": (lambda x: math.erfc(x / 1e-6) - 0.05, 0.0, 2e-5),
    "step": (lambda x: -1.0 if x < 0.7 else 2.0, 0.0, 1.0),
    "zero at the end": (lambda x: x - 1.0, 1.0, 2.0),
    "flat": (lambda x: math.erfc(x) - 1e-5, 0.0, 40.0),
    "next to nothing": (lambda x: math.erfc(x) - 1e-300, 0.0, 40.0),
}


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("tolerance", [1e-15, 1e-12, 1e-6])
def test_roots_are_those_of_scipy(name, tolerance):
    function, a, b = FUNCTIONS[name]
    expected = brentq(function, a, b, xtol=1e-15)
    assert root_between(function, a, b, tolerance) == pytest.approx(expected, abs=2 * tolerance)


def test_few_values_are_asked_for():
    asked = []
    root_between(lambda x: asked.append(x) or math.erfc(x) - 1e-5, 0.0, 40.0, 1e-12)
    assert len(asked) < 30


def test_random_functions_too():
    rng = np.random.default_rng(5)
    for bend, shift in rng.normal(size=(200, 2)):

        def function(x, bend=bend, shift=shift):
            return math.tanh(3.0 * x + shift) + bend * math.sin(x) * 0.2 + 0.1 * x

        a, b = -9.0, 40.0
        if function(a) < 0.0 < function(b):
            assert abs(function(root_between(function, a, b, 1e-12))) < 1e-9


def test_no_change_of_sign_is_refused():
    with pytest.raises(DataError, match="no change of sign"):
        root_between(lambda x: x * x + 1.0, -1.0, 1.0, 1e-9)
