"""The settings of the methods mean what their descriptions say."""

import math
from dataclasses import fields

import numpy as np
import pytest
from plate_data import parse_plate

from rotcal_ros.foundation.errors import ConfigurationError
from rotcal_ros.methods.tracer.settings import TracerLimits

PLATE = {"grid": 12, "ball_steps": [0, 3, 4], "circle_radius_m": 0.2, "ball_diameter_m": 0.025}
CHORD = 2 * 0.2 * math.sin(math.pi / 12)
"""Between the balls of steps 3 and 4 of 12."""


@pytest.mark.parametrize(
    ("name", "last_good", "first_bad"),
    [
        ("grid", 36_000, 36_001),
        ("circle_radius_m", 10.0, 10.001),
        ("ball_diameter_m", 1e-4, 0.99e-4),
        ("ball_diameter_m", CHORD - 1e-9, CHORD + 1e-9),
        ("ball_steps", [0, 3, 11], [0, 3, 12]),
        ("ball_steps", [0, 3, 4], [0, 3, 3]),
        ("ball_steps", [0, 3, 4], [0, 3]),
        ("ball_steps", [2, 1, 5, 7], [2, -1, 5, 7]),
    ],
)
def test_the_ranges_of_a_plate_are_inclusive(name, last_good, first_bad):
    entries = PLATE | ({"ball_steps": [0, 9000, 18_000]} if name == "grid" else {})
    assert parse_plate(entries | {name: last_good}, "p") is not None
    with pytest.raises(ConfigurationError, match=r"^p"):
        parse_plate(entries | {name: first_bad}, "p")


def test_the_smallest_gap_of_a_plate_may_lie_across_step_0():
    with pytest.raises(ConfigurationError, match="balls 1 grid steps apart"):
        parse_plate(PLATE | {"grid": 72, "ball_steps": [0, 30, 71]}, "p")


def test_places_of_a_plate():
    plate = parse_plate(PLATE, "p")
    angles = np.radians(30.0 * np.arange(12))
    expected = 0.2 * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    np.testing.assert_allclose(plate.places, expected, atol=1e-15)
    assert (plate.name, plate.material, plate.separate_groups) == ("ball plate", "", False)


@pytest.mark.parametrize("name", [field.name for field in fields(TracerLimits)])
def test_limits_of_the_tracer_lie_between_0_and_1(name):
    for value in (0.0, 1.0, -0.1, math.nan):
        with pytest.raises(ConfigurationError, match=name):
            TracerLimits(**{name: value})
    assert getattr(TracerLimits(**{name: 0.999}), name) == 0.999
