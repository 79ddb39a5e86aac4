"""What a control makes of its file removes the error: the round trips of the core, further."""

import numpy as np
import pytest
from compensation_examples import result_of, wavy
from controls_beside_the_core import OURS
from hypothesis import given
from test_controllers import (
    EXAMPLES,
    MEASURED,
    SPACINGS_DEG,
    assert_error_removed,
    assert_rounding,
    assert_spacing_taken,
    export,
)

from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.foundation.errors import ConfigurationError, DataError

VARIANTS = {
    "sinumerik": ("sinumerik", {"max_points": 400}),
    "sinumerik cec": ("sinumerik", {"tables": "cec", "max_points": 400}),
    "sinumerik cec other sign": ("sinumerik", {"tables": "cec", "cec_adds": False}),
    "fanuc IS-B": ("fanuc", {"reference_slot": 10, "slots": 1024}),
    "fanuc each": ("fanuc", {"directions": "each", "detection_unit_deg": 0.0001, "slots": 1024}),
    "fanuc IS-C": ("fanuc", {"detection_unit_deg": 0.0001, "slots": 512}),
    "twincat": ("twincat", {}),
    "twincat_nc each": ("twincat_nc", {"directions": "each"}),
    "kflop": ("kflop", {"turns": 3, "first_turn": -1}),
    "smoothieware": ("smoothieware", {"turns": 2, "first_turn": -1}),
    "aerotech": ("aerotech", {"turns": 2}),
    "acs": ("acs", {"turns": 3, "first_turn": -1}),
    "mach4 each": ("mach4", {"directions": "each"}),
    "centroid": ("centroid", {"turns": 2}),
    "heidenhain": ("heidenhain", {}),
    "heidenhain difference": ("heidenhain", {"backlash": "difference"}),
    "fagor": ("fagor", {}),
    "pmac": ("pmac", {"counts_per_turn": 3_600_000}),
}
EVEN_ONLY = {"sinumerik", "fanuc", "twincat", "twincat_nc", "kflop", "pmac", "aerotech", "acs",
             "mach4", "centroid"}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("variant", VARIANTS)
@EXAMPLES
@given(**MEASURED)
def test_what_is_left_is_below_the_stated_residual(variant, curve, rows, reference, seed):
    name, values = VARIANTS[variant]
    if name in ("fanuc", "pmac", "smoothieware"):
        reference = 0.0
    if name == "pmac":  # a negative reversal at zero is refused
        terms, (offset, size, phase) = curve
        curve = terms, (abs(offset) + size, size, phase)
    try:
        assert_error_removed(name, values, curve, rows, reference, seed, halves=name != "fanuc")
    except DataError as error:
        # A control with 3.6 arcsec steps may not be able to help; it then must say so.
        if name != "fanuc" or "too coarse" not in str(error):
            raise


@pytest.mark.parametrize(
    ("name", "value_arcsec", "angle_arcsec"),
    [("twincat", 0.18, 0.0), ("fagor", 0.18, 0.36), ("heidenhain", 0.036, 0.036)],
)
def test_rounding_is_half_a_step_and_what_the_angle_moves(name, value_arcsec, angle_arcsec):
    """A value of Heidenhain's way back may be the sum of two rounded ones."""
    assert_rounding(name, value_arcsec, angle_arcsec)


@pytest.mark.parametrize("name", [name for name in OURS if name != "encoder_lut"])
@pytest.mark.parametrize("spacing_deg", SPACINGS_DEG)
def test_spacings_that_do_not_divide_the_turn(name, spacing_deg):
    assert_spacing_taken(name, spacing_deg, even_only=name in EVEN_ONLY)


@pytest.mark.parametrize("name", OURS)
def test_controls_that_wrap_refuse_an_arc(name):
    angles = np.deg2rad(np.arange(0, 181, 10))
    table = table_from_result(result_of(angles, wavy(angles)))
    with pytest.raises(ConfigurationError, match="full circle"):
        export(table, name)
