"""Limits of these controllers met exactly, their steps, and what they refuse, in their words."""

from dataclasses import replace

import numpy as np
import pytest
from compensation_examples import TAU, arc, even, result_of, turn, wavy
from controls_beside_the_core import OURS
from test_controller_details import assert_fits_exactly
from test_controller_limits import export, refuse_rows

from rotcal_ros.compensation.controllers import make_controller
from rotcal_ros.compensation.table import table_from_result
from rotcal_ros.foundation.errors import BagError, ConfigurationError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import ARCSEC, DEGREE


@pytest.mark.parametrize(
    ("name", "settings", "most", "words"),
    [
        ("heidenhain", {}, 255, "heidenhain: rows: 257, and the controller holds 256: choose a"),
        ("fagor", {}, 999, "fagor: points: 1001, and the controller holds 1000: choose a wider"),
        ("fagor", {"max_points": 7}, 6, "fagor: points: 8, and the controller holds 7: choose a"),
        ("twincat", {"max_points": 10}, 8, r"twincat: points: 10, and the controller holds 9: cho"
         "ose a wider spacing, or raise P-COMP-00059"),
        ("sinumerik", {"max_points": 9}, 8, "sinumerik: points at 40 deg: 10, and the controller "
         "holds 9: choose a wider spacing, or set max_points to MD38000 of the machine"),
        ("sinumerik", {"max_points": 9, "tables": "cec"}, 8, "set max_points to MD18342 of the m"),
        ("fanuc", {"slots": 19, "reference_slot": 9}, 9, "fanuc: last slot for 10 intervals from 9"
         ": 19, and the controller holds 18: choose a wider spacing or a lower reference_slot"),
    ],
)  # fmt: skip
def test_the_limit_itself_fits_and_one_more_does_not(name, settings, most, words):
    assert_fits_exactly(make_controller(name, settings), most, words)


@pytest.mark.parametrize("name", OURS)
def test_travel_and_columns(name):
    """docs/compensation.md: controls that wrap by themselves are proven from -360 to 720 deg."""
    controller = make_controller(name)
    turns = name in ("kflop", "smoothieware", "aerotech", "acs", "mach4", "centroid")
    travel = (0.0, TAU) if turns else (-TAU, 2.0 * TAU)
    assert controller.travel == pytest.approx(travel)
    assert controller.staircase is (name == "fanuc")
    one_column = ("fanuc", "sinumerik", "twincat_nc", "kflop", "smoothieware", "aerotech", "acs",
                  "mach4", "encoder_lut")  # fmt: skip
    assert controller.one_direction is (name in one_column)


@pytest.mark.parametrize("name", ["kflop", "smoothieware", "acs", "mach4", "centroid"])
def test_the_travel_is_that_of_the_turns(name):
    controller = make_controller(name, {"first_turn": -2, "turns": 5})
    assert controller.travel == pytest.approx((-2.0 * TAU, 3.0 * TAU))


@pytest.mark.parametrize(
    ("name", "settings", "value_deg", "place_deg"),
    [
        ("heidenhain", {}, 2e-5, 1e-5),
        ("fagor", {}, 1e-4, 1e-4),
        ("sinumerik", {}, 1e-7, 1e-7),
        ("twincat", {}, 1e-4, 0.0),
        ("twincat_nc", {}, 1e-9, 1e-6),
        ("kflop", {}, 1e-9, 1e-6),
        ("aerotech", {}, 1e-4 / 3600.0, 1e-6),
        ("acs", {}, 1e-9, 1e-6),
        ("mach4", {}, 1e-6, 1e-6),
        ("centroid", {}, 1e-5, 1e-4),
        ("encoder_lut", {"counts_per_turn": 3600}, 0.1, 0.0),
        ("encoder_lut", {"form": "simplefoc"}, np.rad2deg(1.0 / 10430.2191955), 0.0),
        ("pmac", {"counts_per_turn": 3600}, 2.0 * 0.1 / 16.0, 0.0),
        ("fanuc", {"magnification": 3, "detection_unit_deg": 0.01}, 0.03, 0.0),
        ("fanuc", {}, 0.002, 0.0),
    ],
)
def test_steps_of_values_and_positions(name, settings, value_deg, place_deg):
    """The decimals, the sixteenth of a count, or the detection units that the pages name.

    A way back that is a difference is rounded twice. A step of 0.008 deg needs magnification 2.
    """
    controller = make_controller(name, settings)
    table = turn([0.0, 0.008, 0.0, 0.0])
    assert controller.position_resolution / DEGREE == pytest.approx(place_deg)
    assert controller.resolution(table) / DEGREE == pytest.approx(value_deg)


@pytest.mark.parametrize(
    ("name", "title"),
    [("fanuc", "Fanuc"), ("pmac", "PMAC"), ("sinumerik", "SINUMERIK"), ("twincat", "TwinCAT CNC"),
     ("twincat_nc", "TwinCAT NC"), ("kflop", "KFLOP"), ("aerotech", "Aerotech"), ("acs", "ACS"),
     ("mach4", "Mach4"), ("encoder_lut", "encoder_lut"), ("centroid", "Centroid")],
)  # fmt: skip
def test_uneven_rows_are_refused_by_name(name, title):
    angles = even(12)
    angles[5] += 0.01
    with pytest.raises(ConfigurationError, match=f"^{title} needs evenly spaced rows from 0 to"):
        make_controller(name).write(turn(np.zeros(12), angles), "t")


@pytest.mark.parametrize(
    ("name", "title"),
    [("fanuc", "Fanuc"), ("pmac", "PMAC"), ("sinumerik", "SINUMERIK"), ("twincat", "TwinCAT CNC"),
     ("heidenhain", "Heidenhain"), ("fagor", "Fagor 8055"), ("twincat_nc", "TwinCAT NC"),
     ("kflop", "KFLOP"), ("smoothieware", "Smoothieware"), ("aerotech", "Aerotech"),
     ("acs", "ACS"), ("mach4", "Mach4"), ("encoder_lut", "encoder_lut"),
     ("centroid", "Centroid")],
)  # fmt: skip
def test_an_arc_is_refused_by_name(name, title):
    words = rf"^{title} takes a table of a whole turn, and this one covers only 0 \.\. 19\.5 deg: "
    with pytest.raises(ConfigurationError, match=words):
        make_controller(name).write(arc(40), "t")


@pytest.mark.parametrize(
    ("name", "title"), [("fanuc", "Fanuc"), ("pmac", "PMAC"), ("smoothieware", "Smoothieware")]
)
def test_a_machine_zero_that_is_not_zero_is_refused_by_name(name, title):
    with pytest.raises(ConfigurationError, match=f"^{title} counts its corrections from the mach"):
        make_controller(name).write(turn(np.full(12, 0.01)), "t")


@pytest.mark.parametrize(
    ("degrees", "magnification"),
    [([0.0, 0.007, 0.0], 1), ([0.0, 0.008, 0.0], 2), ([0.0, -0.014, 0.0], 2),
     ([0.0, 0.745, 0.0], 100), ([0.0, 0.0, 0.0], 1)],
)  # fmt: skip
def test_fanuc_takes_the_smallest_magnification_that_holds_every_step(degrees, magnification):
    files = make_controller("fanuc").write(turn(degrees), "t")
    assert f"N03623A4P{magnification};" in files["t.txt"]


def test_fanuc_steps_that_no_magnification_holds():
    words = (
        r"^fanuc: a step of 0\.8 deg between rows is more than 7 x 100 x 0\.001 deg: choose a n"
    )
    with pytest.raises(ConfigurationError, match=words):
        make_controller("fanuc").write(turn([0.0, 0.3, -0.5, 0.0]), "t")


def test_fanuc_with_a_magnification_of_ones_own():
    fits = make_controller("fanuc", {"magnification": 2}).write(turn([0.0, 0.014, 0.0, 0.0]), "t")
    assert "N10001P-7;\nN10002P7;\nN10003P0;\nN10004P0;" in fits["t.txt"]
    words = "the step to 180 deg is 8 at magnification 2, and a slot holds -7 .. .7: use a "
    with pytest.raises(ConfigurationError, match=f"^fanuc: {words}magnification of at least 3 or"):
        make_controller("fanuc", {"magnification": 2}).write(turn([0.0, 0.0, -0.016, 0.0]), "t")


def test_fanuc_rounds_the_running_sum_with_halves_away_from_zero():
    """Corrections of -0.0015, 0.0015, 0.0005 and -0.0004 deg are -2, 2, 1 and 0 units."""
    table = turn([0.0, 0.0015, -0.0015, -0.0005, 0.0004])
    text = make_controller("fanuc").write(table, "t")["t.txt"]
    slots = [line.split("P")[1] for line in text.splitlines() if line.startswith("N10")]
    assert slots == ["0;", "-2;", "4;", "-1;", "-1;", "0;"]


def test_fanuc_in_two_directions_by_hand():
    """Up -e is 0, -5, 3, -1 and down 2, -3, 5, 1 thousandths; in steps of two, halves away."""
    up, down = [0.0, 0.005, -0.003, 0.001], [-0.002, 0.003, -0.005, -0.001]
    settings = {"directions": "each", "reference_slot": 60}
    both = replace(turn(up), correction_reverse=turn(down).correction_forward)
    files = make_controller("fanuc", settings).write(both, "t")
    assert files["t.txt"].splitlines()[1:-1] == [
        "N03620A4P60;", "N03621A4P60;", "N03622A4P64;", "N03623A4P2;", "N03624A4P90.000000;",
        "N03625A4P360.0;", "N03626A4P65;", "N03627A4P2;",
        "N10060P1;", "N10061P-3;", "N10062P5;", "N10063P-3;", "N10064P1;",
        "N10065P0;", "N10066P-3;", "N10067P5;", "N10068P-2;", "N10069P0;",
    ]  # fmt: skip
    rule = make_controller("fanuc", settings).read(files)
    back = rule.correction(np.deg2rad([0.0, 90.0, 180.0, 270.0]), Approach.NEGATIVE)
    np.testing.assert_allclose(np.rad2deg(back), [0.002, -0.004, 0.006, 0.002], atol=1e-12)
    with pytest.raises(ConfigurationError, match="last slot for two times 4 intervals from 119"):
        make_controller("fanuc", {**settings, "reference_slot": 119}).write(both, "t")
    assert any(
        "3605#0 to 1 by hand" in text for text in make_controller("fanuc", settings).unverified
    )


@pytest.mark.parametrize(
    ("line", "words"),
    [("N03627A4P2;", "of the parameters 3626 and 3627 one is missing"),
     ("N10067P5;", "not all slots 65 .. 69 are there")],
)  # fmt: skip
def test_fanuc_reads_no_half_of_a_way_back(line, words):
    settings = {"directions": "each", "reference_slot": 60}
    both = replace(
        turn([0.0, 0.005, -0.003, 0.001]),
        correction_reverse=turn([-0.002, 0.003, -0.005, -0.001]).correction_forward,
    )
    text = make_controller("fanuc", settings).write(both, "t")["t.txt"]
    with pytest.raises(BagError, match=words):
        make_controller("fanuc", settings).read({"t.txt": text.replace(f"{line}\n", "")})


def test_fanuc_has_a_slot_for_its_reference():
    assert make_controller("fanuc", {"slots": 5, "reference_slot": 4}).reference_slot == 4
    with pytest.raises(
        ConfigurationError, match=r"reference_slot 5 is none of the 5 slots 0 \.\. 4"
    ):
        make_controller("fanuc", {"slots": 5, "reference_slot": 5})


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (["BEGIN t.COM", "NR A B C", "[END]"], "expected BEGIN in the first line"),
        (["BEGIN t.COM", "NR A B C", "0 0 0 0", "[END]"], r"t\.COM: 1 rows, expected at least 2"),
        (["BEGIN t.COM", "NR A B C", "0 0 0 0", "1 360 0 0", "[END]"], None),
    ],
)
def test_a_heidenhain_table_has_two_rows_at_least(lines, words):
    files = {"t.COM": "\n".join(lines), "t.CMA": "0 * t\n"}
    controller = make_controller("heidenhain")
    if words is None:
        assert controller.read(files).correction(1.0, Approach.POSITIVE) == 0.0
        return
    with pytest.raises(BagError, match=words):
        controller.read(files)


@pytest.mark.parametrize("name", ["heidenhain", "fagor", "twincat", "fanuc", "pmac", "kflop"])
def test_an_arc_is_refused_where_tables_repeat_every_turn(name):
    angles = np.deg2rad(np.arange(10.0, 160.0, 10.0))
    table = table_from_result(result_of(angles, wavy(angles)))
    with pytest.raises(ConfigurationError, match=r"covers only 10 \.\. 150 deg: measure the full"):
        export(table, name)


@pytest.mark.parametrize("name", ["fanuc", "pmac", "smoothieware"])
def test_tables_counted_from_the_machine_zero_must_be_zero_there(name):
    angles = even(36)
    table = table_from_result(result_of(angles, wavy(angles)), reference_angle=2.0)
    with pytest.raises(ConfigurationError, match="move the reference angle to 0"):
        export(table, name)
    assert export(table, name, reference_angle=0.0).residual.stated < 15 * ARCSEC


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


@pytest.mark.parametrize(
    ("name", "values", "rows", "text"),
    [
        ("sinumerik", {}, 360, r"361, and the controller holds 200.*MD38000"),
        ("sinumerik", {"tables": "cec"}, 360, r"holds 200.*MD18342"),
        ("fanuc", {"reference_slot": 100}, 36, r"136, and the controller holds 127"),
        ("twincat", {"max_points": 37}, 36, r"37, and the controller holds 36.*P-COMP-00059"),
        ("heidenhain", {}, 360, r"361, and the controller holds 256"),
        ("fagor", {"max_points": 30}, 36, r"37, and the controller holds 30"),
        ("pmac", {"counts_per_turn": 1000}, 36, r"whole steps of 0.36 deg"),
        ("twincat", {}, 7, r"whole steps of 0.0001 deg"),
        ("encoder_lut", {"points": 200}, 100, r"100 rows, and the firmware has 200 values"),
    ],
)
def test_limits_are_errors_with_the_number(name, values, rows, text):
    refuse_rows(name, values, rows, text)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("sinumerik", {"measuring_system": 2}),
        ("fanuc", {"reference_slot": 200}),
        ("fanuc", {"axis_number": 33}),
        ("fanuc", {"detection_unit_deg": 1.0}),
        ("twincat", {"max_points": 0}),
        ("pmac", {"counts_per_turn": 359}),
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
        ("aerotech", {"axis_number": 0}),
        ("aerotech", {"first_turn": -1}),
        ("acs", {"zone": -1}),
        ("mach4", {"directions": "both"}),
        ("centroid", {"units": "DEG"}),
        ("encoder_lut", {"form": "as5600"}),
        ("encoder_lut", {"points": 65537}),
        ("smoothieware", {"letter": "A"}),
    ],
)
def test_settings_out_of_range_are_refused(name, values):
    with pytest.raises(ConfigurationError, match=name):
        make_controller(name, values)


def test_the_name_of_an_axis_is_no_program():
    with pytest.raises(ConfigurationError, match="axis name"):
        make_controller("sinumerik", {"axis_name": "C1\n$MN"})
