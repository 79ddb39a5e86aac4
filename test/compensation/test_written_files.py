"""The files of controllers, letter by letter, for a table that is worked out by hand.

Deviations 0, 0.005, -0.003, 0.001 deg on the way up and -0.002, 0.003, -0.005, -0.001 on the way
down, at 0, 90, 180 and 270 deg; the correction is the opposite.
"""

from dataclasses import replace
from datetime import datetime, timezone

import numpy as np
import pytest
from compensation_examples import d4_table, two_ways
from independent_controls import CONTROLS

from rotcal_ros.compensation.controller_files import only_file, parse_number, parse_rows
from rotcal_ros.compensation.controllers import make_controller
from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.writing import without_provenance
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import DEGREE

POSITIVE, NEGATIVE = Approach.POSITIVE, Approach.NEGATIVE
NOW = datetime(2026, 1, 2, 3, 4, 5, tzinfo=timezone.utc)
HEAD = "angle_deg,correction_forward_arcsec,correction_reverse_arcsec,std_arcsec\n"


LINUXCNC = """\
0.000000000 0.000000000 0.002000000
90.000000000 -0.005000000 -0.003000000
180.000000000 0.003000000 0.005000000
270.000000000 -0.001000000 0.001000000
360.000000000 0.000000000 0.002000000
"""
FILES = {
    "csv": ({}, {
        "x.csv": HEAD + "0.000000000,0.000000,7.200000,0.000000\n"
        "90.000000000,-18.000000,-10.800000,0.000000\n"
        "180.000000000,10.800000,18.000000,0.000000\n"
        "270.000000000,-3.600000,3.600000,0.000000\n"
        "360.000000000,0.000000,7.200000,0.000000\n",
    }),
    "linuxcnc": ({"joint": 3}, {
        "x.comp": LINUXCNC,
        "x.ini": "[JOINT_3]\nCOMP_FILE = x.comp\nCOMP_FILE_TYPE = 1\n",
    }),
}  # fmt: skip


def write_and_read(controller, expected):
    """The mean of both directions, where there is one column, is zero at the reference angle."""
    files = controller.write(d4_table(), "x")
    assert files == expected
    degrees = np.array([0.0, 90.0, 180.0, 270.0, 360.0])
    rule = controller.read(files)
    table = d4_table()
    step = controller.resolution(table)
    down = table.correction_forward if controller.one_direction else table.correction_reverse
    for column, approach in ((table.correction_forward, POSITIVE), (down, NEGATIVE)):
        found = rule.correction(degrees * DEGREE, approach)
        np.testing.assert_allclose(found, np.append(column, column[0]), atol=step)


@pytest.mark.parametrize("name", FILES)
def test_files_letter_by_letter(name):
    settings, expected = FILES[name]
    write_and_read(make_controller(name, settings), expected)


# Damage: the reader names it.

DAMAGE = [
    ("csv", "std_arcsec", "std", "the first line is .*, expected angle_deg,correction_forward"),
    ("csv", "90.000000000,", "90.000000000,1,", r"x\.csv, row 2: 5 columns, expected 4"),
    ("csv", "270.0", "180.0", r"x\.csv, row 4: the position does not ascend from the row before"),
    ("linuxcnc", "COMP_FILE_TYPE = 1", "COMP_FILE_TYPE = 2", "hold no COMP_FILE_TYPE = 0 or 1"),
    ("linuxcnc", "0.005000000\n", "0.005000000\nnote\n", "6 lines, of which LinuxCNC uses 3; exp"),
    ("linuxcnc", "270.0", "170.0", "5 lines, .* uses 4; expected all; compensation values must"),
    ("linuxcnc", "-0.001000000 0.0", "-1e400 0.0", r"x\.comp: a number is too large"),
]  # fmt: skip


def assert_damage_named(controller, files, before, after, words):
    assert any(before in text for text in files.values())
    files = {name: text.replace(before, after) for name, text in files.items()}
    with pytest.raises(BagError, match=words):
        controller.read(files)


@pytest.mark.parametrize(("name", "before", "after", "words"), DAMAGE)
def test_damage_is_named(name, before, after, words):
    settings, files = FILES[name]
    assert_damage_named(make_controller(name, settings), files, before, after, words)


def test_parsing_names_file_and_row():
    assert only_file({"a.TXT": "1", "b.csv": "2"}, ".txt") == ("a.TXT", "1")
    with pytest.raises(
        BagError, match=r"^2 files end with \.txt, expected one, among a\.txt, b\.t"
    ):
        only_file({"a.txt": "", "b.txt": ""}, ".txt")
    with pytest.raises(BagError, match=r"^0 files end with \.txt, expected one, among -$"):
        only_file({}, ".txt")
    assert parse_rows("f", ["0 1", "2 3"], 2, None).tolist() == [[0.0, 1.0], [2.0, 3.0]]
    with pytest.raises(BagError, match=r"^f: 1 rows, expected at least 2$"):
        parse_rows("f", ["0 1"], 2, None)
    for text in ("x", "nan", "-inf", " "):
        with pytest.raises(BagError, match=rf"^here: found '{text.strip()}', expected a number$"):
            parse_number(text, "here")


# Marks of a simulation.


def assert_marked_as_simulated(control, has_comments, table):
    """The control that reads the file, and our own reader, make the same of it."""
    texts = [
        prepare_export(
            replace(table, simulated=simulated),
            control.kind,
            now=NOW,
            settings=control.settings,
            stem="c_x",
            accept_unverified=True,
        )
        for simulated in (False, True)
    ]
    real, marked = (without_provenance(done.files) for done in texts)
    assert not any("SIMULATED" in text for text in real.values())
    assert all(("SIMULATED" in text) == has_comments for text in marked.values())
    at = np.linspace(0.0, 359.0, 97)
    for way in (True, False):
        by_mark, without = (control.correction(files)(at, way) for files in (marked, real))
        np.testing.assert_array_equal(by_mark, without)


@pytest.mark.parametrize("name", CONTROLS)
def test_a_simulated_table_says_so_inside_every_file_whose_form_has_comments(name):
    assert_marked_as_simulated(CONTROLS[name], name == "linuxcnc", two_ways(36))
