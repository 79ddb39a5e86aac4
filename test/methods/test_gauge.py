"""What six deviations show to a method that knows neither axis nor artefact."""

import numpy as np
import pytest

from rotcal_ros.foundation.components import COMPONENTS
from rotcal_ros.foundation.curves.gauge import without_axis_and_artefact

EVEN = 2 * np.pi * np.arange(36) / 36 + 0.3
UNEVEN = np.radians([0.0, 11.0, 40.0, 62.0, 90.0, 131.0, 140.0, 200.0, 260.0, 290.0])


@pytest.mark.parametrize("angles", [EVEN, UNEVEN], ids=["even", "uneven"])
def test_the_gauge_takes_off_what_a_moved_artefact_would_cause(angles):
    rng = np.random.default_rng(0)
    curves = {name: rng.normal(size=len(angles)) for name in COMPONENTS}
    seen = without_axis_and_artefact(angles, curves)
    moved = {name: values + 5.0 for name, values in curves.items()}  # constants are not seen
    moved["EXC"] = moved["EXC"] + 2.0 * np.cos(angles + 1.0)  # a shifted artefact
    moved["EYC"] = moved["EYC"] + 2.0 * np.sin(angles + 1.0)
    moved["EAC"] = moved["EAC"] + 3.0 * np.cos(angles - 1.0)  # a tilted one
    moved["EBC"] = moved["EBC"] + 3.0 * np.sin(angles - 1.0)
    again = without_axis_and_artefact(angles, moved)
    for name in COMPONENTS:
        np.testing.assert_allclose(again[name], seen[name], atol=1e-12)
    other = {**curves, "EXC": curves["EXC"] + np.cos(angles), "EYC": curves["EYC"]}
    change = without_axis_and_artefact(angles, other)["EXC"] - seen["EXC"]
    assert np.abs(change).max() > 0.4  # the other half is


@pytest.mark.parametrize("angles", [EVEN, UNEVEN], ids=["even", "uneven"])
def test_what_is_left_is_free_of_it(angles):
    rng = np.random.default_rng(1)
    seen = without_axis_and_artefact(
        angles, {name: rng.normal(size=len(angles)) for name in COMPONENTS}
    )
    for name in COMPONENTS:
        assert abs(seen[name].mean()) < 1e-14
    for x, y in (("EXC", "EYC"), ("EAC", "EBC")):
        turning = np.mean((seen[x] + 1j * seen[y]) * np.exp(-1j * angles))
        assert abs(turning) < 1e-14
