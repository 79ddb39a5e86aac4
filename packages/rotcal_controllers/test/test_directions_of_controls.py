"""A reversal that was measured gets to every controller whose files have room for it."""

import re

import pytest
from controls_beside_the_core import CONTROLS
from hypothesis import given, reject, settings
from test_two_directions import RANDOM, remove_curves, remove_play

from rotcal_ros.foundation.errors import ConfigurationError

ONE_COLUMN = ("sinumerik", "fanuc", "twincat_nc", "kflop", "smoothieware", "aerotech", "acs",
              "mach4", "encoder_lut")  # fmt: skip
STAIRCASE = {"fanuc each": 1.1}
"""Steps of 0.36 arcsec leave more than lines between rows."""


@pytest.mark.parametrize("name", CONTROLS)
def test_six_arcsec_of_play_are_removed_or_stated(name):
    remove_play(CONTROLS[name], None if name in ONE_COLUMN else STAIRCASE.get(name, 0.7))


@pytest.mark.slow
@pytest.mark.parametrize("control", CONTROLS.values(), ids=CONTROLS)
@settings(max_examples=6, deadline=None)
@given(**RANDOM)
def test_random_curves_and_uneven_angles(control, **drawn):
    """A curve that the file of a control cannot hold is refused in words."""
    try:
        remove_curves(control, **drawn)
    except ConfigurationError as error:
        assert re.search("fanuc: |fagor: every error|PMAC: the reversal", str(error)), error  # noqa: PT017
        reject()
