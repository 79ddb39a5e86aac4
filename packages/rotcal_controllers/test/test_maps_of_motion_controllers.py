"""Files of motion controllers that were harmed, and what they say."""

import pytest
from compensation_examples import d4_table

from rotcal_ros.compensation.controllers import make_controller
from rotcal_ros.foundation.errors import BagError

ENDINGS = {"aerotech": ".cal", "acs": ".prg", "mach4": ".txt", "centroid": ".tab"}


@pytest.mark.parametrize(
    ("name", "before", "after", "words"),
    [
        ("aerotech", ":START 1", ":START 2", "expected one block :START 1 SAMPLEDIST"),
        ("aerotech", "/3600", "/1000", "CORUNIT=PRIMARY/3600"),
        ("aerotech", ":END", "", "values, :END"),
        ("aerotech", "-18.0000 ", "", r"4 points every 90 deg from 0, expected 0 \.\. 360"),
        ("aerotech", "=90.", "=60.", r"5 points every 60 deg from 0, expected 0 \.\. 360"),
        ("aerotech", "-18.0000", "-1-8", "found '-1-8', expected a number"),
        ("acs", "ERRORMAPON 0, 0\n", "", "ERRORMAPON for 0, 0, STOP"),
        ("acs", "ERRORMAPON 0, 0", "ERRORMAPON 1, 0", "ERRORMAPON for 0, 0, STOP"),
        (
            "acs",
            "C1_CORRECTION(2)",
            "C1_CORRECTION(3)",
            "5 values of 5, expected all, in their order",
        ),
        (
            "acs",
            "REAL C1_CORRECTION(5)",
            "REAL C1_CORRECTION(6)",
            "5 values of 6, expected all, in their order",
        ),
        ("acs", "0.000000, 90", "10.000000, 90", r"from 10, expected 0 \.\. 360 deg"),
        ("mach4", "Points 5", "Points 6", "5 rows, and Number of Points is 6"),
        ("mach4", "Length 360", "Length 350", "are not evenly spaced over the length"),
        ("mach4", "\n90.000000 -0.004000", "\n90.000000 -0.004100", "and the columns differ"),
        (
            "centroid",
            "VERSION 3",
            "VERSION 2",
            "expected CNC10 TAB FILE VERSION 3, AXIS, UNITS MM",
        ),
        (
            "centroid",
            "UNITS MM",
            "UNITS INCH",
            "expected CNC10 TAB FILE VERSION 3, AXIS, UNITS MM",
        ),
        ("centroid", "ENTRIES 5", "ENTRIES 6", "5 rows, expected 6 that are 90 deg apart"),
        ("centroid", "INTERVAL 90", "INTERVAL 80", "5 rows, expected 5 that are 80 deg apart"),
        ("centroid", "\n90.0000\t", "\n90.0000 ", r"row 2: 2 columns, expected 3"),
        ("mach4", "Start", "Begin", "expected Start Point, Length, Number of Points"),
    ],
)
def test_the_damage_is_named(name, before, after, words):
    controller = make_controller(name)
    (text,) = controller.write(d4_table(), "x").values()
    if name == "mach4":
        before = before.replace("-0.004000", text.splitlines()[5].split()[1])
    assert before in text
    controller.read({f"x{ENDINGS[name]}": text})
    with pytest.raises(BagError, match=words):
        controller.read({f"x{ENDINGS[name]}": text.replace(before, after, 1)})
