"""Limits and damage: refused before anything is written, and reported when anything is read."""

from datetime import datetime, timezone

import numpy as np
import pytest
from compensation_examples import TAU, even, result_of, wavy
from hypothesis import given, settings
from hypothesis import strategies as st

from rotcal_ros.compensation.controllers import controller_names, make_controller
from rotcal_ros.compensation.export import prepare_export
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.observations import Approach

NOW = datetime(2026, 1, 2, 3, 4, 5, tzinfo=timezone.utc)


def export(table, name, spacing=None, **more):
    return prepare_export(table, name, now=NOW, spacing=spacing, accept_unverified=True, **more)


# Limits, before anything is written.


def refuse_rows(name, values, rows, text):
    """So many rows are refused in the words ``text``."""
    angles = even(72)
    table = table_from_result(result_of(angles, wavy(angles)))
    with pytest.raises(ConfigurationError, match=text):
        export(table, name, TAU / rows, settings=values)


@pytest.mark.parametrize(
    ("name", "values", "rows", "text"),
    [
        ("linuxcnc", {}, 360, r"360 rows x 1 turns \+ 1: 361, and the controller holds 256"),
        ("linuxcnc", {"turns": 4}, 72, r"289, and the controller holds 256.*at most 3 turns"),
    ],
)
def test_limits_are_errors_with_the_number(name, values, rows, text):
    refuse_rows(name, values, rows, text)


def test_settings_of_the_wrong_name_type_or_range_are_refused():
    with pytest.raises(ConfigurationError, match="unknown controller 'haas'"):
        make_controller("haas")
    with pytest.raises(ConfigurationError, match="did you mean 'linuxcnc'"):
        make_controller("linuxcmc")
    with pytest.raises(
        ConfigurationError, match="linuxcnc: unknown setting 'turn'; did you mean 'turns'"
    ):
        make_controller("linuxcnc", {"turn": 2})
    with pytest.raises(ConfigurationError, match=r"linuxcnc\.turns: expected int .*, found '2'"):
        make_controller("linuxcnc", {"turns": "2"})
    for name, values in [
        ("linuxcnc", {"joint": 16}),
        ("linuxcnc", {"file_type": 2}),
        ("linuxcnc", {"turns": 0}),
    ]:
        with pytest.raises(ConfigurationError, match=name):
            make_controller(name, values)


# Damaged files: the reader says what and where, whatever was done to them.


GOOD_FILES = {
    name: make_controller(name).write(table_from_result(result_of(even(12), wavy(even(12)))), "t")
    for name in controller_names()
}


@pytest.mark.parametrize("name", controller_names())
@settings(max_examples=50, deadline=None)
@given(data=st.data())
def test_damaged_files_raise_our_error_or_read_as_numbers(name, data):
    files = dict(GOOD_FILES[name])
    victim = data.draw(st.sampled_from(sorted(files)))
    lines = files[victim].splitlines()
    row = data.draw(st.integers(0, len(lines) - 1))
    damage = data.draw(st.sampled_from(["drop", "blank", "text", "nan", "twice", "cut", "slip"]))
    if damage == "drop":
        del lines[row]
    elif damage == "twice":
        lines.insert(row, lines[row])
    elif damage == "cut":
        lines = lines[:row]
    else:
        place = data.draw(st.integers(0, len(lines[row])))
        slip = data.draw(st.text("0189.,;-+e[]$#PA ", max_size=3))
        texts = {
            "blank": "",
            "text": "# note",
            "nan": lines[row].replace("0", "nan"),
            "slip": lines[row][:place] + slip + lines[row][place + 1 :],
        }
        lines[row] = texts[damage]
    files[victim] = "\n".join(lines) + "\n"
    try:
        rule = make_controller(name).read(files)
    except BagError:
        return
    assert np.all(np.isfinite(rule.correction(np.linspace(0, TAU, 50), Approach.POSITIVE)))


def test_unreadable_rows_name_the_place():
    controller = make_controller("csv")
    head = "angle_deg,correction_forward_arcsec,correction_reverse_arcsec,std_arcsec"
    with pytest.raises(BagError, match=r"t\.csv, row 2: found 'x', expected a number"):
        controller.read({"t.csv": f"{head}\n0,0,0,0\n90,x,0,0\n"})
    with pytest.raises(BagError, match="row 2: the position does not ascend"):
        controller.read({"t.csv": f"{head}\n0,0,0,0\n0,1,0,0\n"})
