"""Why two curves may disagree: curves with one known mistake, and curves with none."""

import numpy as np
import pytest

from rotcal_ros.evaluation.compare import suspected_cause

ANGLES = np.arange(24) * 2 * np.pi / 24
CURVE = 3.0 * np.sin(ANGLES) + np.cos(3 * ANGLES) + 0.5 * np.sin(2 * ANGLES + 1.0)
OTHER = np.cos(ANGLES)


@pytest.mark.parametrize("offset", [0.0, 50.0])
@pytest.mark.parametrize(
    ("factor", "text"),
    [
        (1.0, ""),
        (1.5, ""),
        (3600.0, "degrees taken for arcseconds"),
        (60.0, "arcminutes taken for arcseconds"),
        (206265.0, "radians taken for arcseconds"),
        (0.2063, "microradians and arcseconds exchanged"),
        (1.19 * 60.0, "arcminutes taken for arcseconds"),
        (1.3 * 60.0, ""),
    ],
)
def test_a_wrong_unit_is_named_whichever_curve_has_it(factor, text, offset):
    expected = f"both curves have one shape, but for one of them {text}" if text else None
    assert suspected_cause(factor * CURVE + offset, CURVE, None) == expected
    assert suspected_cause(CURVE, factor * CURVE + offset, None) == expected


def test_a_turned_sign_is_named_and_a_wrong_unit_with_it():
    start = "both curves have one shape, but for one of them its sign is reversed"
    assert suspected_cause(CURVE, -CURVE, None) == f"{start} (commanded - actual?)"
    assert suspected_cause(CURVE, -3600.0 * CURVE, None) == (
        f"{start} (commanded - actual?); degrees taken for arcseconds"
    )


def test_curves_of_another_shape_raise_no_suspicion():
    """A correlation of 0.8 is not enough, one of 0.95 is; an offset does not feign it."""
    unit, across = np.sqrt(2) * np.sin(ANGLES), np.sqrt(2) * np.cos(ANGLES)
    for alike, suspicious in ((0.8, False), (0.95, True)):
        second = -(alike * unit + np.sqrt(1 - alike**2) * across)
        assert bool(suspected_cause(unit, second, None)) is suspicious
        assert bool(suspected_cause(unit + 9.0, second + 9.0, None)) is suspicious


def test_a_curve_without_any_shape_raises_no_suspicion():
    assert suspected_cause(CURVE, np.full(24, 2.0), None) is None


def test_an_angle_counted_clockwise_is_named():
    backward = (-ANGLES) % (2 * np.pi)
    order = np.argsort(backward)
    turned = -CURVE[order]
    assert "counted clockwise" in suspected_cause(CURVE, turned, CURVE)
    assert suspected_cause(CURVE, CURVE, CURVE) is None
    assert suspected_cause(CURVE, OTHER, turned) is None


FACTORS = {  # arc seconds in each unit
    "degrees taken for arcseconds": 3600.0,
    "arcminutes taken for arcseconds": 60.0,
    "radians taken for arcseconds": np.rad2deg(1.0) * 3600.0,
    "microradians and arcseconds exchanged": np.rad2deg(1e-6) * 3600.0,
}


@pytest.mark.parametrize("text", FACTORS)
@pytest.mark.parametrize(
    ("share", "named"),
    [(0.8 + 1e-7, True), (0.8 - 1e-7, False), (1.2 - 1e-7, True), (1.2 + 1e-7, False)],
)
def test_a_unit_is_recognised_within_a_fifth(text, share, named):
    """The units by their definition; either the ratio or one over the factor is a fifth off."""
    factor = FACTORS[text]
    expected = f"both curves have one shape, but for one of them {text}" if named else None
    assert suspected_cause(factor * share * CURVE, CURVE, None) == expected
    assert suspected_cause(share / factor * CURVE, CURVE, None) == expected


def of_correlation(alike, first, across):
    return alike * first + np.sqrt(1.0 - alike**2) * across


@pytest.mark.parametrize(
    ("straight", "mirrored", "named"),
    [
        (0.0, 0.91, True),
        (0.0, 0.89, False),
        (0.70, 0.95, True),
        (-0.70, 0.95, True),
        (0.80, 0.95, False),
        (-0.80, 0.95, False),
    ],
)
def test_clockwise_needs_a_shape_that_fits_clearly_better(straight, mirrored, named):
    """A correlation of 0.9, and 0.2 more than straight."""
    unit, across, other = (np.sqrt(2) * np.sin(k * ANGLES) for k in (1, 2, 3))
    found = suspected_cause(
        unit, of_correlation(straight, unit, across), of_correlation(mirrored, unit, other)
    )
    words = "the curves fit if one is reversed: is its angle counted clockwise?"
    assert found == (words if named else None)


def test_a_flat_curve_is_like_none():
    assert suspected_cause(CURVE, OTHER, np.full(24, 2.0)) is None
    assert suspected_cause(np.full(24, 2.0), OTHER, CURVE) is None
