"""Every file of these controllers, letter by letter, and damage to it, as of the core's."""

from dataclasses import replace

import numpy as np
import pytest
from compensation_examples import d4_table, two_ways
from controls_beside_the_core import CONTROLS
from test_written_files import assert_damage_named, assert_marked_as_simulated, write_and_read

from rotcal_ros.compensation.controllers import make_controller
from rotcal_ros.foundation.errors import BagError
from rotcal_ros.foundation.observations import Approach
from rotcal_ros.foundation.units import DEGREE

CEC = """\
$AN_CEC_INPUT_AXIS[{0}]=(C1)
$AN_CEC_OUTPUT_AXIS[{0}]=(C1)
$AN_CEC_STEP[{0}]=90.0000000
$AN_CEC_MIN[{0}]=0.0
$AN_CEC_MAX[{0}]=360.0
$AN_CEC_DIRECTION[{0}]={1}
$AN_CEC_MULT_BY_TABLE[{0}]=0
$AN_CEC_IS_MODULO[{0}]=1
"""


def cec_values(index, values):
    return "".join(f"$AN_CEC[{index},{k}]={value}\n" for k, value in enumerate(values.split()))


def enc_comp(system, axis, values):
    lines = [f"$AA_ENC_COMP[{system},{k},{axis}]={v}\n" for k, v in enumerate(values.split())]
    end = (
        f"$AA_ENC_COMP_STEP[{system},{axis}]=90.0000000\n$AA_ENC_COMP_MIN[{system},{axis}]=0.0\n"
        f"$AA_ENC_COMP_MAX[{system},{axis}]=360.0\n$AA_ENC_COMP_IS_MODULO[{system},{axis}]=1\n"
    )
    return f"%_N_AX_EEC_INI\nCHANDATA(1)\n{''.join(lines)}{end}M17\n"


def nc_table(way, values):
    rows = [
        f"        (Position := {90 * k}.000000, Compensation := {value}00)"
        for k, value in enumerate(values.split())
    ]
    return (
        f"    C1_{way}_parameter : ST_PositionCompensationTableParameter := (\n"
        "        MinPosition := 0.0, MaxPosition := 360.0, NoOfTableElements := 5,\n"
        f"        Direction := WorkDirection{way}, Modulo := TRUE);\n"
        f"    C1_{way}_table : ARRAY [0..4] OF ST_PositionCompensationTableElement := [\n"
        + ",\n".join(rows)
        + "\n    ];\n"
    )


UP = "0.0000000 -0.0050000 0.0030000 -0.0010000 0.0000000"
DOWN = "0.0020000 -0.0030000 0.0050000 0.0010000 0.0020000"
FILES = {
    "heidenhain": ({}, {
        "x.COM": "BEGIN x.COM\nNR AXISPOS BACKLASH C1\n"
        "0 0.00000 -0.00200 0.00000\n1 90.00000 0.00300 0.00500\n2 180.00000 -0.00500 -0.00300\n"
        "3 270.00000 -0.00100 0.00100\n4 360.00000 -0.00200 0.00000\n[END]\n",
        "x.CMA": "BEGIN x.CMA\nNR ACTIVE C1\n0 * x\n[END]\n",
    }),
    "heidenhain difference": ({"backlash": "difference"}, {
        "x.COM": "BEGIN x.COM\nNR AXISPOS BACKLASH C1\n"
        "0 0.00000 -0.00200 0.00000\n1 90.00000 -0.00200 0.00500\n2 180.00000 -0.00200 -0.00300\n"
        "3 270.00000 -0.00200 0.00100\n4 360.00000 -0.00200 0.00000\n[END]\n",
        "x.CMA": "BEGIN x.CMA\nNR ACTIVE C1\n0 * x\n[END]\n",
    }),
    "fagor": ({}, {
        "x.txt": "P001 C1 0.0000 EC1 0.0000 EC1 -0.0020\nP002 C1 90.0000 EC1 0.0050 EC1 0.0030\n"
        "P003 C1 180.0000 EC1 -0.0030 EC1 -0.0050\nP004 C1 270.0000 EC1 0.0010 EC1 -0.0010\n"
        "P005 C1 360.0000 EC1 0.0000 EC1 -0.0020\n",
    }),
    "pmac": ({"motor": 4, "counts_per_turn": 36_000, "reversal": "mean"}, {
        "x.pmc": "#4 DELETE BLCOMP\n#4 DELETE COMP\n#4 DEFINE COMP 4,36000\n-8 5 -2 0\n"
        "I51=1\n",  # a unit of 0.000625 deg
    }),
    "kflop": ({}, {
        "x.txt": "5\n90.000000\n0.000000\n0,0.000000000\n1,89.995000000\n2,180.003000000\n"
        "3,269.999000000\n4,360.000000000\n",
    }),
    "aerotech": ({"axis_number": 4}, {
        "x.cal": ":START 4 SAMPLEDIST=90.000000 POSUNIT=PRIMARY CORUNIT=PRIMARY/3600\n"
        "0.0000 -18.0000 10.8000 -3.6000 0.0000\n:END\n",
    }),
    "acs": ({"axis_number": 2, "zone": 1}, {
        "x.prg": "GLOBAL REAL C1_CORRECTION(5)\nC1_CORRECTION(0)=0.000000000\n"
        "C1_CORRECTION(1)=-0.005000000\nC1_CORRECTION(2)=0.003000000\n"
        "C1_CORRECTION(3)=-0.001000000\nC1_CORRECTION(4)=0.000000000\nERRORUNMAP 2, 1\n"
        "ERRORMAP1D 2, 1, 0.000000, 90.000000, C1_CORRECTION\nERRORMAPON 2, 1\nSTOP\n",
    }),
    "centroid": ({}, {  # a head as in the lathe's cnc-x.tab
        "x.tab": "CNC10 TAB FILE VERSION 3\nAXIS C1\nUNITS MM\nINTERVAL 90.0000\nENTRIES 5\n"
        "0.0000\t0.00000\t0.00200\n90.0000\t-0.00500\t-0.00300\n"
        "180.0000\t0.00300\t0.00500\n270.0000\t-0.00100\t0.00100\n"
        "360.0000\t0.00000\t0.00200\n",
    }),
    "mach4": ({"directions": "each"}, {
        "x.txt": "Start Point 0.000000\nLength 360.000000\nNumber of Points 5\n"
        "Position Error positive Error negative\n0.000000 0.000000 0.002000\n"
        "90.000000 -0.005000 -0.003000\n180.000000 0.003000 0.005000\n"
        "270.000000 -0.001000 0.001000\n360.000000 0.000000 0.002000\n",
    }),
    "encoder_lut": ({"points": 4, "counts_per_turn": 360_000}, {
        "x.h": "int16_t encoder_lut[4] = {\n0, -5, 3, -1\n};\n",
    }),
    "encoder_lut simplefoc": ({"points": 4, "form": "simplefoc"}, {
        "x.h": "uint16_t calibrationLut[4] = {\n32767, 32766, 32768, 32767\n};\n",
    }),
    "encoder_lut servo": ({"points": 4, "form": "servo", "counts_per_turn": 40_000}, {
        "x.h": "uint16_t FlashCalData[4] = {\n0, 9999, 20000, 30000\n};\n",
    }),
    "twincat_nc each": ({"directions": "each"}, {
        "x.st": "VAR_GLOBAL\n" + nc_table("Positive", UP) + nc_table("Negative", DOWN)
        + "END_VAR\n",
    }),
    "sinumerik": ({"measuring_system": 1, "axis_name": "B2"}, {
        "x.ini": enc_comp(1, "B2", "0.0000000 0.0050000 -0.0030000 0.0010000 0.0000000"),
    }),
    "sinumerik cec": ({"tables": "cec", "first_cec_table": 6}, {
        "x.ini": "%_N_NC_CEC_INI\nCHANDATA(1)\n" + cec_values(6, UP) + CEC.format(6, 1)
        + cec_values(7, DOWN) + CEC.format(7, -1) + "M17\n",
    }),
    "sinumerik cec turned": ({"tables": "cec", "cec_adds": False}, {
        "x.ini": "%_N_NC_CEC_INI\nCHANDATA(1)\n"
        + cec_values(0, "0.0000000 0.0050000 -0.0030000 0.0010000 0.0000000") + CEC.format(0, 1)
        + cec_values(1, "-0.0020000 0.0030000 -0.0050000 -0.0010000 -0.0020000")
        + CEC.format(1, -1) + "M17\n",
    }),
    "fanuc": ({"reference_slot": 60, "axis_number": 5, "magnification": 2}, {  # steps of 0.002
        "x.txt": "%\nN03620A5P60;\nN03621A5P60;\nN03622A5P64;\nN03623A5P2;\n"
        "N03624A5P90.000000;\nN03625A5P360.0;\n"
        "N10060P1;\nN10061P-3;\nN10062P5;\nN10063P-3;\nN10064P1;\n%\n",
    }),
}  # fmt: skip


@pytest.mark.parametrize("variant", FILES)
def test_files_letter_by_letter(variant):
    settings, expected = FILES[variant]
    write_and_read(make_controller(variant.split()[0], settings), expected)


@pytest.mark.parametrize(("directional", "lines"), [(False, 6 + 5), (True, 6 + 10)])
def test_twincat_writes_two_columns_only_for_two_directions(directional, lines):
    table = d4_table()
    table = table if directional else replace(table, correction_reverse=table.correction_forward)
    text = make_controller("twincat").write(table, "x")["x.lis"]
    assert len(text.splitlines()) == lines
    assert f"kw.ssfk.bilateral {int(directional)}\n" in text


def test_pmac_writes_a_backlash_table_only_for_two_directions():
    table = replace(d4_table(), correction_reverse=d4_table().correction_forward)
    text = make_controller("pmac").write(table, "x")["x.pmc"]
    assert (
        text == "#1 DELETE BLCOMP\n#1 DELETE COMP\n#1 DEFINE COMP 4,360000\n-80 48 -16 0\nI51=1\n"
    )


PLAY = "#4 DEFINE BLCOMP 4,36000\n0 0 1 0\nI485=16\nI486=3\nI51"
DAMAGE = [
    ("heidenhain", "BEGIN x.COM", "x.COM", "expected BEGIN in the first line and"),
    ("heidenhain", "0.00000\n[END]", "0.00000", "expected BEGIN in the first line and"),
    ("heidenhain", "0 * x", "0 * y", "the .CMA table does not name x.COM"),
    ("heidenhain", "270.00000 -0.00100", "270.0 x", r"x\.COM, row 4: found 'x', expected a num"),
    ("fagor", "P003 C1", "P003 B", r"x\.txt, line 3: 'P003 B .* is not a line such as P001 C"),
    ("fagor", "270.0000", "nan", r"x\.txt, line 4: found 'nan', expected a number"),
    ("pmac", "-2 0\n", "-2 1\n", r"x\.pmc, COMP: entries, counts per turn and last entry are "
     r"\(4, 36000, 1\), expected \(4, 36000, 0\)"),
    ("pmac", "COMP 4,36000\n-8", "COMP 5,36000\n-8", r"are \(4, 36000, 0\), expected \(5, 36000"),
    ("pmac", "COMP 4,36000\n-8", "COMP 4,36001\n-8", r"are \(4, 36001, 0\), expected \(4, 36000"),
    ("pmac", "#4 DEFINE COMP", "#3 DEFINE COMP", r"x\.pmc: no DEFINE COMP for motor 4"),
    ("pmac", "I51", PLAY.replace("4,3", "2,3").replace("0 0 1", "1"), "4 entries in COMP, 2 in"),
    ("pmac", "I51", PLAY.replace("I486=3", "I486=-3"), "I486 is -3, expected 0 .. 8388607"),
    ("pmac", "I51", PLAY.replace("I485=16", "I485=0"), "BLCOMP, I486 and an I485 above 0 go toge"),
    ("pmac", "I51", PLAY.replace("I485=16\n", ""), "BLCOMP, I486 and an I485 above 0 go together"),
    ("pmac", "I51", PLAY.replace("I486=3\n", ""), "BLCOMP, I486 and an I485 above 0 go together"),
    ("pmac", "I51", "I485=16\nI486=3\nI51", "BLCOMP, I486 and an I485 above 0 go together"),
    ("pmac", "5 -2", "x -2", r"x\.pmc, COMP: found 'x', expected a whole number"),
    ("kflop", "5\n90", "6\n90", r"x\.txt: 5 points, expected 6: 0, 1, \.\. 5"),
    ("kflop", "3,269", "4,269", r"x\.txt: 5 points, expected 5: 0, 1, \.\. 4"),
    ("kflop", "5\n90", "5\n80", r"5 points every 80 deg from 0, expected 0 \.\. 360 deg"),
    ("kflop", "90.000000\n0.0", "90\n9.0", r"every 90 deg from 9, expected 0 \.\. 360 deg"),
    ("kflop", "2,180.0", "2;180.0", r"x\.txt, row 3: 1 columns, expected 2"),
    ("kflop", "1,89.995000000\n2,180.003000000\n3,269.999000000\n", "", "and at least 3"),
    ("twincat_nc each", "END_VAR", "", "expected exactly VAR_GLOBAL, parameters and a table"),
    ("twincat_nc each", ")\n    ];", "),\n    ];", "expected exactly VAR_GLOBAL"),
    ("twincat_nc each", "WorkDirectionNegative", "WorkDirectionBoth", "Positive, Both, expect"),
    ("twincat_nc each", "WorkDirectionNegative", "WorkDirectionPositive", "Positive, Positive, e"),
    ("twincat_nc each", "Elements := 5", "Elements := 4", r"C1_Positive: 5 rows, and the param"),
    ("twincat_nc each", "TRUE", "FALSE", r"x\.st, C1_Positive: 5 rows, .* and Modulo FALSE; exp"),
    ("twincat_nc each", "180.0", "170.0", "the positions are not evenly spaced from 0 to 360 deg"),
    ("twincat_nc each", "0.000000000)\n", "0.000000001)\n", "does not close: it holds 0.0 at 0"),
    ("sinumerik", "M17", "M30", r"x\.ini, line 12: 'M30' is not an assignment such as \$AA_ENC_"),
    ("sinumerik", "CHANDATA(1)", "CHANDATA(2)", r"x\.ini, line 2: 'CHANDATA\(2\)' is not an as"),
    ("sinumerik", "COMP[1,3,B2]=", "COMP[1,4,B2]=", r"\$AA_ENC_COMP: 4 points from 0 to 360 deg "
     "every 90, expected all points"),
    ("sinumerik", "MAX[1,B2]=360.0", "MAX[1,B2]=270.0", "5 points from 0 to 270 deg every 90"),
    ("sinumerik", "MIN[1,B2]=0.0", "MIN[1,B2]=1.0", "5 points from 1 to 360 deg every 90"),
    ("sinumerik", "STEP[1,B2]=90.0", "STEP[1,B2]=80.0", "5 points from 0 to 360 deg every 80"),
    ("sinumerik", "STEP[1,", "STEPS[1,", r"\$AA_ENC_COMP_STEP: found 'nothing', expected a numb"),
    ("sinumerik", "MODULO[1,B2]=1", "MODULO[1,B2]=0", "does not close: IS_MODULO is 0, expected"),
    ("sinumerik", "IS_MODULO[1,", "MODULO[1,", "does not close: IS_MODULO is None, expected 1"),
    ("sinumerik", "0.0050000", "0.00x", r"\$AA_ENC_COMP point 1: found '0\.00x', expected a num"),
    ("sinumerik", "COMP[1,2,B2]", "COMP[1,b,B2]", r"\$AA_ENC_COMP index: found 'b', expected a w"),
    ("sinumerik cec", "DIRECTION[7]=-1", "DIRECTION[7]=1", "in the directions 1, expected 1 and"),
    ("sinumerik cec", "DIRECTION[7]", "DIR[7]", "in the directions 1, missing, expected 1 and -1"),
    ("sinumerik cec", "IS_MODULO[7]=1", "IS_MODULO[7]=0", r"\$AN_CEC does not close: IS_MODULO i"),
    ("fanuc", "N03620A5P60;\n", "", r"x\.txt: parameters \[3620\] are missing"),
    ("fanuc", "N03625A5P360.0;\n", "", r"x\.txt: parameters \[3625\] are missing"),
    ("fanuc", "3621A5P60", "3621A5P61", r"slots 61 \.\. 64 from 60, 90 deg apart in a turn of 36"),
    ("fanuc", "3625A5P360.0", "3625A5P180.0", "90 deg apart in a turn of 180 deg; expected"),
    ("fanuc", "P90.000000", "P80.000000", "80 deg apart in a turn of 360 deg; expected the first"),
    ("fanuc", "N10062P5;\n", "", r"not all slots 60 \.\. 64 are there"),
    ("fanuc", "N10060P1;\n", "", r"not all slots 60 \.\. 64 are there"),
    ("fanuc", "P5;", "P8;\n", r"x\.txt, line 11: '' is not a line such as N10061P-3;|add up to 3"),
    ("fanuc", "N10064P1", "N10064P2", r"add up to 1 \(expected 0\), the slot of the reference "
     r"holds 1 and the last 2 \(expected the same\), the largest is 5 \(at most 7\)"),
    ("fanuc", "N10060P1", "N10060P0", r"add up to 0 \(expected 0\), the slot of the reference "
     "holds 0 and the last 1"),
    ("fanuc", "P5;\nN10063P-3;", "P8;\nN10063P-6;", r"add up to 0 .* the largest is 8 \(at most"),
    ("fanuc", "P-3;\nN10062", "P-3.5;\nN10062", "slot 61: found '-3.5', expected a whole number"),
    ("fanuc", "3623A5P2", "3623A5P2.5", "parameter 3623: found '2.5', expected a whole number"),
]  # fmt: skip


@pytest.mark.parametrize(("variant", "before", "after", "words"), DAMAGE)
def test_damage_is_named(variant, before, after, words):
    settings, files = FILES[variant]
    controller = make_controller(variant.split()[0], settings)
    assert_damage_named(controller, files, before, after, words)


def twincat(n=4, last=0, **changes):
    head = {"unit": 1, "interval": 3_600_000 // n, "kw_startpos": 0, "kw_nr_max": n + 1,
            "bilateral": 1, "modulo": 1, **changes}  # fmt: skip
    values = [*range(0, 10 * n, 10), last]
    lines = [f"kw.ssfk.{key} {value}" for key, value in head.items() if value is not None]
    lines += [f"kw.ssfk.table[{k}].{way} {v}" for k, v in enumerate(values)
              for way in ("pos", "neg")]  # fmt: skip
    return {"x.lis": "\n".join(lines) + "\n"}


@pytest.mark.parametrize(
    ("n", "changes", "words"),
    [
        (4, {}, None),
        (2, {}, None),
        (1, {}, "unit 1, modulo 1 and 2 rows that cover 3600000 x 0.0001 deg; expected 1, 1 a"),
        (4, {"unit": 2}, "unit 2, modulo 1 and 5 rows that cover 3600000 x"),
        (4, {"modulo": 0}, "unit 1, modulo 0 and 5 rows that cover 3600000 x"),
        (4, {"interval": 899_999}, "5 rows that cover 3599996 x 0.0001 deg"),
        (4, {"interval": None}, "5 rows that cover 0 x 0.0001 deg"),
        (4, {"kw_nr_max": None}, "and 0 rows that cover 0 x 0.0001 deg"),
        (4, {"kw_nr_max": 6, "interval": 720_000}, r"table\[5\]\.pos is missing, of 6 points"),
        (4, {"last": 1}, r"does not close: it holds 0 at 0 and 1 at 360 deg, expected the same"),
        (4, {"unit": "1.5"}, r"x\.lis, line 1: found '1.5', expected a whole number"),
    ],
)
def test_twincat_lists_that_are_no_turn_are_named(n, changes, words):
    controller = make_controller("twincat")
    if words is None:
        rule = controller.read(twincat(n, **changes))
        at = rule.correction(np.array([360.0 * (n - 1) / n]) * DEGREE, Approach.POSITIVE)
        np.testing.assert_allclose(at, -10.0 * (n - 1) * 1e-4 * DEGREE)
        return
    with pytest.raises(BagError, match=words):
        controller.read(twincat(n, **changes))


def test_the_list_header_of_twincat_names_the_axis():
    """TF5200, list header: kopf.achs_nr and kopf.log_achs_name."""
    controller = make_controller("twincat", {"axis_number": 6})
    files = controller.write(d4_table(), "x")
    head, rest = files["x.lis"].split("kw.ssfk.unit", 1)
    assert head == "kopf.achs_nr 6\nkopf.log_achs_name C1\n"
    without = make_controller("twincat").write(d4_table(), "x")
    assert without["x.lis"] == f"kw.ssfk.unit{rest}"
    at = np.linspace(0.0, 6.0, 50)
    read = [controller.read(f).correction(at, Approach.POSITIVE) for f in (files, without)]
    np.testing.assert_array_equal(*read)


WITH_COMMENTS = {"sinumerik", "twincat", "twincat_nc", "pmac", "aerotech", "acs", "encoder_lut"}


@pytest.mark.parametrize("name", CONTROLS)
def test_a_simulated_table_says_so_inside_every_file_whose_form_has_comments(name):
    control, table = CONTROLS[name], two_ways(36)
    if control.kind == "pmac":  # from above it comes out higher
        table = replace(table, correction_reverse=table.correction_forward - 1e-4)
    assert_marked_as_simulated(control, control.kind in WITH_COMMENTS, table)
