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
from rotcal_ros.foundation.units import ARCSEC

NOW = datetime(2026, 1, 2, 3, 4, 5, tzinfo=timezone.utc)


def export(table, name, spacing=None, **more):
    return prepare_export(table, name, now=NOW, spacing=spacing, accept_unverified=True, **more)


# Limits, before anything is written.


@pytest.mark.parametrize("name", ["heidenhain", "fagor", "twincat", "fanuc", "pmac", "kflop"])
def test_an_arc_is_refused_where_tables_repeat_every_turn(name):
    angles = np.deg2rad(np.arange(10.0, 160.0, 10.0))
    table = table_from_result(result_of(angles, wavy(angles)))
    with pytest.raises(ConfigurationError, match=r"covers only 10 \.\. 150 deg: measure the full"):
        export(table, name)


@pytest.mark.parametrize(
    ("name", "values", "rows", "text"),
    [
        ("linuxcnc", {}, 360, r"360 rows x 1 turns \+ 1: 361, and the controller holds 256"),
        ("linuxcnc", {"turns": 4}, 72, r"289, and the controller holds 256.*at most 3 turns"),
        ("sinumerik", {}, 360, r"361, and the controller holds 200.*MD38000"),
        ("sinumerik", {"tables": "cec"}, 360, r"holds 200.*MD18342"),
        ("fanuc", {"reference_slot": 100}, 36, r"136, and the controller holds 127"),
        ("twincat", {"max_points": 37}, 36, r"37, and the controller holds 36.*P-COMP-00059"),
        ("heidenhain", {}, 360, r"361, and the controller holds 256"),
        ("fagor", {"max_points": 30}, 36, r"37, and the controller holds 30"),
        ("pmac", {"counts_per_turn": 1000}, 36, r"whole steps of 0.36 deg"),
        ("twincat", {}, 7, r"whole steps of 0.0001 deg"),
    ],
)
def test_limits_are_errors_with_the_number(name, values, rows, text):
    angles = even(72)
    table = table_from_result(result_of(angles, wavy(angles)))
    with pytest.raises(ConfigurationError, match=text):
        export(table, name, TAU / rows, settings=values)


@pytest.mark.parametrize("name", ["fanuc", "pmac", "smoothieware"])
def test_tables_counted_from_the_machine_zero_must_be_zero_there(name):
    angles = even(36)
    table = table_from_result(result_of(angles, wavy(angles)), reference_angle=2.0)
    with pytest.raises(ConfigurationError, match="move the reference angle to 0"):
        export(table, name)
    assert export(table, name, reference_angle=0.0).residual.stated < 15 * ARCSEC


def test_settings_of_the_wrong_name_type_or_range_are_refused():
    with pytest.raises(ConfigurationError, match="unknown controller 'haas'"):
        make_controller("haas")
    with pytest.raises(ConfigurationError, match="did you mean 'fanuc'"):
        make_controller("fanux")
    with pytest.raises(
        ConfigurationError, match="linuxcnc: unknown setting 'turn'; did you mean 'turns'"
    ):
        make_controller("linuxcnc", {"turn": 2})
    with pytest.raises(ConfigurationError, match=r"linuxcnc\.turns: expected int .*, found '2'"):
        make_controller("linuxcnc", {"turns": "2"})
    for name, values in [
        ("linuxcnc", {"joint": 16}),
        ("sinumerik", {"measuring_system": 2}),
        ("fanuc", {"reference_slot": 200}),
        ("fanuc", {"axis_number": 33}),
        ("fanuc", {"detection_unit_deg": 1.0}),
        ("twincat", {"max_points": 0}),
        ("pmac", {"counts_per_turn": 359}),
        ("linuxcnc", {"file_type": 2}),
        ("linuxcnc", {"turns": 0}),
        ("sinumerik", {"tables": "leak"}),
        ("fanuc", {"magnification": 101}),
        ("fanuc", {"slots": 5000}),
        ("heidenhain", {"backlash": "both"}),
        ("fagor", {"max_points": 1001}),
        ("pmac", {"motor": 0}),
        ("pmac", {"take_up_rate": 0}),
        ("pmac", {"reversal": "none"}),
        ("twincat_nc", {"directions": "both"}),
        ("kflop", {"turns": 0}),
        ("smoothieware", {"letter": "A"}),
    ]:
        with pytest.raises(ConfigurationError, match=name):
            make_controller(name, values)
    with pytest.raises(ConfigurationError, match="axis name"):
        make_controller("sinumerik", {"axis_name": "C1\n$MN"})


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


def cec_table(index, direction, points):
    step = 360.0 / (points - 1)
    lines = [f"$AN_CEC[{index},{k}]=0.0" for k in range(points)]
    values = {"STEP": step, "MIN": 0.0, "MAX": 360.0, "DIRECTION": direction, "IS_MODULO": 1}
    return lines + [f"$AN_CEC_{name}[{index}]={value}" for name, value in values.items()]


COM = ["BEGIN t.COM", "NR AXISPOS BACKLASH C", "0 0 0 0", "1 90 0 0.01", "2 180 0 0", "3 360 0 0"]


@pytest.mark.parametrize(
    ("name", "values", "files", "text"),
    [
        ("heidenhain", {}, {"t.COM": [*COM, "[END]"]}, None),
        ("heidenhain", {}, {"t.COM": [*COM[:3], "1 200 0 0", *COM[4:], "[END]"]}, "that ascend"),
        ("heidenhain", {}, {"t.COM": [*COM[:3], "1 360 0 0", "[END]"]}, None),
        ("heidenhain", {}, {"t.COM": [*COM[:-1], "3 350 0 0", "[END]"]}, "from 0 to 360"),
        ("heidenhain", {}, {"t.COM": [*COM[:-1], "3 360 0 0.01", "[END]"]}, "does not close"),
        ("fagor", {}, {"t.txt": []}, "from 0 to 360"),
        ("fagor", {}, {"t.txt": ["P001 C 0 EC 0 EC 1", "P002 C 360 EC 0 EC 2"]}, "1.0 at 0 and 2"),
        ("sinumerik", {"tables": "cec"}, {"t.ini": [(0, 1, 9), (1, -1, 9)]}, None),
        ("sinumerik", {"tables": "cec"}, {"t.ini": [(0, 1, 9), (1, -1, 5)]}, "5 values for 9"),
    ],
)
def test_a_table_that_is_no_whole_turn_is_refused(name, values, files, text):
    """The unharmed ones, without ``text``, show that only the damage is refused."""
    if name == "sinumerik":
        files = {"t.ini": [line for given in files["t.ini"] for line in cec_table(*given)]}
    files = {file: "".join(f"{line}\n" for line in lines) for file, lines in files.items()}
    files |= {"t.CMA": "0 * t\n"} if name == "heidenhain" else {}
    controller = make_controller(name, values)
    if text is None:
        assert controller.read(files).correction(0.0, Approach.POSITIVE) == 0.0
        return
    with pytest.raises(BagError, match=text):
        controller.read(files)
